# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Random changes to small files: to bytes, records, lengths, numbers, and words of a text.

A format supplies how its bytes split into records, and corrects its checksums afterwards.
"""

from __future__ import annotations

import json
import random
import re
import struct
from collections.abc import Callable, Sequence
from typing import Any

Split = Callable[[bytes], list[bytes]]

# What a length or count may claim: around the limits of each width.
_EXTREME_INTEGERS = (
    *(0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**40),
    *(2**63 - 1, 2**63, 2**64 - 1),
)
_REAL = (0.0, -0.0, 1e-320, 1e30, -1e30, 1e300, float("inf"), float("-inf"), float("nan"), 1e7, 0.1)
_INTEGER_FORMS = ("B", "<H", "<I", "<Q", ">H", ">I", ">Q")
# JSON values that are seldom right in the place of another.
_WRONG_VALUES: tuple[Any, ...] = (
    *(None, True, False, "", "x", 0, -1, 1, 2**63, 10**400, -1e-300, 1e308, 0.5),
    *([], [1.0], [[1.0]], {}, {"a": 1}, [None]),
)
_WORDS = (
    b"",
    b"0",
    b"-1",
    b"1e999",
    b"-1e308",
    b"1e-320",
    b"nan",
    b"inf",
    b".inf",
    b"1:30",
    b"99999999999999999999999999",
    b"9" * 400,
    b"0x10",
    b"null",
    b"true",
    b"~",
    b'""',
    b"[]",
    b"{}",
    b"\xff\xfe",
    b"\x00",
    b"\xe2\x80\xa8",
    b"[red]",
    b"*a",
    b"&a",
    b"!!int ",
    b"!!float x",
    b"!!bool ",
    b"!!timestamp x",
    b"!!python/none",
    b"<<: ",
    b"? ",
    b"- ",
    b"\n",
    b"\t",
    b",",
    b":",
    b"|",
    b"x" * 5000,
    b"[" * 2000,
    b"../../../etc/passwd",
)
_TOKENS = re.compile(rb"[\w.+-]+|\s+|.", re.DOTALL)


class Finding(Exception):  # noqa: N818 - it is none of the program's errors
    """Something that a reader let pass and should not have."""


def mutate(rng: random.Random, data: bytes, split: Split | None, others: Sequence[bytes]) -> bytes:
    """A few changes to a file.

    Args:
        rng: source of randomness.
        data: the file.
        split: splits the file into records whose concatenation is the file; None without records.
        others: files of the same format, whose pieces may be inserted.
    """
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        if split is not None and rng.random() < 0.6:
            data = _change_records(rng, split(data), [one for other in others[:2] for one in split(other)])
        else:
            data = change_bytes(rng, data, rng.choice(others))
    return data


def mutate_text(rng: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """A few changes to the lines and words of a text, and sometimes to its bytes."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        kind = rng.random()
        if kind < 0.15:
            data = change_bytes(rng, data, rng.choice(others))
        elif kind < 0.4:
            lines, more = data.splitlines(keepends=True), rng.choice(others).splitlines(keepends=True)
            data = _change_records(rng, lines, more, within=False)
        else:
            tokens = _TOKENS.findall(data) or [b""]
            place = rng.randrange(len(tokens))
            word = rng.choice(_WORDS) if rng.random() < 0.7 else rng.choice(tokens)
            tokens[place] = rng.choice((word, word + tokens[place], tokens[place] + word))
            data = b"".join(tokens)
    return data


def change_bytes(rng: random.Random, data: bytes, other: bytes = b"") -> bytes:
    """One change to bytes: flip a bit, overwrite by noise or a number, cut, delete, repeat, or replace."""
    changed = bytearray(data)
    # Prefer the head of the file, which decides more than the many samples behind it.
    place = rng.randrange(rng.choice((min(64, len(data)), len(data))) + 1) if data else 0
    length = rng.choice((1, 2, 4, 8, 16, rng.randrange(1, 200)))
    kind = rng.randrange(10)
    if kind == 0 and place < len(changed):
        changed[place] ^= 1 << rng.randrange(8)
    elif kind == 1:
        changed[place : place + length] = rng.randbytes(length)
    elif kind == 2:
        form = rng.choice(_INTEGER_FORMS)
        number = (rng.choice(_EXTREME_INTEGERS) + rng.choice((0, 0, 1, -1))) % 256 ** struct.calcsize(form)
        changed[place : place + struct.calcsize(form)] = struct.pack(form, number)
    elif kind == 3:
        form, number = rng.choice((("<f", rng.choice(_REAL[:4] + _REAL[6:])), ("<d", rng.choice(_REAL))))
        changed[place : place + struct.calcsize(form)] = struct.pack(form, number)
    elif kind == 4:
        del changed[place:]
    elif kind == 5:
        del changed[place : place + length]
    elif kind == 6:
        changed[place:place] = changed[place : place + length] * rng.choice((1, 1, 2, 100))
    elif kind == 7:
        changed[place:place] = rng.randbytes(length)
    elif kind == 8 and other:
        start = rng.randrange(len(other))
        changed[place : place + length] = other[start : start + length]
    else:
        changed[place : place + length] = bytes((rng.choice((0, 0xFF, rng.randrange(256))),)) * length
    return bytes(changed)


def _change_records(
    rng: random.Random, records: list[bytes], others: list[bytes], *, within: bool = True
) -> bytes:
    """One change to the records of a file: delete, repeat, move, cut, insert, or alter one."""
    if not records:
        return b""
    place = rng.randrange(rng.choice((min(16, len(records)), len(records))))
    kind = rng.randrange(10 if within else 5)
    if kind == 0:
        del records[place]
    elif kind == 1:
        records[place:place] = [records[place]] * rng.choice((1, 1, 2, 50))
    elif kind == 2:
        records.insert(rng.randrange(len(records)), records.pop(place))
    elif kind == 3:
        del records[place + 1 :]
    elif kind == 4 and others:
        records[place:place] = [rng.choice(others)]
    else:
        records[place] = change_bytes(rng, records[place], rng.choice(others or records))
    return b"".join(records)


def mutate_json(rng: random.Random, content: Any) -> bytes:
    """JSON with a value replaced, missing or repeated, and sometimes with changes to its text."""
    for _ in range(rng.choice((1, 1, 2))):
        content = alter(rng, content)
    text = json.dumps(content).encode()
    return mutate_text(rng, text, [text]) if rng.random() < 0.2 else text


def alter(rng: random.Random, content: Any) -> Any:
    """JSON content with one value replaced, missing, repeated or scaled."""
    if isinstance(content, dict) and content and rng.random() < 0.9:
        key = rng.choice(sorted(content))
        if rng.random() < 0.05:
            return {name: value for name, value in content.items() if name != key}
        return {**content, key: alter(rng, content[key])}
    if isinstance(content, list) and content and rng.random() < 0.8:
        place = rng.randrange(len(content))
        if rng.random() < 0.1:
            return content[:place] + content[place:][: rng.randrange(3)] * rng.choice((0, 2))
        return [*content[:place], alter(rng, content[place]), *content[place + 1 :]]
    is_number = isinstance(content, float) or (type(content) is int and abs(content) < 2**64)
    if is_number and rng.random() < 0.4:
        return content * rng.choice((-1, 0, 2, 1000, 1e200))
    return rng.choice(_WRONG_VALUES)
