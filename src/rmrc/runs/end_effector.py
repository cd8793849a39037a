"""The end effector of a model that nobody has described: its tool, its hand or its tip."""

import re
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.errors import ModelError, unknown_name
from rmrc.model.configuration import QPOS_WIDTH, joint_dofs, joint_type
from rmrc.model.frames import OBJECTS, dofs_before, names
from rmrc.model.objects import Objects
from rmrc.tasks.loop import ROWS
from rmrc.text.base import Frame
from rmrc.text.source import FrameKind

# Parts of names, the likeliest first: what is held, the hand or its mount, a limb's end.
_KINDS = (
    r"tcp|tool|end.?eff|(^|[_/:.-])ee[f]?($|[_/:.-])|eef|pinch|grip_?site|grasp",
    r"attachment|flange|hand|gripper|palm",
    r"tip|finger|wrist",
    r"foot|feet|toe|ankle|head",
)
_MOST_NAMED = 6


@dataclass(frozen=True)
class Candidate:
    """A frame that may be the end effector."""

    kind: FrameKind
    name: str
    body: int
    rank: tuple[float, ...]
    """The smaller the likelier."""

    @property
    def frame(self) -> Frame:
        """The frame, as a configuration names it."""
        return Frame.model_validate({self.kind: self.name})


def end_effectors(model: mujoco.MjModel, objects: Objects) -> list[Candidate]:
    """Return the frames that may be the end effector, the likeliest first.

    A frame is likely by its name, then by how many joints move it; a finger is not, whose joints
    follow others. Of a robot without telling names it is the end of the longest chain.
    """
    followers = _followers(model)
    found = []
    for kind in ("site", "body"):
        count = model.nsite if kind == "site" else model.nbody
        for i in range(count):
            name = mujoco.mj_id2name(model, OBJECTS[kind], i)
            body = int(model.site_bodyid[i]) if kind == "site" else i
            if not name or " + [" in name or objects.bodies[body]:
                continue
            dofs = set(dofs_before(model, body))
            own = dofs & _scalar_dofs(model)
            if not dofs:
                continue
            likely = next(
                (k for k, part in enumerate(_KINDS) if re.search(part, name, re.IGNORECASE)),
                len(_KINDS),
            )
            chain = len(own - followers)
            coupled = len(own & followers)
            rank = (coupled, likely, -chain, kind == "body", _depth(model, body) * -1.0)
            found.append(Candidate(kind, name, body, tuple(map(float, rank))))
    return sorted(found, key=lambda candidate: candidate.rank)


def find_end_effector(
    model: mujoco.MjModel, objects: Objects, name: str | None
) -> tuple[Candidate, list[str]]:
    """Return the end effector, or the frame that is named, and others that are as likely.

    Raises:
        ModelError: If there is no such frame, or nothing that the robot moves has a name.
    """
    found = end_effectors(model, objects)
    if name is not None:
        for candidate in found:
            if candidate.name == name:
                return candidate, []
        known = [*names(model, "site"), *names(model, "body")]
        if name in known:
            raise ModelError(f"no joint of the robot moves '{name}'")
        raise ModelError(unknown_name("site or body", name, known))
    if not found:
        raise ModelError("no joint moves anything that has a name; there is nothing to aim with")
    best = found[0]
    alike = [
        other.name
        for other in found[1:]
        if other.rank[:2] == best.rank[:2]
        and dofs_before(model, other.body) != dofs_before(model, best.body)
        and other.rank[2] == best.rank[2]
    ]
    return best, list(dict.fromkeys(alike))[:_MOST_NAMED]


def _scalar_dofs(model: mujoco.MjModel) -> set[int]:
    return {
        int(model.jnt_dofadr[joint])
        for joint in range(model.njnt)
        if QPOS_WIDTH[joint_type(model, joint)] == 1
    }


def _followers(model: mujoco.MjModel) -> set[int]:
    """Return the dofs that equalities couple: those of fingers, mostly."""
    coupled: set[int] = set()
    for i in np.flatnonzero(model.eq_active0).tolist():
        kind = mujoco.mjtEq(int(model.eq_type[i]))
        if kind == mujoco.mjtEq.mjEQ_JOINT and kind in ROWS:
            for joint in (int(model.eq_obj1id[i]), int(model.eq_obj2id[i])):
                if joint >= 0:
                    coupled.update(joint_dofs(model, joint).tolist())
    return coupled


def _depth(model: mujoco.MjModel, body: int) -> int:
    depth = 0
    while body:
        body, depth = int(model.body_parentid[body]), depth + 1
    return depth


def scalar_joints_above(model: mujoco.MjModel, body: int) -> NDArray[np.intp]:
    """Return the hinges and slides that move a body."""
    dofs = set(dofs_before(model, body)) & _scalar_dofs(model)
    return np.array([j for j in range(model.njnt) if int(model.jnt_dofadr[j]) in dofs], dtype=int)
