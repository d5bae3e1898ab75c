# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Every encoding of the fields of a Blackbox frame, against the bytes of the documentation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadpi_core.core import compiled
from quadpi_core.logs.formats.betaflight import RULES

from .blackbox_writer import signed, unsigned

SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB = 0, 1, 3, 6

# The bits of three values A, B and C, by encoding; the shortest form that holds them is taken.
FORMS = {
    7: ("00AABBCC", "0100AAAABBBBCCCC", "10AAAAAA00BBBBBB00CCCCCC"),
    10: ("00AABBCC", "01AAAAABBBBBCCCC", "10AAAAAAAABBBBBBBCCCCCCC"),
}


def triple(values, encoding):
    for form in FORMS[encoding]:
        bits, room = form, {letter: form.count(letter) for letter in "ABC"}
        for value, (letter, count) in zip(values, room.items(), strict=True):
            if -(1 << (count - 1)) <= value < 1 << (count - 1):
                bits = bits.replace(letter * count, f"{value & (1 << count) - 1:0{count}b}")
        if not set(bits) & set(room):
            return int(bits, 2).to_bytes(len(bits) // 8, "big")
    lengths = [next(n for n in (1, 2, 3, 4) if -(1 << (8 * n - 1)) <= v < 1 << (8 * n - 1)) for v in values]
    lead = 0xC0 | sum((n - 1) << 2 * k for k, n in enumerate(lengths))
    parts = (v.to_bytes(n, "little", signed=True) for v, n in zip(values, lengths, strict=True))
    return bytes([lead]) + b"".join(parts)


def quadruple(values):
    sizes = [
        0 if v == 0 else next(tag for tag, b in ((1, 4), (2, 8), (3, 16)) if -(1 << b - 1) <= v < 1 << b - 1)
        for v in values
    ]
    digits = "".join(
        f"{v & (1 << b) - 1:0{b // 4}x}"
        for v, b in zip(values, ((0, 4, 8, 16)[tag] for tag in sizes), strict=True)
        if b
    )
    head = sum(tag << 2 * k for k, tag in enumerate(sizes))
    return bytes([head]) + bytes.fromhex(digits + "0" * (len(digits) % 2))


def eight(values):
    if len(values) == 1:
        return signed(values[0])
    head = sum((value != 0) << k for k, value in enumerate(values))
    return bytes([head]) + b"".join(signed(value) for value in values if value)


ENCODERS = {
    0: lambda values: b"".join(map(signed, values)),
    6: eight,
    7: lambda values: triple(values, 7),
    8: quadruple,
    10: lambda values: triple(values, 10),
}


SIZES = {0: 2, 6: 8, 7: 3, 8: 4, 10: 3}


def test_encoders_of_this_test_give_the_bytes_of_the_documentation():
    assert unsigned(23456) == b"\xa0\xb7\x01"
    assert signed(-2147483648) == unsigned(4294967295)
    assert eight([0, 0, 4, 0, 4])[:1] == b"\x14"
    assert quadruple([13, 0, 4, 2]) == bytes([0b01010010, 0x0D, 0x42])
    assert triple([1, -2, -1], 7) == bytes([0b00011011])


def read(packed: bytes, *encodings: int) -> tuple[list[int] | None, int]:
    """The values of a frame whose fields are in these encodings, if it is whole, and the damaged bytes."""
    count, rules = len(encodings), np.zeros(1, RULES)
    rules["sizes"][0, 0], rules["encoding"][0, 0, :count] = count, encodings
    rules["signed"][0, :count] = np.not_equal(encodings, UNSIGNED_VB)
    for name in ("every", "numerator", "denominator"):
        rules[name] = 1
    # Fields that no frame has.
    rules["time"] = rules["iteration"] = compiled.BLACKBOX_FIELDS_MAX - 1
    table = np.empty((1, count))
    frames, _, _, damaged = compiled.decode_blackbox(b"I" + packed, 0, rules, np.arange(count), table)
    return table[0].astype(int).tolist() if frames else None, damaged


@pytest.mark.parametrize("encoding", ENCODERS)
@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_every_value_of_every_encoding(encoding, data):
    most = data.draw(st.sampled_from([1, 7, 15, 31, 100, 30000] + [2**23, 2**31 - 1] * (encoding != 8)))
    size = data.draw(st.integers(1, 8)) if encoding == 6 else SIZES[encoding]
    values = data.draw(st.lists(st.integers(-most - 1, most), min_size=size, max_size=size))
    packed = ENCODERS[encoding](values)
    assert read(packed + b"I", *[encoding] * size) == (values, 0)
    for cut in range(len(packed)):
        assert read(packed[:cut], *[encoding] * size) == (None, 0)


def test_numbers_without_sign_of_14_bits_and_none_at_all():
    packed = unsigned(2**32 - 1) + unsigned(40) + unsigned(-5 & 0x3FFF)
    found = read(packed, UNSIGNED_VB, NEG_14BIT, NEG_14BIT, compiled.BLACKBOX_NOTHING)
    assert found == ([2**32 - 1, -40, 5, 0], 0)


def test_a_number_of_more_than_five_bytes_is_none():
    assert read(b"\xff" * 6, UNSIGNED_VB) == (None, 7)
    assert read(b"\x01" + b"\xff" * 6, UNSIGNED_VB, SIGNED_VB) == (None, 8)


def test_groups_of_eight_end_with_the_fields_of_their_encoding():
    """Nine fields in a row are a group of eight and one by itself, which has no byte before it."""
    values = [3, 0, -2, 0, 0, 1, 0, 7, -6]
    packed = eight(values[:8]) + signed(values[8])
    assert read(packed, *[TAG8_8SVB] * 9) == (values, 0)
    two = eight([5, 0]) + signed(9)
    assert read(two, TAG8_8SVB, TAG8_8SVB, SIGNED_VB) == ([5, 0, 9], 0)
