"""Backends and a clock that a test turns, for solves that must end in time."""

from collections.abc import Callable
from dataclasses import dataclass

from rmrc.qp.backends import BACKENDS, Backend, create
from rmrc.qp.backends.qpsolvers_adapter import QpsolversAdapter

BUILDERS: dict[str, Callable[[], Backend]] = {
    **{name: lambda name=name: create(name) for name in BACKENDS},
    "adapter": lambda: QpsolversAdapter("daqp"),
}


@dataclass
class Clock:
    """A clock that stands still between two `tick`s apart from `step` at each look, s."""

    now: float = 0.0
    step: float = 0.0

    def __call__(self) -> float:
        self.now += self.step
        return self.now
