"""Whatever a file holds, loading it gives a configuration or one `ConfigError`, and soon."""

import random
import time
from pathlib import Path

from rmrc.config.load import load, show
from rmrc.config.models import Config
from rmrc.errors import ConfigError

# Seconds for a file of a few hundred bytes; they take some hundredths, and a loaded machine more.
SOON = 2.0
MUTATIONS = 400

CONFIG = """\
# The hand moves while the elbow rests.
scene: arm.xml
start: {shoulder: 0.1, elbow: 0.2}
dt: 2e-3
damping: {lambda: 0.01}
metric: [1.0, 2.0]
dofs: [shoulder, elbow]
tasks:
  - use: stack.yaml
    with: {frame: {site: hand}, gain: 5}
    override: {hand: {B: {position: 2.0}}}
  - {name: rest, type: posture, level: 1, B: [[2.0, 1.0], [1.0, 2.0]], target: home}
  - &gaze
    name: gaze
    type: look_at
    frame: {body: lower}
    target: [1.0, 2, -.5]
limits:
  position: {margin: 0.01}
  velocity: &caps {default: 2.0, elbow: 1.0}
  acceleration: *caps
targets:
  hand:
    path: line
    to: {position: [1.0, 1.0, 0.0], quaternion: [1, 0, 0, 0]}
    duration: 3.0
"""
STACK = """\
parameters:
  frame: null
  gain: 20.0
tasks:
  - {name: hand, type: frame, frame: $frame, gain: $gain, B: {position: 1.0, orientation: 0.5}}
limits:
  velocity: {default: 2.0}
"""
SCENE = (Path(__file__).parents[1] / "unit" / "golden" / "config" / "arm.xml").read_text()
# Texts that mean something to YAML, to our models or to Python.
PIECES = [
    *"\n :-?,[]{}#&*!|>'\"%@`$~<=\\\t\r\0\x1b\u2028\ud7ff\ufeff😀",
    *("- ", ": ", "---\n", "...\n", "<<: ", "*caps", "&caps ", "$frame", "${gain}", "$$", "!!str "),
    *("null", "true", "off", "home", ".inf", "-.nan", "1e400", "9" * 400, "0x1F", "1_0", "-0.0"),
    *("1e308", "1e-320", "[[1e308, -1e308], [1e308, 1e308]]", "[1, [2]]", "{a: {b: }}", "[]", "{}"),
    *("arm.xml", "stack.yaml", "fuzz.yaml", "hand", "elbow", "type: ", "path: ", "use: ", "with: "),
]


def mutated(text: str, chance: random.Random) -> str:
    """Return a text with a few edits: pieces put in, cut out, doubled and moved."""
    for _ in range(chance.randint(1, 4)):
        begin, end = sorted(chance.randint(0, len(text)) for _ in range(2))
        end = min(end, begin + chance.choice((1, 3, 10, 60)))
        part = text[begin:end]
        new = chance.choice(
            (chance.choice(PIECES), chance.choice(PIECES), "", part * 2, part[::-1])
        )
        text = text[:begin] + new + text[end:]
    return text


def refuses(config: Path) -> bool:
    """Load a file in time, and what is shown of it again; tell whether it is refused."""
    began = time.process_time()
    loaded, refusal = None, None
    try:
        loaded = load(config)
    except ConfigError as error:
        refusal = error
    assert time.process_time() - began < SOON
    if loaded is None:
        assert refusal is not None
        assert refusal.mistakes
        assert all(mistake.place is not None for mistake in refusal.mistakes)
        assert str(refusal).encode()  # it can be printed
        return True
    text = show(config)
    config.write_text(text, encoding="utf-8")
    assert load(config).resolved() == loaded.resolved()
    return False


def test_a_mutated_file_loads_or_is_refused_with_places(tmp_path):
    chance = random.Random(0)
    (tmp_path / "arm.xml").write_text(SCENE)
    config, stack = tmp_path / "fuzz.yaml", tmp_path / "stack.yaml"
    refused = []
    for _ in range(MUTATIONS):
        in_stack = chance.random() < 0.25
        config.write_text(CONFIG if in_stack else mutated(CONFIG, chance), encoding="utf-8")
        stack.write_text(mutated(STACK, chance) if in_stack else STACK, encoding="utf-8")
        refused.append(refuses(config))
    assert any(refused)
    assert not all(refused)


def test_what_is_mutated_loads_as_it_is(tmp_path):
    (tmp_path / "arm.xml").write_text(SCENE)
    (tmp_path / "stack.yaml").write_text(STACK)
    (tmp_path / "fuzz.yaml").write_text(CONFIG)
    assert isinstance(load(tmp_path / "fuzz.yaml"), Config)
