"""What came of many steps; figures of episodes add up, in any order, to those of all."""

from collections import Counter
from dataclasses import dataclass, field
from math import inf

from rmrc.control.step import Step


@dataclass
class Figures:
    """What came of all steps."""

    statuses: Counter[str] = field(default_factory=Counter)
    """Steps by their most severe status."""
    scenes: Counter[str] = field(default_factory=Counter)
    """Steps by scene."""
    engines: Counter[str] = field(default_factory=Counter)
    """Steps by engine."""
    worst: dict[str, float] = field(default_factory=dict)
    """The largest violation of each kind."""
    kkt: float = 0.0
    """The largest residual of a solution that nothing was reported of."""
    slowest: dict[str, tuple[float, str]] = field(default_factory=dict)
    """The longest time of a step by engine, s, of its thread where it has a deadline."""
    late: tuple[float, str] = (-inf, "")
    """The longest time in s that a native step took beyond its deadline."""
    braking: int = 0
    """Steps that braked for what came in."""
    refused: int = 0
    """Configurations that the package refused."""
    steps: int = 0

    def add(self, scene: str, step: Step, found: dict[str, float], braking: bool) -> None:
        """Take note of a step."""
        self.steps += 1
        self.scenes[scene] += 1
        self.statuses[step.status.name] += 1
        self.braking += braking
        for kind, excess in found.items():
            self.worst[kind] = max(self.worst.get(kind, 0.0), excess)

    def time(self, engine: str, seconds: float, deadline: float, again: str) -> None:
        """Take note of how long a step took."""
        self.engines[engine] += 1
        self.slowest[engine] = max(self.slowest.get(engine, (0.0, "")), (seconds, again))
        if engine == "native" and deadline < inf:
            self.late = max(self.late, (seconds - deadline, again))

    def join(self, other: "Figures") -> None:
        """Add the figures of other steps."""
        self.statuses += other.statuses
        self.scenes += other.scenes
        self.engines += other.engines
        for kind, excess in other.worst.items():
            self.worst[kind] = max(self.worst.get(kind, 0.0), excess)
        for engine, slowest in other.slowest.items():
            self.slowest[engine] = max(self.slowest.get(engine, (0.0, "")), slowest)
        self.kkt, self.late = max(self.kkt, other.kkt), max(self.late, other.late)
        self.braking += other.braking
        self.refused += other.refused
        self.steps += other.steps
