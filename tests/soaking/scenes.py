"""The scenes of the soak, and random configurations of each."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from models import REPOSITORY
from rmrc.config.compiled_scene import load_model
from soaking.drawer import Drawer, Generator
from soaking.trees import Tree, draw_tree
from soaking.wishes import Wishes

OBSTACLE = "mover"
"""The mocap body that is put into the scenes of this repository."""
TREE_EPISODES = 4
"""Seeds in a row that share a tree."""


@dataclass
class Drawn:
    """A configuration that was drawn, and the sizes that go with it."""

    config: dict[str, Any]
    length: float = 1.0
    """Lengths beside those of an arm."""
    rate: float = 1.0
    """Rates beside those of an arm, 1/s."""
    said: str = ""
    """What a report says of the scene."""


@dataclass(frozen=True)
class Scene:
    """A model and what of it is asked to move."""

    source: str
    """A name in `scenes/`, or menagerie:NAME/ENTRY."""
    sites: tuple[str, ...] = ()
    bodies: tuple[str, ...] = ()
    share: float = 1.0
    """Share of the steps, beside those of the others."""

    @property
    def name(self) -> str:
        """What a report calls it."""
        return self.source.removeprefix("menagerie:").partition("/")[0]

    @property
    def frames(self) -> list[dict[str, str]]:
        """The frames, as a task names them."""
        return [{"site": name} for name in self.sites] + [{"body": name} for name in self.bodies]

    def draw(self, seed: int, folder: Path, rng: Generator) -> Drawn:
        """Return a random configuration of this scene."""
        return Drawn(_draw(self, scene_file(self, folder), rng))


@dataclass(frozen=True)
class Trees:
    """Random trees, in place of a scene: some seeds in a row have the same one."""

    name: str = field(default="trees", init=False)

    def draw(self, seed: int, folder: Path, rng: Generator) -> Drawn:
        """Return a random configuration of the tree that belongs to a seed."""
        number = seed // TREE_EPISODES
        tree, path = _tree(number), folder / f"tree{number}.xml"
        if not path.exists():
            path.write_text(tree.xml)
        wishes = Wishes(tree, Drawer(rng), str(path))
        return Drawn(wishes.config(), wishes.length, wishes.rate, str(tree))


@lru_cache(maxsize=2)
def _tree(number: int) -> Tree:
    return draw_tree(np.random.default_rng([TREES, number]))


TREES = 7
"""What the seeds of the trees begin with, unlike those of the episodes."""

SCENES = (
    Scene("planar_2r", ("hand",), ("link1",), 3.0),
    Scene("planar_3r", ("hand",), ("link2",), 3.0),
    Scene("planar_4r", ("hand",), ("link2",), 3.0),
    Scene("panda", ("hand",), ("link4",), 4.0),
    Scene("ur5e", ("tool",), ("forearm_link",), 4.0),
    Scene("dual_arm", ("left_hand", "right_hand"), (), 1.0),
    Scene("mobile_arm", ("arm_hand", "base"), (), 3.0),
    Scene("biped", ("left_hand", "right_hand", "head", "left_foot", "right_foot"), (), 1.0),
    Scene("four_bar", ("coupler_point",), ("rocker",), 3.0),
    Scene("menagerie:franka_emika_panda/scene", ("attachment_site",), ("link4",), 0.2),
    Scene("menagerie:kuka_iiwa_14/scene", ("attachment_site",), ("link4",), 0.2),
    Scene("menagerie:ufactory_xarm7/scene", ("attachment_site",), ("link4",), 0.2),
    Scene("menagerie:universal_robots_ur5e/ur5e", ("attachment_site",), (), 0.2),
    Scene("menagerie:shadow_hand/right_hand", (), ("rh_ffdistal", "rh_thdistal"), 0.2),
    Scene("menagerie:aloha/scene", ("left/gripper", "right/gripper"), (), 0.1),
    Scene("menagerie:unitree_g1/g1", ("left_palm", "right_palm", "left_foot"), (), 0.2),
)


def present() -> list[Scene]:
    """Return the scenes at hand: the Menagerie's only where MENAGERIE_ROOT says where it is."""
    real = "MENAGERIE_ROOT" in os.environ
    return [scene for scene in SCENES if real or not scene.source.startswith("menagerie:")]


def scene_file(scene: Scene, folder: Path) -> str:
    """Return the path of a scene, with an obstacle that moves if it is one of this repository."""
    if scene.source.startswith("menagerie:"):
        return scene.source
    path = folder / f"{scene.source}.xml"
    if not path.exists():
        spec = mujoco.MjSpec.from_file(str(REPOSITORY / "scenes" / f"{scene.source}.xml"))
        body = spec.worldbody.add_body(name=OBSTACLE, mocap=True, pos=[0.0, 0.0, 3.0])
        kinds = (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE)
        for k, kind in enumerate(kinds):
            body.add_geom(
                name=f"{OBSTACLE}{k}", type=kind, size=[0.05, 0.1, 0.0], pos=[0, 0.1 * k, 0]
            )
        spec.compile()
        path.write_text(spec.to_xml())
    return str(path)


def _draw(scene: Scene, path: str, rng: Generator) -> dict[str, Any]:
    """Return a random configuration of a scene, as plain data."""
    drawer = Drawer(rng)
    model = load_model(path, REPOSITORY)
    data = mujoco.MjData(model)
    if model.nkey:
        data.qpos = model.key_qpos[0]
    mujoco.mj_kinematics(model, data)
    tasks = _tasks(scene, model, drawer)
    config: dict[str, Any] = {
        "scene": path,
        "dt": drawer.between(1e-4, 2e-2),
        "tasks": tasks,
        "limits": _limits(scene, model, data, drawer, tasks),
        "damping": {
            "lambda": drawer.among(0.0, *[1e-3] * 3, *[1e-2] * 6),
            "adapt": drawer.among("off", "off", "sigma_min", "manipulability", "error"),
        },
        "solver": {"backend": drawer.among(*["auto"] * 6, *["daqp"] * 2, "proxqp", "osqp")},
        "priority": drawer.among(*["soft"] * 9, "strict"),
        "previous": drawer.among(*["commanded"] * 5, "measured"),
    }
    if drawer.chance(0.05):
        config["solver"]["max_iter"] = drawer.among(1, 5, 20)
    if drawer.chance(0.1):
        config["metric"] = drawer.among(0.01, "inertia")
    if drawer.chance(0.15):
        config["timeout"] = {
            key: config["dt"] * drawer.among(3.5, 50.0) for key in ("target", "measurement")
        }
    if drawer.chance(0.1) and model.njnt > 2:
        config["dofs"] = [model.joint(j).name for j in range(model.njnt) if j != 1]
    return config


def _tasks(scene: Scene, model: mujoco.MjModel, drawer: Drawer) -> list[dict[str, Any]]:
    rng = drawer.rng
    frames = scene.frames
    chosen = rng.permutation(len(frames))[: rng.integers(1, len(frames) + 1)]
    tasks: list[dict[str, Any]] = []
    for k, index in enumerate(chosen.tolist()):
        task: dict[str, Any] = {
            "name": f"frame{k}",
            "type": "frame",
            "frame": frames[index],
            "gain": drawer.among(1.0, 10.0, 100.0, "deadbeat"),
            "B": {"position": drawer.among(1.0, 100.0), "orientation": drawer.among(0.0, 0.1, 1.0)},
            "axes": drawer.among("body", "world"),
            "level": int(rng.integers(2)) if k else 0,
        }
        if drawer.chance(0.3):
            task["clamp"] = {"position": 0.1, "orientation": 0.3}
        if k == 0:
            task |= drawer.among(*[{}] * 18, {"preserve": "direction"}, {"hard": True})
        tasks.append(task)
    first = frames[chosen[0]]
    joints = [
        model.joint(j).name
        for j in range(model.njnt)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE
    ]
    driven = joints[rng.integers(len(joints))]  # into the end of its range
    extras = (
        {"type": "posture", "B": 0.01, "gain": 1.0, "level": 1},
        {"type": "smooth", "B": 0.1, "level": 1},
        {"type": "com", "level": 1},
        {"type": "velocity", "target": {driven: drawer.among(-9.0, 9.0)}, "B": 100.0},
        {"type": "look_at", "frame": first, "level": 1, "target": [1.0, 2.0, 3.0]},
        {"type": "axis_align", "frame": first, "level": 2},
        {"type": "kinetic_energy", "B": 0.01},
        {"type": "manipulability", "frame": frames[0], "B": 0.1, "level": 2},
        {"type": "centering", "B": 0.01, "level": 2},
        {"type": "freeze", "joints": joints[-1:]},
        {"type": "coupling", "coefficients": {joints[0]: 1.0, joints[1]: -1.0}},
    )
    shares = (0.7, 0.1, 0.1, 0.3, *[0.1] * (len(extras) - 4))
    for k, (extra, share) in enumerate(zip(extras, shares, strict=True)):
        ranged = extra["type"] != "centering" or model.jnt_limited.any()
        if drawer.chance(share) and ranged:
            tasks.append({"name": f"extra{k}", **extra})
    if model.neq:
        tasks.append({"name": "chain", "type": "loop", "gain": drawer.among(10.0, "deadbeat")})
    return tasks


def _limits(
    scene: Scene,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    drawer: Drawer,
    tasks: Sequence[dict[str, Any]],
) -> dict[str, Any]:
    limits: dict[str, Any] = {"position": {"gain": drawer.among(0.5, 0.95, 1.0)}}
    limits["velocity"] = {"default": drawer.between(0.2, 6.0)}
    for name in limits:
        if drawer.chance(0.05):
            limits[name] = "off"
    if drawer.chance(0.6):
        limits["acceleration"] = {"default": drawer.between(1.0, 60.0)}
    if drawer.chance(0.3):
        limits["jerk"] = {"default": drawer.between(50.0, 1e4)}
    if (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any() and drawer.chance(0.9):
        limits["base"] = {"linear": drawer.between(0.1, 2.0), "angular": drawer.between(0.1, 2.0)}
    if drawer.chance(0.25):
        limits["speed"] = {tasks[0]["name"]: {"linear": drawer.between(0.05, 1.0), "angular": 1.0}}
    if drawer.chance(0.25):
        # A planar arm has nothing that moves along z.
        normal = drawer.direction() * [1.0, 1.0, 0.0 if "planar" in scene.name else 1.0]
        normal /= np.linalg.norm(normal)
        ((kind, name),) = scene.frames[0].items()
        position = data.site(name).xpos if kind == "site" else data.body(name).xpos
        offset = float(normal @ position) - drawer.among(0.01, 0.1, 0.3)
        limits["workspace"] = [
            {"frame": scene.frames[0], "normal": normal.tolist(), "offset": offset}
        ]
    if drawer.chance(0.4):
        d_min = drawer.among(0.0, 0.005, 0.02)
        limits["collision"] = {
            "d_min": d_min,
            "detect": d_min + drawer.among(0.02, 0.1),
            "gain": drawer.among(0.5, 0.9, 1.0),
        }
    return limits
