"""What is said of tasks below others that do not fit their model."""

from pathlib import Path
from typing import Any

import mujoco
import pytest
from nullspace_models import written

import rmrc
from models import REPOSITORY, config, scene_path
from rmrc.errors import ConfigError

# Mistakes.


@pytest.mark.parametrize(
    ("robot", "task", "message"),
    [
        (
            "four_bar",
            {"type": "centering"},
            "tasks[0].joints: no hinge or slide of this model has a range",
        ),
        (
            "mobile_arm",
            {"type": "centering", "joints": ["arm_joint1", "base_yaw"]},
            "tasks[0].joints: joint 'base_yaw' is no hinge or slide with a range",
        ),
        (
            "biped",
            {"type": "centering", "joints": ["root"]},
            "tasks[0].joints: joint 'root' is no hinge or slide with a range",
        ),
        (
            "biped",
            {"type": "manipulability", "frame": {"site": "pelvis"}},
            "tasks[0].frame: no joint moves the site 'pelvis'",
        ),
        (
            "planar_2r",
            {"type": "manipulability", "frame": {"body": "base"}},
            "tasks[0].frame: no joint moves the body 'base'",
        ),
        (
            "planar_2r",
            {"type": "manipulability", "frame": {"body": "link1"}},
            "tasks[0].part: no joint changes the position of the body 'link1'",
        ),
        (
            "planar_2r",
            {"type": "clearance", "pairs": [["link2", "link1"], ["base", "floor"]]},
            "tasks[0].pairs: no joint moves 'base' and 'floor' relative to each other",
        ),
        (
            "planar_2r",
            {"type": "clearance", "pairs": [["link1", "pin1"]]},
            "tasks[0].pairs: no joint moves 'link1' and 'pin1' relative to each other",
        ),
        (
            "dual_arm",
            {"type": "clearance", "pairs": [["left_hand", "table"]]},
            "tasks[0]: no geom or body named 'left_hand'",
        ),
    ],
)
def test_what_does_not_fit_the_model_is_said(
    robot: str, task: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        rmrc.compile(config(scene_path(robot, Path()), [{"name": "task", **task}]))
    assert str(caught.value).startswith(message)


def test_a_body_without_geoms_is_said(tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_file(scene_path("planar_2r", tmp_path))
    spec.worldbody.add_body(name="marker")
    task = {"name": "task", "type": "clearance", "pairs": [["marker", "link2"]]}
    with pytest.raises(ConfigError, match="the body 'marker' has no geoms"):
        rmrc.compile(config(written(tmp_path, spec.to_xml()), [task]))


def test_names_of_geoms_and_bodies_are_checked_in_a_file(tmp_path: Path) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(
        f"scene: {REPOSITORY / 'scenes' / 'planar_2r.xml'}\n"
        "tasks:\n"
        "  - name: clear\n"
        "    type: clearance\n"
        "    pairs: [[pin2, base], [lnik2, floor]]\n"
    )
    with pytest.raises(ConfigError) as caught:
        rmrc.load(file)
    (mistake,) = caught.value.mistakes
    assert mistake.message == (
        "no geom or body named 'lnik2'; did you mean 'link2'? "
        "There is: floor, base, link1, pin1, link2, pin2, world (`rmrc inspect` lists all names)"
    )
    assert mistake.place is not None
    assert (mistake.place.line, mistake.place.column) == (5, 28)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"pairs": []}, "pairs: this list is empty; name at least one"),
        ({"pairs": "link1"}, "pairs: a list of pairs is wanted here, not the text 'link1'"),
        ({"pairs": [["link1"]]}, "pairs[0]: a list of 2 values is wanted here"),
        ({"pairs": [["link1", "post"]], "distance": 0}, "distance: this must be greater"),
        ({"pairs": [["link1", "post"]], "B": -1.0}, "B: this must be at least 0"),
    ],
)
def test_values_out_of_bounds_are_said(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        rmrc.ClearanceTask(name="task", **keys)
    assert str(caught.value).startswith(message)
