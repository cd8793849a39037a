"""Instructions of a step, which no load on the machine moves, counted by valgrind's callgrind.

Counted are the instructions in rmrc's extension, in MuJoCo and in the library of mathematics, over
steps on a fixed path: those of Python and of numpy are not, so that the count is that of the step.
`--check` fails where a case takes over 5 % more than in `bench/instructions.json`, which is of one
architecture, compiler and MuJoCo, and says nothing of others; without it the file is written.
"""

import json
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import mujoco

from timing import REPOSITORY, parser

BASELINE = REPOSITORY / "bench" / "instructions.json"
ALLOWED = 1.05
"""Times the instructions of the baseline."""
WARM_UP, STEPS = 100, 200
COUNTED = {"_native": "rmrc", "libmujoco": "mujoco", "libm.": "libm"}
"""Beginnings of the names of files, and what their instructions count as."""
MARKER = "mj_version"
"""A function of MuJoCo's that nothing calls but `walk`: the counts are written where it is called,
and begin anew."""


def circumstances() -> dict[str, str]:
    """Return what the counts depend on, beside the code.

    Raises:
        ImportError: If the extension is not there.
    """
    from rmrc import _native

    binary = Path(str(_native.__file__)).read_bytes()
    compiler = re.search(rb"GCC: [ -~]*|clang version [ -~]*", binary)
    return {
        "architecture": platform.machine(),
        "compiler": compiler[0].decode() if compiler else "unknown",
        "mujoco": mujoco.__version__,
    }


def walk() -> None:
    """Take the steps of each case that the native engine has, and print the names of the cases."""
    import rmrc
    from cases import ALOHA, COLLISION, G1, PANDA, offsets

    cases = {"panda": (PANDA, {}), "g1": (G1, {}), "aloha, collision": (ALOHA, COLLISION)}
    moves, walked = offsets(WARM_UP + STEPS), []
    for name, (case, limits) in cases.items():
        try:
            config = case.config(case.scene) | {"limits": limits}
            controller = rmrc.Controller(rmrc.compile(rmrc.Config.model_validate(config)))
        except rmrc.RmrcError as absent:
            print(f"{name} is left out: {absent}", file=sys.stderr)
            continue
        if controller.engine.name != "native":
            print(f"{name} is left out: it runs in Python", file=sys.stderr)
            continue
        terms = controller.problem.term
        poses = [(task, terms[task].target.copy()) for task in case.names]
        for k, move in enumerate(moves):
            if k == WARM_UP:
                mujoco.mj_version()
            for task, pose in poses:
                controller.set_target(task, pose[4:] + move, pose[:4])
            controller.step()
        mujoco.mj_version()
        walked.append(name)
    print(json.dumps(walked))


def counts(path: Path) -> dict[str, float]:
    """Return the instructions a step in each of the counted files, and their sum."""
    names: dict[str, str] = {}
    found: Counter[str] = Counter()
    at, called = "", False
    with path.open() as lines:
        for line in lines:
            if match := re.match(r"(c?)ob=(\(\d+\))(?: (.*))?", line):
                if match[3]:
                    names[match[2]] = Path(match[3]).name
                at = at if match[1] else names[match[2]]
            elif line.startswith("calls="):
                called = True  # the next line is what a called function took
            elif line[0].isdigit():
                if not called:
                    found[at] += int(line.split()[1])
                called = False
    of = {
        name: sum(count for at, count in found.items() if at.startswith(file)) / STEPS
        for file, name in COUNTED.items()
    }
    return {"instructions": sum(of.values()), **of}


def measure() -> dict[str, Any]:
    """Return the instructions of a step by case."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "counts"
        command = [
            "valgrind", "--tool=callgrind", f"--dump-before={MARKER}", "--compress-pos=no",
            f"--callgrind-out-file={out}", sys.executable, __file__, "--walk",
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(done.stderr)
        for line in re.findall(".* is left out: .*", done.stderr):
            print(line)
        walked = json.loads(done.stdout)
        cases = {name: counts(Path(f"{out}.{2 * k + 2}")) for k, name in enumerate(walked)}
    return {**circumstances(), "steps": STEPS, "cases": cases}


def grown(found: dict[str, Any], baseline: dict[str, Any]) -> list[str]:
    """Return what is to say of each case that takes more instructions than it may."""
    return [
        f"{name}: {count['instructions']:,.0f} instructions a step, {now:.3f} times the baseline"
        for name, count in found["cases"].items()
        if name in baseline["cases"]
        and (now := count["instructions"] / baseline["cases"][name]["instructions"]) > ALLOWED
    ]


def obstacle(baseline: dict[str, Any] | None) -> str | None:
    """Return why nothing can be counted, or compared with a baseline, or None."""
    if not shutil.which("valgrind"):
        return "there is no valgrind"
    try:
        here = circumstances()
    except ImportError as failure:
        return f"there is no native engine: {failure}"
    for name, value in here.items():
        if baseline and baseline[name] != value:
            return f"the baseline is of {name} {baseline[name]}, and here it is {value}"
    return None


def main() -> None:
    """Count, print a row for each case, and write the baseline or hold the counts to it."""
    command = parser(__doc__)
    command.add_argument("--check", action="store_true", help="compare with the baseline")
    command.add_argument("--walk", action="store_true", help="take the steps that are counted")
    arguments = command.parse_args()
    if arguments.walk:
        return walk()
    baseline = json.loads(BASELINE.read_text()) if arguments.check else None
    if reason := obstacle(baseline):
        print(f"skipped: {reason}")
        return None
    found = measure()
    for name, count in found["cases"].items():
        parts = ", ".join(f"{count[part]:,.0f} in {part}" for part in COUNTED.values())
        print(f"{name:17} {count['instructions']:9,.0f} instructions a step: {parts}")
    if baseline is None:
        BASELINE.write_text(json.dumps(found, indent=2) + "\n")
    elif more := grown(found, baseline):
        raise SystemExit("\n".join(more))
    return None


if __name__ == "__main__":
    main()
