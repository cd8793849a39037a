"""The other methods of a run, closed forms and mink: the tasks, paths and record are the QP's."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rmrc import reference
from rmrc.config.models import Config, DampingModel, SolverModel
from rmrc.config.solvers import backend_of
from rmrc.engine.mink_ik import MinkIK, Unsolved, ignored_tasks, unread
from rmrc.limits.ball import BallRanges
from rmrc.problem.evaluation import Evaluation
from rmrc.problem.problem import Problem
from rmrc.qp.assemble import Assembly
from rmrc.qp.cascade import WHOLE
from rmrc.qp.program import KKT, Solution, SolveStatus
from rmrc.qp.rows import Rows
from rmrc.tasks.base import Term, square_root
from rmrc.text.mistakes import Mistake, config_error

Array = NDArray[np.float64]

PASSED = 1e-9
"""What a command is beyond the limits of a joint by, rad/s or m/s, is more than rounding."""
UNCERTIFIED = KKT(np.nan, np.nan, np.nan)
"""A closed form solves no program, and so has no residuals."""


@dataclass(frozen=True, eq=False)
class Ask:
    """What a step asks of a closed form: the rows of the highest level, and what else there is."""

    problem: Problem
    evaluation: Evaluation
    assembly: Assembly
    rows: NDArray[np.intp]
    """The rows of the highest level that have a weight."""
    weight: Array
    """B of those rows (m, m)."""
    dt: float

    @cached_property
    def jacobian(self) -> Array:
        """J (m, n)."""
        return self.evaluation.jacobian[np.ix_(self.rows, self.problem.dofs)]

    @cached_property
    def rate(self) -> Array:
        """ẋ = K e + ẋ_ff (m,)."""
        return self.assembly.rate[self.rows]

    @property
    def metric(self) -> Array:
        """A (n, n)."""
        return self.assembly.metric()

    @property
    def curved(self) -> Array:
        """A + X (n, n), with the curvature of the highest level's tasks."""
        assembly, levels = self.assembly, self.assembly.curvature.levels
        if not levels:
            return self.metric
        highest = min(levels)
        unit = assembly.unit * self.problem.soft_ratio**highest
        return self.metric + np.diag(levels[highest]) / unit


def _descent(ask: Ask) -> Array:
    """Return one step of gradient descent on ½ eᵀBe with a line search, as a velocity."""
    evaluation, problem = ask.evaluation, ask.problem
    start, root = evaluation.data.qpos.copy(), square_root(ask.weight)

    def at(step: Array) -> Array:
        evaluation.move(start, problem.dofs, step)
        return -root @ evaluation.error[ask.rows]

    def jacobian(step: Array) -> Array:
        evaluation.move(start, problem.dofs, step)
        return root @ evaluation.jacobian[np.ix_(ask.rows, problem.dofs)]

    rest = np.zeros(problem.dofs.size)
    found = reference.descent(
        np.zeros(ask.rows.size), rest, at, jacobian, tolerance=0.0, max_iterations=1
    )
    evaluation.move(start, problem.dofs, rest)
    return found.q / ask.dt


Solve = Callable[[Ask], Array | reference.Saturation]

METHODS: dict[str, Solve] = {
    "inverse": lambda ask: reference.inverse(ask.jacobian, ask.rate),
    "transpose": lambda ask: reference.transpose(ask.jacobian, ask.rate),
    "pinv": lambda ask: reference.pinv(ask.jacobian, ask.rate),
    "weighted": lambda ask: reference.weighted(ask.jacobian, ask.rate, ask.metric),
    "dls": lambda ask: reference.weighted_dls(
        ask.jacobian, ask.rate, ask.curved, ask.weight, ask.assembly.damping
    ),
    "sdls": lambda ask: reference.selectively_damped(ask.jacobian, ask.rate * ask.dt) / ask.dt,
    "nullspace": lambda ask: reference.prioritized(
        [(level.rows, level.rate) for level in ask.assembly.levels()[:-1]],
        damping=ask.assembly.damping * math.sqrt(ask.assembly.unit),
    ),
    "saturated": lambda ask: reference.saturate(
        ask.jacobian, ask.rate, ask.assembly.qp.lb, ask.assembly.qp.ub
    ),
    "descent": _descent,
}
"""The closed form of each method: v (n,), with what the limits did to it where it keeps them."""

KEPT_LIMITS = {
    "saturated": ("position", "velocity", "acceleration", "jerk"),
    "mink": ("position", "velocity", "balls", "collision", "mink's"),
}
"""The limits that methods keep, but for those that keep none and qp, which keeps all."""
ALL_LEVELS = frozenset({"nullspace", "mink"})
"""The methods that have tasks below the highest level, and tasks on the joints."""
BENT = frozenset({"qp", "dls"})
"""The methods that have the curvature of the tasks."""
DAMPED = BENT | {"nullspace", "mink"}
"""The methods that have λ."""
WITH_SOLVER = frozenset({"qp", "mink"})
"""The methods that have a QP solver."""


def as_read(config: Config) -> Config:
    """Return a configuration without what its method does not read of damping and solver."""
    method, update = config.method, {}
    if method not in DAMPED:
        update["damping"] = DampingModel()
    elif method not in BENT:
        update["damping"] = config.damping.model_copy(update={"curvature": True})
    if method not in WITH_SOLVER:
        update["solver"] = SolverModel()
    return config.model_copy(update=update)


def ignored_limits(problem: Problem) -> list[str]:
    """Return the limits at work that the problem's method has no place for, if it keeps any."""
    kept, box = KEPT_LIMITS.get(problem.config.method), problem.box
    if kept is None:
        return []
    at_work = {
        "acceleration": bool(np.isfinite(box.acceleration).any()),
        "jerk": bool(np.isfinite(box.jerk).any()),
        "balls": any(isinstance(limit, BallRanges) for limit in problem.barriers),
        "speed": bool(problem.speeds),
        "workspace": bool(problem.config.limits.workspace),
        "collision": problem.config.limits.collision != "off",
        "mink's": bool(problem.mink_limits),
    }
    return [kind for kind, works in at_work.items() if works and kind not in kept]


def ignored(problem: Problem) -> list[Term]:
    """Return the tasks that the problem's method has no place for."""
    method = problem.config.method
    highest = min((t.level for t in problem.terms if t.rows and not t.joint), default=0)
    if method == "qp":
        return []
    if method == "mink":
        return ignored_tasks(problem)
    if method in ALL_LEVELS:
        return [term for term in problem.terms if not term.rows]
    return [t for t in problem.terms if t.joint or not t.rows or t.level > highest]


def shortcomings(problem: Problem) -> list[str]:
    """Return what the problem's method cannot honour, a sentence each."""
    method, lines = problem.config.method, []
    follow = problem.config.follow
    if follow != "rate" and problem.barriers:
        lines.append(
            f"follow {follow} shortens its commands where a distance would be passed, but does not "
            "evade what moves towards the robot"
        )
    if method == "qp":
        return lines
    if method not in KEPT_LIMITS:
        lines.append(f"method {method} keeps no limits; what it passes is counted as violations")
    elif kinds := ignored_limits(problem):
        lines.append(f"method {method} has no place for the limits {', '.join(kinds)}")
    if absent := ignored(problem):
        names = ", ".join(term.name for term in absent)
        lines.append(f"method {method} has no place for the tasks {names}")
    if method == "mink":
        lines += [f"method {method} has no place for {asked}" for asked in unread(problem)]
    elif problem.mink_tasks:
        names = ", ".join(type(task).__name__ for task in problem.mink_tasks)
        lines.append(f"method {method} has no place for tasks of mink's: {names}")
    return lines


class MethodEngine:
    """Turns q, v_prev, the targets and dt into the v of a closed form, or of mink."""

    name = "python"
    relaxed = damped = False
    deadline = math.inf
    share = 1.0

    def __init__(self, problem: Problem):
        self.problem = problem
        self.backend = backend_of(problem.config.solver.backend)
        self.evaluation = Evaluation(problem)
        self.assembly = Assembly(problem, self.evaluation)
        self.rows = Rows(problem, self.evaluation)
        self.outside = False
        self.scaled = False
        """Whether the limits slowed the task down at the last step."""
        self.passes = False
        """Whether the last command passes a limit of a joint."""
        self.fault: str | None = None
        """Why mink has given no command, where it has not."""
        method = problem.config.method
        self._method: Solve = MinkIK(problem) if method == "mink" else METHODS[method]
        left_out = {term.name for term in ignored(problem)}
        kept = [t for t in self.evaluation.terms if not t.joint and t.name not in left_out]
        weights = [np.diag(t.weight) if t.weight.ndim == 1 else t.weight for t in kept]
        weight = np.zeros((0, 0))
        for block in weights:
            corner = np.zeros((len(weight), len(block)))
            weight = np.block([[weight, corner], [corner.T, block]])
        rows = np.concatenate(
            [np.arange(s.start, s.stop) for s in map(self._slice, kept)] or [np.zeros(0, np.intp)]
        ).astype(np.intp)
        weighed = np.diagonal(weight) > 0.0
        self._rows, self._weight = rows[weighed], weight[np.ix_(weighed, weighed)]
        if mistake := self._misfit():
            raise config_error([mistake], problem.config)

    def _misfit(self) -> Mistake | None:
        """Return why the method cannot run on this problem at all."""
        method, n, rows = self.problem.config.method, self.problem.dofs.size, self._rows.size
        if hard := [term.name for term in self.problem.terms if term.hard]:
            return Mistake(
                ("method",),
                f"{method} has no place for hard tasks: {', '.join(hard)}; "
                "take qp, or set `hard: false`",
            )
        if method in ALL_LEVELS and len(ignored(self.problem)) == len(self.problem.terms):
            return Mistake(("method",), f"{method} has no place for any of the tasks")
        if not rows and method not in ALL_LEVELS:
            return Mistake(
                ("method",), f"{method} needs a task with a weight on a frame or a point"
            )
        if method == "inverse" and rows != n:
            return Mistake(
                ("method",),
                f"inverse needs as many task rows as dofs, and there are {rows} rows and {n} dofs; "
                "pinv takes any number",
            )
        inertia = self.problem.inertia > 0.0  # M(q) weighs every dof
        if (
            method == "weighted"
            and not inertia
            and np.linalg.matrix_rank(self.assembly.metric()) < n
        ):
            return Mistake(("method",), "weighted needs a metric that weighs every dof: set metric")
        return None

    def _slice(self, term: Term) -> slice:
        return self.evaluation.rows_of([term])

    @property
    def steps_alone(self) -> bool:
        """Whether the extension can take a controller's common steps without Python."""
        return False

    def reset(self) -> None:
        """A closed form remembers nothing."""

    def keep_distances(self, solution: Solution, dt: float) -> None:
        """Do nothing: a closed form keeps no distances."""

    def prepare(self, q: Array, v_previous: Array, dt: float) -> bool:
        """Evaluate and assemble without solving; return whether a joint is outside its range."""
        self.evaluation.v_previous[:] = v_previous
        self.evaluation.update(q)
        self.evaluation.evaluate()
        return self.assembly.assemble(q, dt)

    def solve(self, q: Array, v_previous: Array, dt: float) -> Solution:
        """Return the closed form's v at q (nq,) for a step of dt seconds.

        Where it has none, as an inverse at a singularity or mink where no v keeps its limits, or
        where an evaluation cannot be used, v is the brake.
        """
        self.outside, self.fault = self.prepare(q, v_previous, dt), None
        qp = self.assembly.qp
        ask = Ask(self.problem, self.evaluation, self.assembly, self._rows, self._weight, dt)
        solution = Solution.at_rest(qp)
        solution.kkt = UNCERTIFIED
        self.passes = False
        if self.evaluation.refused:
            solution.v = np.clip(solution.v, qp.lb, qp.ub)
            return solution
        try:
            found = self._method(ask)
        except ValueError as failure:
            found = np.full(qp.g.size, np.nan)
            self.fault = str(failure) if isinstance(failure, Unsolved) else None
        scale = 1.0
        if isinstance(found, reference.Saturation):
            found, scale, solution.bound_multiplier = found
        self.scaled = scale < 1.0 - WHOLE
        if np.isfinite(found).all():
            solution.v, solution.status = found, SolveStatus.SOLVED
            beyond = np.maximum(qp.lb - found, found - qp.ub)
            self.passes = bool(beyond.max(initial=0.0) > PASSED)
        else:
            solution.v = np.clip(solution.v, qp.lb, qp.ub)
        return solution
