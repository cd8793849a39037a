"""Problems whose steps take long, and a walk that is the same however long they take."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import rmrc
from rmrc import Problem

Array = NDArray[np.float64]

JUMP = 5
"""Steps from one place to the next, between which the joints move on."""
FAST = 1.0
"""Largest speed of a joint on the way, rad/s or m/s."""
SPREADS = (0.3, 0.6, 1.0)
"""Shares of the joints' ranges that places are drawn from, about the start."""
NO_RANGE = 2.5
"""How far from the start a joint without a range is taken, rad or m."""
AWAY = (0.1, 0.5, 5.0)
"""How far from their place at the start targets are drawn, m: the last are out of reach."""
LINKS = 24
POSTURE: dict[str, Any] = {"name": "posture", "type": "posture", "B": 0.01, "level": 1}


def _frames(*sites: str) -> list[dict[str, Any]]:
    return [
        {"name": site.replace("/", "_"), "type": "frame", "frame": {"site": site}} for site in sites
    ]


def _of_menagerie(scene: str, sites: tuple[str, ...], **others: Any) -> Callable[[Path], Any]:
    config = {"scene": f"menagerie:{scene}", "tasks": [*_frames(*sites), POSTURE], **others}
    return lambda _: config


def _chain(folder: Path) -> dict[str, Any]:
    """Return a chain whose pose is hard, and whose own links are near everywhere."""
    rng, path = np.random.default_rng(0), folder / "chain.xml"
    bodies = ""
    for k in range(LINKS):
        axis, places = rng.normal(size=3), rng.normal(size=(2, 3)) * 0.08
        balls = "".join(
            f'<geom type="sphere" size="0.03" pos="{x} {y} {z}"/>' for x, y, z in places
        )
        bodies += (
            f'<body name="b{k}" pos="{0.1 if k else 0} 0 0">'
            f'<joint name="j{k}" axis="{axis[0]} {axis[1]} {axis[2]}"/>{balls}'
        )
    bodies += '<site name="tip"/>' + "</body>" * LINKS
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    tip = {**_frames("tip")[0], "hard": True}
    posture = {"name": "posture", "type": "posture", "B": 0.01, "gain": 1.0}
    limits = {"collision": {"pairs": "all", "d_min": 0.05, "detect": 0.4}}
    return {"scene": str(path), "tasks": [tip, posture], "limits": limits}


_ALL = {"collision": {"pairs": "all"}}
_STOPPING = {"acceleration": {"default": 15.0}}
_PALMS = ("left_palm", "right_palm", "left_foot")
_GRIPPERS = ("left/gripper", "right/gripper")
_ZERO = [0.0] * 16  # where the arms of ALOHA are inside each other
_PANDA, _G1 = "franka_emika_panda/scene", "unitree_g1/g1"
_NEAR = {"collision": {"pairs": "all", "d_min": 0.02, "detect": 0.2}}
_FAR = {"collision": {"pairs": "all", "detect": 0.5}}

CASES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "panda": _of_menagerie(_PANDA, ("attachment_site",), limits=_ALL),
    "panda, stopping": _of_menagerie(_PANDA, ("attachment_site",), limits={**_ALL, **_STOPPING}),
    "panda, strict": _of_menagerie(_PANDA, ("attachment_site",), limits=_ALL, priority="strict"),
    "g1": _of_menagerie(_G1, _PALMS, start="stand", limits=_ALL),
    "g1, strict": _of_menagerie(_G1, _PALMS, start="stand", limits=_ALL, priority="strict"),
    "g1, stopping, far": _of_menagerie(_G1, _PALMS, start="stand", limits={**_FAR, **_STOPPING}),
    "aloha": _of_menagerie("aloha/scene", _GRIPPERS, start=_ZERO, equalities="off", limits=_NEAR),
    "aloha, stopping": _of_menagerie(
        "aloha/scene", _GRIPPERS, start=_ZERO, equalities="off", limits={**_NEAR, **_STOPPING}
    ),
    "chain": _chain,
}


def problem(case: str, folder: Path, deadline: float | None = None) -> Problem:
    """Return a case, whose scene may be written into a folder, with a deadline in µs."""
    solver = {} if deadline is None else {"deadline": deadline}
    return rmrc.compile(
        rmrc.Config.model_validate({"dt": 0.002, "solver": solver, **CASES[case](folder)})
    )


@dataclass(frozen=True)
class Place:
    """Where a step begins, and what it is asked for."""

    q: Array
    targets: dict[str, tuple[Array, Array]]
    """Position and quaternion of each pose."""


def walk(made: Problem, steps: int, seed: int = 0) -> Iterator[Place]:
    """Yield places that jump now and then, and targets near, far and out of reach."""
    model, rng = made.model, np.random.default_rng(seed)
    hinges = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
    place, dof = model.jnt_qposadr[hinges], model.jnt_dofadr[hinges]
    start, limited = made.start[place], model.jnt_limited[hinges].astype(bool)
    low = np.where(limited, model.jnt_range[hinges, 0], start - NO_RANGE)
    high = np.where(limited, model.jnt_range[hinges, 1], start + NO_RANGE)
    poses = [term for term in made.terms if term.target_kind == "pose"]
    q, rates, targets = made.start.copy(), np.zeros(model.nv), {}
    for k in range(steps):
        if k % JUMP == 0:
            q = made.start.copy()
            q[place] += rng.choice(SPREADS) * (rng.uniform(low, high) - start)
            rates[dof] = rng.uniform(-FAST, FAST, dof.size)
            targets = {
                term.name: (
                    term.target[4:] + rng.choice(AWAY) * rng.normal(size=3),
                    rng.normal(size=4),
                )
                for term in poses
            }
        else:
            q = q.copy()
            mujoco.mj_integratePos(model, q, rates, made.dt)
        yield Place(q, targets)
