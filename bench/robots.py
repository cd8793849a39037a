"""Every model file of other people's packages: does it load, and does the robot move?

The packages are installed into an environment of their own, from which files are only read. Each
file is loaded, inspected, and given to `rmrc init`; what that writes is run untouched and judged by
MuJoCo alone: the pose reached, the file's ranges and speeds held, equalities held, objects still.
"""

import argparse
import json
import multiprocessing
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import rmrc
from rmrc.config.compiled_scene import scene_of
from rmrc.errors import RmrcError
from rmrc.model.frames import resolve
from rmrc.model.located import root_tag
from rmrc.model.objects import Objects, bodies_of_equality
from rmrc.runs.init import init_scene
from rmrc.runs.inspect import inspect

HERE = Path(__file__).parent
ENVIRONMENT = HERE / "peers" / ".venvs" / "packages"
PACKAGES = {
    "example-robot-data": "cmeel.prefix",
    "robosuite": "robosuite",
    "gymnasium-robotics": "gymnasium_robotics",
    "dm_control": "dm_control",
    "metaworld": "metaworld",
    "gym-aloha": "gym_aloha",
    "pybullet": "pybullet_data",
    "playground": "mujoco_playground",
}
"""Packages, and where each has its models."""
LONGEST = 120.0
"""s, of one file; longer ones are counted as failed."""
REACHED = {"position": 1e-3, "orientation": 1e-2}
"""m and rad, as the configuration's own tolerance."""
HELD = 1e-6
"""m or rad that equalities and ranges may be off."""
RATE = 1e-6
"""Share of a joint's speed by which differences of q may be above it: they are rounded."""
STILL = 0.0
"""Objects do not move at all."""


def install(environment: Path) -> None:
    """Install the packages without what they depend on: only their files are read."""
    if not environment.exists():
        subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    python = environment / "bin" / "python"
    for package in PACKAGES:
        options = ["--quiet", "--no-deps", "--only-binary", ":all:"]
        subprocess.run([str(python), "-m", "pip", "install", *options, package], check=False)


def model_files(environment: Path, package: str) -> Iterator[Path]:
    """Yield the files of a package that are models of their own, not parts of others."""
    site = next((environment / "lib").glob("python3.*")) / "site-packages"
    folder = site / PACKAGES[package]
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".urdf", ".xacro") or (
            path.suffix == ".xml" and root_tag(path) == "mujoco"
        ):
            yield path


def included(paths: list[Path]) -> set[Path]:
    """Return the files that others include: parts, which may not stand alone."""
    parts = set()
    for path in paths:
        text = path.read_text(encoding="utf-8", errors="replace")
        for name in re.findall(r"<(?:xacro:)?include\s+file(?:name)?=\"([^\"]+)\"", text):
            parts.add((path.parent / name).resolve())
            parts.add((path.parent / Path(name).name).resolve())
    return parts


def tried(path: Path) -> dict[str, Any]:
    """Return what became of a file."""
    begin = time.time()
    result: dict[str, Any] = {"loaded": False}
    try:
        found = inspect(str(path))
        result |= {"loaded": True, "dofs": found["dofs"], "left_out": len(found["left_out"])}
        if not found["dofs"]:
            return result | {"verdict": "no joints"}
        with tempfile.TemporaryDirectory() as folder:
            said = init_scene(Path(folder) / "robot", str(path))
            config = rmrc.load(Path(folder) / "robot" / "config.yaml")
            result |= {"frame": said[0]} | judged(config)
        passed = not result["broken"] and result["converged"]
        result["verdict"] = "converged" if passed else "not converged"
    except RmrcError as error:
        result |= {"verdict": "refused", "reason": str(error).splitlines()[0][:300]}
    except Exception as fault:
        result |= {"verdict": "fault", "reason": f"{type(fault).__name__}: {fault}"[:300]}
    result["seconds"] = round(time.time() - begin, 2)
    return result


def judged(config: rmrc.Config) -> dict[str, Any]:
    """Run a configuration and return what MuJoCo says of it."""
    run = rmrc.solve(config)
    scene, problem = scene_of(config), rmrc.compile(config)
    model, broken = problem.model, {}
    task: Any = next(task for task in config.tasks if task.name == "hand")
    line: Any = config.targets["hand"]
    pose, goal = resolve(model, task.frame).pose_at(model, run.q[-1]), line.to
    off = float(np.linalg.norm(pose[4:] - np.array(goal.position)))
    turned = 0.0
    if goal.quaternion is not None:
        dot = abs(float(pose[:4] @ np.array(goal.quaternion)))
        turned = 2.0 * float(np.arccos(min(1.0, dot)))
    for joint in range(model.njnt):
        kind = model.jnt_type[joint]
        if kind not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            continue
        name, values = model.joint(joint).name, run.q[:, model.jnt_qposadr[joint]]
        low, high = model.jnt_range[joint]
        inside = model.jnt_limited[joint] and low - HELD <= values[0] <= high + HELD
        if inside and not (low - HELD <= values.min() and values.max() <= high + HELD):
            broken[f"range of {name}"] = float(max(low - values.min(), values.max() - high))
        most = scene.velocity.get(name)
        rate = np.abs(np.diff(values)).max() / config.dt
        if most is not None and rate > most * (1.0 + RATE) + RATE:
            broken[f"speed of {name}"] = float(rate / most)
    gap = equality_gap(model, run.q[-1], problem.objects)
    if gap > HELD:
        broken["equalities"] = gap
    moved = np.abs(run.q[:, problem.objects.coordinates] - run.q[0, problem.objects.coordinates])
    if moved.size and moved.max() > STILL:
        broken["objects"] = float(moved.max())
    reached = off <= REACHED["position"] and turned <= REACHED["orientation"]
    return {
        "converged": bool(reached),
        "off": off,
        "turned": turned,
        "equalities": gap,
        "broken": broken,
        "engine": run.summary["engine"],
        "step_us": run.summary["step_time_us"]["median"],
    }


def equality_gap(model: mujoco.MjModel, q: Any, objects: Objects) -> float:
    """Return the largest residual of the active equalities, as MuJoCo has it.

    Those of objects are what the scene makes them: nothing moves there.
    """
    data = mujoco.MjData(model)
    data.qpos = q
    mujoco.mj_forward(model, data)
    gaps = [
        abs(float(gap))
        for gap, kind, i in zip(data.efc_pos, data.efc_type, data.efc_id, strict=True)
        if kind == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        and not objects.bodies[bodies_of_equality(model, int(i))].any()
    ]
    return max(gaps, default=0.0)


def _worker(path: Path, pipe: Any) -> None:
    pipe.send(tried(path))


def tried_apart(path: Path) -> dict[str, Any]:
    """Return what became of a file in a process of its own, which may die or take too long."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    process = context.Process(target=_worker, args=(path, there))
    process.start()
    there.close()
    try:
        result = here.recv() if here.poll(LONGEST) else {"loaded": False, "verdict": "too long"}
    except EOFError:
        result = {"loaded": False, "verdict": "died"}
    process.kill()
    process.join()
    return result


def table(results: dict[str, dict[str, dict[str, Any]]]) -> str:
    """Return the results as a page."""
    lines = [
        "# Robots of others",
        "",
        "`make robots` gives every model file of these packages to `rmrc init` and runs what that",
        "writes, untouched, judged by MuJoCo alone. Parts that other files include and files of no",
        "joints (objects, arenas) are counted where they load.",
        "",
        "| package | files | load | with joints | converged |",
        "|---|---|---|---|---|",
    ]
    for package, files in results.items():
        loaded = [r for r in files.values() if r["loaded"]]
        moving = [r for r in loaded if r.get("dofs")]
        good = sum(r["verdict"] == "converged" for r in moving)
        lines.append(f"| {package} | {len(files)} | {len(loaded)} | {len(moving)} | {good} |")
    lines += ["", "## What does not, and why", ""]
    for package, files in results.items():
        for name, r in files.items():
            if r["verdict"] in ("converged", "no joints"):
                continue
            why = r.get("reason") or ", ".join(
                f"{k}: {v:.3g}" for k, v in r.get("broken", {}).items()
            )
            if not why and "off" in r:
                why = f"{r['off']:.3g} m and {r['turned']:.3g} rad off"
            part = " (a part of other files)" if r.get("part") else ""
            lines.append(f"- {package}: `{name}`{part}: {r['verdict']}{': ' if why else ''}{why}")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Try all files, and write what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--environment", type=Path, default=ENVIRONMENT)
    parser.add_argument("--packages", default=",".join(PACKAGES))
    parser.add_argument("--match", default="", help="only files whose path has this")
    parser.add_argument("--without", default=None, help="no files whose path has this")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--table", type=Path)
    arguments = parser.parse_args()
    if arguments.environment == ENVIRONMENT:
        install(ENVIRONMENT)
    results: dict[str, dict[str, dict[str, Any]]] = {}
    if arguments.json and arguments.json.exists():
        results = json.loads(arguments.json.read_text())
    for package in arguments.packages.split(","):
        paths = list(model_files(arguments.environment, package))
        parts, folder = included(paths), next((arguments.environment / "lib").glob("python3.*"))
        found = results.setdefault(package, {})
        for path in paths:
            name = str(path.relative_to(folder / "site-packages"))
            if arguments.match not in name or (arguments.without or "\0") in name:
                continue
            found[name] = tried_apart(path)
            if path.resolve() in parts:
                found[name]["part"] = True
            print(
                f"{found[name]['verdict']:<14} {name} {found[name].get('reason', '')}", flush=True
            )
        print(package, dict(Counter(result["verdict"] for result in found.values())), flush=True)
        if arguments.json:
            arguments.json.write_text(json.dumps(results, indent=1) + "\n")
    if arguments.table:
        arguments.table.write_text(table(results))


if __name__ == "__main__":
    main()
