"""What a model has, for someone who is about to name something of it."""

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from rmrc.limits.joints import compile_box, held_ranges, joint_name
from rmrc.limits.models import LimitsModel
from rmrc.model.actuators import joint_actuators
from rmrc.model.configuration import joint_type
from rmrc.model.frames import names
from rmrc.model.objects import Objects, bodies_of_equality, find_objects
from rmrc.model.scene import Scene
from rmrc.problem.start import start_configuration
from rmrc.tasks.loop import equality_name

TYPES = {
    mujoco.mjtJoint.mjJNT_FREE: "free",
    mujoco.mjtJoint.mjJNT_BALL: "ball",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide",
    mujoco.mjtJoint.mjJNT_HINGE: "hinge",
}


def inspect(scene: Scene, objects: Objects | None = None) -> dict[str, Any]:
    """Return what a scene has as plain data: frames, joints, couplings, keyframes and the rest.

    Args:
        scene: The scene.
        objects: What of it is not the robot; by default what no actuator drives.
    """
    model = scene.model
    objects = objects or find_objects(model, ())
    _, begins = start_configuration(scene, None, LimitsModel())
    return {
        "coordinates": int(model.nq),
        "dofs": int(model.nv),
        "frames": _tree(model),
        "joints": list(_joints(scene, objects)),
        "coupled": [_equality(model, i) for i in np.flatnonzero(model.eq_active0).tolist()],
        "tendons": [
            {
                "name": model.tendon(i).name or f"tendon {i}",
                "range": model.tendon_range[i].tolist() if model.tendon_limited[i] else None,
            }
            for i in range(model.ntendon)
        ],
        "actuators": [model.actuator(i).name or f"actuator {i}" for i in range(model.nu)],
        "keyframes": names(model, "keyframe"),
        "start": begins,
        "cameras": [model.camera(i).name or f"camera {i}" for i in range(model.ncam)],
        "objects": [objects.name(root) for root in objects.roots],
        "left_out": dict(scene.left_out),
        "notices": list(scene.notices),
    }


def _tree(model: mujoco.MjModel) -> dict[str, Any]:
    """Return the bodies as a tree, each with its joints, sites and geoms."""
    nodes = [
        {
            "body": model.body(i).name,
            "joints": [joint_name(model, j) for j in _of(model.jnt_bodyid, i)],
            "sites": [name for j in _of(model.site_bodyid, i) if (name := model.site(j).name)],
            "geoms": [name for j in _of(model.geom_bodyid, i) if (name := model.geom(j).name)],
            "mocap": bool(model.body_mocapid[i] >= 0),
            "below": [],
        }
        for i in range(model.nbody)
    ]
    for i in range(1, model.nbody):
        nodes[model.body_parentid[i]]["below"].append(nodes[i])
    return nodes[0]


def _of(owners: Any, body: int) -> list[int]:
    return np.flatnonzero(owners == body).tolist()


def _joints(scene: Scene, objects: Objects) -> Iterator[dict[str, Any]]:
    model = scene.model
    box, _ = compile_box(objects, LimitsModel(), [], scene.velocity)
    ranges = held_ranges(model, LimitsModel())
    driven: dict[int, list[str]] = {}
    for actuator in joint_actuators(model):
        name = model.actuator(actuator).name or f"actuator {actuator}"
        driven.setdefault(int(model.actuator_trnid[actuator, 0]), []).append(name)
    for joint in range(model.njnt):
        kind, name = joint_type(model, joint), joint_name(model, joint)
        low, high = ranges[joint]
        speed = float(box.velocity[model.jnt_dofadr[joint]])
        yield {
            "name": name,
            "type": TYPES[kind],
            "unit": "m" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "rad",
            "range": [float(low), float(high)] if np.isfinite([low, high]).all() else None,
            "speed": speed if np.isfinite(speed) else None,
            "speed_from": "file" if name in scene.velocity else "default",
            "effort": (
                float(model.jnt_actfrcrange[joint].max())
                if model.jnt_actfrclimited[joint]
                else None
            ),
            "actuators": driven.get(joint, []),
            "body": model.body(int(model.jnt_bodyid[joint])).name,
            "object": bool(objects.joints[joint]),
        }


def _equality(model: mujoco.MjModel, i: int) -> dict[str, Any]:
    """Return an equality constraint in words: what it couples to what."""
    kind = mujoco.mjtEq(int(model.eq_type[i]))
    names_of = [model.body(body).name for body in bodies_of_equality(model, i)]
    relation = ""
    if kind == mujoco.mjtEq.mjEQ_JOINT:
        first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        joints = [joint_name(model, joint) for joint in (first, second) if joint >= 0]
        names_of = joints
        c = model.eq_data[i, :5]
        relation = f"{joints[0]} = {c[0]:g}" + (
            f" + {c[1]:g} · {joints[1]}" if len(joints) > 1 else ""
        )
        relation += " + …" if c[2:].any() else ""
    return {
        "name": equality_name(model, i),
        "type": kind.name.removeprefix("mjEQ_").lower(),
        "between": names_of,
        "relation": relation,
    }


def described(found: dict[str, Any]) -> Iterator[str]:
    """Yield the lines that say the same to a reader."""
    yield f"{found['coordinates']} coordinates, {found['dofs']} dofs"
    yield "frames: bodies, their joints (↻), sites (·) and geoms"
    yield from _branches(found["frames"], "  ")
    yield "joints"
    width = max([len(joint["name"]) for joint in found["joints"]], default=0)
    for joint in found["joints"]:
        yield "  " + _joint_line(joint, width)
    for key, title in (
        ("coupled", "coupled by the model's own equalities"),
        ("tendons", "tendons"),
        ("keyframes", "keyframes"),
        ("cameras", "cameras"),
        ("objects", "objects, which the robot does not move"),
    ):
        items = [_item_line(item) for item in found[key]]
        if items:
            yield title
            yield from (f"  {item}" for item in items)
    yield from (f"note: {notice}" for notice in [*found["start"], *found["notices"]])


def _branches(node: dict[str, Any], indent: str) -> Iterator[str]:
    parts = [node["body"] or "world"]
    parts += [f"↻ {name}" for name in node["joints"]]
    parts += [f"· {name}" for name in node["sites"]]
    if node["geoms"]:
        parts.append(f"[{', '.join(node['geoms'])}]")
    if node["mocap"]:
        parts.append("(mocap)")
    yield indent + "  ".join(parts)
    for child in node["below"]:
        yield from _branches(child, f"{indent}  ")


def _joint_line(joint: dict[str, Any], width: int) -> str:
    unit = joint["unit"]
    ends = joint["range"]
    span = f"[{ends[0]:.4g}, {ends[1]:.4g}] {unit}" if ends else "no range"
    speed = f"{joint['speed']:.4g} {unit}/s ({joint['speed_from']})" if joint["speed"] else ""
    actuators = ", ".join(joint["actuators"])
    note = " (object)" if joint["object"] else ""
    line = (
        f"{joint['name']:<{width}}  {joint['type']:<5}  {span:<24}  {speed:<22}  {actuators}{note}"
    )
    return line.rstrip()


def _item_line(item: Any) -> str:
    if isinstance(item, str):
        return item
    if "between" in item:
        return f"{item['name']} ({item['type']}): {item['relation'] or ' – '.join(item['between'])}"
    low_high = item["range"]
    return item["name"] + (f"  [{low_high[0]:.4g}, {low_high[1]:.4g}]" if low_high else "")
