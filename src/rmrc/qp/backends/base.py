"""What a QP solver is to us."""

from abc import ABC, abstractmethod
from math import inf, isfinite
from time import perf_counter
from typing import ClassVar

from rmrc.errors import SolverError
from rmrc.qp.backends.pace import Pace
from rmrc.qp.polish import Polish
from rmrc.qp.program import QP, Solution, SolveStatus

NO_POINT = (SolveStatus.INFEASIBLE, SolveStatus.FAILED)
"""Statuses whose v means nothing: OSQP leaves 2 143 289 344 in it, the bits of a float32 NaN."""
HEALTHY = (SolveStatus.SOLVED, SolveStatus.TIME_LIMIT)
"""Statuses after which the workspace is kept. A solve that is cut off step after step gets further
from where the last one ended; from a cold start it would never end."""


class Backend(ABC):
    """A QP solver that keeps its workspace and starts each solve from the last solution.

    `setup` and `update` read the buffers of a `QP`; `solve` answers, and never raises for what the
    numbers hold. After any answer but SOLVED and TIME_LIMIT the solver is set up anew before it is
    used again: a bad warm start does not persist. A subclass implements `_load`, `_refresh` and
    `_run`, and says whether its solver ends at the optimum or near it, to be polished.
    """

    screened: ClassVar[bool] = True
    """Whether each update is looked through first: numbers that are not finite cost some solvers
    0.4 s. Where they cost nothing, the certificate is enough."""

    def __init__(self, *, polished: bool) -> None:
        self._polished = polished
        self._polish: Polish | None = None
        self._qp: QP | None = None
        self._refusal: SolveStatus | None = None
        self._spoiled = False
        self._end = inf
        self._polishing = Pace()

    def allow(self, seconds: float | None) -> None:
        """Let what follows take `seconds` from now, updates and solves together; None for any time.

        It holds until the next call. A solve that the end cuts off is a TIME_LIMIT, with the point
        it has got to or at rest; where no time is left, nothing is begun. Setting up, an update,
        and the least that the solver does between two looks at the clock are not cut off.
        """
        self._end = inf if seconds is None else perf_counter() + seconds

    def setup(self, qp: QP) -> None:
        """Read all of `qp` and forget what came before."""
        self._qp = qp
        self._spoiled = perf_counter() >= self._end
        if self._spoiled:
            self._refusal = SolveStatus.TIME_LIMIT
            return
        self._polish = Polish(qp) if self._polished else None
        self._refusal = qp.defect() or self._load(qp)

    def update(self, qp: QP) -> None:
        """Read what has changed in the buffers of `qp`; a `QP` other than the last is set up."""
        unread = self._refusal is not None and self._refusal is not SolveStatus.TIME_LIMIT
        if qp is not self._qp or self._spoiled or unread:
            self.setup(qp)
        elif perf_counter() >= self._end:
            self._refusal = SolveStatus.TIME_LIMIT
        else:
            self._refusal = (self.screened and qp.defect()) or self._refresh(qp)

    def solve(self) -> Solution:
        """Return the solution of the program as it was last read.

        Raises SolverError before the first `setup`.
        """
        qp = self._qp
        if qp is None:
            raise SolverError("a backend needs setup() before solve()")
        if self._spoiled:
            self.setup(qp)
        if self._refusal is not None:
            return Solution.at_rest(qp, self._refusal)
        seconds = self._end - perf_counter()
        if seconds <= 0.0:
            return Solution.at_rest(qp, SolveStatus.TIME_LIMIT)
        solution = self._run(qp, seconds)
        if not isfinite(solution.v.dot(solution.v)):
            solution = Solution.at_rest(qp, SolveStatus.FAILED, solution.iterations)
        elif solution.status is SolveStatus.SOLVED and self._polish is None:
            return solution
        elif solution.status in NO_POINT:
            solution = Solution.at_rest(qp, solution.status, solution.iterations)
        elif self._polish is not None:
            solution = self._improve(self._polish, solution)
        self._spoiled = solution.status not in HEALTHY
        return solution

    def _improve(self, polish: Polish, solution: Solution) -> Solution:
        """Return the solution polished if there is time for it, else as it is."""
        begun = perf_counter()
        if self._polishing.within(self._end - begun) < 1.0:
            if solution.status is SolveStatus.SOLVED:  # but not to the residuals it stands for
                solution.status = SolveStatus.TIME_LIMIT
            return solution
        polished = polish.improve(solution)
        self._polishing.measure(perf_counter() - begun, 1)
        return polished

    @abstractmethod
    def _load(self, qp: QP) -> SolveStatus | None:
        """Build the solver's workspace; return why that cannot be, or None."""

    @abstractmethod
    def _refresh(self, qp: QP) -> SolveStatus | None:
        """Hand the buffers to the workspace that is there; return why that cannot be, or None."""

    @abstractmethod
    def _run(self, qp: QP, seconds: float) -> Solution:
        """Solve what was handed over, within `seconds` (> 0, may be inf)."""
