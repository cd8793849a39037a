"""A run in numbers: what `--json` prints and the manifest keeps."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rmrc.record.channels import Channel, positions, rates

Array = NDArray[np.float64]

# A run has converged whose errors are within tolerance for so long, s, and so many steps.
SETTLED, SETTLED_STEPS = 0.1, 10
# Less than this outside a limit (rad, m, and their rates) is rounding, not a violation.
ROUNDING = 1e-9


def summarize(
    *,
    dt: float,
    q: Array,
    v: Array,
    status: NDArray[np.uint8],
    error: Mapping[str, Array],
    step_time: Array,
    model: dict[str, Any],
    tasks: Mapping[str, Mapping[str, Any]],
    statuses: Sequence[str],
    engine: str,
    backend: str,
    method: str,
    tolerance: Mapping[str, float],
    converging: Mapping[str, Collection[int]],
    least: Mapping[str, tuple[float, str, str]],
    resolution: float,
) -> dict[str, Any]:
    """Return the summary of a run of N steps.

    Args:
        dt: Length of a step, s.
        q: Configurations (N, nq).
        v: Commanded velocities (N, nv); the robot is at rest before the first.
        status: Index into `statuses` (N,).
        error: True error of each task (N, k).
        step_time: Time that each step took to compute, s (N,).
        model: The manifest's `model`.
        tasks: The manifest's `tasks`, with the units of each error's columns.
        statuses: Names of the statuses by value.
        engine: Name of the engine.
        backend: Name of the QP backend.
        method: Name of the method.
        tolerance: Largest error in the last 0.1 s, and 10 steps, that counts as converged, by unit.
        converging: The tasks that must converge, and which columns of their errors.
        least: The least room of each kind of limit on distances and speeds, its unit, and what it
            is of.
        resolution: How finely distances are kept, m.
    """
    last = slice(-max(SETTLED_STEPS, math.ceil(SETTLED / dt - ROUNDING)), None)
    converged = len(q) > 0 and all(
        bool((error[name][last, column] <= tolerance[tasks[name]["units"][column]]).all())
        for name, columns in converging.items()
        for column in columns
    )
    counts = np.bincount(status, minlength=len(statuses))
    return {
        "steps": len(q),
        "converged": converged,
        "engine": engine,
        "backend": backend,
        "method": method,
        "tasks": {name: _task(error[name], task["units"]) for name, task in tasks.items()},
        "limits": _limits(dt, q, v, model, least, resolution),
        "status": {
            name: int(number) for name, number in zip(statuses, counts, strict=True) if number
        },
        "step_time_us": _step_time(step_time),
        "real_time_factor": len(q) * dt / float(step_time.sum()) if step_time.any() else None,
    }


def _task(error: Array, units: Sequence[str]) -> dict[str, Any]:
    """Return the numbers of a task's first column, with those of an orientation nested."""
    first, *rest = (_column(error[:, i], unit) for i, unit in enumerate(units))
    return first | ({"orientation": rest[0]} if rest else {})


def _column(values: Array, unit: str) -> dict[str, Any]:
    if not values.size:
        return {"rms": None, "max": None, "final": None, "unit": unit}
    return {
        "rms": float(np.sqrt(np.mean(values**2))),
        "max": float(values.max()),
        "final": float(values[-1]),
        "unit": unit,
    }


def _limits(
    dt: float,
    q: Array,
    v: Array,
    model: dict[str, Any],
    least: Mapping[str, tuple[float, str, str]],
    resolution: float,
) -> dict[str, Any]:
    """Return how far each kind of limit was passed."""
    rest = np.zeros((1, v.shape[1]))
    acceleration = np.diff(v, axis=0, prepend=rest) / dt
    jerk = np.diff(acceleration, axis=0, prepend=rest) / dt
    return {
        "position": _position(positions(model, q)),
        "velocity": _violation(rates(model, v, "velocity")),
        "acceleration": _violation(rates(model, acceleration, "acceleration")),
        "jerk": _violation(rates(model, jerk, "jerk"), ROUNDING / dt),
        **{
            kind: _passed(least.get(kind), resolution)
            for kind in ("collision", "workspace", "speed")
        },
    }


def _position(channels: Sequence[Channel]) -> dict[str, Any]:
    """Return the largest excess over the ranges, and how far a joint was outside at the start.

    Where it starts is not rmrc's doing: until it has come back it may be as far outside as then,
    but at the end it counts.
    """
    started = _violation([replace(c, values=c.values[:1]) for c in channels])
    after = _violation([replace(c, values=c.values[_counting(c.excess)]) for c in channels])
    return after | {"started_outside": started if started["max_violation"] else None}


def _counting(excess: Array) -> NDArray[np.bool_]:
    """Return the rows (N,) whose excess (N,) is a violation, where there is any."""
    back = np.cumsum(excess <= ROUNDING) > 0
    counting = back | (excess > excess[:1] + ROUNDING)
    counting[-1:] = True
    return counting


def _violation(channels: Sequence[Channel], rounding: float = ROUNDING) -> dict[str, Any]:
    """Return the largest excess over the limits, and the joint that it is of.

    Less than `rounding` is none: that of a jerk is an acceleration's over dt.
    """
    largest: dict[str, Any] = {"max_violation": 0.0, "joint": None, "unit": None}
    for channel in channels:
        excess = float(channel.excess.max(initial=0.0))
        if excess > max(rounding, largest["max_violation"]):
            largest = {"max_violation": excess, "joint": channel.name, "unit": channel.unit}
    return largest


def _passed(least: tuple[float, str, str] | None, resolution: float) -> dict[str, Any]:
    """Return how far a limit is passed where the room is least, and what it is of."""
    if least is None or least[0] >= -(resolution if least[1] == "m" else ROUNDING):
        return {"max_violation": 0.0, "joint": None, "unit": None}
    room, unit, name = least
    return {"max_violation": -room, "joint": name, "unit": unit}


def _step_time(step_time: Array) -> dict[str, float | None]:
    if not step_time.size:
        return {"median": None, "p99": None, "max": None}
    median, p99, largest = 1e6 * np.percentile(step_time, [50, 99, 100])
    return {"median": float(median), "p99": float(p99), "max": float(largest)}
