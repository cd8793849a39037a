"""Where the numbers of a step stand that the extension has noted one after another."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rmrc.problem.evaluation import Kept
from rmrc.qp.rows import KeptRows

if TYPE_CHECKING:
    from rmrc.native.engine import NativeEngine

Array = NDArray[np.float64]

_NONE = np.zeros(0)


class Layout:
    """Where the numbers of a record stand that the extension has noted one after another."""

    def __init__(self, engine: "NativeEngine"):
        model, data, evaluation = engine.problem.model, engine.evaluation.data, engine.evaluation
        nq, nv, n = model.nq, model.nv, engine.problem.dofs.size
        self.kept = {
            "error": evaluation.error,
            "targets": evaluation.targets,
            "twists": evaluation.twists,
        }
        """The arrays that each step keeps a copy of."""
        if model.nmocap:
            self.kept |= {
                "mocap_pos": data.mocap_pos,
                "mocap_quat": data.mocap_quat,
                "obstacle_twist": evaluation.obstacle_twist,
            }
        first = {"kkt": 3, "dt": 1, "share": 1, "v": nv, "q": nq, "from": nq}
        first |= {"v_previous": nv, "z": n}
        shapes = {name: (size,) for name, size in first.items()}
        shapes |= {name: array.shape for name, array in self.kept.items()}
        shapes["moving"] = (len(evaluation.moving),)
        self._parts: dict[str, tuple[slice, tuple[int, ...]]] = {}
        end = 0
        for name, shape in shapes.items():
            begin, end = end, end + math.prod(shape)
            self._parts[name] = (slice(begin, end), shape)
        self._rows, self._end = engine.rows, end

    def part(self, numbers: Array, name: str) -> Array:
        """Return an array by its name."""
        place, shape = self._parts[name]
        return numbers[place].reshape(shape)

    def rows(self, numbers: Array) -> tuple[KeptRows | None, Array, Array]:
        """Return the rows of a step, if it had any, and the multipliers of rows and equalities."""
        rows, barriers = self._rows, self._rows.barriers
        counts, numbers = np.split(numbers[self._end :], [len(barriers)])
        count = rows.speed_count + int(counts.sum())
        of_rows, of_equalities = np.split(numbers, [4 * count])
        if not count:
            return None, _NONE, of_equalities
        ids, lower, upper, multiplier = of_rows.reshape(4, -1)
        blocks, first = [], rows.speed_count
        for barrier, count in zip(barriers, counts.astype(int).tolist(), strict=True):
            part = slice(first, first + count)
            blocks.append((barrier, ids[part].astype(np.intp), part))
            first += count
        return KeptRows(rows.speeds, blocks, lower, upper), multiplier, of_equalities

    def surroundings(self, numbers: Array) -> Kept:
        """Return the error of a step, and what it depended on beside q and v_prev."""
        moving = self.part(numbers, "moving").astype(np.uint8).tobytes()
        twists = (moving, self.part(numbers, "twists")) if 1 in moving else None
        obstacles = None
        if "mocap_pos" in self.kept:
            obstacles = (
                self.part(numbers, "mocap_pos"),
                self.part(numbers, "mocap_quat"),
                self.part(numbers, "obstacle_twist"),
            )
        return Kept(self.part(numbers, "error"), self.part(numbers, "targets"), twists, obstacles)
