"""The README and the pages of docs: what they show is what there is, and their snippets run."""

import json
import re
import shutil
import textwrap
from pathlib import Path

import pytest
from ruamel.yaml import YAML

import rmrc
from models import REPOSITORY
from rmrc.cli import app

PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
TEXT = "\n".join(path.read_text(encoding="utf-8") for path in PAGES)
LONGEST = 150
"""Lines of the README: it is a guide, and the pages have the rest."""


def blocks() -> list[str]:
    """Return the indented blocks, in order."""
    found, lines = [], []
    for line in [*TEXT.splitlines(), "the end"]:
        if line.startswith("    ") or (lines and not line):
            lines.append(line)
        elif lines:
            found.append(textwrap.dedent("\n".join(lines)).strip() + "\n")
            lines = []
    return found


def block(start: str) -> str:
    """Return the one block that starts so."""
    (found,) = (each for each in blocks() if each.startswith(start))
    return found


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of what the README's commands read, as the working directory."""
    for name in ("configs", "scenes", "tasks"):
        shutil.copytree(REPOSITORY / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_guide_is_short_and_its_links_lead_somewhere() -> None:
    readme = PAGES[0].read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= LONGEST
    for page in PAGES:
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_table_of_times_is_that_of_the_results(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(REPOSITORY / "bench")
    import table  # pyright: ignore[reportMissingImports]

    results = json.loads((REPOSITORY / "bench" / "results.json").read_text(encoding="utf-8"))
    assert f"{table.BEGIN}\n{table.table(results['step'])}\n{table.END}" in TEXT


def test_the_configuration_is_the_shipped_one() -> None:
    shipped = (REPOSITORY / "configs" / "panda_line.yaml").read_text(encoding="utf-8")
    yaml = YAML(typ="safe")
    assert yaml.load(block("# configs/panda_line.yaml")) == yaml.load(shipped)


def test_the_mistakes_are_the_messages(folder: Path) -> None:
    path = Path("configs", "panda_line.yaml")
    wrong = path.read_text(encoding="utf-8").replace("site: hand", "site: hnad")
    path.write_text(wrong.replace("level: 1", "levl: 1"), encoding="utf-8")
    with pytest.raises(rmrc.ConfigError) as mistake:
        rmrc.load(path)
    shown = block("$ rmrc check").split("\n", 1)[1]
    assert str(mistake.value).split() == shown.split()


def test_the_limits_are_those_of_a_configuration(folder: Path) -> None:
    limits = YAML(typ="safe").load(block("limits:"))["limits"]
    config = rmrc.load("configs/panda_obstacle.yaml", overrides={"limits": limits})
    assert rmrc.compile(config).barriers
    assert set(limits) == set(type(config.limits).model_fields)


SNIPPETS = [each for each in blocks() if each.startswith("import ")]


@pytest.mark.parametrize("snippet", SNIPPETS, ids=["solve", "batch", "running", "recorder", "step"])
def test_the_snippets_run(snippet: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(snippet, "README.md", "exec"), {})
    assert capsys.readouterr().out


def test_every_status_is_explained() -> None:
    rows = [line.split("`")[1] for line in TEXT.splitlines() if line.startswith("| `")]
    assert [row for row in rows if row.isupper()] == [status.name for status in rmrc.Status]


def test_every_command_is_listed() -> None:
    callbacks = (command.callback for command in app.registered_commands)
    commands = {callback.__name__ for callback in callbacks if callback is not None}
    assert commands <= set(re.findall(r"`rmrc (\w+)", TEXT))
