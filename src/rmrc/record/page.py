"""A page of numbers and plots: one HTML file with everything in it, readable without a network."""

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape as escape_html
from importlib.resources import files
from math import floor, log10
from pathlib import Path
from string import Template
from typing import Any

from ruamel.yaml import YAML

from rmrc.errors import printable, printable_lines

_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: ""}


def write_page(
    path: str | Path,
    manifest: dict[str, Any],
    *,
    badge: str,
    facts: Iterable[str],
    cards: Iterable[str],
    notices: Iterable[str],
    data: dict[str, Any],
    hint: str = "",
) -> None:
    """Write a page of tables and of linked plots over time, with configuration and versions.

    Args:
        path: The HTML file; about 5 MB, most of it plotly.js.
        manifest: Of what the page is about: `name`, `config`, `versions`.
        badge: HTML beside the title.
        facts: Short texts below the title.
        cards: HTML of the tables, as `card` gives it.
        notices: Texts of a list below the tables.
        data: What the plots draw, as `rmrc.record.plots` gives it.
        hint: A sentence on the use of the plots.
    """
    # Imported here, as importing plotly takes longer than the rest of a short command.
    from plotly.offline import get_plotlyjs

    page = Template(_asset("page.html")).substitute(
        title=escape(manifest["name"]),
        style=_asset("page.css"),
        badge=badge,
        facts=escape(" · ".join(facts)),
        cards="".join(cards),
        notices="".join(f"<li>{escape(notice)}</li>" for notice in notices),
        hint=escape(hint),
        config=escape_html(printable_lines(_yaml(manifest["config"]))),
        versions=_versions(manifest),
        # A name with </script> in it must not end the element.
        data=json.dumps(_shown(data), allow_nan=False).replace("<", "\\u003c"),
        plotly=get_plotlyjs().replace("</script", "<\\/script"),
        script=_asset("page.js"),
    )
    Path(path).write_text(page, encoding="utf-8")


def quantity(value: float | None, unit: str) -> str:
    """Return a number with its unit, three digits and a prefix from femto to none."""
    if value is None:
        return "–"
    if value == 0:
        return f"0 {unit}"
    value = float(f"{value:.3g}")
    power = min(0, max(-15, 3 * floor(log10(abs(value)) / 3)))
    return f"{value / 10.0**power:.3g} {_PREFIXES[power]}{unit}"


def badge(text: str, good: bool) -> str:
    """Return a word on a green or a red ground."""
    return f'<span class="badge {"good" if good else "bad"}">{escape(text)}</span>'


def card(title: str, head: Sequence[str], rows: Iterable[Iterable[str]], kind: str = "") -> str:
    """Return a titled table; the cells are HTML, each with its own <td>.

    Args:
        title: Above the table.
        head: The heads of the columns.
        rows: The cells.
        kind: `wide` for a table of many columns.
    """
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    return (
        f'<div class="card {kind}"><h2>{escape(title)}</h2><table>'
        f"<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>\n"
    )


def cell(text: str, note: str = "", bad: bool = False) -> str:
    """Return a cell with a small note behind its text."""
    small = f" <small>{escape(note)}</small>" if note else ""
    kind = ' class="bad"' if bad else ""
    return f"<td{kind}>{escape(text)}{small}</td>"


def escape(text: str) -> str:
    """Return text as HTML shows it, with characters that a browser would obey written out."""
    return escape_html(printable(text))


def _shown(value: Any) -> Any:
    """Return what the plots draw with every text in it as it is to be seen."""
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, Mapping):
        return {_shown(key): _shown(item) for key, item in value.items()}
    return [_shown(item) for item in value] if isinstance(value, (list, tuple)) else value


def _asset(name: str) -> str:
    return files("rmrc.record").joinpath(name).read_text(encoding="utf-8")


def _yaml(value: Any) -> str:
    stream = io.StringIO()
    yaml = YAML()
    yaml.width = 100
    yaml.dump(value, stream)
    return stream.getvalue()


def _versions(manifest: dict[str, Any]) -> str:
    known = dict(manifest["versions"])
    known |= {key: manifest[key] for key in ("config_hash", "seed") if key in manifest}
    rows = ((cell(name), cell(str(value))) for name, value in known.items())
    return f"<table>{''.join(f'<tr>{a}{b}</tr>' for a, b in rows)}</table>"
