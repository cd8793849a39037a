"""The report of a run: one HTML file with everything in it, readable without a network."""

import io
import json
from collections.abc import Iterable
from html import escape
from importlib.resources import files
from math import floor, log10
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from ruamel.yaml import YAML

from rmrc.record.plots import panels, status_colour, step_length

if TYPE_CHECKING:
    from rmrc.record.run import Run

_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: ""}


def write_report(run: "Run", path: str | Path) -> None:
    """Write the report: summary, linked plots over time, configuration and versions.

    Args:
        run: The run.
        path: The HTML file; about 5 MB, most of it plotly.js.
    """
    # Imported here, as importing plotly takes longer than the rest of a short command.
    from plotly.offline import get_plotlyjs

    page = Template(_asset("report.html")).substitute(
        title=escape(run.manifest["name"]),
        style=_asset("report.css"),
        badge=_badge(run.manifest),
        facts=_facts(run),
        tables="".join(card(run.summary) for card in (_tasks, _limits, _statuses, _times)),
        notices="".join(f"<li>{escape(n)}</li>" for n in run.manifest.get("notices", ())),
        config=escape(_yaml(run.manifest["config"])),
        versions=_versions(run.manifest),
        # A name with </script> in it must not end the element.
        data=json.dumps(panels(run), allow_nan=False).replace("<", "\\u003c"),
        plotly=get_plotlyjs().replace("</script", "<\\/script"),
        script=_asset("report.js"),
    )
    Path(path).write_text(page, encoding="utf-8")


def quantity(value: float | None, unit: str) -> str:
    """Return a number with its unit, three digits and a prefix from nano to none."""
    if value is None:
        return "–"
    if value == 0:
        return f"0 {unit}"
    value = float(f"{value:.3g}")
    power = min(0, max(-9, 3 * floor(log10(abs(value)) / 3)))
    return f"{value / 10.0**power:.3g} {_PREFIXES[power]}{unit}"


def _asset(name: str) -> str:
    return files("rmrc.record").joinpath(name).read_text(encoding="utf-8")


def _yaml(value: Any) -> str:
    stream = io.StringIO()
    yaml = YAML()
    yaml.width = 100
    yaml.dump(value, stream)
    return stream.getvalue()


def _badge(manifest: dict[str, Any]) -> str:
    if manifest.get("interrupted"):
        return '<span class="badge bad">interrupted</span>'
    if manifest["summary"]["converged"]:
        return '<span class="badge good">converged</span>'
    return '<span class="badge bad">not converged</span>'


def _facts(run: "Run") -> str:
    summary = run.summary
    length = step_length(run.time)
    facts = [
        f"{summary['steps']} steps of {quantity(length, 's')}",
        quantity(summary["steps"] * length, "s"),
        f"{run.manifest['model']['nv']} degrees of freedom",
        *(f"{key} {summary[key]}" for key in ("method", "backend", "engine")),
    ]
    return escape(" · ".join(facts))


def _card(title: str, head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a titled table; the cells are HTML, each with its own <td>."""
    top = "".join(f"<th>{name}</th>" for name in head)
    body = "".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    return (
        f'<div class="card"><h2>{title}</h2><table><thead><tr>{top}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>\n"
    )


def _cell(text: str, note: str = "", bad: bool = False) -> str:
    small = f" <small>{escape(note)}</small>" if note else ""
    kind = ' class="bad"' if bad else ""
    return f"<td{kind}>{escape(text)}{small}</td>"


def _tasks(summary: dict[str, Any]) -> str:
    rows = []
    for name, task in summary["tasks"].items():
        for part, note in ((task, ""), (task.get("orientation"), "orientation")):
            if part is not None:
                numbers = (quantity(part[key], part["unit"]) for key in ("final", "rms", "max"))
                rows.append([_cell(name, note), *map(_cell, numbers)])
    return _card("Task errors", ("task", "at the end", "rms", "largest"), rows)


def _limits(summary: dict[str, Any]) -> str:
    rows = []
    for kind, limit in summary["limits"].items():
        excess = limit["max_violation"]
        passed = quantity(excess, limit["unit"]) if excess else "none"
        rows.append([_cell(kind, limit["joint"] or ""), _cell(passed, bad=bool(excess))])
    return _card("Limits", ("limit", "violation"), rows)


def _statuses(summary: dict[str, Any]) -> str:
    rows = []
    for name, number in summary["status"].items():
        swatch = f'<i class="swatch" style="background:{status_colour(name)}"></i>'
        share = f"{number / summary['steps']:.1%}"
        rows.append([f"<td>{swatch}{escape(name)}</td>", _cell(str(number), share)])
    return _card("Statuses", ("status", "steps"), rows)


def _times(summary: dict[str, Any]) -> str:
    times, factor = summary["step_time_us"], summary["real_time_factor"]
    rows = []
    for key, title in (("median", "median"), ("p99", "99 %"), ("max", "largest")):
        seconds = None if times[key] is None else times[key] * 1e-6
        rows.append([_cell(title), _cell(quantity(seconds, "s"))])
    rows.append([_cell("real-time factor"), _cell("–" if factor is None else f"{factor:.3g}")])
    return _card("Time", ("", "of a step"), rows)


def _versions(manifest: dict[str, Any]) -> str:
    known = dict(manifest["versions"])
    known |= {key: manifest[key] for key in ("config_hash", "seed") if key in manifest}
    rows = ((_cell(name), _cell(str(value))) for name, value in known.items())
    return f"<table>{''.join(f'<tr>{a}{b}</tr>' for a, b in rows)}</table>"
