"""The message for each kind of mistake, compared exactly: the texts are what users get.

`python tests/unit/text/test_config_golden.py` writes the messages anew, to be read before they are
committed.
"""

import os
from pathlib import Path

import pytest

from rmrc.config.load import load
from rmrc.errors import ConfigError

GOLDEN = Path(__file__).parents[1] / "text" / "golden" / "config"
MISTAKEN = sorted(path.name for path in GOLDEN.glob("*.yaml"))


def message(name: str) -> str:
    """Return the message for a file in the present folder."""
    with pytest.raises(ConfigError) as caught:
        load(name)
    return f"{caught.value}\n"


@pytest.mark.parametrize("name", MISTAKEN)
def test_message_is_the_golden_one(name, monkeypatch):
    monkeypatch.chdir(GOLDEN)
    assert message(name) == Path(name).with_suffix(".txt").read_text(encoding="utf-8")


def test_every_golden_message_has_its_file():
    assert MISTAKEN
    assert sorted(path.with_suffix(".yaml").name for path in GOLDEN.glob("*.txt")) == MISTAKEN


if __name__ == "__main__":
    os.chdir(GOLDEN)
    for mistaken in MISTAKEN:
        Path(mistaken).with_suffix(".txt").write_text(message(mistaken), encoding="utf-8")
