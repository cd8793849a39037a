"""Both installs, with the native engine and in Python alone, and what the second says of itself."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from importlib.metadata import distribution, requires
from pathlib import Path
from typing import Any

import pytest

import rmrc
from compiler import compiler
from models import REPOSITORY
from rmrc.control.engines import NOT_BUILT, missing
from rmrc.record.run import MANIFEST

WITHOUT = "import sys; sys.modules['rmrc._native'] = None; from rmrc.cli import main; main()"
"""The command line where the extension cannot be imported."""
COMPILER = "import sys; sys.exit('no compiler here')"
"""What stands in for a compiler that fails."""
PARTS = ("src", "native", "scenes", "tasks", "configs", "pyproject.toml", "README.md", "LICENSE")
ABSENT = f"the native engine is not there: {NOT_BUILT}"
OLD_MUJOCO = "mujoco==3.10.*"
"""The oldest that the project admits."""
TOOLS = ("pyright", "ruff")
"""Of the extra `test`, what no test imports."""


def run(
    command: Iterable[object], folder: Path, environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(part) for part in command], cwd=folder, env=environment, capture_output=True, text=True
    )


def output(
    command: Iterable[object], folder: Path, environment: Mapping[str, str] | None = None
) -> str:
    """Return what a command prints; the test fails, with all that it said, if the command does."""
    done = run(command, folder, environment)
    assert done.returncode == 0, f"{done.args}:\n{done.stdout}\n{done.stderr}"
    return done.stdout


def solved(command: list[object], folder: Path, sources: Path = REPOSITORY) -> dict[str, Any]:
    """Run a configuration with an install's command line; return the manifest."""
    line = sources / "configs" / "panda_line.yaml"
    shown = output([*command, "solve", line, "--out", "run"], folder)
    manifest = json.loads((folder / "run" / MANIFEST).read_text())
    for notice in manifest["notices"]:
        assert " ".join(notice.split()) in " ".join(shown.split())
    return manifest


def assert_python_alone(command: list[object], folder: Path, sources: Path = REPOSITORY) -> None:
    """Everything runs, and says once why in Python; the native engine by name is an error."""
    manifest = solved(command, folder, sources)
    assert manifest["summary"]["engine"] == "python"
    assert [notice for notice in manifest["notices"] if "native" in notice] == [
        f"the Python engine runs: {ABSENT}"
    ]

    bench = output([*command, "bench"], folder)
    assert bench.count(ABSENT) == 1
    assert bench.count("native") == 1

    line = sources / "configs" / "panda_line.yaml"
    refused = run([*command, "solve", line, "--set", "engine=native"], folder)
    assert refused.returncode == 2
    said = " ".join(refused.stderr.split())
    assert f"native cannot run: {ABSENT}. With `engine: auto` the Python engine runs" in said
    assert "Traceback" not in said


def test_without_the_extension_everything_runs_and_says_so_once(tmp_path: Path) -> None:
    assert_python_alone([sys.executable, "-c", WITHOUT], tmp_path)


def test_where_a_compiler_works_the_extension_is_there(tmp_path: Path) -> None:
    """Without it all tests of the native engine are skipped, which nobody would see."""
    reason = missing()
    if reason is None:
        return
    found = compiler(tmp_path)
    if found is None:
        pytest.skip(f"no C++20 compiler with Python's headers: {reason}")
    pytest.fail(f"{found} compiles C++20, but the native engine is not there: {reason}")


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Skip the test, by name, where there is nothing to install from."""
    pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "nanobind"]
    if run(pip, tmp_path_factory.mktemp("index")).returncode:
        pytest.skip("needs a package index: pip finds no nanobind")


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """Return a copy of what the package is built from."""
    folder = tmp_path / "sources"
    folder.mkdir()
    for name in PARTS:
        part = REPOSITORY / name
        if part.is_dir():
            ignored = shutil.ignore_patterns("__pycache__", "*.so", "build")
            shutil.copytree(part, folder / name, ignore=ignored)
        else:
            shutil.copy(part, folder)
    return folder


def environment_at(folder: Path) -> Path:
    """Make a virtual environment; return the folder of its programs."""
    output([sys.executable, "-m", "venv", folder], folder.parent)
    return folder / ("Scripts" if os.name == "nt" else "bin")


@pytest.mark.slow
@pytest.mark.usefixtures("index")
def test_with_a_compiler_the_native_engine_is_installed(sources: Path, tmp_path: Path) -> None:
    if missing():
        pytest.skip("needs what the extension is compiled with")
    programs = environment_at(tmp_path / "with")
    output([programs / "python", "-m", "pip", "install", "--quiet", sources], tmp_path)
    command: list[object] = [programs / "rmrc"]
    manifest = solved(command, tmp_path, sources)
    assert manifest["summary"]["engine"] == "native"
    assert not [notice for notice in manifest["notices"] if "engine" in notice]
    assert "native engine: installed" in output([*command, "bench"], tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures("index")
def test_without_a_compiler_the_install_succeeds_in_python(sources: Path, tmp_path: Path) -> None:
    programs = environment_at(tmp_path / "without")
    failing = tmp_path / "failing"
    failing.write_text(f"#!{sys.executable}\n{COMPILER}\n")
    failing.chmod(0o755)
    outside = {key: value for key, value in os.environ.items() if key != "CMAKE_GENERATOR"}
    compilers = {"CC": str(failing), "CXX": str(failing), "PATH": str(programs)}
    install = [programs / "python", "-m", "pip", "install", "--quiet", sources]
    output(install, tmp_path, outside | compilers)
    assert_python_alone([programs / "rmrc"], tmp_path, sources)


@pytest.mark.slow
@pytest.mark.usefixtures("index")
@pytest.mark.parametrize("name", ["test_native_engine.py", "test_native_barriers.py"])
def test_the_same_build_runs_with_the_oldest_mujoco(old_mujoco: list[str], name: str) -> None:
    """Nothing of MuJoCo's is compiled in: its functions and arrays are found at run time."""
    python, packages = old_mujoco
    tests = Path("tests", "engines", name)
    options = ["-p", "no:cacheprovider", "-o", "addopts=", "-m", "not slow", "-q", "-rs"]
    told = output(
        [python, "-m", "pytest", tests, *options], REPOSITORY, os.environ | {"PYTHONPATH": packages}
    )
    assert " passed" in told
    assert "native extension is not built" not in told


@pytest.fixture(scope="module")
def old_mujoco(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return a Python with the oldest MuJoCo, and the path that has the present build for it."""
    if reason := missing():
        pytest.skip(f"there is no build to try: {reason}")
    from rmrc import _native

    folder = tmp_path_factory.mktemp("old")
    python = environment_at(folder / "environment") / "python"
    wanted = [line for line in requires("rmrc") or () if not line.startswith(("mujoco>", *TOOLS))]
    tested = [line.split(";")[0] for line in wanted if "extra ==" not in line or "test" in line]
    output([python, "-m", "pip", "install", "--quiet", OLD_MUJOCO, *tested], folder)

    packages = folder / "packages"
    shutil.copytree(Path(rmrc.__file__).parent, packages / "rmrc")
    shutil.copy(str(_native.__file__), packages / "rmrc")
    described = distribution("rmrc").locate_file(f"rmrc-{rmrc.__version__}.dist-info")
    shutil.copytree(Path(str(described)), packages / Path(str(described)).name)
    versions = output(
        [python, "-c", "import mujoco, rmrc._native as n; print(mujoco.__version__, n.__file__)"],
        folder,
        os.environ | {"PYTHONPATH": str(packages)},
    )
    assert versions.startswith(OLD_MUJOCO.removeprefix("mujoco==").removesuffix("*"))
    assert str(packages) in versions
    return [str(python), str(packages)]
