"""How far geoms reach and how far a joint can move them, at most."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from rmrc.model.configuration import turning_dofs

Array = NDArray[np.float64]

PLANE_EXTENT = 1e100
"""Half the side in m of a plane: it has no end, but 0 · ∞ would be no number."""
FINEST, SMALL = 1e-6, 0.1
"""Resolution of MuJoCo's distances in m or rad, and the size in m below which it is finer."""

_FREE = mujoco.mjtJoint.mjJNT_FREE
_SLIDE = mujoco.mjtJoint.mjJNT_SLIDE
_PLANE = mujoco.mjtGeom.mjGEOM_PLANE
_MESH = mujoco.mjtGeom.mjGEOM_MESH


def dofs_of_bodies(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Return which dofs move which bodies (nbody, nv)."""
    moves = np.zeros((model.nbody, model.nv), dtype=np.bool_)
    for body in range(1, model.nbody):  # a parent comes before its children
        moves[body] = moves[model.body_parentid[body]]
        first = model.body_dofadr[body]
        moves[body, first : first + model.body_dofnum[body]] = True
    return moves


def extents(model: mujoco.MjModel) -> Array:
    """Return the distance from each geom's body's origin to the geom's farthest point (ngeom,)."""
    radius = np.where(model.geom_type == _PLANE, PLANE_EXTENT, model.geom_rbound)
    return np.linalg.norm(model.geom_pos, axis=1) + radius


def levers(model: mujoco.MjModel, geoms: NDArray[np.intp]) -> Array:
    """Return how fast each dof can move the one and the other geom of pairs, at most.

    The distance of a pair changes by no more than levers · |Δ|: a rotation moves a point by its
    distance from the axis, which is no longer than the chain of links to it, and a dof that moves
    both geoms does not change their distance. Slides count up to the end of the model's range:
    what they may be further out, `Slides` adds to Δ.

    Args:
        model: The model.
        geoms: Pairs of geoms (p, 2).

    Returns:
        Levers (2, p, nv + 6 nmocap) in m/rad or m/m: of the dofs, then of the linear and the
        angular velocity of each mocap body. The two sum to those of the distance.
    """
    reach = extents(model)
    used, index = np.unique(geoms, return_inverse=True)
    bodies = model.geom_bodyid[used].tolist()
    rows = np.array(
        [body_levers(model, b, r) for b, r in zip(bodies, reach[used].tolist(), strict=True)]
    )
    sides = rows[index.reshape(geoms.shape).T]
    return np.where((sides > 0.0).all(axis=0), 0.0, sides)


def body_levers(model: mujoco.MjModel, body: int, reach: float) -> Array:
    """Return the levers (nv + 6 nmocap,) of a body's points, walking from it to the world.

    They are no further than `reach` in m from the body's origin.
    """
    row = np.zeros(model.nv + 6 * model.nmocap)
    while body:
        first = int(model.body_jntadr[body])
        for joint in reversed(range(first, first + int(model.body_jntnum[body]))):
            dof, kind = model.jnt_dofadr[joint], model.jnt_type[joint]
            offset = float(np.linalg.norm(model.jnt_pos[joint]))
            if kind == _SLIDE:
                row[dof] = 1.0
                reach += counted_travel(model, joint)
            elif kind == _FREE:
                row[dof : dof + 3], row[dof + 3 : dof + 6] = 1.0, reach
            else:
                row[dof : dof + (1 if kind == mujoco.mjtJoint.mjJNT_HINGE else 3)] = reach + offset
                reach += 2.0 * offset  # the body's origin turns about the joint's anchor
        mocap = int(model.body_mocapid[body])
        if mocap >= 0:
            address = model.nv + 6 * mocap
            row[address : address + 3], row[address + 3 : address + 6] = 1.0, reach
        reach += float(np.linalg.norm(model.body_pos[body]))
        body = int(model.body_parentid[body])
    return row


def counted_travel(model: mujoco.MjModel, slide: int) -> float:
    """Return the travel of a slide from its zero that levers count, m: 0 without a range."""
    if not model.jnt_limited[slide]:
        return 0.0
    zero = model.qpos0[model.jnt_qposadr[slide]]
    return float(np.abs(model.jnt_range[slide] - zero).max())


def size(model: mujoco.MjModel) -> float:
    """Return the length in m of the longest chain of what moves, the geoms included."""
    solid = np.where(model.geom_type == _PLANE, 0.0, extents(model))
    reach, turning, longest = np.zeros(model.nbody), turning_dofs(model), 0.0
    np.maximum.at(reach, model.geom_bodyid, solid)
    for body in np.flatnonzero(dofs_of_bodies(model).any(axis=1)).tolist():
        levers_of_turning = body_levers(model, body, reach[body])[: model.nv][turning]
        longest = max(longest, reach[body], levers_of_turning.max(initial=0.0))
    return longest or 1.0


def resolution(model: mujoco.MjModel) -> float:
    """Return how finely distances are kept in m: 1e-6, and 1e-5 of the size of a small model."""
    return FINEST * min(1.0, size(model) / SMALL)


def half_thickness(model: mujoco.MjModel, geom: int) -> float:
    """Return the radius in m of a ball that fits into a geom; a plane has no end."""
    sizes = {
        mujoco.mjtGeom.mjGEOM_PLANE: (np.inf,),
        mujoco.mjtGeom.mjGEOM_SPHERE: model.geom_size[geom, :1],
        mujoco.mjtGeom.mjGEOM_CAPSULE: model.geom_size[geom, :1],
        mujoco.mjtGeom.mjGEOM_CYLINDER: model.geom_size[geom, :2],
        mujoco.mjtGeom.mjGEOM_MESH: (_mesh_radius(model, geom),),
    }
    return float(min(sizes.get(mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom])))


def _mesh_radius(model: mujoco.MjModel, geom: int) -> float:
    """Return the radius of a ball about a mesh's origin in its hull; 0 where it is outside."""
    mesh = int(model.geom_dataid[geom])
    if model.geom_type[geom] != _MESH or not model.mesh_polynum[mesh]:
        return 0.0
    faces = slice(model.mesh_polyadr[mesh], model.mesh_polyadr[mesh] + model.mesh_polynum[mesh])
    corners = model.mesh_vertadr[mesh] + model.mesh_polyvert[model.mesh_polyvertadr[faces]]
    heights = np.einsum("ij,ij->i", model.mesh_polynormal[faces], model.mesh_vert[corners])
    return max(0.0, float(heights.min()))
