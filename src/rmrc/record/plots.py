"""A run as panels of plots: plain data that the page's script draws."""

import base64
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rmrc.record.channels import Channel, positions, rates

if TYPE_CHECKING:
    from rmrc.record.run import Run

Array = NDArray[np.float64]
Panel = dict[str, Any]

# Points that a trace may have, and that all traces of a panel may have together: a screen is
# about 2000 pixels wide, and a browser redraws 150 000 points without a pause.
TRACE_POINTS = 4000
PANEL_POINTS = 120_000
# Cells that a strip may have along time.
STRIP_CELLS = 2000

# From calm to alarming; a status that is not here is drawn in the last colour.
STATUS_COLOURS = {
    "OK": "#4c9f70",
    "LIMITED": "#5b8def",
    "SCALED": "#38a3a5",
    "DAMPED": "#a06fd0",
    "RECOVERING": "#d9b13b",
    "RELAXED": "#e08e45",
    "STUCK": "#8d5a2b",
    "MAX_ITER": "#dd4b39",
    "DEADLINE": "#d6408b",
    "STALE": "#5c6670",
    "INVALID_INPUT": "#7a1030",
}
SINGULAR_VALUE = "Smallest singular value σ_min"
_BOUND_COLOURS = {"lower bound": "#38a3a5", "upper bound": "#e08e45"}


def status_colour(name: str) -> str:
    """Return the colour of a status."""
    return STATUS_COLOURS.get(name, STATUS_COLOURS["INVALID_INPUT"])


def step_length(time: Array) -> float:
    """Return the usual length of a step in s, 0 where there are fewer than two."""
    return float(np.median(np.diff(time))) if len(time) > 1 else 0.0


def panels(run: "Run") -> dict[str, Any]:
    """Return what the report of a run draws."""
    drawn = [
        *_error_panels(run),
        _joint_panel(run, "Joint positions", positions(run.manifest["model"], run.q)),
        _velocity_panel(run),
        *_margin_panels(run),
        _status_panel(run),
        _active_panel(run),
        line_panel(run.time, "Largest KKT residual", "", {"residual": run.kkt}),
        line_panel(run.time, SINGULAR_VALUE, "", {"σ_min": run.sigma_min}, log=False),
        _step_time_panel(run),
    ]
    return page_data(run.time, drawn)


def page_data(time: Array, drawn: Sequence[Panel | None], **more: Any) -> dict[str, Any]:
    """Return what a page draws: the time axis and the panels from top to bottom."""
    return {
        "time": _packed(time),
        "range": [float(time[0]), _end(time)] if len(time) else [0.0, 1.0],
        "panels": [panel for panel in drawn if panel is not None],
        **more,
    }


def extreme_rows(values: Array, limit: int) -> NDArray[np.intp]:
    """Return at most `limit` rows, in order, that keep the extremes of every stretch of a curve.

    The rows are the first, the last, and the least and the greatest value of each of
    (limit − 2)/2 stretches of equal length; all rows where there are no more than `limit`.

    Args:
        values: The curve (N,); NaN is never an extreme.
        limit: At least 4.
    """
    rows = len(values)
    if rows <= limit:
        return np.arange(rows)
    length = -(-rows // ((limit - 2) // 2))
    # The last stretch is filled up with its last value, which is a row of its own anyway.
    stretches = np.pad(values, (0, -rows % length), mode="edge").reshape(-1, length)
    starts = np.arange(len(stretches)) * length
    least = starts + np.where(np.isnan(stretches), np.inf, stretches).argmin(axis=1)
    greatest = starts + np.where(np.isnan(stretches), -np.inf, stretches).argmax(axis=1)
    return np.unique(np.concatenate([[0], least, greatest, [rows - 1]]).clip(max=rows - 1))


def _end(time: Array) -> float:
    """Return the end of the last step, s; a run of one step is drawn as a second."""
    return float(time[-1]) + (step_length(time) or 1.0)


def _packed(values: NDArray[Any]) -> str:
    """Return an array as base64 of little-endian 32-bit floats, as the script unpacks it."""
    with np.errstate(over="ignore"):
        return base64.b64encode(np.asarray(values).astype("<f4").tobytes()).decode("ascii")


def _trace(time: Array, name: str, values: Array, limit: int, **more: Any) -> dict[str, Any]:
    """Return one curve, downsampled; without `x` it has a point at each of the page's times."""
    rows = extreme_rows(values, limit)
    x = {"x": _packed(time[rows])} if len(rows) < len(values) else {}
    return {"name": name, **x, "y": _packed(values[rows]), **more}


def line_panel(
    time: Array,
    title: str,
    unit: str,
    curves: Mapping[str, Array],
    marks: Sequence[dict[str, Any]] = (),
    log: bool = True,
    styles: Mapping[str, Mapping[str, Any]] | None = None,
) -> Panel | None:
    """Return a panel of positive curves; None where all are NaN.

    Args:
        time: The page's times (N,), s.
        title: Of the panel.
        unit: Of the values.
        curves: The values (M,) by name, M ≤ N: the curve of a run that ended early is shorter.
        marks: Horizontal lines, as `mark` gives them.
        log: Whether the axis is logarithmic at first.
        styles: `series`, the number of the colour, `dash`, `width` and `layer`, by the names of
            curves; by default each has a colour of its own.
    """
    if not any(np.isfinite(curve).any() for curve in curves.values()):
        return None
    styles = styles or {}
    traces = [
        _trace(time, name, curve, TRACE_POINTS, **styles.get(name, {}))
        for name, curve in curves.items()
    ]
    return {
        "kind": "lines",
        "title": title,
        "unit": unit,
        "traces": traces,
        "marks": marks,
        "log": log,
    }


def mark(name: str, y: float, unit: str) -> dict[str, Any]:
    """Return a horizontal line with its name and value."""
    return {"y": float(y), "text": f"{name} {y:.3g} {unit}"}


def _error_panels(run: "Run") -> list[Panel | None]:
    """Return one panel for each unit that the tasks' errors have."""
    curves: dict[str, dict[str, Array]] = {}
    for name, task in run.manifest["tasks"].items():
        for column, unit in enumerate(task["units"]):
            curves.setdefault(unit, {})[name] = run.error[name][:, column]
    titles = {"m": "Position error", "rad": "Angular error"}
    tolerance = run.manifest["config"].get("tolerance", {})
    wanted = {"m": tolerance.get("position"), "rad": tolerance.get("orientation")}
    return [
        line_panel(
            run.time,
            titles.get(unit, f"Error in {unit}"),
            unit,
            curves[unit],
            [mark("tolerance", wanted[unit], unit)] if wanted.get(unit) else (),
        )
        for unit in sorted(curves)
    ]


def _margin_panels(run: "Run") -> list[Panel | None]:
    """Return one panel for each kind of limit on distances and speeds."""
    drawn = []
    for kind, room in run.margin.items():
        unit = _margin_unit(kind, run.manifest["config"])
        curves = {"room": np.where(np.isfinite(room), room, np.nan)}
        marks = [mark("limit", 0.0, unit)]
        title = f"Room to the {kind} limit"
        drawn.append(line_panel(run.time, title, unit, curves, marks, log=False))
    return drawn


def _margin_unit(kind: str, config: Mapping[str, Any]) -> str:
    """Return the unit of a kind of limit; frames may be limited in two."""
    if kind != "speed":
        return "rad" if kind == "position" else "m"
    limits = config.get("limits", {}).get("speed", {}).values()
    units = {"linear": "m/s", "angular": "rad/s"}
    return " or ".join(units[part] for part in units if any(limit.get(part) for limit in limits))


def _joint_panel(
    run: "Run", title: str, channels: Sequence[Channel], measured: Array | None = None
) -> Panel:
    """Return a panel of joints, each with its own limits and its largest share of them."""
    limit = max(1000, min(TRACE_POINTS, PANEL_POINTS // max(1, len(channels))))
    traces = []
    for channel in channels:
        trace = _trace(run.time, channel.name, channel.values, limit, unit=channel.unit)
        if channel.bounded:
            middle, half = (channel.lower + channel.upper) / 2, (channel.upper - channel.lower) / 2
            peak = float(np.fmax.reduce(np.abs(channel.values - middle), initial=0.0)) / half
            trace |= {"lower": channel.lower, "upper": channel.upper, "peak": peak}
        if measured is not None:
            trace["measured"] = _trace(run.time, "measured", measured[:, channel.dof], limit)
        traces.append(trace)
    return {"kind": "joints", "title": title, "traces": traces}


def _velocity_panel(run: "Run") -> Panel:
    channels = rates(run.manifest["model"], run.v, "velocity")
    dofs = [channel.dof for channel in channels]
    followed_exactly = np.array_equal(run.v[:, dofs], run.v_measured[:, dofs], equal_nan=True)
    measured = None if followed_exactly else run.v_measured
    return _joint_panel(run, "Joint velocities", channels, measured)


def _step_time_panel(run: "Run") -> Panel | None:
    if not len(run.step_time):
        return None
    microseconds = run.step_time * 1e6
    median, p99 = np.percentile(microseconds, [50, 99])
    marks = [mark("median", median, "µs"), mark("99 %", p99, "µs")]
    return line_panel(run.time, "Time to compute a step", "µs", {"step": microseconds}, marks)


def _strip(title: str, run: "Run", rows: Mapping[str, NDArray[Any]], names: Sequence[str]) -> Panel:
    """Return a panel of coloured strips, one for each row of integers (N,), greatest wins."""
    steps = len(run.time)
    length = -(-steps // STRIP_CELLS)
    cells = [
        np.pad(values, (0, -steps % length), mode="edge").reshape(-1, length).max(axis=1).tolist()
        for values in rows.values()
    ]
    return {
        "kind": "strip",
        "title": title,
        "edges": _packed(np.append(run.time[::length], _end(run.time))),
        "rows": list(rows),
        "cells": cells,
        "names": list(names),
    }


def _status_panel(run: "Run") -> Panel | None:
    if not len(run.time):
        return None
    statuses = run.manifest["statuses"]
    panel = _strip("Status", run, {"": run.status}, statuses)
    return panel | {"colours": [status_colour(name) for name in statuses]}


def _active_panel(run: "Run") -> Panel | None:
    """Return the strips of the joints that have had an active bound; None where none has."""
    # 0 none, 1 lower, 2 upper.
    rows = {
        channel.name: np.where(active < 0, 1, 2 * active)
        for channel in rates(run.manifest["model"], run.v, "velocity")
        if (active := run.active[:, channel.dof]).any()
    }
    if not rows:
        return None
    panel = _strip("Active limits", run, rows, ["", *_BOUND_COLOURS])
    return panel | {"colours": ["rgba(0,0,0,0)", *_BOUND_COLOURS.values()]}
