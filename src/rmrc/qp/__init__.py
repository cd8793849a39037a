"""The program, its certificate and the backends that solve it."""
