"""Configurations run by several methods, and in numbers what each of them made of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from rmrc.config.models import Config, Method
from rmrc.config.solvers import AUTO
from rmrc.control.engines import missing
from rmrc.engine.closed_form import KEPT_LIMITS, WITH_SOLVER, as_read, ignored, ignored_limits
from rmrc.errors import ConfigError, RmrcError, unknown_name
from rmrc.problem.compile import compile
from rmrc.problem.problem import Problem
from rmrc.qp.backends import BACKENDS, create
from rmrc.record.channels import Channel, rates
from rmrc.record.folder import FolderKind, plain, write_json
from rmrc.record.overlay import write_overlay
from rmrc.record.run import Run
from rmrc.runs.deviation import line_deviations
from rmrc.runs.solve import Progress, solve
from rmrc.text.mistakes import Mistake, config_error

Array = NDArray[np.float64]

METHODS: tuple[str, ...] = get_args(Method)
FOLLOWS: tuple[str, ...] = get_args(Config.model_fields["follow"].annotation)
NUMBERS = "compare.json"
PAGE = "compare.html"
COMPARISON_FOLDER = FolderKind("comparison", (NUMBERS, PAGE))
FORMAT = 1
NATIVE = "native"
"""Among the backends: the native engine with its own."""
REPLACED = (("method",), ("follow",))
"""The places whose mistakes are a method's, not the configuration's."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One of the runs that are compared."""

    name: str
    """Method, and backend, way of following and configuration where there are several, as in
    `qp daqp curvature=off`."""
    run: Run
    finished: bool
    """Whether it went on to the end of its duration."""
    keeps_limits: bool
    """Whether the method knows of the limits."""
    ignored_limits: tuple[str, ...]
    """The limits that it has no place for nevertheless."""
    ignored_tasks: tuple[str, ...]
    """The tasks that the method has no place for."""
    task: str | None
    """The first task of the highest level that must converge, whose errors are compared."""
    deviation: Array | None
    """That task's distance from the line, m, and angle, rad (N, 2); None where none is drawn."""

    @cached_property
    def rates(self) -> list[Channel]:
        """The commanded rates of the joints that turn; of those that slide where none turns."""
        channels = rates(self.run.manifest["model"], self.run.v, "velocity")
        return [c for c in channels if c.unit == "rad/s"] or channels

    def row(self) -> dict[str, Any]:
        """Return the run in numbers."""
        config, summary = self.run.manifest["config"], self.run.summary
        error = dict(summary["tasks"][self.task]) if self.task is not None else None
        return plain(
            {
                "name": self.name,
                "method": summary["method"],
                "backend": summary["backend"] if summary["method"] in WITH_SOLVER else None,
                "follow": config["follow"],
                "finished": self.finished,
                "converged": summary["converged"],
                "steps": summary["steps"],
                "solves": summary["solves"],
                "line": error.pop("line", None) if error is not None else None,
                "error": error,
                "largest_rate": self._largest_rate(),
                "limits": summary["limits"],
                "keeps_limits": self.keeps_limits,
                "ignored_limits": self.ignored_limits,
                "ignored_tasks": self.ignored_tasks,
                "sigma_min": self._sigma_min(),
                "step_time_us": summary["step_time_us"],
                "status": summary["status"],
            }
        )

    def _largest_rate(self) -> dict[str, Any] | None:
        if not self.run.v.size:
            return None
        values = np.abs([channel.values for channel in self.rates])
        joint, step = np.unravel_index(values.argmax(), values.shape)
        channel, time = self.rates[joint], self.run.time[step]
        return {
            "value": values[joint, step],
            "unit": channel.unit,
            "joint": channel.name,
            "time": time,
        }

    def _sigma_min(self) -> dict[str, Any] | None:
        """Return the least σ_min and when it was."""
        sigma = self.run.sigma_min
        if not np.isfinite(sigma).any():
            return None
        worst = int(np.nanargmin(sigma))
        return {"value": sigma[worst], "time": self.run.time[worst]}


@dataclass(frozen=True, eq=False)
class Comparison:
    """One configuration, or variants of it, run by several methods."""

    config: Config
    """What was run, but for the method, the backend and the way of following; of several
    configurations the first."""
    entries: tuple[Entry, ...]
    """At least one."""
    left_out: dict[str, str]
    """Why a run could not be made, by its name."""
    interrupted: bool

    @property
    def finished(self) -> bool:
        """Whether all runs went on to their end."""
        return not self.interrupted and all(entry.finished for entry in self.entries)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The runs in numbers, as plain data."""
        return {
            "task": self.entries[0].task,
            "runs": [entry.row() for entry in self.entries],
            "left_out": [{"name": name, "reason": why} for name, why in self.left_out.items()],
            "interrupted": self.interrupted,
        }

    @property
    def manifest(self) -> dict[str, Any]:
        """What `compare.json` holds: name, configuration, versions and summary."""
        return {
            "format": FORMAT,
            "name": self.config.name,
            "config": self.config.resolved(),
            "versions": self.entries[0].run.manifest["versions"],
            "summary": self.summary,
        }

    def save(self, directory: str | Path) -> Path:
        """Write `directory` with `compare.json` and `compare.html`, both or nothing.

        Raises:
            RmrcError: If the folder is in the way or cannot be written.
        """
        return COMPARISON_FOLDER.save(directory, self._write)

    def save_numbered(self, parent: str | Path) -> Path:
        """Write the same as `parent`/NAME-0001, counting up; return it.

        Raises:
            RmrcError: If the folder cannot be written.
        """
        return COMPARISON_FOLDER.save_numbered(parent, self.config.name, self._write)

    def _write(self, folder: Path) -> None:
        write_json(folder / NUMBERS, self.manifest)
        write_overlay(self, folder / PAGE)


def compare(
    config: Config | Mapping[str, Config],
    methods: Sequence[str] = (),
    backends: Sequence[str] = (),
    follow: Sequence[str] = (),
    progress: Progress | None = None,
) -> Comparison:
    """Run a configuration, or several, by several methods, one after the other.

    A method that cannot run on this problem is left out and says why. What a method does not read,
    as the curvature of the tasks, it is not run for again. An interrupt (Ctrl-C) ends the
    comparison; what was done so far is returned.

    Args:
        config: The configuration; its method, backend and way of following are replaced. Or
            several with the same dt and tasks, by what their runs are called, as
            ``{"curvature=on": …}``.
        methods: By default all.
        backends: The QP solvers of method qp, `native` for the native engine with its own; by
            default that, where it is installed, daqp, proxqp and osqp.
        follow: The ways of following a path; by default the configuration's own.
        progress: Called now and then with the number of steps done and of all.

    Raises:
        ConfigError: If none can run: what is wrong with the configuration, or why each cannot.
        RmrcError: If there is no method, backend or way of following of a name, no configuration,
            or if their dt or tasks differ.
    """
    configs = {"": config} if isinstance(config, Config) else dict(config)
    if not configs:
        raise RmrcError("there is no configuration to compare")
    variants = _variants(configs, methods, backends, follow)
    config = next(iter(configs.values()))
    entries: list[Entry] = []
    mistakes: dict[str, tuple[Mistake, ...]] = {}
    interrupted, done, whole = False, 0, sum(variant.steps for variant in variants.values())
    for name, variant in variants.items():
        try:
            entry = _entry(name, variant, _part(progress, done, whole))
            if entries:
                _ensure_alike(entries[0], entry)
            entries.append(entry)
            interrupted = entry.run.manifest["interrupted"]
        except ConfigError as error:
            mistakes[name] = error.mistakes
        except KeyboardInterrupt:  # before the first step or after the last
            if not entries:
                raise
            interrupted = True
        if interrupted:
            break
        done += variant.steps
    if not entries:
        wrong = [mistake for several in mistakes.values() for mistake in several]
        # What is wrong with the configuration itself comes first: nothing can run before.
        itself = [mistake for mistake in wrong if mistake.location[:1] not in REPLACED]
        raise config_error(itself or wrong, config)
    left_out = {
        name: "; ".join(each.message for each in several) for name, several in mistakes.items()
    }
    return Comparison(config, tuple(entries), left_out, interrupted)


def _variants(
    configs: Mapping[str, Config],
    methods: Sequence[str],
    backends: Sequence[str],
    follow: Sequence[str],
) -> dict[str, Config]:
    """Return the configurations to run, by name, in order and each once."""
    _ensure_known("method", methods, METHODS)
    _ensure_known("way of following", follow, FOLLOWS)
    for backend in backends:
        if backend != NATIVE:
            create(backend)  # an unknown one says so
    variants = {}
    there = () if missing() else (NATIVE,)
    for method in methods or METHODS:
        solvers = (backends or (*there, *BACKENDS)) if method == "qp" else ("",)
        for backend, way in product(solvers, follow or ("",)):
            name = [method, *[backend] * (len(solvers) > 1), *[way] * (len(follow) > 1)]
            read: dict[str, tuple[str, Config]] = {}
            for label, config in configs.items():
                own = AUTO if backend == NATIVE else backend or config.solver.backend
                solver = config.solver.model_copy(update={"backend": own})
                update = {"method": method, "solver": solver, "follow": way or config.follow}
                # Methods and backends are the Python engine's, so that their times compare.
                engine = NATIVE if backend == NATIVE else "python"
                variant = config.model_copy(update=update | {"engine": engine})
                read.setdefault(repr(as_read(variant).resolved()), (label, variant))
            for label, variant in read.values():
                parts = [*name, *[label] * (len(read) > 1)]
                variants[" ".join(parts)] = variant
    return variants


def _ensure_alike(first: Entry, other: Entry) -> None:
    """Refuse runs whose errors or times cannot be laid over one another."""
    one, two = ((entry.run.manifest["config"]["dt"], _units(entry)) for entry in (first, other))
    if one != two:
        raise RmrcError(
            f"'{other.name}' has not the dt and the tasks of '{first.name}', and cannot be "
            "compared with it"
        )


def _units(entry: Entry) -> dict[str, Any]:
    """Return the units of the errors by task."""
    return {name: task["units"] for name, task in entry.run.manifest["tasks"].items()}


def _ensure_known(kind: str, names: Sequence[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise RmrcError(unknown_name(kind, name, known))


def _part(progress: Progress | None, done: int, whole: int) -> Progress | None:
    """Return the progress of one run, told as that of all."""
    return None if progress is None else lambda step, _: progress(done + step, whole)


def _entry(name: str, config: Config, progress: Progress | None) -> Entry:
    problem, method = compile(config), config.method
    run = solve(problem, progress)
    task = _decisive(problem)
    return Entry(
        name=name,
        run=run,
        finished=len(run.time) == problem.config.steps,
        keeps_limits=method == "qp" or method in KEPT_LIMITS,
        ignored_limits=tuple(ignored_limits(problem)),
        ignored_tasks=tuple(term.name for term in ignored(problem)),
        task=task,
        deviation=line_deviations(problem, run.q).get(task) if task is not None else None,
    )


def _decisive(problem: Problem) -> str | None:
    decisive = (term for term in problem.terms if term.decisive and term.units)
    first = min(decisive, key=lambda term: term.level, default=None)
    return None if first is None else first.name
