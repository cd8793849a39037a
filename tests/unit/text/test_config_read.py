"""Reading: YAML 1.2 with positions, and every file that is none is refused soon and clearly."""

import math
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rmrc.errors import ConfigError
from rmrc.text.read import DEEPEST, LARGEST_FILE, MOST_VALUES, parse, read

# Seconds and bytes that the worst file may take; it takes half a second, and 200 MB in all.
SOON = 2.0
MOST_MEMORY = 500e6


def plain(text):
    node = parse(text, "text.yaml")
    assert node is not None
    return node.plain


def refusal(path):
    """Return the message for a file."""
    with pytest.raises(ConfigError) as caught:
        read(path, path.name)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-6", 1e-6),
        ("1.", 1.0),
        (".5", 0.5),
        ("-2E+3", -2000.0),
        ("+7", 7),
        ("0o17", 15),
        ("0x1F", 31),
        ("017", 17),
        ("9007199254740993", 9007199254740993),
        ("1" + "0" * 30, 1e30),
        ("9" * 5000, math.inf),
        ("-.inf", -math.inf),
        ("true", True),
        ("False", False),
        ("null", None),
        ("~", None),
        ("'5'", "5"),
        ('"true"', "true"),
    ]
    + [
        (text, text)
        for text in ("yes", "no", "on", "off", "y", "1_000", "12:30:45", "2001-12-14", "1e", "0b1")
    ],
)
def test_a_scalar_means_what_yaml_1_2_says(text, value):
    got = plain(f"[{text}]")[0]
    assert got == value
    assert type(got) is type(value)


def test_nan_is_read_for_the_models_to_refuse():
    assert math.isnan(plain("[.nan]")[0])


def test_every_key_and_value_has_its_place():
    text = (
        "tasks:\n  - {name: hand, frame: {site: tip}}\n  - name: rest\nlimits:\n  velocity: off\n"
    )
    root = parse(text, "text.yaml")
    assert root is not None
    for location, line, column, key in (
        (("tasks",), 2, 3, (1, 1)),
        (("tasks", 0), 2, 5, None),
        (("tasks", 0, "frame"), 2, 25, (2, 18)),
        (("tasks", 0, "frame", "site"), 2, 32, (2, 26)),
        (("tasks", 1, "name"), 3, 11, (3, 5)),
        (("limits", "velocity"), 5, 13, (5, 3)),
    ):
        node = root
        for step in location:
            node = node.child(step)
            assert node is not None
        assert (node.place.line, node.place.column) == (line, column)
        assert node.place.text == text.splitlines()[line - 1]
        assert (node.key and (node.key.line, node.key.column)) == key


def test_an_alias_is_its_anchor_again():
    assert plain("a: &x {b: [1, 2]}\nc: *x\n") == {"a": {"b": [1, 2]}, "c": {"b": [1, 2]}}


def test_a_byte_order_mark_and_windows_lines_are_no_matter(tmp_path):
    path = tmp_path / "windows.yaml"
    path.write_bytes("scene: arm.xml\r\ndt: 0.1\r\n".encode("utf-8-sig"))
    node = read(path, path.name)
    assert node.plain == {"scene": "arm.xml", "dt": 0.1}
    assert node.mapping["dt"].place.line == 2


def test_a_missing_file_names_the_nearest_one(tmp_path):
    (tmp_path / "panda_line.yaml").touch()
    assert refusal(tmp_path / "panda_lien.yaml") == (
        "panda_lien.yaml: there is no such file; did you mean 'panda_line.yaml'?"
    )
    assert refusal(tmp_path / "no" / "such.yaml") == "such.yaml: there is no such file"


def test_a_folder_is_no_file(tmp_path):
    assert refusal(tmp_path).endswith(": this is a folder, not a file")


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    assert refusal(tmp_path / "pipe.yaml") == "pipe.yaml: this is not a regular file"


def test_a_link_to_itself_is_refused(tmp_path):
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    assert refusal(tmp_path / "loop.yaml") == (
        "loop.yaml: this is a symbolic link that leads back to itself"
    )


def test_a_file_without_permission_is_refused(tmp_path):
    path = tmp_path / "secret.yaml"
    path.write_text("scene: arm.xml\n")
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user may read everything")
    assert refusal(path) == "secret.yaml: you have no permission to read this file"


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"\x7fELF\x02\x01\x01\x00\x00", "this is a binary file, not text"),
        (b"scene: a\nname: \xff\xfe\n", "this is not a text file in UTF-8: see line 2"),
        ("scene: a".encode("utf-16"), "this is not a text file in UTF-8: see line 1"),
        (b"scene: a\ndt: \x1b[31m\n", "line 2 has the character '\\x1b', which no text file has"),
        (b"", "the file is empty"),
        (b"null\n", "the file is empty"),
    ],
)
def test_what_is_no_text_is_refused(content, why, tmp_path):
    path = tmp_path / "file.yaml"
    path.write_bytes(content)
    assert refusal(path) == f"file.yaml: {why}"


def test_text_that_cannot_be_written_is_refused():
    with pytest.raises(ConfigError, match="1:7: this text has a character that no name"):
        parse(r'name: "\ud800"', "text.yaml")


@pytest.mark.parametrize(
    "text",
    [
        "a: " + "x" * 10_000_000,
        "a: [" + "1, " * 3_400_000 + "]",
        "a: '" + "\n x" * (LARGEST_FILE // 3 - 5),
        "a: [" + "1, " * (LARGEST_FILE // 3 - 5) + "]",
        "a: " + "[" * (LARGEST_FILE - 5),
        "a: !" + "x" * (LARGEST_FILE - 5),
        "".join(f"a{i}: &a{i} 1\n" for i in range(60_000)),
        "".join(
            f"a{i}: &a{i} [{', '.join([f'*a{i - 1}' if i else 'x'] * 9)}]\n" for i in range(40)
        ),
        "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}]\n" for i in range(1, 5000)),
    ],
    ids=["scalar", "list", "quote", "values", "deep", "tag", "anchors", "bomb", "chain"],
)
def test_a_file_beyond_the_bounds_is_refused_soon(text, tmp_path):
    path = tmp_path / "large.yaml"
    path.write_text(text)
    del text
    began = time.process_time()
    assert len(refusal(path)) < 1000
    assert time.process_time() - began < SOON


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="needs Linux's /proc")
def test_the_largest_file_takes_little_memory(tmp_path):
    # The peak that getrusage gives is that of the process before exec: the whole test suite's.
    path = tmp_path / "large.yaml"
    path.write_text("a: [" + "1, " * (MOST_VALUES - 10) + "]\n#" + "x" * (LARGEST_FILE - 70_000))
    script = (
        "import re, sys, pathlib; from rmrc.text.read import read;"
        "print(len(read(pathlib.Path(sys.argv[1]), 'large.yaml').plain['a']),"
        "re.search(r'VmHWM:\\s*(\\d+)', pathlib.Path('/proc/self/status').read_text())[1])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, path], capture_output=True, text=True, check=True
    )
    values, kilobytes = map(int, done.stdout.split())
    assert values == MOST_VALUES - 10
    assert kilobytes * 1e3 < MOST_MEMORY


def test_depth_is_bounded_where_it_says():
    assert plain("[" * DEEPEST + "]" * DEEPEST)
    with pytest.raises(ConfigError, match=f"1:{DEEPEST + 2}: .* at most {DEEPEST} levels deep"):
        parse("[" * (DEEPEST + 2) + "]" * (DEEPEST + 2), "text.yaml")


def test_nothing_in_a_file_is_executed(tmp_path):
    path, trace = tmp_path / "evil.yaml", tmp_path / "trace"
    path.write_text(f"scene: !!python/object/apply:os.mkdir ['{trace}']\n")
    assert "tags such as !!python/object have no meaning here" in refusal(path)
    assert not trace.exists()
