"""A side in a process and an environment of its own: takes the steps that it is told to, and says
how long each of them took."""

import importlib
import json
import os
import sys
import warnings
from importlib.metadata import version
from pathlib import Path

from side import timed


def main() -> None:
    """Answer each line "begin end" with the times of those steps in µs and where they led."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what the libraries print is no answer
    warnings.simplefilter("ignore")  # of backends that are tried and not taken
    name, option, work = sys.argv[1:]
    module = importlib.import_module(f"with_{name}")
    side = module.build(json.loads(Path(work).read_text()), option)
    versions = {name: version(name) for name in module.PACKAGES}
    print(json.dumps({"solver": side.solver, "versions": versions}), file=answers)
    answers.flush()
    for line in sys.stdin:
        begin, end = map(int, line.split())
        times = [timed(side.step, k) for k in range(begin, end)]
        print(json.dumps({"times": times, "q": side.configuration().tolist()}), file=answers)
        answers.flush()


if __name__ == "__main__":
    main()
