"""A short soak: random steps in scenes and random trees, each held to what a step promises."""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from soaking.episode import Episode
from soaking.figures import Figures
from soaking.scenes import SCENES, TREE_EPISODES, Scene, Trees

STEPS = 5_000
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


SEEDS = 64
"""Of random trees: four trees to a part, each with as many configurations."""
STEPS_OF_TREE = 25


@pytest.mark.parametrize("first", range(0, SEEDS, 4 * TREE_EPISODES))
def test_no_step_breaks_a_promise_in_random_trees(first: int, tmp_path: Path) -> None:
    figures = Figures()
    for seed in range(first, first + 4 * TREE_EPISODES):
        for _ in Episode(Trees(), seed, tmp_path).run(STEPS_OF_TREE, figures):
            pass
    assert figures.steps == 4 * TREE_EPISODES * STEPS_OF_TREE
    assert len(figures.statuses) > 3
    assert len(figures.engines) == 2


def test_a_brake_that_passes_a_distance_on_its_way_says_so(tmp_path: Path) -> None:
    # The jerk limit makes it slow, and where it ends it is back where it may be, but for rounding.
    panda = next(scene for scene in HERE if scene.name == "panda")
    for _ in Episode(panda, 356, tmp_path).run(725, Figures()):
        pass
