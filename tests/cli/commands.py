"""The command line in this process, which spares a test the imports of another."""

import contextlib
import io
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

from rmrc.cli import main


def rmrc(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Return how a command ends in a folder, and what it says; it shows no traceback."""
    line = ["rmrc", *map(str, arguments)]
    out, err, code = io.StringIO(), io.StringIO(), 0
    with (
        contextlib.chdir(cwd),
        patch.object(sys, "argv", line),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
    done = subprocess.CompletedProcess(line, code, out.getvalue(), err.getvalue())
    assert "Traceback" not in done.stderr + done.stdout
    return done
