"""Paths as configurations say them."""

from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from rmrc.paths import PATHS, PathConfig, PathModel

# The models.

ADAPTER: TypeAdapter[PathModel] = TypeAdapter(PathConfig)
EXAMPLES: list[dict[str, Any]] = [
    {"path": "hold"},
    {"path": "pose", "position": [0.5, 0.2, 0.4], "delay": 1.0},
    {"path": "line", "from": {"position": [0, 0, 1]}, "to": {"position": [1, 0, 1]}, "speed": 0.1},
    {"path": "arc", "via": [0.1, 0.2, 0.3], "to": {"position": [1, 0, 1]}, "duration": 2},
    {"path": "circle", "center": [0, 0, 0], "normal": [0, 0, 1], "duration": 2, "turns": -3},
    {"path": "waypoints", "through": [{"position": [1, 0, 1]}], "profile": "constant", "speed": 1},
    {"path": "file", "file": "poses.csv", "coordinates": "start"},
]


def test_the_key_path_chooses_the_type() -> None:
    assert [type(ADAPTER.validate_python(example)) for example in EXAMPLES] == list(PATHS)
    with pytest.raises(ValidationError, match="spiral"):
        ADAPTER.validate_python({"path": "spiral"})


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example["path"])
def test_a_path_survives_being_written_and_read(example: dict[str, Any]) -> None:
    model = ADAPTER.validate_python(example)
    written = model.model_dump(by_alias=True)
    assert example.keys() <= written.keys()
    assert ADAPTER.validate_python(written) == model
    with pytest.raises(ValidationError, match="Extra inputs are not permitted"):
        ADAPTER.validate_python({**example, "colour": "red"})


@pytest.mark.parametrize(
    ("index", "change", "message"),
    [
        (2, {"duration": 1.0}, "exactly one of duration"),
        (2, {"speed": None}, "exactly one of duration"),
        (2, {"speed": 0.0}, "greater than 0"),
        (3, {"duration": -1.0}, "greater than 0"),
        (3, {"delay": -1.0}, "greater than or equal to 0"),
        (4, {"normal": [0, 0, 0]}, "zero length"),
        (4, {"turns": float("nan")}, "finite"),
        (5, {"through": []}, "at least 1"),
        (5, {"profile": "smooth"}, "minimum_jerk"),
        (6, {"file": "poses.txt"}, r"a \.csv or a \.npz, and this is 'poses\.txt'"),
    ],
)
def test_a_mistake_in_a_model_is_refused(index: int, change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        ADAPTER.validate_python({**EXAMPLES[index], **change})
