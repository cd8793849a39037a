"""Signed distance of two geoms: MuJoCo's, and our own where MuJoCo's is wrong."""

from math import copysign, sqrt

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

_CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_BOX = int(mujoco.mjtGeom.mjGEOM_BOX)

# Directions nearer to parallel than this, a sine, have no common perpendicular worth using.
PARALLEL = 1e-9

ASIDE, AGAIN = 1e-10, 6
"""Distance in m by which a geom is moved to be measured again, and how often that is done."""


def is_capsule_and_box(model: mujoco.MjModel, a: int, b: int) -> bool:
    """Return whether the distance of two geoms, ordered by type, is our own."""
    return model.geom_type[a] == _CAPSULE and model.geom_type[b] == _BOX


def signed_distance(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    pair: tuple[int, int, bool],
    most: float,
    segment: Array,
) -> float:
    """Return the distance of two geoms in m, negative where they overlap.

    Args:
        model: The model.
        data: With `mj_kinematics` done.
        pair: Geoms a and b, ordered by type, and whether they are a capsule and a box.
        most: Distance in m from which on this is all that is returned.
        segment: Gets the nearest points (6,) of a and of b, with b − a = d n for the normal n
            from a to b, where the distance is below `most`.
    """
    a, b, is_ours = pair
    if is_ours:
        return min(_capsule_and_box(model, data, a, b, segment), most)
    d = mujoco.mj_geomDistance(model, data, a, b, most, segment)
    return d if d != 0.0 else _measured_again(model, data, (a, b), most, segment)


def _measured_again(
    model: mujoco.MjModel, data: mujoco.MjData, pair: tuple[int, int], most: float, segment: Array
) -> float:
    """Return the distance of two geoms that MuJoCo says is exactly 0, from a hair's breadth aside.

    MuJoCo before 4.0 says so of one in twenty boxes and meshes that are apart. Moved by 1e-10 m it
    says so again of one in six, and never that they are further apart than they are.
    """
    d, place = 0.0, data.geom_xpos[pair[1]]
    for k in range(AGAIN):
        coordinate = place[k % 3]
        place[k % 3] += -ASIDE if k % 2 else ASIDE
        d = mujoco.mj_geomDistance(model, data, *pair, most, segment)
        place[k % 3] = coordinate
        if d != 0.0:
            break
    return d


def _capsule_and_box(
    model: mujoco.MjModel, data: mujoco.MjData, capsule: int, box: int, segment: Array
) -> float:
    """Return the distance of a capsule and a box, and the nearest points of the two.

    `mj_geomDistance` has no distance of a capsule whose axis passes through the box: it takes the
    axis' own there, which is 0, or that of another part of the capsule, so that it may call the two
    apart. And it knows lengths below a millimetre no better than to a tenth.
    """
    turn, turned = data.geom_xmat[box].tolist(), data.geom_xmat[capsule, 2::3].tolist()
    apart = (data.geom_xpos[capsule] - data.geom_xpos[box]).tolist()
    c, u = _in_axes(turn, apart), _in_axes(turn, turned)  # centre and direction, in the box's axes
    s = model.geom_size[box].tolist()
    radius, half = model.geom_size[capsule, :2].tolist()
    pierced = _pierced(c, u, s, half)
    if pierced is None:
        along = _nearest(c, u, s, half)
        axis = [
            min(max(x + along * w, -r), r) - (x + along * w)
            for x, w, r in zip(c, u, s, strict=True)
        ]
        gap = sqrt(sum(x * x for x in axis))
        axis = [x / (gap or 1.0) for x in axis]
        d = gap - radius
    else:
        overlap, axis, along = pierced
        d = -(overlap + radius)
    normal = data.geom_xmat[box].reshape(3, 3) @ axis
    segment[:3] = data.geom_xpos[capsule] + along * np.array(turned) + radius * normal
    segment[3:] = segment[:3] + d * normal
    return d


def _nearest(c: Vector, u: Vector, s: list[float], half: float) -> float:
    """Return where on the segment c + t u, |t| ≤ half, the distance from a box is least.

    Half its square has the slope Σ uᵢ (what coordinate i is beyond the box), which grows with t,
    in a straight line between the places where a coordinate enters or leaves the box.
    """

    def slope(t: float) -> float:
        way = 0.0
        for x, w, r in zip(c, u, s, strict=True):
            at = x + t * w
            way += w * (at - min(max(at, -r), r))
        return way

    low, high = -half, half
    slope_low, slope_high = slope(low), slope(high)
    if slope_low >= 0.0 or slope_high <= 0.0:
        return low if slope_low >= 0.0 else high
    for x, w, r in zip(c, u, s, strict=True):
        for end in (-r, r):
            t = (end - x) / w if w else low
            if low < t < high:
                at = slope(t)
                if at < 0.0:
                    low, slope_low = t, at
                else:
                    high, slope_high = t, at
    return low + (high - low) * (slope_low / (slope_low - slope_high))


def _pierced(
    c: Vector, u: Vector, s: list[float], half: float
) -> tuple[float, list[float], float] | None:
    """Return by how much a segment overlaps a box, along which axis, and where on the segment.

    None where it does not. The overlap is least along a normal of the box's faces or along a
    perpendicular of the segment and an edge.
    """
    least, axis, edge = np.inf, [0.0, 0.0, 0.0], -1
    for i in range(3):
        overlap = s[i] + half * abs(u[i]) - abs(c[i])
        if not overlap > 0.0:
            return None
        if overlap < least:
            least, axis = overlap, [0.0, 0.0, 0.0]
            axis[i] = -copysign(1.0, c[i])
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        sine = sqrt(u[j] ** 2 + u[k] ** 2)
        if sine < PARALLEL:
            continue
        offset = (c[k] * u[j] - c[j] * u[k]) / sine
        overlap = (s[j] * abs(u[k]) + s[k] * abs(u[j])) / sine - abs(offset)
        if not overlap > 0.0:
            return None
        if overlap < least:
            least, axis, edge = overlap, [0.0, 0.0, 0.0], i
            away = -copysign(1.0, offset)
            axis[j], axis[k] = -away * u[k] / sine, away * u[j] / sine
    # Where on the capsule's axis the contact is: at its end, or abreast of the box's edge.
    along = copysign(half, sum(map(float.__mul__, u, axis)))
    if edge >= 0:
        j, k = (edge + 1) % 3, (edge + 2) % 3
        corner = {m: -copysign(s[m], axis[m]) for m in (j, k)}
        gap = sum((corner[m] - c[m]) * u[m] for m in (j, k))
        along = gap / (u[j] ** 2 + u[k] ** 2)
    return least, axis, along


def _in_axes(turn: list[float], v: list[float]) -> Vector:
    """Return the components of a vector along the columns of a rotation matrix (9,)."""
    x, y, z = v
    return (
        turn[0] * x + turn[3] * y + turn[6] * z,
        turn[1] * x + turn[4] * y + turn[7] * z,
        turn[2] * x + turn[5] * y + turn[8] * z,
    )
