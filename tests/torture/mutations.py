"""How files are damaged: at random, reproducible from a generator."""

import json
import re
from collections.abc import Callable
from random import Random
from typing import Any

import safetensors.numpy

from tustinnet.store.sealed import KEY, SEAL, _digest

Mutation = Callable[[bytes, Random], bytes]

_TOKEN = re.compile(rb'[^\s,=\[\]{}"]+')
_ODD_NUMBERS = (
    "1e999",
    "-1e308",
    "1e-320",
    "nan",
    "-inf",
    "inf",
    "-0.0",
    "0",
    "-1",
    "9" * 400,
    "0x1F",
    "1_0",
    "1e5000",
    "99999999999999999999",
    "2147483648",
    "0.1e",
    "１２",
    "1,5",
    "+",
    "1e",
    ".5",
    "1d3",
)
_ODD_TEXT = (
    "",
    '""',
    "'",
    '"',
    "true",
    "[]",
    "{}",
    "[" * 3000,
    "{a=" * 2000,
    "(" * 500,
    "a" * 5000,
    "ä",
    "\x00",
    "\x1b[2J",
    "\u202e",
    "\u2028",
    "\x85",
    "\r",
    "\n",
    "\t",
    "\x0b",
    "#",
    "1979-05-27",
    "../../x",
    "/etc/passwd",
    "**",
    "**/*",
    "*",
    "?",
    "..",
    ".",
    "~/x",
    "a/b",
    "CON",
    "=SUM(A1)",
)
_ODD_VALUES = (
    None,
    True,
    False,
    0,
    -1,
    1,
    2,
    10**30,
    1e308,
    float("inf"),
    float("nan"),
    "",
    "x",
    "a" * 5000,
    "\x1b[2J",
    "../../x",
    [],
    {},
    [0],
    [[]],
    {"name": 1},
    [None],
    2**31,
    2**63,
    "F32",
    "angular",
)


def mutate(clean: bytes, kind: str, random: Random) -> bytes:
    """The content with one to three damages of a kind: `text`, `binary` or `safetensors`."""
    if kind == "safetensors" and random.random() < 0.3:
        return _sealed_again(_inner(clean, random))
    damaged = clean
    own = _OWN.get(kind, ())
    for _ in range(random.choice((1, 1, 1, 2, 3))):
        choices = own if own and random.random() < 0.6 else _ANY
        damaged = random.choice(choices)(damaged, random)
    return damaged


# --- any file ---


def _range(data: bytes, random: Random, longest: int = 64) -> tuple[int, int]:
    begin = random.randrange(len(data) + 1)
    return begin, min(len(data), begin + random.randint(1, longest))


def _flip(data: bytes, random: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 8)) if data else 0):
        changed[random.randrange(len(data))] ^= 1 << random.randrange(8)
    return bytes(changed)


def _overwrite(data: bytes, random: Random) -> bytes:
    begin, end = _range(data, random, 16)
    fill = random.choice((b"\x00", b"\xff", b"\x7f", random.randbytes(1)))
    return data[:begin] + fill * (end - begin) + data[end:]


def _truncate(data: bytes, random: Random) -> bytes:
    return data[: random.randrange(len(data) + 1)]


def _insert(data: bytes, random: Random) -> bytes:
    begin, _ = _range(data, random)
    return data[:begin] + random.randbytes(random.choice((1, 4, 64))) + data[begin:]


def _delete(data: bytes, random: Random) -> bytes:
    begin, end = _range(data, random)
    return data[:begin] + data[end:]


def _repeat(data: bytes, random: Random) -> bytes:
    begin, end = _range(data, random)
    return data[:end] + data[begin:end] + data[end:]


def _swap(data: bytes, random: Random) -> bytes:
    a, b, c, d = sorted(random.randrange(len(data) + 1) for _ in range(4))
    return data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


# --- text ---


def _tokens(data: bytes, random: Random, number: int) -> list[re.Match[bytes]]:
    found = list(_TOKEN.finditer(data))
    chosen = random.sample(found, number) if len(found) >= number else []
    return sorted(chosen, key=lambda match: match.start())


def _odd_token(data: bytes, random: Random) -> bytes:
    for match in _tokens(data, random, 1):
        odd = random.choice(random.choice((_ODD_NUMBERS, _ODD_TEXT))).encode()
        data = data[: match.start()] + odd + data[match.end() :]
    return data


def _odd_inside(data: bytes, random: Random) -> bytes:
    begin, _ = _range(data, random)
    return data[:begin] + random.choice(_ODD_TEXT).encode() + data[begin:]


def _swap_tokens(data: bytes, random: Random) -> bytes:
    if pair := _tokens(data, random, 2):
        a, b = pair
        data = data[: a.start()] + b[0] + data[a.end() : b.start()] + a[0] + data[b.end() :]
    return data


def _lines(data: bytes, random: Random) -> bytes:
    lines = data.splitlines(keepends=True) or [b""]
    at, other = random.randrange(len(lines)), random.randrange(len(lines))
    match random.randrange(4):
        case 0:
            lines.insert(other, lines[at])
        case 1:
            del lines[at]
        case 2:
            lines[at], lines[other] = lines[other], lines[at]
        case _:
            lines[at] = lines[at].rstrip(b"\r\n") + lines[other]
    return b"".join(lines)


# --- safetensors: the outer header names arrays, the inner one is JSON of the package ---


def _places(content: Any) -> list[tuple[Any, Any]]:
    """Every container in a JSON tree with each of its keys."""
    if isinstance(content, dict):
        keys = list(content)
    elif isinstance(content, list):
        keys = list(range(len(content)))
    else:
        return []
    return [p for key in keys for p in [(content, key), *_places(content[key])]]


def _edit(content: Any, random: Random) -> Any:
    place: Any
    place, key = random.choice(_places(content) or [([content], 0)])
    match random.randrange(4):
        case 0:
            del place[key]
        case 1 if isinstance(place, dict):
            place[random.choice(("", "x", "kind", "../x", "\x1b[2J", "physics"))] = place.pop(key)
        case 2 if isinstance(place[key], int | float):
            place[key] *= random.choice((-1, 0, 2, 1000, 1e300, 0.5))
        case _:
            place[key] = random.choice(_ODD_VALUES)
    return content


def parts(data: bytes) -> tuple[dict[str, Any], bytes] | None:
    """Header and body of a safetensors file, None of one that is damaged already."""
    length = int.from_bytes(data[:8], "little")
    try:
        header = json.loads(data[8 : 8 + length])
    except ValueError:
        return None
    return (header, data[8 + length :]) if isinstance(header, dict) else None


def joined(header: dict[str, Any], body: bytes) -> bytes:
    """A safetensors file."""
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + body


def _outer(data: bytes, random: Random) -> bytes:
    found = parts(data)
    return data if found is None else joined(_edit(found[0], random), found[1])


def _inner(data: bytes, random: Random) -> bytes:
    found = parts(data)
    metadata = found[0].get("__metadata__") if found else None
    if found is None or not isinstance(metadata, dict) or not metadata:
        return data
    key = sorted(metadata)[0]
    try:
        content = json.loads(metadata[key])
    except (TypeError, ValueError, RecursionError):
        return data
    metadata[key] = random.choice(
        (json.dumps(_edit(content, random)), "[" * 50_000, "1" * 5000, '{"kind": 1, "format": 2}')
        if random.random() < 0.1
        else (json.dumps(_edit(content, random)),)
    )
    return joined(*found)


def _sealed_again(data: bytes) -> bytes:
    """The file with the digest that fits what its header says now."""
    found = parts(data)
    try:
        assert found is not None
        header = json.loads(found[0]["__metadata__"][KEY])
        header.pop(SEAL, None)
        digest = _digest(header, safetensors.numpy.load(data))
        found[0]["__metadata__"][KEY] = json.dumps({SEAL: digest, **header})
    except (ValueError, AttributeError, RecursionError):
        return data  # no header that could say one
    return joined(*found)


def change_header(data: bytes, random: Random) -> tuple[bytes, str]:
    """A model file with one or two entries of its header changed and sealed again; their places.

    Most changes keep the type of an entry, so that only its meaning is wrong.
    """
    found = parts(data)
    assert found is not None
    metadata = found[0]["__metadata__"]
    header, told = json.loads(metadata[KEY]), []
    for _ in range(random.choice((1, 1, 2))):
        path = _random_path(header, random)
        place = header
        for key in path[:-1]:
            place = place[key]
        told.append(f"{'.'.join(map(str, path))}: {_change(place, path[-1], random)}")
    metadata[KEY] = json.dumps(header)
    return _sealed_again(joined(*found)), "; ".join(told)


def _random_path(content: Any, random: Random) -> list[Any]:
    """The keys to a random entry, each table as likely as another, however long its lists are."""
    path: list[Any] = []
    while isinstance(content, dict | list) and content and (not path or random.random() < 0.85):
        path.append(
            random.choice(list(content) if isinstance(content, dict) else range(len(content)))
        )
        content = content[path[-1]]
    return path


def _change(place: Any, key: Any, random: Random) -> str:
    """Changes an entry; the new value in words."""
    old = place[key]
    if random.random() < 0.3:
        new = random.choice((*_ODD_VALUES, "\ud800"))
    elif isinstance(old, bool):
        new = not old
    elif isinstance(old, int | float):
        new = random.choice(
            (0, -old, old * 2, old / 2, 1e-300, 1e140, 1e308, -1.0, 1, 10**6, 1e300)
        )
    elif isinstance(old, str):
        new = random.choice(
            ("", f"{old}x", "file", "model-20", "model-99999999", "warm-up-3", "theta")
        )
    elif isinstance(old, list):
        new = random.choice(([], old * 2, old[1:], old[::-1], [old], old[:1] * 3))
    elif isinstance(old, dict):
        new = random.choice(({}, {**old, "x": 1}, dict(list(old.items())[1:]), [old]))
    else:
        new = random.choice((0.5, "x", [], {}))
    if isinstance(place, dict) and random.random() < 0.15:
        del place[key]
        return "removed"
    place[key] = new
    return repr(new)[:40]


def _weights(data: bytes, random: Random) -> bytes:
    """Flips bits of the body alone."""
    found = parts(data)
    return data if found is None else joined(found[0], _flip(found[1], random))


_ANY: tuple[Mutation, ...] = (_flip, _overwrite, _truncate, _insert, _delete, _repeat, _swap)
_OWN: dict[str, tuple[Mutation, ...]] = {
    "text": (_odd_token, _odd_inside, _swap_tokens, _lines),
    "safetensors": (_outer, _inner, _inner, _weights),
}
