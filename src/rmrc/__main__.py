"""`rmrc` and `python -m rmrc`: the command line, which may be interrupted while it is imported."""

import sys

from rmrc.errors import INTERRUPTED


def main() -> None:
    """Run the command line.

    It takes a good part of a second to import, more than it takes to change one's mind.
    """
    try:
        from rmrc.cli import main as run_command

        run_command()
    except KeyboardInterrupt:
        print("rmrc: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
