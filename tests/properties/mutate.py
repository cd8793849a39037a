"""Mutations of YAML files at four levels: bytes, structure, types of values, and names."""

import copy
import io
import random
from collections.abc import Callable, Iterator
from typing import Any

from ruamel.yaml import YAML

from rmrc.config.schema import schema

# Texts that mean something to YAML, to our models or to Python.
PIECES = [
    *"\n :-?,[]{}#&*!|>'\"%@`$~<=\\\t\r\0\x1b\u2028\ud7ff\ufeff😀",
    *("- ", ": ", "---\n", "...\n", "<<: ", "*caps", "&caps ", "$frame", "${gain}", "$$", "!!str "),
    *("null", "true", "off", "home", ".inf", "-.nan", "1e400", "9" * 400, "0x1F", "1_0", "-0.0"),
    *("1e308", "1e-320", "[[1e308, -1e308], [1e308, 1e308]]", "[1, [2]]", "{a: {b: }}", "[]", "{}"),
    *("arm.xml", "stack.yaml", "fuzz.yaml", "hand", "elbow", "type: ", "path: ", "use: ", "with: "),
]
# Values of every type, for a place that wants another.
VALUES: list[Any] = [
    *(None, True, False, "", " ", "home", "off", "deadbeat", "1.0", "é\u2028\x7f", "x" * 20_000),
    *(0, -1, 1, 3, 1000, 2**31, 2**63, -(2**64), 10**30, 10**400),
    *(0.0, -0.0, 0.5, -1e-320, 1e-300, 1e-9, 1e9, 1e300, 1.7e308, -1e308),
    *(float("nan"), float("inf"), -float("inf")),
    *([], {}, [[]], [{}], {"a": None}, {"": 1}, ["home"], [1, [2]], [[1, 2], [2, 1]]),
    *([0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [1e308] * 3, [1e-320] * 4, [float("nan")] * 3),
    *([1] * 6, [-1] * 7, [1e300] * 7, [[1e308, -1e308], [1e308, 1e308]], [[0] * 6] * 6),
]
# What a scene, a stack or a path's file may be told to be.
FILES = [
    *(
        "/etc/passwd",
        "../../../../../../etc/passwd",
        "/dev/zero",
        "/dev/stdin",
        ".",
        "..",
        "/",
        "~",
    ),
    *("", " ", "\u202e.xml", "x" * 300, "h/" * 4000, "no.xml", "no.csv", "no.npz", "/dev/zero.csv"),
    *("menagerie:", "menagerie:no_such_robot", "menagerie:unitree_go2", "menagerie:../.."),
    *("menagerie:unitree_g1/../../x", "file:///etc/passwd", "https://localhost/a.xml"),
    *("../scenes/panda.xml", "../scenes/pendulum.xml", "../configs/panda_line.yaml"),
    *("../tasks/reach.yaml", "../tasks/humanoid.yaml", "panda_line.yaml"),
]
# Keys whose values are files.
FILE_KEYS = ("scene", "use", "file")


def edit_bytes(content: bytes, chance: random.Random) -> bytes:
    """Return bytes with a few edits: pieces put in, cut out, doubled, turned, a bit flipped."""
    for _ in range(chance.randint(1, 4)):
        begin, end = sorted(chance.randint(0, len(content)) for _ in range(2))
        end = min(end, begin + chance.choice((1, 3, 10, 60)))
        part = content[begin:end]
        piece = chance.choice(PIECES).encode()
        flipped = bytes(byte ^ 1 << chance.randrange(8) for byte in part[:1]) + part[1:]
        new = chance.choice((piece, piece, b"", part * 2, part[::-1], flipped))
        content = content[:begin] + new + content[end:]
    return content


class Mutator:
    """Makes mutations of one file, a quarter of them at each level."""

    def __init__(self, content: bytes):
        """Read the file once."""
        self._content = content
        self._data = YAML(typ="safe", pure=True).load(content)
        self._names = sorted(set(_texts(self._data)))
        self._words = sorted(set(_vocabulary(schema())))

    def __call__(self, chance: random.Random) -> bytes:
        """Return one mutation."""
        edit = chance.choice((None, self._edit_structure, self._edit_type, self._edit_name))
        if edit is None:
            return edit_bytes(self._content, chance)
        root = [copy.deepcopy(self._data)]
        for _ in range(chance.choice((1, 1, 2, 3))):
            edit(root, chance)
        text = io.StringIO()
        yaml = YAML(typ="safe", pure=True)
        yaml.allow_unicode = chance.random() < 0.5
        yaml.dump(root[0], text)
        return text.getvalue().encode()

    def _edit_structure(self, root: list[Any], chance: random.Random) -> None:
        """Delete, add, double, move, rename or wrap a subtree; with aliases, and cycles of them."""
        holder, key = chance.choice(places(root))
        value = holder[key]
        other, place = chance.choice(places(root))
        match chance.randrange(8):
            case 0:
                if holder is not root:
                    del holder[key]
            case 1:
                _put(chance.choice((holder, other)), value, chance.choice(self._words), chance)
            case 2:
                holder[key], other[place] = other[place], value
            case 3:
                other[place] = value  # an alias, and a cycle if it stands inside itself
            case 4:
                if isinstance(holder, dict):
                    word = chance.choice((chance.choice(self._words), misspelled(key, chance)))
                    holder[word] = holder.pop(key)
            case 5:
                holder[key] = chance.choice(([value], {chance.choice(self._words): value}))
            case 6:
                new = chance.choice((chance.choice(VALUES), chance.choice(self._words)))
                _put(other, copy.deepcopy(new), chance.choice(self._words), chance)
            case 7:
                if isinstance(value, list):
                    holder[key] = value * chance.choice((0, 2, 30))
                else:
                    holder[key] = [copy.deepcopy(value) for _ in range(chance.choice((2, 30)))]

    def _edit_type(self, root: list[Any], chance: random.Random) -> None:
        """Put a value of another type, or another number, in the place of one."""
        found = places(root)
        numbers = [(h, k) for h, k in found if type(h[k]) in (int, float)]
        holder, key = chance.choice(numbers if numbers and chance.random() < 0.5 else found)
        value = holder[key]
        if type(value) in (int, float) and abs(value) < 1e300 and chance.random() < 0.6:
            holder[key] = value * chance.choice((-1.0, 1e-300, 1e-9, 0.3, 2, 100, 1e9, 1e200))
        elif isinstance(value, list) and chance.random() < 0.3:
            holder[key] = [copy.deepcopy(chance.choice(VALUES)) for _ in value]
        else:
            holder[key] = copy.deepcopy(chance.choice(VALUES))

    def _edit_name(self, root: list[Any], chance: random.Random) -> None:
        """Misspell a name or a key, or put another that exists somewhere in its place."""
        holder, key = chance.choice(places(root))
        if isinstance(holder, dict) and key not in FILE_KEYS and chance.random() < 0.5:
            name = chance.choice((misspelled(key, chance), chance.choice(self._words)))
            holder[name] = holder.pop(key)
            return
        named = [(h, k) for h, k in places(root) if isinstance(h[k], str)]
        if not named:
            return
        holder, key = chance.choice(named)
        if key in FILE_KEYS:
            others = FILES
        else:
            others = chance.choice((self._names, self._words, [misspelled(holder[key], chance)]))
        holder[key] = chance.choice(others)


def misspelled(name: Any, chance: random.Random) -> str:
    """Return a name with a slip of the pen in it."""
    name = str(name)
    at = chance.randint(0, max(len(name) - 1, 0))
    slip: Callable[[], str] = chance.choice(
        (
            lambda: name[:at] + name[at + 1 :],
            lambda: name[:at] + name[at : at + 2][::-1] + name[at + 2 :],
            lambda: name[:at] + name[at : at + 1] * 2 + name[at + 1 :],
            lambda: name.swapcase(),
            lambda: name[:at] + chance.choice("é а.-\n$[") + name[at:],
        )
    )
    return slip()


def places(root: list[Any]) -> list[tuple[Any, Any]]:
    """Return every container and key below the root, which holds the data alone, each once."""
    found: list[tuple[Any, Any]] = []
    seen: set[int] = set()
    open_: list[Any] = [root]
    while open_:
        holder = open_.pop()
        if id(holder) in seen:
            continue
        seen.add(id(holder))
        for key in list(holder) if isinstance(holder, dict) else range(len(holder)):
            found.append((holder, key))
            if isinstance(holder[key], (dict, list)):
                open_.append(holder[key])
    return found


def _put(holder: Any, value: Any, word: str, chance: random.Random) -> None:
    """Put a value into a mapping under a word, or somewhere into a list."""
    if isinstance(holder, dict):
        holder[word] = value
    else:
        holder.insert(chance.randint(0, len(holder)), value)


def _texts(data: Any) -> Iterator[str]:
    for holder, key in places([data]):
        yield from (text for text in (key, holder[key]) if isinstance(text, str))


def _vocabulary(node: Any) -> Iterator[str]:
    """Yield the keys and the literal texts that a JSON Schema knows."""
    if isinstance(node, list):
        for item in node:
            yield from _vocabulary(item)
    elif isinstance(node, dict):
        yield from node.get("properties", {})
        yield from (
            text for text in (*node.get("enum", ()), node.get("const")) if type(text) is str
        )
        for child in node.values():
            yield from _vocabulary(child)
