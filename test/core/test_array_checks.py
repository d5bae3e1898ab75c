# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What callers hand in: taken in any form that says the same, refused in one line otherwise."""

from pathlib import Path

import numpy as np
import pytest

from quadpi_core import array_checks
from quadpi_core.errors import ArgumentError
from quadpi_core.inputs import DERIVATIVES

ROWS = np.arange(12.0).reshape(4, 3)


def read_only(array):
    array = array.copy()
    array.flags.writeable = False
    return array


def unaligned(array):
    memory = np.zeros(array.nbytes + 1, np.uint8)
    shifted = memory[1:].view(array.dtype).reshape(array.shape)
    shifted[:] = array
    return shifted


class Frame:
    """As a data frame or a tensor: an array by asking, and neither true nor false."""

    def __array__(self, dtype=None, copy=None):
        return ROWS.astype(dtype or float, copy=True)

    def __bool__(self):
        raise ValueError("ambiguous")


@pytest.mark.parametrize(
    "same",
    [
        ROWS,
        Frame(),
        ROWS.tolist(),
        ROWS.astype(">f8"),
        ROWS.astype(np.float32),
        ROWS.astype(np.int16),
        np.asfortranarray(ROWS),
        np.repeat(ROWS, 2, axis=0)[::2],
        ROWS[::-1].copy()[::-1],
        read_only(ROWS),
        unaligned(ROWS),
        np.ma.masked_array(ROWS),
    ],
)
def test_the_same_numbers_in_any_form(same):
    taken = array_checks.floats("rows", same, 3, rows=4, of="time")
    np.testing.assert_array_equal(taken, ROWS)
    assert type(taken) is np.ndarray
    assert taken.dtype == np.dtype("=f8")
    assert taken.flags.carray


def test_an_array_that_is_right_is_not_copied():
    assert array_checks.floats("rows", ROWS, 3) is ROWS


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (ROWS[:3], r"rows: expected shape \(4, 3\) for time \(4,\), found \(3, 3\)"),
        (ROWS[:, :2], r"expected shape \(4, 3\)"),
        (ROWS.ravel(), "expected shape"),
        (5.0, r"expected shape .* found \(\)"),
        (np.where(ROWS == 7.0, np.nan, ROWS), "finite numbers, found others first in row 2"),
        (np.ma.masked_equal(ROWS, 7.0), "finite numbers, found others first in row 2"),
        (ROWS > 0.0, "expected numbers, found an array .* of bool"),
        (ROWS.astype(str), "expected numbers"),
        (ROWS + 0j, "expected numbers"),
        ([[1.0, 2.0], [3.0]], "expected numbers, found list"),
        (None, "expected numbers, found None"),
        ("a.mcap", "expected numbers"),
    ],
)
def test_other_numbers_are_refused(wrong, message):
    with pytest.raises(ArgumentError, match=message):
        array_checks.floats("rows", wrong, 3, rows=4, of="time")


@pytest.mark.parametrize(
    "values",
    [ROWS[:3], ROWS[:, :2], ROWS.astype(">f8"), np.asfortranarray(ROWS), read_only(ROWS), ROWS.tolist()],
)
def test_samples_that_need_a_check_or_a_copy_are_told_from_those_of_a_node(values):
    stamps = np.arange(4)
    assert array_checks.are_samples(stamps, ROWS, 3)
    assert not array_checks.are_samples(stamps, values, 3)
    assert not array_checks.are_samples(np.arange(4.0), ROWS, 3)


@pytest.mark.parametrize("same", [[3, 7], np.array([3, 7], ">i8"), np.array([3, 7], np.uint64)])
def test_stamps_are_whole_nanoseconds(same):
    taken = array_checks.stamps("time_ns", same)
    np.testing.assert_array_equal(taken, [3, 7])
    assert taken.dtype == np.int64


@pytest.mark.parametrize(
    "wrong",
    [
        np.array([3.0, 7.0]),
        np.array([2**63], np.uint64),
        np.array(["2026-01-01"], "datetime64[ns]"),
        [[3]],
        [True],
        None,
    ],
)
def test_other_stamps_are_refused(wrong):
    with pytest.raises(ArgumentError, match="time_ns: expected"):
        array_checks.stamps("time_ns", wrong)


def test_records_go_by_the_names_of_their_fields():
    given = np.zeros(4, DERIVATIVES)
    given["rotor_jerks"] = 5.0
    other = np.zeros(4, [(name, ">f4", DERIVATIVES[name].shape) for name in DERIVATIVES.names])
    other["rotor_jerks"] = 5.0
    for same in (given, other, np.repeat(given, 2)[::2], read_only(given)):
        np.testing.assert_array_equal(array_checks.records("moving", same, DERIVATIVES, rows=4), given)
    shuffled = other[list(DERIVATIVES.names)[::-1]]
    for wrong in (given[:3], shuffled, np.zeros((4, 11)), None, given.reshape(2, 2)):
        with pytest.raises(ArgumentError, match="moving: expected"):
            array_checks.records("moving", wrong, DERIVATIVES, rows=4)
    given["rotor_jerks"][2, 1] = np.inf
    with pytest.raises(ArgumentError, match="row 2"):
        array_checks.records("moving", given, DERIVATIVES)


def test_single_values():
    assert array_checks.number("rate_hz", np.float32(5.0), above=0.0) == 5.0
    assert array_checks.whole("seed", np.int8(5), 0, 9) == 5
    for wrong in (0.0, np.nan, np.inf, True, "5", None, [5.0]):
        with pytest.raises(ArgumentError, match="rate_hz: expected a positive number"):
            array_checks.number("rate_hz", wrong, above=0.0)
        with pytest.raises(ArgumentError, match="seed: expected a whole number from 1 to 9"):
            array_checks.whole("seed", wrong, 1, 9)


def test_one_alone_is_a_list_of_one():
    assert array_checks.paths("paths", "a.mcap") == [Path("a.mcap")]
    assert array_checks.paths("paths", Path("a.mcap")) == [Path("a.mcap")]
    assert array_checks.paths("paths", (name for name in ("a", "b"))) == [Path("a"), Path("b")]
    assert array_checks.several("names", "drag", str) == ["drag"]
    for wrong in (None, 5, b"a.mcap", ["a.mcap", None], {"a": "b"}, ["a\0"], ""):
        with pytest.raises(ArgumentError, match="paths"):
            array_checks.paths("paths", wrong)
    with pytest.raises(ArgumentError, match="flights, entry 2: expected int, found str 'b'; ask"):
        array_checks.several("flights", [1, "b"], int, "ask")
