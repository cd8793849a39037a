"""The nearest points of pairs of geoms that were nearest before they jumped elsewhere."""

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KEPT = 3
"""Points of a pair that are kept beside the nearest: with it they are the corners of a face."""
ASIDE = 0.05
"""Share of their distance by which kept points may have slid along each other and still are those
of a corner and of the face before it."""


class Contacts:
    """Pairs of points that were the nearest of two geoms, each as it stands in its geom.

    The first of a pair's `count` is the nearest of now, the others were it before it jumped, by
    more than the ball that fits into the thinner geom. The distance of two points of the geoms is
    at least that of the geoms. Those that slide a little along each other are a corner and its
    place on a face: the distance is that of a point and a plane, whose normal stands in one geom.
    """

    def __init__(self, geoms: NDArray[np.intp], base: NDArray[np.intp], apart: Array):
        self._geoms, self._base = geoms, base
        self.apart = apart
        """The way (p,) that the nearest points do not jump where they only slide, m."""
        self.points = np.zeros((len(geoms), KEPT + 1, 9))
        """The points of the first and of the second geom, and the normal in the base's axes."""
        self.count = np.zeros(len(geoms), dtype=np.intp)
        """How many there are (p,)."""

    def see(self, data: mujoco.MjData, pair: int, segment: Array, normal: Array) -> None:
        """Take the points (6,) that are the nearest of a pair now, with their normal (3,)."""
        points, count = self.points[pair], int(self.count[pair])
        now = np.empty(9)
        for side, geom in enumerate(self._geoms[pair].tolist()):
            three = slice(3 * side, 3 * side + 3)
            now[three] = _turned(_axes(data, geom).T, segment[three] - data.geom_xpos[geom])
        now[6:] = _turned(_axes(data, self._base[pair]).T, normal)
        if count and not self._same(pair, now, points[0]):
            place = self._place(data, pair)
            points[place] = points[0]
            count = max(count, place + 1)
        place = 1
        while place < count:
            if self._same(pair, now, points[place]):
                count -= 1
                points[place] = points[count]
            else:
                place += 1
        points[0] = now
        self.count[pair] = max(count, 1)

    def kept(self, data: mujoco.MjData, pair: int) -> list[tuple[Array, Array, float]]:
        """Return the kept points of a pair but for the nearest (6,), normals (3,) and distances."""
        found = []
        for points in self.points[pair, 1 : max(int(self.count[pair]), 1)]:
            segment = self._segment(data, pair, points)
            normal = segment[3:] - segment[:3]
            distance = float(np.sqrt((normal * normal).sum()))
            if distance == 0.0:
                continue
            flat = _turned(_axes(data, self._base[pair]), points[6:])
            height = float((flat * normal).sum())
            aside = np.sqrt(max(distance * distance - height * height, 0.0))
            if height > 0.0 and aside <= ASIDE * distance:
                found.append((segment, flat, height))
            else:
                found.append((segment, normal / distance, distance))
        return found

    def forget(self) -> None:
        """Keep nothing."""
        self.count[:] = 0

    def _place(self, data: mujoco.MjData, pair: int) -> int:
        """Return where to keep the nearest points of before: for the same, or for the farthest."""
        points, count = self.points[pair], int(self.count[pair])
        for place in range(1, count):
            if self._same(pair, points[0], points[place]):
                return place
        if count <= KEPT:
            return count
        segments = [self._segment(data, pair, kept) for kept in points[1:]]
        return 1 + int(np.argmax([((s[3:] - s[:3]) ** 2).sum() for s in segments]))

    def _segment(self, data: mujoco.MjData, pair: int, points: Array) -> Array:
        """Return where kept points are now (6,)."""
        ends = zip(self._geoms[pair].tolist(), (points[:3], points[3:6]), strict=True)
        places = [data.geom_xpos[geom] + _turned(_axes(data, geom), at) for geom, at in ends]
        return np.concatenate(places)

    def _same(self, pair: int, one: Array, other: Array) -> bool:
        """Return whether the points of both geoms are no jump away."""
        square = (one - other) ** 2
        return max(square[:3].sum(), square[3:6].sum()) <= self.apart[pair] ** 2


def _axes(data: mujoco.MjData, geom: int) -> Array:
    return data.geom_xmat[geom].reshape(3, 3)


def _turned(axes: Array, vector: Array) -> Array:
    """Return axes @ vector; by @ the last bit depends on the addresses."""
    return (axes * vector).sum(axis=1)
