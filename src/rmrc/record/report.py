"""The report of a run: its summary, and its errors, joints and statuses over time."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rmrc.record.page import badge, card, cell, escape, quantity, write_page
from rmrc.record.plots import panels, status_colour, step_length

if TYPE_CHECKING:
    from rmrc.record.run import Run


def write_report(run: "Run", path: str | Path) -> None:
    """Write the report: summary, linked plots over time, configuration and versions.

    Args:
        run: The run.
        path: The HTML file; about 5 MB, most of it plotly.js.
    """
    write_page(
        path,
        run.manifest,
        badge=_badge(run.manifest),
        facts=_facts(run),
        cards=(make(run) for make in (_tasks, _limits, _statuses, _times)),
        notices=run.manifest.get("notices", ()),
        data=panels(run),
    )


def _badge(manifest: dict[str, Any]) -> str:
    if manifest.get("interrupted"):
        return badge("interrupted", good=False)
    converged = manifest["summary"]["converged"]
    return badge("converged" if converged else "not converged", good=converged)


def _facts(run: "Run") -> list[str]:
    summary = run.summary
    length = step_length(run.time)
    return [
        f"{summary['steps']} steps of {quantity(length, 's')}",
        quantity(summary["steps"] * length, "s"),
        f"{run.manifest['model']['nv']} degrees of freedom",
        *(f"{key} {summary[key]}" for key in ("method", "backend", "engine")),
    ]


def _tasks(run: "Run") -> str:
    rows = []
    for name, task in run.summary["tasks"].items():
        for part, note in ((task, ""), (task.get("orientation"), "orientation")):
            if part is not None:
                numbers = (quantity(part[key], part["unit"]) for key in ("final", "rms", "max"))
                rows.append([cell(name, note), *map(cell, numbers)])
    return card("Task errors", ("task", "at the end", "rms", "largest"), rows)


def _limits(run: "Run") -> str:
    rows, wanted = [], run.manifest["config"].get("limits", {})
    for kind, limit in run.summary["limits"].items():
        excess = limit["max_violation"]
        none = "off" if wanted.get(kind) in ("off", [], {}) else "none"
        passed = quantity(excess, limit["unit"]) if excess else none
        rows.append([cell(kind, limit["joint"] or ""), cell(passed, bad=bool(excess))])
        if started := limit.get("started_outside"):
            by = quantity(started["max_violation"], started["unit"])
            rows.append([cell("started outside by", started["joint"]), cell(by)])
    return card("Limits", ("limit", "violation"), rows)


def _statuses(run: "Run") -> str:
    rows = []
    for name, number in run.summary["status"].items():
        swatch = f'<i class="swatch" style="background:{status_colour(name)}"></i>'
        share = f"{number / run.summary['steps']:.1%}"
        rows.append([f"<td>{swatch}{escape(name)}</td>", cell(str(number), share)])
    return card("Statuses", ("status", "steps"), rows)


def _times(run: "Run") -> str:
    times, factor = run.summary["step_time_us"], run.summary["real_time_factor"]
    rows = []
    for key, title in (("median", "median"), ("p99", "99 %"), ("max", "largest")):
        seconds = None if times[key] is None else times[key] * 1e-6
        rows.append([cell(title), cell(quantity(seconds, "s"))])
    rows.append([cell("real-time factor"), cell("–" if factor is None else f"{factor:.3g}")])
    return card("Time", ("", "of a step"), rows)
