"""Lower bounds of the distances of convex geoms at other poses, without measuring them."""

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

_SPHERE = mujoco.mjtGeom.mjGEOM_SPHERE
_CAPSULE = mujoco.mjtGeom.mjGEOM_CAPSULE
_PLANE = mujoco.mjtGeom.mjGEOM_PLANE


def spreads(model: mujoco.MjModel) -> Array:
    """Return how far turning a geom about its centre can move its surface, per rad (ngeom,), m."""
    kind = model.geom_type
    spread = np.where(kind == _CAPSULE, model.geom_size[:, 1], model.geom_rbound)
    return np.where(kind == _PLANE, np.inf, np.where(kind == _SPHERE, 0.0, spread))


class Turning:
    """Which geom of each pair carries the plane between them: the one that turning spreads more."""

    def __init__(self, model: mujoco.MjModel, geoms: Ids):
        spread = spreads(model)[geoms]
        swapped = spread[:, 0] < spread[:, 1]
        self.base = np.where(swapped, geoms[:, 1], geoms[:, 0])
        """The geom that carries the plane (p,)."""
        self.other = np.where(swapped, geoms[:, 0], geoms[:, 1])
        self.spread = spread.min(axis=1)
        """ρ of the other geom (p,), m."""
        self.width = 2.0 * model.geom_rbound[self.other]
        """Most that two points of the other geom are apart (p,), m."""
        self.sign = np.where(swapped, -1.0, 1.0)[:, None]
        """Of the normal from a to b, so that it points away from the base (p, 1)."""


class Separation:
    """Planes between the geoms of pairs, each carried by one of the two.

    The signed distance of convex bodies is the largest width of a slab that separates them, over
    all normals. So with the normal n of the present distance d kept in the axes of one geom, a, and
    the centre p and the orientation R of the other, all in the axes of a,

        d' ≥ d + nᵀ(p' − p) − ρ ‖R'ᵀn − Rᵀn‖,

    where ρ is how far the other reaches from its centre. Pairs that move together keep their d.
    """

    def __init__(
        self, data: mujoco.MjData, turning: Turning, ids: Ids, distance: Array, normals: Array
    ):
        self.distance = distance
        """Of the pairs, at the poses that the planes were made at (k,), m."""
        self._base, self._other = turning.base[ids], turning.other[ids]
        self._spread = turning.spread[ids]
        away = normals * turning.sign[ids]
        rotation = data.geom_xmat.reshape(-1, 3, 3)
        self._normal = np.einsum("kji,kj->ki", rotation[self._base], away)
        self._seen = np.einsum("kji,kj->ki", rotation[self._other], away)
        apart = data.geom_xpos[self._other] - data.geom_xpos[self._base]
        self._offset = distance - np.einsum("ki,ki->k", away, apart)

    def least(self, data: mujoco.MjData, which: Ids) -> Array:
        """Return lower bounds of the distances of some pairs (k,) at other kinematics."""
        base, other = self._base[which], self._other[which]
        rotation, position = data.geom_xmat.reshape(-1, 3, 3), data.geom_xpos
        away = np.einsum("kij,kj->ki", rotation[base], self._normal[which])
        turned = np.einsum("kji,kj->ki", rotation[other], away)
        turned -= self._seen[which]
        turn = np.sqrt(np.einsum("ki,ki->k", turned, turned))
        gap = np.einsum("ki,ki->k", away, position[other] - position[base])
        return self._offset[which] + gap - self._spread[which] * turn
