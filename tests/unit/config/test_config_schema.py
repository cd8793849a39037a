"""The JSON Schema: current, valid, and in agreement with the models on what is right and wrong."""

import json
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from rmrc.config.schema import schema
from rmrc.text.read import read

GOLDEN = Path(__file__).parents[1] / "text" / "golden" / "config"
FOLDERS = ("configs", "tasks")


@pytest.fixture(scope="module")
def validator() -> Draft202012Validator:
    return Draft202012Validator(schema())


def plain(path: Path) -> Any:
    return read(path, path.name).plain


def test_the_schema_is_one():
    Draft202012Validator.check_schema(schema())


def test_the_committed_copy_is_current(repository):
    committed = (repository / "rmrc.schema.json").read_text(encoding="utf-8")
    assert committed == json.dumps(schema(), indent=2, ensure_ascii=False) + "\n", (
        "write it anew: rmrc schema > rmrc.schema.json"
    )


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_shipped_file_is_valid_and_names_the_schema(repository, folder, validator):
    paths = sorted((repository / folder).glob("*.yaml"))
    assert paths
    for path in paths:
        assert [error.message for error in validator.iter_errors(plain(path))] == [], path.name
        first, *_ = path.read_text(encoding="utf-8").splitlines()
        assert first == "# yaml-language-server: $schema=../rmrc.schema.json", path.name


@pytest.mark.parametrize(
    "name",
    [
        "empty_lists",
        "missing_keys",
        "not_one_of",
        "one_of_several_kinds",
        "path_type",
        "stack_item_keys",
        "task_type",
        "unknown_key",
        "wrong_kind",
    ],
)
def test_mistakes_that_an_editor_can_see_are_invalid(name, validator):
    assert list(validator.iter_errors(plain(GOLDEN / f"{name}.yaml")))


@pytest.mark.parametrize("name", ["reach", "careful", "dollars"])
def test_stacks_with_parameters_are_valid(name, validator):
    assert list(validator.iter_errors(plain(GOLDEN / "stacks" / f"{name}.yaml"))) == []


@pytest.mark.parametrize(
    "stack",
    [
        {"tasks": [{"name": "rest", "type": "postur"}]},
        {"tasks": [{"name": "rest", "type": "posture", "gian": "$gain"}]},
        {"tasks": [{"name": "rest", "type": "posture", "gain": "fast"}]},
        {"tasks": [{"use": "other.yaml"}]},
        {"parameters": {"left-foot": 1}},
        {"parameters": [], "tasks": []},
    ],
)
def test_mistakes_in_stacks_are_invalid(stack, validator):
    assert list(validator.iter_errors(stack))


def test_an_unknown_task_type_is_one_mistake_in_an_editor(validator):
    config = {"scene": "arm.xml", "tasks": [{"name": "hand", "type": "fraem", "frame": {}}]}
    (error,) = validator.iter_errors(config)
    assert error.json_path == "$.tasks[0].type"
