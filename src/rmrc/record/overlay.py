"""The page of a comparison: its table, and the curves of all runs over one another."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from rmrc.config.models import Method
from rmrc.record.channels import positions
from rmrc.record.page import badge, card, cell, escape, quantity, write_page
from rmrc.record.plots import SINGULAR_VALUE, line_panel, mark, page_data

if TYPE_CHECKING:
    from rmrc.runs.compare import Comparison, Entry

Array = NDArray[np.float64]
Style = dict[str, Any]
"""`series`, the number of the colour, `dash`, `width` and `layer`."""

COLOURS = 10
"""How many the style has: more could not be told apart."""
SERIES = {method: min(number, COLOURS - 1) for number, method in enumerate(get_args(Method))}
"""The number of each method's colour, the same in every comparison; the last methods share one."""
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
FAINT = 1e-8
"""Less than this share of its greatest value is noise in a curve."""
WIDEST, THINNEST = 3.4, 1.2
"""Widths of the curves in pixels, from the lowest to the one on top."""
ALWAYS_SHOWN = ("position", "velocity")
"""The limits that have a column in the table even where no run passes them."""


class Cell(NamedTuple):
    """What stands in the table, and whether it is a fault."""

    text: str
    bad: bool = False


Columns = dict[str, Callable[[dict[str, Any]], Cell]]
"""What stands in the columns of a table, by their heads, for the numbers of a run."""


def table(summary: dict[str, Any], whole: bool = True) -> tuple[list[str], list[list[Cell]]]:
    """Return the heads of the columns and the rows of a comparison's summary.

    Args:
        summary: The comparison's.
        whole: Whether to have the columns too that a narrow terminal has no room for.
    """
    runs = summary["runs"]
    more: Columns = {
        "solves": lambda run: _number(run, "solves"),
        "leaves out": _left_out,
    }
    columns = {
        **_columns(runs[0]),
        **_limit_columns(runs),
        "least σ_min": lambda run: _number(run["sigma_min"], "value"),
        "step [µs]": lambda run: _number(run["step_time_us"], "median"),
        **(more if whole else {}),
        "statuses": lambda run: Cell(", ".join(f"{k} {v}" for k, v in run["status"].items())),
    }
    return list(columns), [[column(run) for column in columns.values()] for run in runs]


def _columns(first: dict[str, Any]) -> Columns:
    """Return the columns whose units are the same in all runs; lengths are in mm."""
    error, rate = ((first[key] or {}).get("unit") for key in ("error", "largest_rate"))
    unit, scale = ("mm", 1e3) if error == "m" else (error, 1.0)
    return {
        "method": _name,
        _head("error rms", unit): lambda run: _number(run["error"], "rms", scale),
        _head("error max", unit): lambda run: _number(run["error"], "max", scale),
        _head("off line", unit): lambda run: _number(run["line"], "max", scale),
        _head("largest rate", rate): lambda run: _number(run["largest_rate"], "value"),
    }


def _limit_columns(runs: Sequence[dict[str, Any]]) -> Columns:
    """Return a column for each limit that is passed; joints that slide may differ in the unit."""
    columns: Columns = {}
    for kind in runs[0]["limits"]:
        passed = [run["limits"][kind] for run in runs if run["limits"][kind]["max_violation"]]
        units = {limit["unit"] for limit in passed}
        if passed or kind in ALWAYS_SHOWN:
            unit = units.pop() if len(units) == 1 else None
            columns[_head(f"past {kind}", unit)] = lambda run, kind=kind, with_unit=unit is None: (
                _excess(run["limits"][kind], with_unit)
            )
    return columns


def _head(text: str, unit: str | None) -> str:
    return f"{text} [{unit}]" if unit else text


def _name(run: dict[str, Any]) -> Cell:
    return Cell(run["name"]) if run["finished"] else Cell(f"{run['name']} (unfinished)", bad=True)


def _excess(limit: dict[str, Any], with_unit: bool) -> Cell:
    """Return the excess over a limit and its joint."""
    if not limit["max_violation"]:
        return Cell("none")
    unit = f" {limit['unit']}" if with_unit else ""
    return Cell(f"{_number(limit, 'max_violation').text}{unit} {limit['joint']}", bad=True)


def _left_out(run: dict[str, Any]) -> Cell:
    limits = run["ignored_limits"] if run["keeps_limits"] else ["limits"]
    return Cell(", ".join([*limits, *run["ignored_tasks"]]) or "–")


def _number(numbers: dict[str, Any] | None, key: str, scale: float = 1.0) -> Cell:
    """Return a number with three digits; with one, or with all before the point, to be short."""
    value = numbers[key] if numbers else None
    if value is None:
        return Cell("–")
    value *= scale
    if 1e3 <= value < 1e6:
        return Cell(f"{value:.0f}")
    return Cell(f"{value:.{3 if value >= 0.01 else 1}g}")


def write_overlay(comparison: "Comparison", path: str | Path) -> None:
    """Write the page of a comparison.

    Args:
        comparison: The comparison.
        path: The HTML file; about 5 MB, most of it plotly.js.
    """
    entries, styles = comparison.entries, _styles(comparison.entries)
    head, rows = table(comparison.summary)
    lines = [
        [
            _legend(entry.name, row[0].text, styles[entry.name]),
            *(cell(c.text, bad=c.bad) for c in row[1:]),
        ]
        for entry, row in zip(entries, rows, strict=True)
    ]
    time = max((entry.run.time for entry in entries), key=len)
    panels = []
    for shown in _quantities(entries):
        curves = {entry.name: shown.curve(entry) for entry in entries}
        layered = {name: styles[name] | _layer(curve) for name, curve in curves.items()}
        panels.append(
            line_panel(time, shown.title, shown.unit, curves, shown.marks, shown.log, layered)
        )
    write_page(
        path,
        comparison.manifest,
        badge=_badge(comparison),
        facts=_facts(comparison),
        cards=[card("Methods", head, lines, "wide")],
        notices=[f"{name} is left out: {reason}" for name, reason in comparison.left_out.items()],
        data=page_data(time, panels, linked=True),
        hint="A click on a method hides it in all of them.",
    )


def _styles(entries: Sequence["Entry"]) -> dict[str, Style]:
    """Return the styles of curves by name: the method's colour, or each its own if there is one.

    Those of the same colour differ by their dashes. Each is thinner than the one below it, so that
    curves that coincide are all seen.
    """
    methods = [entry.run.summary["method"] for entry in entries]
    several = len(set(methods)) > 1
    styles = {}
    for number, (entry, method) in enumerate(zip(entries, methods, strict=True)):
        before = sum(SERIES[each] == SERIES[method] for each in methods[:number])
        styles[entry.name] = {
            "series": SERIES[method] if several else number,
            "dash": DASHES[before % len(DASHES)] if several else DASHES[0],
            "width": round(WIDEST - (WIDEST - THINNEST) * number / len(entries), 2),
        }
    return styles


def _layer(curve: Array) -> Style:
    """Return the style of a curve that zigzags, as gradient methods do: thin, below the others.

    Every fifth of its points or more is a turn between two jumps of a tenth of its value.
    """
    steps, later = np.diff(curve), curve[1:]
    jumps = np.sign(steps)
    jumps[np.abs(steps) < 0.1 * later] = 0.0
    jumps[later < FAINT * np.fmax.reduce(curve, initial=0.0)] = 0.0
    turns = np.count_nonzero(jumps[1:] * jumps[:-1] < 0.0)
    return {"layer": -1, "width": THINNEST} if turns > 0.2 * len(curve) else {}


def _legend(name: str, text: str, style: Style) -> str:
    """Return the cell that the script makes the legend of a run."""
    data = {"name": name, **style}
    attributes = "".join(f' data-{key}="{escape(str(value))}"' for key, value in data.items())
    return f"<td{attributes}>{escape(text)}</td>"


def _badge(comparison: "Comparison") -> str:
    if comparison.interrupted:
        return badge("interrupted", good=False)
    return "" if comparison.finished else badge("unfinished", good=False)


def _facts(comparison: "Comparison") -> list[str]:
    config, task = comparison.config, comparison.entries[0].task
    return [
        f"{len(comparison.entries)} runs of {config.steps} steps of {quantity(config.dt, 's')}",
        *([f"errors are those of {task}"] if task is not None else []),
    ]


class _Quantity(NamedTuple):
    """What a panel shows of each run."""

    title: str
    unit: str
    curve: Callable[["Entry"], Array]
    log: bool = True
    marks: Sequence[dict[str, Any]] = ()


def _quantities(entries: Sequence["Entry"]) -> Iterator[_Quantity]:
    first = entries[0]
    task, tasks, unit = first.task, first.run.manifest["tasks"], first.rates[0].unit
    if task is not None:
        yield from _errors(task, tasks[task]["units"])
        yield from _deviations(first, tasks[task]["units"])
    for name in tasks:
        if name != task:
            yield from _errors(name, tasks[name]["units"])
    yield _Quantity("Largest joint rate", unit, _largest_rate, marks=_cap(first))
    yield _Quantity("Norm of the joint rates", unit, _rate_norm)
    yield _Quantity(SINGULAR_VALUE, "", lambda entry: entry.run.sigma_min, log=False)
    if any(_outside(entry).any() for entry in entries):
        yield _Quantity("Outside the joint range", unit.removesuffix("/s"), _outside, log=False)


def _errors(task: str, units: Sequence[str]) -> Iterator[_Quantity]:
    for column, unit in enumerate(units):
        yield _Quantity(
            f"Error of {task}", unit, lambda entry, k=column: entry.run.error[task][:, k]
        )


def _deviations(first: "Entry", units: Sequence[str]) -> Iterator[_Quantity]:
    halves = (("m", "Distance from the line"), ("rad", "Angle from the line's orientation"))
    for column, (unit, title) in enumerate(halves):
        if first.deviation is not None and unit in units:
            yield _Quantity(title, unit, lambda entry, k=column: entry.deviation[:, k])


def _rates(entry: "Entry") -> Array:
    """Return the rates of the joints (n, N)."""
    return np.array([channel.values for channel in entry.rates])


def _largest_rate(entry: "Entry") -> Array:
    return np.abs(_rates(entry)).max(axis=0)


def _rate_norm(entry: "Entry") -> Array:
    return np.linalg.norm(_rates(entry), axis=0)


def _cap(entry: "Entry") -> list[dict[str, Any]]:
    """Return the mark of the velocity limit, where all joints that have one have the same."""
    caps = {channel.upper for channel in entry.rates if channel.bounded}
    return [mark("limit", cap, entry.rates[0].unit) for cap in caps if len(caps) == 1]


def _outside(entry: "Entry") -> Array:
    """Return how far the joint that is farthest outside its range is outside (N,)."""
    unit = entry.rates[0].unit.removesuffix("/s")
    channels = positions(entry.run.manifest["model"], entry.run.q)
    return np.max([channel.excess for channel in channels if channel.unit == unit], axis=0)
