"""The command line."""

from rmrc.cli.commands import app, main

__all__ = ["app", "main"]
