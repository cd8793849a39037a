"""The report: self-contained, escaped, complete, and with plots that keep to the same time."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fabricated_runs import STATUSES, arm_model, fabricated, humanoid_model
from hypothesis import given, settings
from hypothesis import strategies as st

from pages import Page, assert_self_contained, browsed, data_of, unpack
from rmrc.record.page import quantity
from rmrc.record.plots import STATUS_COLOURS, STRIP_CELLS, TRACE_POINTS, extreme_rows, panels
from rmrc.record.report import write_report
from rmrc.record.run import Run

# plotly.js is 4.8 MB; the rest is for the longest runs of the largest robots.
SMALL_REPORT, LARGE_REPORT = 6_000_000, 9_000_000
NASTY = "</script><script>document.title='owned'</script>&amp;%{y}<b>"


def written(run: Run, tmp_path: Path) -> tuple[str, Page]:
    write_report(run, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    return text, Page(text)


def panel(run: Run, title: str) -> dict[str, Any]:
    return next(each for each in panels(run)["panels"] if each["title"] == title)


@pytest.fixture(scope="module")
def run() -> Run:
    return fabricated(arm_model())


def test_the_report_needs_no_network(run: Run, tmp_path: Path) -> None:
    _, page = written(run, tmp_path)
    assert_self_contained(page)


def test_the_report_has_the_numbers_and_the_names(run: Run, tmp_path: Path) -> None:
    text, page = written(run, tmp_path)
    visible = page.texts["td"] + page.texts["small"]
    for shown in ("hand", "posture", "LIMITED", "RELAXED", "acceleration", "orientation"):
        assert shown in visible
    assert page.texts["h1"] == "reach"
    assert page.texts["span"] == "not converged"
    assert "scene: ../scenes/arm.xml" in page.texts["pre"]
    assert "0123abcd" in visible
    names = {trace["name"] for each in data_of(text)["panels"] for trace in each.get("traces", ())}
    assert {"hand", "posture", *(f"joint{i}" for i in range(1, 8))} <= names


def test_the_badge_says_how_it_ended(run: Run, tmp_path: Path) -> None:
    converged = run.manifest | {"summary": run.summary | {"converged": True}}
    _, page = written(replace(run, manifest=converged), tmp_path)
    assert page.texts["span"] == "converged"
    _, page = written(replace(run, manifest=converged | {"interrupted": True}), tmp_path)
    assert page.texts["span"] == "interrupted"


def test_limits_that_are_off_are_said_to_be(run: Run, tmp_path: Path) -> None:
    limits = {"position": {}, "velocity": {"default": 2.0}, "acceleration": "off", "speed": {}}
    config = run.manifest["config"] | {"limits": limits}
    passed = {"max_violation": 0.1, "joint": "joint1", "unit": "rad"}
    kept = {"max_violation": 0.0, "joint": None, "unit": None}
    summary = run.summary | {"limits": dict.fromkeys(limits, kept) | {"position": passed}}
    manifest = run.manifest | {"config": config, "summary": summary}
    _, page = written(replace(run, manifest=manifest), tmp_path)
    assert "velocitynone" + "accelerationoff" + "speedoff" in page.texts["td"]


def test_notices_are_listed(run: Run, tmp_path: Path) -> None:
    _, page = written(replace(run, manifest=run.manifest | {"notices": ["a < b", "c"]}), tmp_path)
    assert page.texts["li"] == "a < bc"


def nasty_run() -> Run:
    """Return a run every name of which is a piece of HTML."""
    model = arm_model()
    model["joints"][0]["name"] = NASTY
    run = fabricated(model, name=NASTY, tasks={NASTY: {"type": "frame", "units": ["m", NASTY]}})
    return replace(run, manifest=run.manifest | {"versions": {NASTY: NASTY}})


def test_names_are_text_and_nothing_else(run: Run, tmp_path: Path) -> None:
    _, ordinary = written(run, tmp_path)
    text, page = written(nasty_run(), tmp_path)
    scripts = [tag for tag, _ in ordinary.tags].count("script")
    assert [tag for tag, _ in page.tags].count("script") == scripts
    assert "b" not in {tag for tag, _ in page.tags}
    assert page.texts["h1"] == page.texts["title"] == NASTY
    assert NASTY in page.texts["pre"]
    assert NASTY in {t["name"] for each in data_of(text)["panels"] for t in each.get("traces", ())}


def test_reports_of_long_runs_stay_small(tmp_path: Path) -> None:
    text, _ = written(fabricated(arm_model(), steps=20_000), tmp_path)
    assert len(text) < SMALL_REPORT
    text, _ = written(fabricated(humanoid_model(), steps=20_000), tmp_path)
    assert len(text) < LARGE_REPORT


@pytest.mark.parametrize("steps", [0, 1, 2])
def test_the_shortest_runs_have_a_report(steps: int, tmp_path: Path) -> None:
    text, _ = written(fabricated(arm_model(), steps=steps), tmp_path)
    low, high = data_of(text)["range"]
    assert low < high


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (None, "m", "–"),
        (0.0, "m", "0 m"),
        (1.2345, "rad", "1.23 rad"),
        (0.0123456, "m", "12.3 mm"),
        (0.9999, "m", "1 m"),
        (4.5e-7, "m", "450 nm"),
        (-2e-5, "s", "-20 µs"),
        (1e-13, "m", "100 fm"),
        (1e-17, "m", "0.01 fm"),
        (120.0, "s", "120 s"),
    ],
)
def test_quantities_have_three_digits_and_a_prefix(
    value: float | None, unit: str, text: str
) -> None:
    assert quantity(value, unit) == text


# Panels


def test_errors_of_different_units_are_on_different_panels(run: Run) -> None:
    metres, radians = panel(run, "Position error"), panel(run, "Angular error")
    assert (metres["unit"], radians["unit"]) == ("m", "rad")
    assert [trace["name"] for trace in metres["traces"]] == ["hand"]
    assert [trace["name"] for trace in radians["traces"]] == ["hand", "posture"]
    assert [mark["y"] for mark in metres["marks"]] == [1e-3]


def test_room_to_limits_is_in_the_unit_of_the_limit(run: Run) -> None:
    speed = {"hand": {"linear": 1.0, "angular": None}, "tool": {"linear": None, "angular": 2.0}}
    config = run.manifest["config"] | {"limits": {"speed": speed}}
    room = {kind: np.where(run.time > 0.1, 0.02, np.inf) for kind in ("collision", "speed")}
    run = replace(run, margin=room, manifest=run.manifest | {"config": config})
    distances, speeds = (panel(run, f"Room to the {kind} limit") for kind in room)
    assert (distances["unit"], speeds["unit"]) == ("m", "m/s or rad/s")
    assert [each["text"] for each in distances["marks"]] == ["limit 0 m"]


def test_joints_come_with_their_values_units_and_limits(run: Run) -> None:
    traces = panel(run, "Joint positions")["traces"]
    assert [trace["unit"] for trace in traces] == ["rad"] * 7
    assert [traces[1]["lower"], traces[1]["upper"]] == pytest.approx([-2.6, 2.6])
    assert traces[1]["peak"] == pytest.approx(np.abs(run.q[:, 1]).max() / 2.6)
    assert "upper" not in traces[6]
    np.testing.assert_array_equal(unpack(traces[1]["y"]), run.q[:, 1].astype(np.float32))


def test_a_measured_velocity_is_drawn_where_it_differs(run: Run) -> None:
    assert "measured" not in panel(run, "Joint velocities")["traces"][0]
    lagging = replace(run, v_measured=0.9 * run.v)
    trace = panel(lagging, "Joint velocities")["traces"][0]
    np.testing.assert_allclose(unpack(trace["measured"]["y"]), 0.9 * run.v[:, 0], rtol=1e-6)


def test_what_was_not_computed_has_no_panel(run: Run) -> None:
    without = replace(run, sigma_min=np.full(len(run.time), np.nan), active=0 * run.active)
    titles = [each["title"] for each in panels(without)["panels"]]
    assert len(titles) == len(panels(run)["panels"]) - 2
    assert "Active limits" not in titles


def test_strips_keep_the_most_severe_status_and_every_active_bound() -> None:
    run = fabricated(arm_model(), steps=3 * STRIP_CELLS + 1)
    status, active = 0 * run.status, 0 * run.active
    status[4001] = STATUSES.index("INVALID_INPUT")
    active[5002, 2], active[-1, 4] = -1, 1
    run = replace(run, status=status, active=active)
    strip, bounds = panel(run, "Status"), panel(run, "Active limits")
    (cells,) = strip["cells"]
    edges = unpack(strip["edges"])
    assert len(cells) == len(edges) - 1 <= STRIP_CELLS
    (severe,) = np.flatnonzero(cells)
    assert strip["names"][cells[severe]] == "INVALID_INPUT"
    assert edges[severe] <= run.time[4001] < edges[severe + 1]
    assert bounds["rows"] == ["joint3", "joint5"]
    assert [[cell for cell in row if cell] for row in bounds["cells"]] == [[1], [2]]


def test_every_status_has_a_colour_of_its_own() -> None:
    assert list(STATUS_COLOURS) == STATUSES
    assert len(set(STATUS_COLOURS.values())) == len(STATUSES)


@given(
    values=st.lists(st.floats(-1e6, 1e6) | st.just(np.nan), min_size=1, max_size=400),
    limit=st.integers(4, 60),
)
@settings(derandomize=True, deadline=None)
def test_downsampling_keeps_the_extremes_and_both_ends(values: list[float], limit: int) -> None:
    curve = np.array(values)
    rows = extreme_rows(curve, limit)
    assert len(rows) <= limit
    assert (np.diff(rows) > 0).all()
    assert (rows[0], rows[-1]) == (0, len(curve) - 1)
    if np.isfinite(curve).any():
        assert np.nanmax(curve[rows]) == np.nanmax(curve)
        assert np.nanmin(curve[rows]) == np.nanmin(curve)


def test_a_spike_of_one_step_survives_in_a_long_run() -> None:
    run = fabricated(arm_model(), steps=50_000)
    run.kkt[31_234] = 7.0
    (trace,) = panel(run, "Largest KKT residual")["traces"]
    x, y = unpack(trace["x"]), unpack(trace["y"])
    assert len(y) <= TRACE_POINTS
    assert y.max() == 7.0
    assert x[y.argmax()] == np.float32(run.time[31_234])


# In a browser

_ACT = """
  const { panels } = data;
  const joints = panels.find((panel) => panel.kind === "joints");
  const ranges = () => panels.map((panel) => panel.plot.layout.xaxis.range);
  Object.assign(found, { title: document.title, drawn: panels.length });
  Plotly.Fx.hover(panels[0].plot, { xval: 0.1 });
  await new Promise((done) => setTimeout(done, 300));
  found.hover = panels[0].plot.querySelector(".hoverlayer").textContent;
  const real = joints.plot.data.flatMap((trace) => [...trace.customdata]);
  found.real = [Math.min(...real), Math.max(...real)];
  await Plotly.relayout(panels[0].plot, { "xaxis.range[0]": 0.1, "xaxis.range[1]": 0.2 });
  found.zoomed = ranges();
  await Plotly.relayout(panels[3].plot, { "xaxis.autorange": true });
  found.whole = ranges();
  joints.choice.value = 1;
  joints.choice.onchange();
  found.limits = joints.plot.layout.shapes.map((shape) => shape.y0);
  found.axis = panels[0].plot.layout.yaxis.type;
  document.querySelector(".head button").click();
  found.other = panels[0].plot.layout.yaxis.type;
  dispatchEvent(new Event("beforeprint"));
  dispatchEvent(new Event("afterprint"));
"""


def test_the_plots_work_in_a_browser(tmp_path: Path) -> None:
    run = nasty_run()
    write_report(run, tmp_path / "report.html")
    found = browsed(tmp_path / "report.html", _ACT, tmp_path)
    assert found["mistakes"] == []
    assert found["title"] == NASTY
    assert NASTY in found["hover"]
    assert found["drawn"] == len(panels(run)["panels"])
    # Zooming one zooms all, and so does going back.
    assert found["zoomed"] == [[0.1, 0.2]] * found["drawn"]
    assert found["whole"] == [panels(run)["range"]] * found["drawn"]
    # What is drawn as a share of the range says the true value.
    bounded = run.q[:, :6].astype(np.float32)
    assert found["real"] == pytest.approx([bounded.min(), bounded.max()])
    assert found["limits"] == pytest.approx([-2.6, 2.6])
    assert (found["axis"], found["other"]) == ("log", "linear")
