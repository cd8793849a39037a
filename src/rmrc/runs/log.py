"""The rows of a run as they come, and the `Run` that they become."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rmrc.control.controller import Controller
from rmrc.control.status import ACTIVE_MULTIPLIER, Status
from rmrc.control.step import Step
from rmrc.problem.problem import Problem
from rmrc.record.manifest import manifest
from rmrc.record.run import Run
from rmrc.record.summary import summarize
from rmrc.runs.deviation import line_deviations, line_summary
from rmrc.runs.execution import State
from rmrc.runs.measure import Margin, Measure

Array = NDArray[np.float64]

STATUSES = [status.name for status in Status]
_ROWS = ("time", "q", "v", "v_measured", "status", "sigma_min", "active", "kkt", "step_time")


class Log:
    """The rows of a run as they come, in arrays allocated once."""

    def __init__(
        self,
        problem: Problem,
        controller: Controller,
        unfinished: list[str],
        notices: Sequence[str],
        count: int | None = None,
    ):
        model = problem.model
        count = problem.config.steps if count is None else count
        self.unfinished, self._notices = unfinished, notices
        self.problem, self.controller = problem, controller
        self.count, self.done, self.interrupted = count, 0, False
        self.time = np.zeros(count)
        self.q = np.zeros((count, model.nq))
        self.v = np.zeros((count, model.nv))
        self.v_measured = np.zeros((count, model.nv))
        actuated = problem.config.execute == "actuated"
        self.q_commanded = np.zeros((count, model.nq)) if actuated else None
        self.status = np.zeros(count, dtype=np.uint8)
        self.active = np.zeros((count, model.nv), dtype=np.int8)
        self.kkt = np.zeros(count)
        self.step_time = np.zeros(count)
        self.sigma_min = np.zeros(count)
        self._measure = Measure(problem)
        self.margin = {kind: np.full(count, np.inf) for kind in self._measure.kinds}
        self._least: dict[str, Margin] = {}
        moved = bool(problem.config.obstacles)
        self.mocap = np.zeros((count, 7 * model.nmocap)) if moved else None
        self.error = {t.name: np.zeros((count, len(t.units))) for t in problem.terms if t.units}

    def add(self, k: int, now: float, step: Step, state: State, nanoseconds: int) -> None:
        """Write row k: a step at a time in s, the state that it was taken in, how long it took."""
        self.time[k], self.q[k], self.v[k], self.v_measured[k] = now, state.q, step.v, state.v
        if self.q_commanded is not None:
            self.q_commanded[k] = state.q_commanded
        self.status[k] = step.status
        multiplier = step.solution.bound_multiplier
        binding = np.where(np.abs(multiplier) > ACTIVE_MULTIPLIER, np.sign(multiplier), 0)
        self.active[k, self.problem.dofs] = binding
        self.kkt[k] = step.solution.kkt.largest
        self.step_time[k] = nanoseconds * 1e-9
        self.sigma_min[k] = step.moment.engine.assembly.sigma_min()
        for name, values in self.error.items():
            values[k] = state.error[name]
        data = step.moment.engine.evaluation.data
        for kind, margin in self._measure.at(state.q, step.v, data).items():
            self.margin[kind][k] = margin.room
            if kind not in self._least or margin.room < self._least[kind].room:
                self._least[kind] = margin
        if self.mocap is not None:
            self.mocap[k] = np.hstack([data.mocap_pos, data.mocap_quat]).ravel()
        self.done = k + 1

    def run(self, solves: int) -> Run:
        """Return the run of the rows so far, which took so many solves."""
        problem, config = self.problem, self.problem.config
        rows: dict[str, Any] = {name: getattr(self, name)[: self.done] for name in _ROWS}
        if self.q_commanded is not None:
            rows["q_commanded"] = self.q_commanded[: self.done]
        if self.mocap is not None:
            rows["mocap"] = self.mocap[: self.done]
        error = {name: values[: self.done] for name, values in self.error.items()}
        margin = {kind: values[: self.done] for kind, values in self.margin.items()}
        record = manifest(problem, STATUSES)
        converging = {
            term.name: range(len(term.units))
            for term in problem.terms
            if term.level == 0 and term.decisive
        }
        record["summary"] = summarize(
            dt=problem.dt,
            q=rows["q"],
            v=rows["v"],
            status=rows["status"],
            error=error,
            step_time=rows["step_time"],
            model=record["model"],
            tasks=record["tasks"],
            statuses=STATUSES,
            engine=self.controller.engine.name,
            backend=self.controller.engine.backend,
            method=config.method,
            tolerance={"m": config.tolerance.position, "rad": config.tolerance.orientation},
            converging=converging,
            least={kind: (m.room, m.unit, m.name) for kind, m in self._least.items()},
            resolution=problem.resolution,
        )
        record["summary"]["solves"] = solves
        for name, line in line_deviations(problem, rows["q"]).items():
            record["summary"]["tasks"][name]["line"] = line_summary(problem.term[name], line)
        record["interrupted"] = self.interrupted
        record["notices"] = [*self.unfinished, *self._notices, *record["notices"]]
        if self.interrupted or self.unfinished:
            record["summary"]["converged"] = False
        return Run(**rows, error=error, margin=margin, manifest=record)
