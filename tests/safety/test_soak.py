"""A short soak: 20,000 random steps, each finite, inside its limits, and certified or reported."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from soaking.episode import Episode, Figures
from soaking.scenes import SCENES, Scene

STEPS = 20_000
HERE = [scene for scene in SCENES if not scene.source.startswith("menagerie:")]
CONFIGURATIONS = 8
"""Of each scene."""
EACH = -(-STEPS // (CONFIGURATIONS * len(HERE)))
"""Steps of each configuration."""


@pytest.mark.parametrize("scene", HERE, ids=lambda scene: scene.name)
def test_no_step_breaks_a_promise(scene: Scene, tmp_path: Path) -> None:
    figures = Figures()

    @settings(
        max_examples=CONFIGURATIONS,
        deadline=None,
        derandomize=True,
        database=None,
        phases=[Phase.generate],  # another seed is another walk: there is nothing to shrink
        suppress_health_check=[HealthCheck.too_slow],
    )
    @given(seed=st.integers(0, 2**31))
    def soak(seed: int) -> None:
        for _ in Episode(scene, seed, tmp_path).run(EACH, figures):
            pass

    soak()
    assert figures.steps == CONFIGURATIONS * EACH
    assert figures.braking > 0
    assert len(figures.statuses) > 3


def test_a_brake_that_passes_a_distance_on_its_way_says_so(tmp_path: Path) -> None:
    # The jerk limit makes it slow, and where it ends it is back where it may be, but for rounding.
    panda = next(scene for scene in HERE if scene.name == "panda")
    for _ in Episode(panda, 356, tmp_path).run(725, Figures()):
        pass
