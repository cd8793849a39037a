"""The nearest points of pairs of geoms that were nearest before they jumped elsewhere."""

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ids = NDArray[np.intp]

KEPT = 3
"""Points of a pair that are kept beside the nearest: with it they are the corners of a face."""
ASIDE = 0.05
"""Share of their distance by which kept points may have slid along each other and still are those
of a corner and of the face before it."""
ELSEWHERE = 10.0
"""Steps at the speed of the fastest joint: where q is farther from where the last command led, the
robot was put elsewhere, and nearest points that were say nothing of those to come."""


class Contacts:
    """Pairs of points that were the nearest of two geoms, each as it stands in its geom.

    The first of a pair's `count` is the nearest of now, the others were it before it jumped, by
    more than the ball that fits into the thinner geom. The distance of two points of the geoms is
    at least that of the geoms. Those that slide a little along each other are a corner and its
    place on a face: the distance is that of a point and a plane, whose normal stands in one geom.
    """

    def __init__(self, geoms: Ids, base: Ids, apart: Array):
        self._geoms, self._base = geoms, base
        self.apart = apart
        """The way (p,) that the nearest points do not jump where they only slide, m."""
        self.points = np.zeros((len(geoms), KEPT + 1, 9))
        """The points of the first and of the second geom, and the normal in the base's axes."""
        self.count = np.zeros(len(geoms), dtype=np.intp)
        """How many there are (p,)."""

    def see(self, data: mujoco.MjData, ids: Ids, segments: Array, normals: Array) -> None:
        """Take the points (k, 6) that are the nearest of pairs (k,) now, with their normals."""
        now = np.empty((ids.size, 9))
        for side, geoms in enumerate(self._geoms[ids].T):
            three = slice(3 * side, 3 * side + 3)
            now[:, three] = _turned_back(data, geoms, segments[:, three] - data.geom_xpos[geoms])
        now[:, 6:] = _turned_back(data, self._base[ids], normals)
        count = self.count[ids]
        jumped = (count > 0) & ~self._same(ids, now, self.points[ids, 0])
        same = self._same(ids[:, None], now[:, None], self.points[ids, 1:])
        met = (same & (np.arange(1, KEPT + 1) < count[:, None])).any(axis=1)
        for k in np.flatnonzero(jumped | met).tolist():
            self._renew(data, int(ids[k]), now[k], bool(jumped[k]))
        self.points[ids, 0] = now
        self.count[ids] = np.maximum(self.count[ids], 1)

    def _renew(self, data: mujoco.MjData, pair: int, now: Array, jumped: bool) -> None:
        """Keep the nearest points of before if they jumped, and none that are those of now."""
        points, count = self.points[pair], int(self.count[pair])
        if jumped:
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
        self.count[pair] = count

    def kept(self, data: mujoco.MjData, ids: Ids) -> tuple[Ids, Array, Array, Array]:
        """Return the kept points of pairs but for the nearest: the pair of each (m,), the points
        (m, 6), normals (m, 3) and distances (m,).
        """
        counts = np.maximum(self.count[ids], 1) - 1
        pairs = np.repeat(ids, counts)
        places = np.arange(pairs.size) - np.repeat(np.cumsum(counts) - counts, counts) + 1
        points = self.points[pairs, places]
        segments = self._segments(data, pairs, points)
        between = segments[:, 3:] - segments[:, :3]
        distance = np.sqrt((between * between).sum(axis=1))
        apart = distance > 0.0
        pairs, points, segments = pairs[apart], points[apart], segments[apart]
        between, distance = between[apart], distance[apart]
        flat = _turned(data, self._base[pairs], points[:, 6:])
        height = (flat * between).sum(axis=1)
        aside = np.sqrt(np.maximum(distance * distance - height * height, 0.0))
        slides = (height > 0.0) & (aside <= ASIDE * distance)
        normals = np.where(slides[:, None], flat, between / distance[:, None])
        return pairs, segments, normals, np.where(slides, height, distance)

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
        segments = self._segments(data, np.full(KEPT, pair), points[1:])
        return 1 + int(np.argmax(((segments[:, 3:] - segments[:, :3]) ** 2).sum(axis=1)))

    def _segments(self, data: mujoco.MjData, pairs: Ids, points: Array) -> Array:
        """Return where kept points (m, 9) are now (m, 6)."""
        ends = zip(self._geoms[pairs].T, (points[:, :3], points[:, 3:6]), strict=True)
        return np.hstack([data.geom_xpos[geoms] + _turned(data, geoms, at) for geoms, at in ends])

    def _same(self, pairs: Ids | int, one: Array, other: Array) -> NDArray[np.bool_]:
        """Return whether the points of both geoms are no jump away."""
        square = (one - other) ** 2
        farther = np.maximum(square[..., :3].sum(axis=-1), square[..., 3:6].sum(axis=-1))
        return farther <= self.apart[pairs] ** 2


def _turned(data: mujoco.MjData, geoms: Ids, vectors: Array) -> Array:
    """Return R v of geoms and vectors (k, 3); by @ the last bit depends on the addresses."""
    return (data.geom_xmat[geoms].reshape(-1, 3, 3) * vectors[:, None, :]).sum(axis=2)


def _turned_back(data: mujoco.MjData, geoms: Ids, vectors: Array) -> Array:
    """Return Rᵀ v of geoms and vectors (k, 3)."""
    return (data.geom_xmat[geoms].reshape(-1, 3, 3) * vectors[:, :, None]).sum(axis=1)
