"""The C++ compiler of this machine, if it has one that can build the extension."""

import os
import shutil
import subprocess
import sysconfig
from pathlib import Path

PROGRAM = (
    "#include <Python.h>\n#include <concepts>\n"
    "template <std::integral T> T same(T x) { return x; }\nint main() { return same(0); }\n"
)
"""What compiles where the extension does: C++20, with Python's headers."""


def compiler(folder: Path, *options: str) -> str | None:
    """Return the path of a compiler that builds C++20 with these options; tried in a folder."""
    (folder / "program.cpp").write_text(PROGRAM)
    include = f"-I{sysconfig.get_path('include')}"
    for name in (os.environ.get("CXX"), "c++", "g++", "clang++"):
        found = shutil.which(name) if name else None
        if not found:
            continue
        command = [found, "-std=c++20", include, *options, "program.cpp", "-o", "program"]
        if subprocess.run(command, cwd=folder, capture_output=True).returncode == 0:
            return found
    return None
