# Temporary pointer: the shared helper is tests/safety/matrix.py, because tests/regression/robots.py
# already has the module name `robots`. Use `from matrix import ...`. This file will be deleted.
