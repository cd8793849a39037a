"""The extension and its C++ tests under the sanitizers, built once and kept from run to run."""

import contextlib
import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from compiler import compiler
from models import REPOSITORY

BUILD = REPOSITORY / "build" / "sanitized"
"""Where CMake builds, and the next time only what has changed."""
SANITIZERS = "-fsanitize=address,undefined"


@cache
def cpp() -> str:
    """Return the path of a compiler that has the sanitizers; the test is skipped without one."""
    BUILD.mkdir(parents=True, exist_ok=True)
    with alone():
        found = compiler(BUILD, SANITIZERS)
    if found is None:
        pytest.skip("needs a C++20 compiler with sanitizers")
    return found


@cache
def tool(name: str) -> str:
    """Return the path of one of CMake's programs; the test is skipped without it."""
    programs = os.pathsep.join((sysconfig.get_path("scripts"), os.environ["PATH"]))
    found = shutil.which(name, path=programs)
    if found is None:
        pytest.skip("needs CMake, of the extra `test`")
    return found


def build(*targets: str) -> Path:
    """Build targets of `native/CMakeLists.txt`, and return the folder that they are in.

    The core of the extension is compiled once for all of them.
    """
    options = ["-DRMRC_TESTS=ON", "-DRMRC_SANITIZE=ON"]
    has_nanobind = importlib.util.find_spec("nanobind") is not None
    options.append(f"-DRMRC_MODULE={'ON' if has_nanobind else 'OFF'}")
    if has_nanobind:
        import nanobind

        options += [
            f"-Dnanobind_DIR={nanobind.cmake_dir()}",
            f"-DPython_EXECUTABLE={sys.executable}",
        ]
    cpp()  # which waits for itself
    with alone():
        done([tool("cmake"), "-S", REPOSITORY / "native", "-B", BUILD, *options])
        jobs = str(os.cpu_count())
        done([tool("cmake"), "--build", BUILD, "--parallel", jobs, "--target", *targets])
    return BUILD


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """Wait until no other process builds: tests may run in several."""
    import fcntl  # not on Windows, which has no sanitizers of this kind

    with (BUILD / "lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def extension() -> Path:
    """Return the path of the extension; the test is skipped where it cannot be built."""
    if importlib.util.find_spec("nanobind") is None:
        pytest.skip("needs nanobind, of the extra `test`")
    name = f"_native{sysconfig.get_config_var('EXT_SUFFIX')}"
    return build("_native") / name


def runtime() -> dict[str, str]:
    """Return the environment in which Python can load it; the test is skipped without libasan."""
    libraries = []
    for name in ("libasan.so", "libstdc++.so"):
        command = [cpp(), f"-print-file-name={name}"]
        path = subprocess.run(command, capture_output=True, text=True).stdout.strip()
        if not Path(path).is_absolute():
            pytest.skip(f"needs {name}, which {cpp()} has not")
        libraries.append(path)
    return os.environ | {
        "LD_PRELOAD": " ".join(libraries),
        # CPython keeps what it has until it ends, and a size that is refused is an exception.
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "PYTHONPATH": str(REPOSITORY / "tests"),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }


def done(command: list[str | Path]) -> None:
    """Run a command, which must not fail."""
    # CMake asks for the compiler once: another one is another folder.
    environment = os.environ | {"CXX": cpp()}
    result = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert result.returncode == 0, f"{command}:\n{result.stdout}\n{result.stderr}"
