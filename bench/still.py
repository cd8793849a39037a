"""Draw the joint rates of `configs/unreachable.yaml`: rmrc, without its term, and mink, as SVG."""

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import rmrc
from plot import GAP, HEIGHT, LEFT, TOP, WIDTH, page, text

CONFIG = Path(__file__).parents[1] / "configs" / "unreachable.yaml"
TITLES = {
    "qp curvature=on": "rmrc",
    "qp curvature=off": "rmrc, curvature: off",
    "mink": "mink's solve_ik",
}
SHOWN = 1.2
"""How much of the run, s."""
LIMIT = 2.0
"""The limit of the rates in the configuration, rad/s."""
COLOURS = {"joint2": "#e69f00", "joint4": "#d55e00", "joint6": "#0072b2"}
"""The joints that move: the others stay in the plane."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plot", type=Path, help="the SVG file")
    path = parser.parse_args().plot
    configs = {
        f"curvature={switch}": rmrc.load(CONFIG, overrides={"damping.curvature": switch})
        for switch in ("on", "off")
    }
    comparison = rmrc.compare(configs, ["qp", "mink"], ["daqp"])
    parts = [text(8, 14, "rad/s", "start")]
    for k, entry in enumerate(comparison.entries):
        shown = entry.run.time <= SHOWN
        rates = {channel.name: channel.values[shown] for channel in entry.rates}
        parts += panel(LEFT + k * (WIDTH + GAP), TITLES[entry.name], entry.run.time[shown], rates)
    bottom = TOP + HEIGHT + 54
    for k, (joint, colour) in enumerate(COLOURS.items()):
        parts.append(text(LEFT + 70 * k, bottom, joint, "start", colour))
    path.write_text(page(parts, LEFT + len(TITLES) * (WIDTH + GAP), bottom + 10), encoding="utf-8")


def panel(
    left: float, title: str, time: NDArray[np.float64], rates: Mapping[str, NDArray[np.float64]]
) -> list[str]:
    """Return the parts of a panel: a grid, and the rates of the joints over time."""
    bottom, middle = TOP + HEIGHT, TOP + HEIGHT / 2
    parts = [text(left + WIDTH / 2, 14, title), text(left + WIDTH / 2, bottom + 34, "s")]
    for rate in (-LIMIT, -LIMIT / 2, 0.0, LIMIT / 2, LIMIT):
        at = middle - 0.5 * HEIGHT * rate / LIMIT
        parts.append(f'<path d="M{left} {at:.1f}h{WIDTH}" stroke="#ddd"/>')
        parts.append(text(left - 6, at + 4, f"{rate:g}", "end"))
    ticks = np.linspace(0.0, SHOWN, 7)
    parts += [text(left + WIDTH * tick / SHOWN, bottom + 16, f"{tick:g}") for tick in ticks]
    x = left + WIDTH * time / SHOWN
    for joint, colour in COLOURS.items():
        y = middle - 0.5 * HEIGHT * rates[joint] / LIMIT
        points = " ".join(f"{px:.1f},{py:.0f}" for px, py in zip(x, y, strict=True))
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="0.8"/>'
        )
    return parts


if __name__ == "__main__":
    main()
