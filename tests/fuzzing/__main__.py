"""Run the fuzz for a while: `python -m fuzzing --seconds 60 --seed 0`."""

import argparse
import importlib.util
import sys
import tempfile
import traceback
from pathlib import Path
from time import perf_counter

import numpy as np


def load(path: str) -> None:
    """Have an extension that was built for the fuzz in place of the installed one."""
    spec = importlib.util.spec_from_file_location("rmrc._native", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules[spec.name] = module


def main() -> int:
    """Fuzz until the time is over; return 1 if a promise was broken."""
    parser = argparse.ArgumentParser(prog="fuzzing", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="how long to go on")
    parser.add_argument("--seed", type=int, default=0, help="the first case is this one")
    parser.add_argument("--cases", type=int, help="how many cases to run, in place of all")
    parser.add_argument("--only", choices=("programs", "controllers", "arguments"))
    parser.add_argument("--module", help="path of the extension, by default the installed one")
    options = parser.parse_args()
    if options.module:
        load(options.module)

    from fuzzing import arguments, controllers, programs

    end, failures, seed = perf_counter() + options.seconds, 0, options.seed
    counts: dict[str, int] = {"programs": 0, "controllers": 0, "arguments": 0}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        parts = {
            "programs": lambda rng: sum(programs.run(rng) for _ in range(10)),
            "controllers": lambda rng: controllers.run(rng, folder),
            "arguments": lambda rng: arguments.run(rng, folder),
        }
        while perf_counter() < end and (options.cases or np.inf) > seed - options.seed:
            for part, run in parts.items():
                if options.only in (None, part):
                    # Said before it is run: a sanitizer ends the process.
                    print(f"\r{part} {seed}", end="", file=sys.stderr, flush=True)
                    try:
                        counts[part] += run(np.random.default_rng([seed, len(part)]))
                    except Exception:
                        print(f"\n{part} --seed {seed}:\n{traceback.format_exc()}")
                        failures += 1
            seed += 1
    print(
        f"\n{seed - options.seed} seeds: {counts['programs']} hostile programs, "
        f"{counts['controllers']} steps, {counts['arguments']} engines with a changed argument; "
        f"{failures} failures"
    )
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
