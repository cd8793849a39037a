"""The C++ tests, `native/tests`, under the sanitizers of addresses and of undefined behaviour."""

import os
import shutil
import subprocess
import sysconfig
from pathlib import Path

import pytest

from compiler import compiler
from models import REPOSITORY

OPTIONS = ("-DRMRC_MODULE=OFF", "-DRMRC_TESTS=ON", "-DRMRC_SANITIZE=ON")


def test_the_cpp_tests_pass_under_the_sanitizers(tmp_path: Path) -> None:
    cxx = compiler(tmp_path, "-fsanitize=address,undefined")
    if cxx is None:
        pytest.skip("needs a C++20 compiler with sanitizers")
    programs = os.pathsep.join((sysconfig.get_path("scripts"), os.environ["PATH"]))
    cmake, ctest = shutil.which("cmake", path=programs), shutil.which("ctest", path=programs)
    if cmake is None or ctest is None:
        pytest.skip("needs CMake, of the extra `test`")
    build = tmp_path / "build"
    compiled_by = f"-DCMAKE_CXX_COMPILER={cxx}"
    for command in (
        [cmake, "-S", REPOSITORY / "native", "-B", build, compiled_by, *OPTIONS],
        [cmake, "--build", build, "--parallel", str(os.cpu_count())],
        [ctest, "--test-dir", build, "--output-on-failure"],
    ):
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, f"{command}:\n{done.stdout}\n{done.stderr}"
