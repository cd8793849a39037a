"""What a step looks at, for the kinematics in C++: bodies with the way to them, geoms and sites."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc import _native
from rmrc.limits.ball import BallRange
from rmrc.limits.barrier import Barrier
from rmrc.limits.collision import Collision
from rmrc.limits.tendon import TendonRange
from rmrc.limits.workspace import Workspace
from rmrc.model.frames import FrameHandle
from rmrc.model.objects import bodies_of_equality
from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.qp.rows import Rows
from rmrc.tasks.axis_align import AxisAlignTerm
from rmrc.tasks.base import Term
from rmrc.tasks.com import ComTerm
from rmrc.tasks.frame import FrameTerm
from rmrc.tasks.look_at import LookAtTerm
from rmrc.tasks.loop import LoopTerm
from rmrc.tasks.relative_frame import RelativeFrameTerm

Array = NDArray[np.float64]
Parts = list[tuple[Any, ...]]

ARRAYS = (
    "qpos",
    "mocap_pos",
    "mocap_quat",
    "xpos",
    "xquat",
    "xmat",
    "geom_xpos",
    "geom_xmat",
    "site_xpos",
    "site_xmat",
    "subtree_com",
)
"""What the extension reads and writes of an mjData."""

_OF_BODIES = (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
_SAME = mujoco.mjtSameFrame
_SAME_ROTATION = (_SAME.mjSAMEFRAME_BODY, _SAME.mjSAMEFRAME_BODYROT)


def frame_of(evaluation: Evaluation, moves: NDArray[np.bool_], frame: FrameHandle) -> _native.Frame:
    """Return where a frame stands, the point its axes refer to, and what moves it.

    Args:
        evaluation: Where the poses are, and the velocities of the mocap bodies.
        moves: Which dofs move each body (nbody, nv).
        frame: The frame.
    """
    model, data = evaluation.model, evaluation.data
    body, carrier = frame.body(model), evaluation.carrier(frame.body(model))
    position, rotation = frame.views(data)
    return _native.Frame(
        position=position,
        rotation=rotation,
        reference=data.xpos[model.body_rootid[body]],
        dofs=np.flatnonzero(moves[body]).tolist(),
        carrier=None if carrier is None else carrier.twist,
    )


class Watched:
    """What is looked at: bodies, geoms, sites, and the subtrees whose centre of mass is."""

    def __init__(self) -> None:
        self.bodies: set[int] = set()
        self.geoms: set[int] = set()
        self.sites: set[int] = set()
        self.subtrees: set[int] = set()

    def add_frame(self, frame: FrameHandle) -> None:
        """Look at a frame."""
        {"body": self.bodies, "geom": self.geoms, "site": self.sites}[frame.kind].add(frame.id)

    def add_term(self, model: mujoco.MjModel, term: Term) -> None:
        """Look at what the extension reads to evaluate a term."""
        match term:
            case FrameTerm() | LookAtTerm() | AxisAlignTerm():
                self.add_frame(term.frame)
            case RelativeFrameTerm():
                self.add_frame(term.frame)
                self.add_frame(term.root)
            case ComTerm():
                self.subtrees.update(root for root, _ in term.shares)
            case LoopTerm():
                for i in term.equalities:
                    if mujoco.mjtEq(int(model.eq_type[i])) in _OF_BODIES:
                        self.bodies.update(bodies_of_equality(model, i))
            case _:
                pass

    def add_barrier(self, barrier: Barrier) -> None:
        """Look at what the distances of a barrier are between."""
        match barrier:
            case Collision(spec=spec):
                self.geoms.update(np.unique(spec.geoms).tolist())
            case Workspace():
                for plane in barrier.planes:
                    self.add_frame(plane.frame)
            case BallRange() | TendonRange():
                pass
            case _:
                raise TypeError(f"there is no {type(barrier).__name__} in C++")


def of_step(problem: Problem, terms: Iterable[Term], rows: Rows) -> Watched:
    """Return what a step looks at where it is."""
    watched = Watched()
    for term in terms:
        watched.add_term(problem.model, term)
    for speed in rows.speeds:
        watched.add_frame(speed.limit.frame)
    for barrier in rows.barriers:
        watched.add_barrier(barrier)
        if isinstance(barrier, Collision):  # it adds up how far all bodies have moved
            watched.bodies.update(range(problem.model.nbody))
    return watched


def of_barriers(barriers: Iterable[Barrier]) -> Watched:
    """Return what is looked at where a command leads."""
    watched = Watched()
    for barrier in barriers:
        watched.add_barrier(barrier)
    return watched


def build(
    model: mujoco.MjModel, data: mujoco.MjData, cdof: Array, watched: Watched
) -> _native.ForwardKinematics:
    """Return what places the watched things in the data, and writes the axes of the dofs (nv, 6).

    What holds still is placed once, here.
    """
    mujoco.mj_kinematics(model, data)
    masses = list(_masses(model, watched.subtrees))
    moving = _moving(model)
    bodies = watched.bodies | {int(model.geom_bodyid[geom]) for geom in watched.geoms}
    bodies |= {int(model.site_bodyid[site]) for site in watched.sites}
    bodies |= {body for body, *_ in masses}
    arrays: Mapping[str, Array] = {name: getattr(data, name) for name in ARRAYS} | {"cdof": cdof}
    return _native.ForwardKinematics(
        arrays=arrays,
        bodies=[_body(model, body) for body in _with_ancestors(model, bodies) if moving[body]],
        geoms=_attached(model, "geom", watched.geoms, moving),
        sites=_attached(model, "site", watched.sites, moving),
        masses=masses,
    )


def _moving(model: mujoco.MjModel) -> list[bool]:
    """Return which bodies a joint or someone else moves."""
    moving = [False]
    for body in range(1, model.nbody):  # a parent comes before its children
        own = bool(model.body_jntnum[body]) or bool(model.body_mocapid[body] >= 0)
        moving.append(own or moving[model.body_parentid[body]])
    return moving


def _with_ancestors(model: mujoco.MjModel, bodies: Iterable[int]) -> list[int]:
    found: set[int] = set()
    for body in bodies:
        while body and body not in found:
            found.add(body)
            body = int(model.body_parentid[body])
    return sorted(found)


def _body(model: mujoco.MjModel, body: int) -> tuple[Any, ...]:
    first = int(model.body_jntadr[body])
    joints = []
    for joint in range(first, first + int(model.body_jntnum[body])):
        coordinate = int(model.jnt_qposadr[joint])
        joints.append(
            (
                int(model.jnt_type[joint]),
                coordinate,
                int(model.jnt_dofadr[joint]),
                model.jnt_axis[joint].tolist(),
                model.jnt_pos[joint].tolist(),
                float(model.qpos0[coordinate]),
            )
        )
    return (
        body,
        int(model.body_parentid[body]),
        int(model.body_rootid[body]),
        int(model.body_mocapid[body]),
        model.body_pos[body].tolist(),
        model.body_quat[body].tolist(),
        joints,
    )


def _attached(model: mujoco.MjModel, kind: str, ids: Iterable[int], moving: list[bool]) -> Parts:
    """Return where geoms or sites are in their bodies."""
    found = []
    for i in sorted(ids):
        body = int(getattr(model, f"{kind}_bodyid")[i])
        if not moving[body]:
            continue
        position, quaternion = getattr(model, f"{kind}_pos")[i], getattr(model, f"{kind}_quat")[i]
        same, of_inertia = getattr(model, f"{kind}_sameframe")[i], model.body_sameframe[body]
        shifted, turned = same != _SAME.mjSAMEFRAME_BODY, same not in _SAME_ROTATION
        if same == _SAME.mjSAMEFRAME_INERTIA:
            shifted, position = of_inertia != _SAME.mjSAMEFRAME_BODY, model.body_ipos[body]
        if same in (_SAME.mjSAMEFRAME_INERTIA, _SAME.mjSAMEFRAME_INERTIAROT):
            turned, quaternion = of_inertia not in _SAME_ROTATION, model.body_iquat[body]
        found.append((i, body, shifted, turned, position.tolist(), quaternion.tolist()))
    return found


def _masses(model: mujoco.MjModel, roots: set[int]) -> Iterator[tuple[Any, ...]]:
    """Return the bodies of subtrees, those without children first."""
    asked: set[int] = set()
    for body in range(model.nbody):
        if body in roots or (body and int(model.body_parentid[body]) in asked):
            asked.add(body)
    for body in sorted(asked, reverse=True):
        parent = int(model.body_parentid[body])
        yield (
            body,
            parent if body and parent in asked else -1,
            float(model.body_mass[body]),
            float(model.body_subtreemass[body]),
            bool(model.body_sameframe[body] != _SAME.mjSAMEFRAME_BODY),
            model.body_ipos[body].tolist(),
        )
