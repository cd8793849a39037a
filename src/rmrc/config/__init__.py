"""Text to `Config`: reading with positions, the models, explaining mistakes.

Nothing is imported here: the tasks and paths take their base classes from `config.base`,
and `config.models` takes the tasks and paths in turn.
"""
