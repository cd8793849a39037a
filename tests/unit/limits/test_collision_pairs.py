"""Which pairs of geoms are kept apart, and what is said of those left out."""

import mujoco
import numpy as np
import pytest
from collision_scenes import barrier, zoo

from models import REPOSITORY, random_configuration
from rmrc.config.compiled_scene import load_model
from rmrc.errors import ModelError
from rmrc.limits.models import CollisionLimit
from rmrc.limits.pairs import resolve_pairs
from rmrc.tasks.base import FieldError


def named(model: mujoco.MjModel, **limit: object) -> tuple[set[tuple[str, str]], list[str]]:
    """Return the pairs of a limit by the names of the geoms, and the notices."""
    pairs, notices = resolve_pairs(model, CollisionLimit.model_validate(limit))
    found = {tuple(sorted(model.geom(g).name for g in pair)) for pair in pairs.tolist()}
    assert len(found) == len(pairs)
    return found, notices  # type: ignore[return-value]


# Which pairs there are.


def collided(model: mujoco.MjModel) -> set[tuple[int, ...]]:
    """Return what MuJoCo collides, with margins so large that all geoms are in contact.

    In one configuration it may find no contact of boxes that are far apart; in twenty it does.
    """
    model.geom_margin[:] = model.body_margin[:] = model.pair_margin[:] = 100.0
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    found = set()
    for _ in range(20):
        data.qpos = random_configuration(model, model.qpos0, rng, 2.0)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        found |= {tuple(sorted(pair)) for pair in data.contact.geom.tolist()}
    return found


@pytest.mark.parametrize("scene", ["zoo", "planar_4r", "panda", "mobile_arm"])
def test_all_is_what_mujoco_would_let_collide(scene: str) -> None:
    model = zoo() if scene == "zoo" else load_model(f"scenes/{scene}.xml", REPOSITORY)
    pairs, _ = resolve_pairs(model, CollisionLimit())
    tree = model.dof_bodyid[0]  # all scenes have one robot; obstacles and the world do not count
    robot = model.body_rootid[model.geom_bodyid] == model.body_rootid[tree]
    measured = model.geom_type != mujoco.mjtGeom.mjGEOM_HFIELD
    expected = {
        (a, b) for a, b in collided(model) if robot[[a, b]].any() and measured[[a, b]].all()
    }
    assert {tuple(sorted(pair)) for pair in pairs.tolist()} == expected
    assert (np.diff(model.geom_type[pairs], axis=1) >= 0).all()


def test_what_the_filters_take_out_is_said() -> None:
    found, notices = named(zoo())
    assert notices[0] == f"pairs of geoms that collision keeps apart: {len(found)}"
    said = "\n".join(notices)
    assert "geoms whose contype and conaffinity are 0 (1): skin" in said
    assert "pairs of a body and its parent (5): trunk – upper" in said
    assert "pairs that the scene excludes (2): fore – tail" in said
    assert "by contype and conaffinity (10): floor – rattle" in said
    assert "that MuJoCo cannot measure (6): hill – trunk" in said
    assert ("rattle", "wall") in found
    assert ("floor", "wall") not in found


def test_parents_are_filtered_as_the_scene_says() -> None:
    model = zoo()
    assert ("trunk", "upper") not in named(model)[0]
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
    found, notices = named(model)
    assert ("trunk", "upper") in found
    assert "parent" not in "\n".join(notices)


def test_a_pair_that_is_named_is_kept_where_it_moves() -> None:
    model = zoo()
    # Parent and child, excluded by the scene, and without contact: all three are meant.
    pairs = [("base", "upper"), ("tail", "tip"), ("tail", "fore"), ("skin", "tip")]
    found, notices = named(model, pairs=pairs)
    assert found == {
        ("trunk", "upper"), ("tail", "tip"), ("fore", "tail"), ("", "tail"), ("skin", "tip")
    }  # fmt: skip
    assert any("named bodies that collide with nothing (1): skin" in n for n in notices)


def test_groups_are_filtered_and_exclude_takes_out() -> None:
    groups = {"arm": ("upper", "fore", "fixed"), "body": ("base", "tail")}
    found, notices = named(
        zoo(), groups=groups, pairs=[("arm", "body")], exclude=[("tip", "base"), ("wall", "floor")]
    )
    assert found == {("fore", "trunk"), ("", "trunk"), ("tail", "upper"), ("tail", "tip")}
    said = "\n".join(notices)
    assert "pairs of a body and its parent (1): trunk – upper" in said
    assert "pairs that the scene excludes (2)" in said
    assert "pairs that `exclude` names (1): trunk – tip" in said
    assert "'wall' and 'floor' in `exclude` are no pair anyway" in said


@pytest.mark.parametrize(
    ("limit", "key", "message"),
    [
        ({"pairs": [("trunc", "wall")]}, "pairs", "did you mean 'trunk'"),
        ({"exclude": [("arm", "wall")], "groups": {"arms": ("fore",)}}, "exclude", "'arms'"),
        ({"groups": {"g": ("foe",)}, "pairs": [("g", "wall")]}, "groups", "did you mean 'fore'"),
        ({"pairs": [("fore", "tip")]}, "pairs", "no joint moves 'fore' and 'tip'"),
        ({"pairs": [("wall", "obstacle")]}, "pairs", "no joint moves 'wall' and 'obstacle'"),
        ({"pairs": [("hill", "tip")]}, "pairs", "MuJoCo cannot measure"),
        ({"pairs": [("tip", "wall")], "exclude": [("fixed", "wall")]}, "pairs", "no pair left"),
    ],
)
def test_names_that_mean_nothing_are_errors(
    limit: dict[str, object], key: str, message: str
) -> None:
    with pytest.raises(FieldError, match=message) as caught:
        resolve_pairs(zoo(), CollisionLimit.model_validate(limit))
    assert caught.value.key == key


def test_a_scene_without_nativeccd_is_refused() -> None:
    model = zoo()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_NATIVECCD)
    with pytest.raises(ModelError, match="nativeccd"):
        resolve_pairs(model, CollisionLimit())


def test_names_of_pairs() -> None:
    limit, geoms = barrier(zoo(), pairs=[("fore", "wall"), ("fore", "floor")])
    assert {limit.name(i) for i in range(len(geoms))} == {
        "fore – wall", "geom 1 of fore – wall", "floor – fore", "floor – geom 1 of fore"
    }  # fmt: skip
