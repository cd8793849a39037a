"""Plots as SVG: of the scaling, panels side by side with the median step in µs over a size."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

WIDTH, HEIGHT, LEFT, TOP, GAP = 260, 200, 50, 24, 30
"""Size of a panel, and the room beside, above and between them, in pixels."""
COLOURS = {"native": "#0072b2", "python": "#d55e00"}


@dataclass(frozen=True)
class Panel:
    """One curve for each engine."""

    label: str
    """Of the horizontal axis."""
    rows: Sequence[dict[str, Any]]
    """The size, and by engine the time in µs."""


def draw(panels: Sequence[Panel]) -> str:
    """Return the SVG; the vertical axis is logarithmic and common to all panels."""
    times = [row[name] for p in panels for row in p.rows for name in COLOURS if name in row]
    low, high = math.floor(math.log10(min(times))), math.ceil(math.log10(max(times)))
    parts = [text(8, 14, "median step, µs", "start")]
    for k, panel in enumerate(panels):
        parts += _panel(panel, LEFT + k * (WIDTH + GAP), low, high, first=k == 0)
    for k, (name, colour) in enumerate(COLOURS.items()):
        parts.append(text(LEFT + 120 + 70 * k, 14, name, "start", colour))
    width, height = LEFT + len(panels) * (WIDTH + GAP), TOP + HEIGHT + 44
    return page(parts, width, height)


def page(parts: Sequence[str], width: int, height: int) -> str:
    """Return an SVG, on white: it is read on dark pages, too."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}"'
        f' height="{height}" font-family="sans-serif" font-size="11">'
        f'<rect width="{width}" height="{height}" fill="white"/>{"".join(parts)}</svg>\n'
    )


def _panel(panel: Panel, left: int, low: int, high: int, first: bool) -> list[str]:
    """Return the parts of a panel: a grid of decades, the sizes, and the curves."""
    largest = max(row["size"] for row in panel.rows)

    def x(size: float) -> float:
        return left + WIDTH * size / largest

    def y(time: float) -> float:
        return TOP + HEIGHT * (high - math.log10(time)) / (high - low)

    bottom = TOP + HEIGHT
    parts = [text(left + WIDTH / 2, bottom + 34, panel.label)]
    for decade in range(low, high + 1):
        at = y(10.0**decade)
        parts.append(f'<path d="M{left} {at:.1f}h{WIDTH}" stroke="#ddd"/>')
        if first:
            parts.append(text(left - 6, at + 4, f"{10.0**decade:g}", "end"))
    last = -math.inf
    for size in (row["size"] for row in panel.rows):
        if x(size) - last > 24:  # or the numbers would touch
            parts.append(text(x(size), bottom + 16, str(size)))
            last = x(size)
    for name, colour in COLOURS.items():
        points = [(x(row["size"]), y(row[name])) for row in panel.rows if name in row]
        path = " ".join(f"{px:.1f},{py:.1f}" for px, py in points)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [f'<circle cx="{px:.1f}" cy="{py:.1f}" r="3" fill="{colour}"/>'
                  for px, py in points]  # fmt: skip
    return parts


def text(x: float, y: float, words: str, anchor: str = "middle", colour: str = "#333") -> str:
    """Return words at a point."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{words}</text>'
