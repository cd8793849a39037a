"""`rmrc init`: a folder with a configuration and a stack of one's own, which run at once."""

import json
import re
from os.path import relpath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rmrc.config.compiled_scene import scene_of
from rmrc.config.models import Config
from rmrc.config.schema import schema
from rmrc.control.controller import Controller
from rmrc.errors import ModelError, RmrcError, unknown_name
from rmrc.model.configuration import free_dofs
from rmrc.model.frames import resolve
from rmrc.model.locate import DESCRIPTIONS, MENAGERIE
from rmrc.model.objects import find_objects
from rmrc.problem.compile import compile
from rmrc.problem.problem import Problem
from rmrc.runs.end_effector import find_end_effector, scalar_joints_above
from rmrc.runs.solve import solve

Array = NDArray[np.float64]

CONFIG, STACK, SCHEMA = "config.yaml", "tasks.yaml", "rmrc.schema.json"
DEFAULT = "scenes/panda.xml"
"""The scene where none is named."""
DT, DURATION, SETTLING = 0.005, 4.0, 1.0
"""s: of a step, of the line, and after it."""
WAYS = (0.25, 0.1, 0.03, 0.01)
"""rad or m that joints move for the end of the line, the first that is reached."""
SHARE_OF_RANGE, SHARE_OF_SPEED = 0.25, 0.25
"""Most that a joint moves, of its range, and of what its speed allows in the time of the line."""
FULL = 6
"""Joints from which on an orientation can be asked for."""
FASTEST = 2.0
"""rad/s or m/s, of joints whose file allows more."""
BASE = {"linear": 0.5, "angular": 1.0}
"""m/s and rad/s of a floating base."""
TASK, POSTURE, GAIN = "hand", "posture", 20.0

_HEAD = "# yaml-language-server: $schema=rmrc.schema.json\n"


def shipped() -> Path:
    """Return the folder with the scenes, stacks and configurations that come with rmrc."""
    package = Path(__file__).parents[1]
    for folder in (package / "data", package.resolve().parents[1]):
        if (folder / DEFAULT).is_file():
            return folder
    raise RmrcError("rmrc was installed without its scenes; install it from its wheel")


def examples() -> dict[str, str]:
    """Return the shipped configurations by name, each with what it shows."""
    return {
        path.stem: _first_words(path) for path in sorted((shipped() / "configs").glob("*.yaml"))
    }


def _first_words(path: Path) -> str:
    lines = (line for line in path.read_text(encoding="utf-8").splitlines() if line[:2] == "# ")
    return next((line[2:] for line in lines if "yaml-language-server" not in line), "")


def init_example(folder: Path, name: str) -> list[str]:
    """Copy a shipped configuration with its scene and its stacks; return what to say.

    Raises:
        RmrcError: If there is none of that name, or a file is there already.
    """
    source, known = shipped(), examples()
    if name not in known:
        raise RmrcError(unknown_name("example", name, known, limit=len(known)))
    texts = _with_parts(source, source / "configs" / f"{name}.yaml")
    _write(folder, {**texts, SCHEMA: _schema()})
    config = folder / "configs" / f"{name}.yaml"
    return [*(f"wrote {folder / path}" for path in texts), f"run it: rmrc solve {config}"]


def _with_parts(source: Path, file: Path) -> dict[str, str]:
    """Return the text of a shipped file and of those that it names, by their places in `source`."""
    waiting, texts = [file], {}
    while waiting:
        path = waiting.pop()
        place = path.relative_to(source).as_posix() if source in path.parents else ""
        if not place or place in texts or not path.is_file():
            continue
        texts[place] = path.read_text(encoding="utf-8")
        named = re.findall(r"(?:scene|use|path): *([^\s,}#]+)|file=\"([^\"]+)\"", texts[place])
        waiting += [(path.parent / part).resolve() for pair in named for part in pair if part]
    return texts


def init_scene(folder: Path, scene: str | None, frame: str | None = None) -> list[str]:
    """Write a configuration and a stack for a robot; return what to say.

    The end effector is found, the line that it follows ends where the robot can be, and the run
    has been tried before it is written.

    Args:
        folder: The folder, made if it is not there.
        scene: The robot as `scene` names it, from the present folder; by default a shipped arm.
        frame: The site or body that moves; by default the end effector.

    Raises:
        RmrcError: If there is no such robot, it cannot move, or a file is there already.
    """
    texts: dict[str, str] = {}
    if scene is None:
        named, tried = DEFAULT, str(shipped() / DEFAULT)
        texts = _with_parts(shipped(), shipped() / DEFAULT)
    else:
        named = scene if scene.startswith((MENAGERIE, DESCRIPTIONS)) else _from(folder, scene)
        tried = scene
    plan = _Plan(tried, frame)
    texts |= {CONFIG: plan.config_text(named), STACK: _STACK, SCHEMA: _schema()}
    _write(folder, texts)
    return [
        f"{plan.effector.kind} '{plan.effector.name}' is the end effector"
        + (f"; as likely: {', '.join(plan.alike)} (--frame takes another)" if plan.alike else ""),
        *([] if plan.converged else ["no line was found that the robot follows to its end"]),
        *(f"wrote {folder / name}" for name in texts if name != SCHEMA),
        f"run it: rmrc solve {folder / CONFIG}",
    ]


def _from(folder: Path, scene: str) -> str:
    try:
        return relpath(Path(scene).expanduser().resolve(), folder.resolve())
    except ValueError:  # on another drive
        return str(Path(scene).resolve())


def _schema() -> str:
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"


def _write(folder: Path, texts: dict[str, str]) -> None:
    taken = [name for name in texts if (folder / name).exists() and name != SCHEMA]
    if taken:
        raise RmrcError(f"{folder / taken[0]} is there already; choose another folder")
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


class _Plan:
    """Finds the frame, and a line to where the robot can take it."""

    def __init__(self, scene: str, frame: str | None):
        still = Config.model_validate({"scene": scene, "tasks": [_posture(1.0)]})
        model = scene_of(still).model
        if not model.nv:
            raise ModelError("this model has no joints: nothing can move")
        self.effector, self.alike = find_end_effector(model, find_objects(model, ()), frame)
        self.joints = scalar_joints_above(model, self.effector.body)
        self.oriented = self.joints.size >= FULL
        self._values: dict[str, Any] = {"scene": scene, "dt": DT, "duration": DURATION + SETTLING}
        problem = compile(self._config(_posture(1.0), self._task(0.0)))
        free = np.intersect1d(free_dofs(problem.model), problem.dofs)
        self.floats = bool(free.size)
        if self.floats:
            self._values["limits"] = {"base": BASE}
        self.converged = False
        for way in WAYS:
            self.pose = self._end(problem, way)
            self.converged = self._arrives()
            if self.converged:
                break

    def _config(self, *tasks: dict[str, Any], **values: Any) -> Config:
        return Config.model_validate({**self._values, "tasks": list(tasks), **values})

    def _end(self, problem: Problem, way: float) -> Array:
        """Return the frame's pose (7,), wxyz + xyz, after the joints have gone a way."""
        model, goal = problem.model, problem.start.copy()
        places = {dof: k for k, dof in enumerate(problem.dofs.tolist())}
        for joint in self.joints.tolist():
            dof, at = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
            if dof not in places:
                continue
            low, high = problem.box.lower[places[dof]], problem.box.upper[places[dof]]
            speed = min(problem.box.velocity[places[dof]], FASTEST)
            most = min(way, SHARE_OF_SPEED * speed * DURATION)
            inward = 1.0
            if np.isfinite([low, high]).all():
                most = min(most, SHARE_OF_RANGE * (high - low))
                inward = np.sign(0.5 * (low + high) - goal[at]) or 1.0
            goal[at] += inward * most
        controller = Controller(problem)
        controller.set_target(POSTURE, q=goal)
        q = problem.start
        for _ in range(round(DURATION / DT)):
            q = controller.step(q).q
        return resolve(model, self.effector.frame).pose_at(model, q)

    def _arrives(self) -> bool:
        """Return whether the run that would be written converges."""
        config = self._config(self._task(1.0), _posture(0.01), targets={TASK: self._line()})
        try:
            return bool(solve(config).summary["converged"])
        except RmrcError:
            return False

    def _weight(self) -> dict[str, float]:
        return {"position": 1.0, "orientation": 0.5 if self.oriented else 0.0}

    def _task(self, share: float) -> dict[str, Any]:
        weight = {key: share * value for key, value in self._weight().items()}
        frame = {self.effector.kind: self.effector.name}
        return {"name": TASK, "type": "frame", "frame": frame, "B": weight, "gain": GAIN}

    def _line(self) -> dict[str, Any]:
        to: dict[str, Any] = {"position": _rounded(self.pose[4:])}
        if self.oriented:
            to["quaternion"] = _rounded(self.pose[:4])
        return {"path": "line", "to": to, "profile": "minimum_jerk", "duration": DURATION}

    def config_text(self, scene: str) -> str:
        """Return the configuration, for a scene as the folder sees it."""
        frame = f"{{{self.effector.kind}: {_quoted(self.effector.name)}}}"
        line = self._line()
        to = ", ".join(f"{key}: {value}" for key, value in line["to"].items())
        turn = self._weight()["orientation"]
        base = f"  base: {{linear: {BASE['linear']}, angular: {BASE['angular']}}}  # m/s, rad/s\n"
        return f"""{_HEAD}# A frame goes along a line. Run it: rmrc solve {CONFIG}
# What else the model has: rmrc inspect {CONFIG}. What a key means: see {SCHEMA}.
scene: {_quoted(scene)}
dt: {DT}                # s, of a step
duration: {DURATION + SETTLING}            # s, of the run
tasks:
  - use: {STACK}        # the tasks; `with` fills the parameters that they begin with
    with: {{frame: {frame}, orientation: {turn}}}
limits:
  position: {{margin: 0.0}}     # rad or m, kept from each end of the ranges of the model
  velocity: {{default: {FASTEST}}}  # rad/s or m/s, where the file has no lower one; or JOINT: VALUE
{base if self.floats else ""}targets:
  {TASK}:                # it starts where the frame is, in the world
    path: {line["path"]}
    to: {{{to}}}
    profile: {line["profile"]}
    duration: {DURATION}        # s
"""


_STACK = f"""{_HEAD}# A stack: tasks that a configuration takes in with `use`.
# A frame goes to its target; the joints stay near the start where the frame leaves them free.
parameters:
  frame: null           # the frame that moves, as in {{site: hand}}; it must be given
  position: 1.0         # weight of the squared position error, 1/m²
  orientation: 0.5      # weight of the squared orientation error, 1/rad²; 0 leaves it free
  posture: 0.01         # weight of the squared distance of the joints from the start, 1/rad²

tasks:
  - name: {TASK}
    type: frame
    frame: $frame
    B: {{position: $position, orientation: $orientation}}
    gain: {GAIN}           # 1/s: the error decays as exp(−gain t)
  - name: {POSTURE}
    type: posture
    level: 1            # below level 0: it moves what the hand leaves free
    B: $posture
    gain: 1.0
"""


def _posture(weight: float) -> dict[str, Any]:
    level = 1 if weight < 1.0 else 0
    gain = 1.0 if weight < 1.0 else 2.0
    return {"name": POSTURE, "type": "posture", "level": level, "B": weight, "gain": gain}


def _rounded(values: Array) -> list[float]:
    return [round(float(value), 6) + 0.0 for value in values]


def _quoted(text: str) -> str:
    plain = re.fullmatch(r"[A-Za-z_./][\w./-]*", text)
    return text if plain else json.dumps(text, ensure_ascii=False)
