# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from types import SimpleNamespace

import pytest

from quadpi_core.monitor.alarm_log import change_words
from quadpi_core.results import (
    CHANGED_CENTRE_FORWARD,
    CHANGED_CENTRE_RIGHT,
    CHANGED_FORCE_FORWARD,
    CHANGED_FORCE_RIGHT,
    CHANGED_MASS,
    CHANGED_ROTOR,
    UNCHANGED,
)

NOON_NS = 1_795_783_267 * 10**9  # 2026-11-27 12:41:07 UTC


TAKE_OFF, ROTOR = None, 3
NOON, BEGIN = " since 12:41:07 UTC", " since 0.0 s"
LATER, ALL = " since 41.3 s", " since this flight is judged"
BY_SPEED, OF_ALL = " thrust than its speed says", " thrust of all rotors"


@pytest.mark.parametrize(
    ("kind", "size", "half", "since_ns", "words"),
    [
        (CHANGED_ROTOR, 0.03, 0.004, NOON_NS, "rotor 3 gives 3.00 ± 0.40 % less" + BY_SPEED + NOON),
        (CHANGED_ROTOR, -0.2, 0.02, 0, "rotor 3 gives 20.0 ± 2.0 % more" + BY_SPEED + BEGIN),
        (CHANGED_MASS, 0.012, 0.003, 41_260_000_000, "12.0 ± 3.0 g heavier, or less" + OF_ALL + LATER),
        (CHANGED_MASS, -0.12, 0.03, TAKE_OFF, "120 ± 30 g lighter, or more" + OF_ALL + ALL),
        (CHANGED_FORCE_RIGHT, 0.08, 0.021, 0, "something pushes to the right, 0.080 ± 0.021 N" + BEGIN),
        (CHANGED_FORCE_RIGHT, -0.8, 0.2, 0, "something pushes to the left, 0.80 ± 0.20 N" + BEGIN),
        (CHANGED_FORCE_FORWARD, -1.0, 0.2, 0, "something pushes backward, 1.00 ± 0.20 N" + BEGIN),
        (CHANGED_CENTRE_FORWARD, 0.02, 0.003, 0, "centre of gravity 20.0 ± 3.0 mm farther forward" + BEGIN),
        (CHANGED_CENTRE_RIGHT, -0.002, 0.0, 0, "centre of gravity 2.00 ± 0.00 mm farther left" + BEGIN),
        (UNCHANGED, 0.0, 0.0, TAKE_OFF, ""),
    ],
)  # fmt: skip
def test_words(kind: int, size: float, half: float, since_ns: int | None, words: str) -> None:
    row = SimpleNamespace(
        changed=[kind],
        changed_rotor=[ROTOR],
        change_size=[size],
        change_lower=[size - half],
        change_upper=[size + half],
        change_since_ns=[since_ns or 0],
        change_from_start=[since_ns is TAKE_OFF],
    )
    assert change_words(row, 0) == ([words] if words else [])
