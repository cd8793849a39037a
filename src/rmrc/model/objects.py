"""Objects: what the scene has joints for, but the robot does not move, such as a cup or a door."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from mink.tasks import BaseTask
from numpy.typing import NDArray

from rmrc.errors import ModelError
from rmrc.model.configuration import QPOS_WIDTH, joint_type
from rmrc.model.frames import find

Ids = NDArray[np.intp]
Mask = NDArray[np.bool_]

_T = mujoco.mjtTrn
_WRAPPED_GEOMS = (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER)


@dataclass(frozen=True, eq=False)
class Objects:
    """The trees of joints that are no part of the robot, by the bodies that they are rooted at."""

    model: mujoco.MjModel
    roots: tuple[int, ...] = ()

    @cached_property
    def bodies(self) -> Mask:
        """Which bodies are of objects (nbody,)."""
        return np.isin(self.model.body_rootid, self.roots)

    @cached_property
    def joints(self) -> Mask:
        """Which joints are (njnt,)."""
        return self.bodies[self.model.jnt_bodyid]

    @cached_property
    def dofs(self) -> Mask:
        """Which dofs are (nv,)."""
        return self.bodies[self.model.dof_bodyid]

    @cached_property
    def coordinates(self) -> Mask:
        """Which coordinates of q are (nq,)."""
        model, mask = self.model, np.zeros(self.model.nq, dtype=np.bool_)
        for joint in np.flatnonzero(self.joints).tolist():
            first = int(model.jnt_qposadr[joint])
            mask[first : first + QPOS_WIDTH[joint_type(model, joint)]] = True
        return mask

    def robot_joints(self) -> list[int]:
        """Return the joints that are no object's."""
        return np.flatnonzero(~self.joints).tolist()

    def name(self, root: int) -> str:
        """Return what a message calls an object."""
        return self.model.body(root).name or f"body {root}"

    def notices(self) -> list[str]:
        """Return what a user should know of them."""
        if not self.roots:
            return []
        named = ", ".join(map(self.name, self.roots))
        return [
            f"objects, obstacles that stay where q has them: {named} (no actuator drives them, and "
            "no task or `dofs` names a joint of theirs or has its frame on them)"
        ]


def find_objects(
    model: mujoco.MjModel, claimed: Iterable[int], held: Iterable[Sequence[int]] = ()
) -> Objects:
    """Return the trees of joints that no actuator drives and that nobody claims.

    A tree is what hangs on a child of the world. Where all would be objects, only those are that
    are a single free body; and where then still nothing would move, nothing is. What a `loop` task
    holds together it names; what is held by default to the robot moves with it.

    Args:
        model: The model.
        claimed: Bodies with a frame of a task's own or with a joint that a task or `dofs` names.
        held: Bodies that each of the equalities holds together that are held by default.
    """
    trees = {int(root) for root in model.body_rootid[model.dof_bodyid]}
    robot = {int(model.body_rootid[body]) for body in (*claimed, *_driven(model))} & trees
    together = [{int(model.body_rootid[body]) for body in bodies} & trees for bodies in held]
    while joined := [one for one in together if one & robot and one - robot]:
        robot.update(*joined)
    found = trees - robot
    if found == trees:
        found = {root for root in trees if _is_free_body(model, root)}
    return Objects(model, () if found == trees else tuple(sorted(found)))


def bodies_of_joints(model: mujoco.MjModel, names: Iterable[str]) -> list[int]:
    """Return the bodies that joints move.

    Raises:
        ModelError: If the model has no such joint.
    """
    return [int(model.jnt_bodyid[find(model, "joint", name)]) for name in names]


def claimed_by_mink(model: mujoco.MjModel, tasks: Sequence[BaseTask]) -> list[int]:
    """Return the bodies with the frames of mink's tasks; a name that is unknown is left out."""
    bodies = []
    for task in tasks:
        kind, name = getattr(task, "frame_type", None), getattr(task, "frame_name", None)
        if kind is None or name is None:
            continue
        try:
            i = name if isinstance(name, int) else find(model, kind, name)
        except (ModelError, KeyError):  # which the evaluation of the task says
            continue
        owners = {"site": model.site_bodyid, "geom": model.geom_bodyid}
        bodies.append(int(owners[kind][i]) if kind in owners else i)
    return bodies


def bodies_of_equality(model: mujoco.MjModel, equality: int) -> list[int]:
    """Return the bodies that a connect, weld, joint or tendon constraint holds together."""
    ids = [int(i) for i in (model.eq_obj1id[equality], model.eq_obj2id[equality]) if i >= 0]
    kind = mujoco.mjtEq(int(model.eq_type[equality]))
    if kind == mujoco.mjtEq.mjEQ_TENDON:
        return [body for tendon in ids for body in bodies_of_tendon(model, tendon)]
    if kind == mujoco.mjtEq.mjEQ_JOINT:
        return [int(model.jnt_bodyid[joint]) for joint in ids]
    of_sites = int(model.eq_objtype[equality]) == int(mujoco.mjtObj.mjOBJ_SITE)
    return [int(model.site_bodyid[i]) for i in ids] if of_sites else ids


def _is_free_body(model: mujoco.MjModel, root: int) -> bool:
    joints = np.flatnonzero(model.body_rootid[model.jnt_bodyid] == root)
    return joints.size == 1 and joint_type(model, joints[0]) == mujoco.mjtJoint.mjJNT_FREE


def _driven(model: mujoco.MjModel) -> list[int]:
    """Return the bodies that actuators act on."""
    bodies: list[int] = []
    for kind, (one, other) in zip(model.actuator_trntype, model.actuator_trnid, strict=True):
        match _T(int(kind)):
            case _T.mjTRN_JOINT | _T.mjTRN_JOINTINPARENT:
                bodies.append(model.jnt_bodyid[one])
            case _T.mjTRN_TENDON:
                bodies += bodies_of_tendon(model, int(one))
            case _T.mjTRN_SITE | _T.mjTRN_SLIDERCRANK:
                bodies += [model.site_bodyid[site] for site in (one, other) if site >= 0]
            case _T.mjTRN_BODY:
                bodies.append(one)
            case _:
                pass
    return [int(body) for body in bodies]


def bodies_of_tendon(model: mujoco.MjModel, tendon: int) -> list[int]:
    """Return the bodies that a tendon pulls at."""
    first = int(model.tendon_adr[tendon])
    bodies = []
    for wrap in range(first, first + int(model.tendon_num[tendon])):
        kind, i = mujoco.mjtWrap(int(model.wrap_type[wrap])), int(model.wrap_objid[wrap])
        if kind == mujoco.mjtWrap.mjWRAP_JOINT:
            bodies.append(int(model.jnt_bodyid[i]))
        elif kind == mujoco.mjtWrap.mjWRAP_SITE:
            bodies.append(int(model.site_bodyid[i]))
        elif kind in _WRAPPED_GEOMS:
            bodies.append(int(model.geom_bodyid[i]))
    return bodies
