"""Hold the includes of native/ to one way: a folder sees itself and those before it, and no circle.

`python native/check_includes.py` prints what breaks that, and exits with 1 if anything does.
"""

import re
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

FOLDERS = ("base", "solver", "kinematics", "tasks", "limits", "engine", "control", "python")
"""In the order of the data."""
ANYWHERE = "tests"
"""What may see all folders, and is seen by none."""
INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)


def included(root: Path) -> dict[str, set[str]]:
    """Return what each source file includes of this folder's, by the text between its quotes."""
    files = sorted(root.rglob("*.[ch]pp"))
    return {
        file.relative_to(root).as_posix(): set(INCLUDE.findall(file.read_text("utf-8")))
        for file in files
    }


def mistakes(graph: dict[str, set[str]]) -> Iterator[str]:
    """Yield a sentence for each include that is not allowed, and for a circle."""
    for file, names in graph.items():
        folder = file.partition("/")[0]
        if folder not in (*FOLDERS, ANYWHERE) or "/" not in file:
            yield f"{file} is in none of the folders {', '.join((*FOLDERS, ANYWHERE))}"
            continue
        for name in sorted(names):
            other = name.partition("/")[0]
            if name not in graph:
                yield f'{file} includes "{name}", which is no file below native/'
            elif ANYWHERE in (folder, other):
                if folder != ANYWHERE:
                    yield f"{file} includes {name}: only tests may"
            elif FOLDERS.index(other) > FOLDERS.index(folder):
                yield f"{file} includes {name}: {other} comes after {folder}"
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as circle:
        yield f"a circle of includes: {' <- '.join(circle.args[1])}"


def main() -> int:
    """Print the mistakes of the folder that this file is in; return 1 if there are any."""
    found = list(mistakes(included(Path(__file__).parent)))
    for mistake in found:
        print(f"native: {mistake}", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
