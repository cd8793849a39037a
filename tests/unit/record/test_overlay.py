"""The page of a comparison: its curves are those of the runs, told apart, and toggled together."""

import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY, config
from pages import browsed, data_of, unpack
from rmrc.record.overlay import COLOURS, _styles, table

CONFIGS = REPOSITORY / "configs"
# What a person with full colour vision sees, and with neither red nor green cones (Machado,
# Oliveira and Fernandes 2009), in linear RGB.
VISION = {
    "full": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
}
# Just noticeable is 0.02 in Oklab; curves are thin, so several times that.
TOLD_APART = 0.1


@pytest.fixture(scope="module")
def comparison() -> rmrc.Comparison:
    loaded = rmrc.load(CONFIGS / "compare_singular.yaml", overrides={"duration": 2.5})
    return rmrc.compare(loaded, ["qp", "transpose", "pinv"], ["daqp", "osqp"])


@pytest.fixture(scope="module")
def page(comparison: rmrc.Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return comparison.save(tmp_path_factory.mktemp("page") / "out") / "compare.html"


@pytest.fixture(scope="module")
def data(page: Path) -> dict[str, Any]:
    return data_of(page.read_text(encoding="utf-8"))


def traces(data: dict[str, Any], title: str) -> dict[str, dict[str, Any]]:
    panel = next(each for each in data["panels"] if each["title"] == title)
    return {trace["name"]: trace for trace in panel["traces"]}


def test_the_curves_are_those_of_the_runs(
    comparison: rmrc.Comparison, data: dict[str, Any]
) -> None:
    assert data["linked"]
    np.testing.assert_array_equal(
        unpack(data["time"]), comparison.entries[0].run.time.astype(np.float32)
    )
    for entry in comparison.entries:
        run = entry.run
        for title, wanted in (
            ("Error of hand", run.error["hand"][:, 0]),
            ("Largest joint rate", np.abs(run.v).max(axis=1)),
            ("Norm of the joint rates", np.linalg.norm(run.v, axis=1)),
            ("Smallest singular value σ_min", run.sigma_min),
        ):
            curve = unpack(traces(data, title)[entry.name]["y"])
            np.testing.assert_allclose(curve, wanted, rtol=1e-6)  # 32-bit


def test_a_method_has_one_colour_and_each_of_its_backends_a_dash(data: dict[str, Any]) -> None:
    drawn = traces(data, "Largest joint rate")
    looks = [(trace["series"], trace["dash"]) for trace in drawn.values()]
    assert looks == [(0, "solid"), (0, "dash"), (2, "solid"), (3, "solid")]


def test_all_methods_look_different() -> None:
    loaded = rmrc.load(CONFIGS / "panda_line.yaml", overrides={"duration": 0.02})
    comparison = rmrc.compare(loaded, backends=["daqp"])
    looks = [(style["series"], style["dash"]) for style in _styles(comparison.entries).values()]
    assert len(set(looks)) == len(looks) == len(comparison.entries)
    assert {series for series, _ in looks} <= set(range(COLOURS))


def test_what_zigzags_is_drawn_below_the_rest(data: dict[str, Any]) -> None:
    layers = {n: t.get("layer", 0) for n, t in traces(data, "Largest joint rate").items()}
    assert layers == {"qp daqp": 0, "qp osqp": 0, "transpose": -1, "pinv": 0}


def test_every_colour_is_told_apart_with_red_green_blindness_too() -> None:
    style = files("rmrc.record").joinpath("page.css").read_text(encoding="utf-8")
    palettes = re.findall(r"--series: ([^;]+);", style)
    assert len(palettes) == 2
    for palette in palettes:
        colours = np.array(
            [[int(hexes[i : i + 2], 16) for i in (1, 3, 5)] for hexes in palette.split()]
        )
        assert len(colours) == COLOURS
        for matrix in VISION.values():
            seen = oklab(linear(colours / 255) @ matrix.T)
            apart = np.linalg.norm(seen[:, None] - seen[None], axis=2)
            assert apart[~np.eye(len(seen), dtype=bool)].min() > TOLD_APART


def linear(rgb: np.ndarray) -> np.ndarray:
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def oklab(rgb: np.ndarray) -> np.ndarray:
    """Return colours in Ottosson's perceptually uniform space."""
    cones = np.array(
        [
            [0.4122214708, 0.5363325363, 0.0514459929],
            [0.2119034982, 0.6806995451, 0.1073969566],
            [0.0883024619, 0.2817188376, 0.6299787005],
        ]
    )
    opponents = np.array(
        [
            [0.2104542553, 0.7936177850, -0.0040720468],
            [1.9779984951, -2.4285922050, 0.4505937099],
            [0.0259040371, 0.7827717662, -0.8086757660],
        ]
    )
    return np.cbrt(np.clip(rgb, 0.0, 1.0) @ cones.T) @ opponents.T


def test_the_table_says_what_differs(comparison: rmrc.Comparison) -> None:
    head, rows = table(comparison.summary)
    cells = {row[0].text: dict(zip(head, row, strict=True)) for row in rows}
    assert cells["qp daqp"]["past velocity [rad/s]"] == ("none", False)
    text, bad = cells["pinv"]["past velocity [rad/s]"]
    assert bad
    assert text.endswith(" joint2") or text.endswith(" joint3") or text.endswith(" joint1")
    assert cells["pinv"]["leaves out"].text == "limits"
    millimetres = 1e3 * comparison.entries[0].run.summary["tasks"]["hand"]["max"]
    assert float(cells["qp daqp"]["error max [mm]"].text) == pytest.approx(millimetres, rel=0.01)


def test_a_comparison_without_a_task_that_must_converge(tmp_path: Path) -> None:
    posture = config(
        str(REPOSITORY / "scenes" / "planar_2r.xml"),
        [{"name": "posture", "type": "posture", "target": [0.1, 0.2]}],
        duration=0.1,
    )
    comparison = rmrc.compare(posture, ["qp", "pinv", "nullspace"], ["daqp"])
    assert comparison.summary["task"] is None
    assert [run["name"] for run in comparison.summary["runs"]] == ["qp", "nullspace"]
    assert comparison.summary["runs"][0]["error"] is None
    assert set(comparison.left_out) == {"pinv"}
    folder = comparison.save_numbered(tmp_path)
    assert "Error of posture" in (folder / "compare.html").read_text(encoding="utf-8")


def test_an_interrupt_keeps_what_was_done(tmp_path: Path) -> None:
    calls = []

    def interrupt(done: int, count: int) -> None:
        calls.append((done, count))
        if len(calls) == 5:
            raise KeyboardInterrupt

    loaded = rmrc.load(CONFIGS / "planar_line.yaml", overrides={"duration": 0.2})
    comparison = rmrc.compare(loaded, ["dls", "pinv", "qp"], progress=interrupt)
    assert comparison.interrupted
    assert not comparison.finished
    assert [entry.finished for entry in comparison.entries] == [True, False]
    assert comparison.summary["runs"][1]["steps"] < comparison.summary["runs"][0]["steps"]
    assert {count for _, count in calls} == {6 * loaded.steps}
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)
    page = (comparison.save(tmp_path / "out") / "compare.html").read_text(encoding="utf-8")
    assert "pinv (unfinished)" in page
    assert 'class="badge bad">interrupted' in page


def test_a_click_hides_a_method_in_all_plots(page: Path, tmp_path: Path) -> None:
    act = """
  const shown = () => data.panels.map((panel) => panel.plot.data.map((trace) => trace.name));
  const row = document.querySelector("td[data-name=pinv]");
  row.querySelector("button").click();
  await new Promise((done) => setTimeout(done, 300));
  found.hidden = shown();
  found.row = row.parentElement.className;
  [...data.panels[1].chips.children].find((chip) => chip.textContent === "pinv").click();
  await new Promise((done) => setTimeout(done, 300));
  found.back = shown();
  await Plotly.relayout(data.panels[0].plot, { "xaxis.range[0]": 0.5, "xaxis.range[1]": 1.5 });
  found.ranges = data.panels.map((panel) => panel.plot.layout.xaxis.range);
"""
    copy = tmp_path / "compare.html"
    copy.write_bytes(page.read_bytes())
    found = browsed(copy, act, tmp_path)
    assert found["mistakes"] == []
    assert len(found["hidden"]) >= 5
    assert all(names == ["qp daqp", "qp osqp", "transpose"] for names in found["hidden"])
    assert found["row"] == "off"
    assert all(names == ["qp daqp", "qp osqp", "transpose", "pinv"] for names in found["back"])
    assert found["ranges"] == [[0.5, 1.5]] * len(found["back"])
