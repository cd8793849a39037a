"""What calls of CPython without Python need: the one place that touches its internals."""
