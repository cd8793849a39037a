"""Fuzz of the extension, for the sanitizers: what comes in may be anything, what comes out may not.

`python -m fuzzing --help`, from the folder `tests`, says how to run it by hand.
"""
