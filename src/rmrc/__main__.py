"""`python -m rmrc` is the command line."""

from rmrc.cli import main

main()
