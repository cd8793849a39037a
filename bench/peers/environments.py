"""The peers' environments: one for each, made from its requirements, with rmrc's version of MuJoCo.

Libraries on Pinocchio share a folder of their distributions and would replace each other's files in
one environment. The descriptions of robots are a wheel that is only read, never installed.
"""

import importlib.metadata
import subprocess
import sys
from pathlib import Path

REQUIREMENTS = Path(__file__).resolve().parent / "requirements"
ENVIRONMENTS = REQUIREMENTS.parent / ".venvs"
PEERS = ("mink", "pink", "placo")
ROBOTS = ENVIRONMENTS / "robots"
"""Where the wheel with the descriptions of robots is."""


def interpreter(peer: str) -> Path:
    """Return the Python of a peer's environment, which may not have been made."""
    return ENVIRONMENTS / peer / "bin" / "python"


def make(name: str) -> None:
    """Make the environment of a peer, or fetch the robots, unless it is there as required."""
    required = (REQUIREMENTS / f"{name}.txt").read_text()
    if name == "mink":
        required += f"mujoco=={importlib.metadata.version('mujoco')}\n"
    folder = ENVIRONMENTS / name
    stamp = folder / "requirements.txt"
    if stamp.is_file() and stamp.read_text() == required:
        return
    print(f"making bench/peers/.venvs/{name}", flush=True)
    pip = ("-m", "pip", "-qq", "--disable-pip-version-check")
    wanted = required.split()
    folder.mkdir(parents=True, exist_ok=True)
    if name == "robots":
        fetch = (*pip, "download", "--no-deps", "--dest", str(folder), *wanted)
        subprocess.run([sys.executable, *fetch], check=True)
    else:
        subprocess.run([sys.executable, "-m", "venv", "--clear", str(folder)], check=True)
        subprocess.run([interpreter(name), *pip, "install", *wanted], check=True)
    stamp.write_text(required)


def main() -> None:
    """Make all environments; a peer that cannot be installed here is left out by name."""
    for name in ("robots", *PEERS):
        try:
            make(name)
        except subprocess.CalledProcessError as failure:
            print(f"{name} is left out of the benchmarks: {failure}", file=sys.stderr)


if __name__ == "__main__":
    main()
