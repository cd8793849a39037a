"""One's own loop as a run: the rows that were taken, saved, explained and bounded."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rmrc
from models import REPOSITORY

ENGINES = ("python", "native")


def controller(engine: Any) -> rmrc.Controller:
    config = rmrc.load(REPOSITORY / "configs" / "panda_line.yaml")
    made = rmrc.Controller(rmrc.compile(config), engine)
    made.set_target("hand", position=[0.5, 0.2, 0.4])
    return made


@pytest.mark.parametrize("engine", ENGINES)
def test_a_run_has_the_steps_that_were_taken(engine: Any, tmp_path: Path) -> None:
    made, steps = controller(engine), []
    with rmrc.Recorder(made) as recorder:
        steps = [made.step(dt=0.002 + 1e-4 * (k % 2)) for k in range(40)]
    made.step()  # outside: no part of it
    run = recorder.run
    np.testing.assert_array_equal(run.v, [step.v for step in steps])
    np.testing.assert_array_equal(run.q, [step.moment.q for step in steps])
    np.testing.assert_allclose(run.error["hand"], [step.error["hand"] for step in steps])
    np.testing.assert_allclose(np.diff(run.time), [0.002, 0.0021] * 19 + [0.002])
    assert run.step_time.min() > 0.0
    assert run.summary["engine"] == engine
    loaded = rmrc.Run.load(run.save(tmp_path / "mine"))
    np.testing.assert_array_equal(loaded.q, run.q)
    assert (tmp_path / "mine" / "report.html").stat().st_size > 0


def test_the_last_ones_of_every_so_many_are_kept() -> None:
    made = controller("native")
    with rmrc.Recorder(made, every=3, size=5) as recorder:
        steps = [made.step() for _ in range(40)]
    assert len(recorder) == 5
    np.testing.assert_array_equal(recorder.run.v, [step.v for step in steps[27::3]])


def test_recording_changes_nothing_and_outlives_a_change() -> None:
    made, twin = controller("native"), controller("native")
    with rmrc.Recorder(made) as recorder:
        for k in range(30):
            if k == 10:
                made.tune("hand", gain=3.0)
                twin.tune("hand", gain=3.0)
            np.testing.assert_array_equal(made.step().v, twin.step().v)
    assert len(recorder.run.time) == 30


def test_what_cannot_be_recorded_is_said() -> None:
    made = controller("python")
    with pytest.raises(rmrc.RmrcError, match="nothing was recorded"):
        _ = rmrc.Recorder(made).run
    with pytest.raises(rmrc.RmrcError, match="every=0"):
        rmrc.Recorder(made, every=0)
