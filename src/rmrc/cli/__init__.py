"""The command line: every way out is an exit code and at most one clear message."""

import os
import sys

from rmrc.cli.commands import NOT_CONVERGED, OUR_FAULT, WRONG_INPUT, app
from rmrc.errors import INTERRUPTED, RmrcError, printable_lines


def main() -> None:
    """Run the command line; every way out is an exit code and at most one clear message."""
    try:
        app()
    except RmrcError as mistake:
        _complain(str(mistake), WRONG_INPUT)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(NOT_CONVERGED)
    except KeyboardInterrupt:
        _complain("interrupted", INTERRUPTED)
    except SystemExit as end:
        if end.code == INTERRUPTED:  # typer's, which says nothing
            _complain("interrupted", INTERRUPTED)
        raise
    except OSError as failure:
        _complain(str(failure), WRONG_INPUT)
    except Exception as fault:  # the last resort: a traceback is for us, not for users
        if os.environ.get("RMRC_TRACEBACK"):
            raise
        where = f"{type(fault).__name__}: {fault}"
        _complain(f"a fault of rmrc itself: {where} (RMRC_TRACEBACK=1 shows where)", OUR_FAULT)


def _complain(message: str, code: int) -> None:
    message = printable_lines(message)
    print(f"rmrc: {message}" if "\n" not in message else message, file=sys.stderr)
    sys.exit(code)
