"""Many controllers at once in C++: their states in the extension, one engine for each thread."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rmrc import _native
from rmrc.problem.problem import Problem

if TYPE_CHECKING:
    from rmrc.control.controller import Controller

Array = NDArray[np.float64]


class NativeBatch:
    """Takes the steps of `count` elements, on one thread for each controller."""

    def __init__(self, problem: Problem, controllers: list["Controller"], count: int):
        self._count, self._nq, self._nv = count, problem.model.nq, problem.model.nv
        self._native = _native.Batch(
            count=count,
            workers=[
                (
                    controller.stepper,
                    evaluation.targets,
                    evaluation.twists,
                    np.frombuffer(evaluation.moving, dtype=np.uint8),
                )
                for controller in controllers
                for evaluation in (controller.engine.evaluation,)
            ],
            start=np.concatenate([term.target for term in problem.terms]).tolist(),
        )
        ends = np.cumsum([term.target.size for term in problem.terms]).tolist()
        self._places = {
            term.name: (k, end - term.target.size, term.target_kind == "pose")
            for k, (term, end) in enumerate(zip(problem.terms, ends, strict=True))
        }

    def reset(self, q: Array, v: Array) -> None:
        """Start anew at valid q (n, nq) with v (n, nv)."""
        self._native.reset(q, v)

    def set_targets(self, name: str, values: Array, velocities: Array | None) -> NDArray[np.bool_]:
        """Set a target of all elements, and return whose was valid."""
        accepted = np.empty(self._count, dtype=np.uint8)
        self._native.aim(*self._places[name], values, velocities, accepted)
        return accepted.view(np.bool_)

    @property
    def q(self) -> Array:
        """The configurations (n, nq) that the last commands led to."""
        q = np.empty((self._count, self._nq))
        self._native.read(q)
        return q

    def step(self, q: Array | None, dt: float) -> tuple[Array, Array, NDArray[np.int32]]:
        """Return v, q and flags after a step of dt seconds from q (n, nq), or the last's."""
        v, following = np.empty((self._count, self._nv)), np.empty((self._count, self._nq))
        flags = np.empty(self._count, dtype=np.int32)
        self._native.step(q, dt, v, following, flags)
        return v, following, flags
