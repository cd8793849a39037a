"""The page of a comparison: its table, and the curves of all runs over one another."""

from collections.abc import Callable, Collection, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rmrc.record.channels import positions
from rmrc.record.page import badge, card, cell, quantity, write_page
from rmrc.record.plots import SINGULAR_VALUE, line_panel, mark, page_data

if TYPE_CHECKING:
    from rmrc.record.compare import Comparison, Entry

Array = NDArray[np.float64]
Style = dict[str, Any]
"""`series`, the number of the colour, and `dash`."""

DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
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
        whole: Whether to have what the methods leave out too; a terminal is narrow.
    """
    runs = summary["runs"]
    columns = _columns(runs[0]) | _limit_columns(runs)
    columns |= {
        "least σ_min": lambda run: _number(run["sigma_min"], "value", digits=2),
        "step [µs]": lambda run: _number(run["step_time_us"], "median"),
        **({"leaves out": _left_out} if whole else {}),
        "statuses": lambda run: Cell(", ".join(f"{k} {v}" for k, v in run["status"].items())),
    }
    return list(columns), [[column(run) for column in columns.values()] for run in runs]


def _columns(first: dict[str, Any]) -> Columns:
    """Return the columns whose units are the same in all runs; lengths are in mm."""
    error, rate = ((first[key] or {}).get("unit") for key in ("error", "largest_rate"))
    unit, scale = ("mm", 1e3) if error == "m" else (error, 1.0)
    return {
        "method": _name,
        f"error rms [{unit}]": lambda run: _number(run["error"], "rms", scale),
        f"error max [{unit}]": lambda run: _number(run["error"], "max", scale),
        "off line [mm]": lambda run: _number(run["line"], "max", 1e3),
        f"largest rate [{rate}]": lambda run: _number(run["largest_rate"], "value"),
    }


def _limit_columns(runs: Sequence[dict[str, Any]]) -> Columns:
    """Return a column for each limit that is passed; joints that slide may differ in the unit."""
    columns: Columns = {}
    for kind in runs[0]["limits"]:
        passed = [run["limits"][kind] for run in runs if run["limits"][kind]["max_violation"]]
        units = {limit["unit"] for limit in passed}
        if passed or kind in ALWAYS_SHOWN:
            head = f"past {kind}" + (f" [{units.pop()}]" if len(units) == 1 else "")
            columns[head] = lambda run, kind=kind, units=units: _excess(run["limits"][kind], units)
    return columns


def _name(run: dict[str, Any]) -> Cell:
    return Cell(run["name"]) if run["finished"] else Cell(f"{run['name']} (unfinished)", bad=True)


def _excess(limit: dict[str, Any], units: Collection[str]) -> Cell:
    """Return the excess over a limit and its joint, with its unit where there are several."""
    if not limit["max_violation"]:
        return Cell("none")
    unit = f" {limit['unit']}" if units else ""
    return Cell(f"{_number(limit, 'max_violation').text}{unit} {limit['joint']}", bad=True)


def _left_out(run: dict[str, Any]) -> Cell:
    limits = [] if run["keeps_limits"] else ["limits"]
    return Cell(", ".join([*limits, *run["ignored_tasks"]]) or "–")


def _number(numbers: dict[str, Any] | None, key: str, scale: float = 1.0, digits: int = 3) -> Cell:
    """Return a number, without an exponent up to a million."""
    value = numbers[key] if numbers else None
    if value is None:
        return Cell("–")
    value *= scale
    return Cell(f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.{digits}g}")


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
    panels = [
        line_panel(
            time,
            shown.title,
            shown.unit,
            {entry.name: shown.curve(entry) for entry in entries},
            shown.marks,
            shown.log,
            styles,
        )
        for shown in _quantities(entries)
    ]
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
    """Return the styles of curves by name: a colour for each method where there are several.

    Each is thinner than the one below it, so that curves that coincide are all seen.
    """
    methods = list(dict.fromkeys(entry.run.summary["method"] for entry in entries))
    styles, seen = {}, dict.fromkeys(methods, 0)
    for number, entry in enumerate(entries):
        method = entry.run.summary["method"]
        several = len(methods) > 1
        styles[entry.name] = {
            "series": methods.index(method) if several else number,
            "dash": DASHES[seen[method] % len(DASHES)] if several else DASHES[0],
            "width": round(WIDEST - (WIDEST - THINNEST) * number / len(entries), 2),
        }
        seen[method] += 1
    return styles


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
    if first.deviation is not None:
        yield _Quantity("Distance from the line", "m", lambda entry: entry.deviation[:, 0])
        yield _Quantity("Angle off the line's", "rad", lambda entry: entry.deviation[:, 1])
    yield _Quantity("Largest joint rate", unit, _largest_rate, marks=_cap(first))
    yield _Quantity("Norm of the joint rates", unit, _rate_norm)
    yield _Quantity(SINGULAR_VALUE, "", lambda entry: entry.run.sigma_min, log=False)
    if any(_outside(entry).any() for entry in entries):
        yield _Quantity("Outside the joint range", unit.removesuffix("/s"), _outside, log=False)
    for name in tasks:
        if name != task:
            yield from _errors(name, tasks[name]["units"])


def _errors(task: str, units: Sequence[str]) -> Iterator[_Quantity]:
    for column, unit in enumerate(units):
        yield _Quantity(
            f"Error of {task}", unit, lambda entry, k=column: entry.run.error[task][:, k]
        )


def _rates(entry: "Entry") -> Array:
    """Return the rates of the joints (n, N)."""
    return np.array([channel.values for channel in entry.rates])


def _largest_rate(entry: "Entry") -> Array:
    return np.abs(_rates(entry)).max(axis=0)


def _rate_norm(entry: "Entry") -> Array:
    return np.linalg.norm(_rates(entry), axis=0)


def _cap(entry: "Entry") -> list[dict[str, Any]]:
    """Return the mark of the velocity limit, where it is the same for all joints."""
    caps = {channel.upper for channel in entry.rates}
    finite = len(caps) == 1 and np.isfinite(min(caps))
    return [mark("limit", min(caps), entry.rates[0].unit)] if finite else []


def _outside(entry: "Entry") -> Array:
    """Return how far the joint that is farthest outside its range is outside (N,)."""
    unit = entry.rates[0].unit.removesuffix("/s")
    channels = positions(entry.run.manifest["model"], entry.run.q)
    return np.max([channel.excess for channel in channels if channel.unit == unit], axis=0)
