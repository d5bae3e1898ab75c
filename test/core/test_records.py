# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import Annotated

import numpy as np
import pytest

from quadpi_core.frames import Array
from quadpi_core.records import Records, Vector3, columns_of, record_dtype


class Sample:
    time_ns: int
    rates: Vector3


class Estimate(Sample):
    weight: float
    covariance: Annotated[Array, 2, 2]


class Memory:
    newest: Estimate
    held: Annotated[Records, Sample, 4]


def test_fields_have_the_types_and_shapes_of_their_annotations():
    dtype = record_dtype(Memory)
    estimate = dtype["newest"]
    assert estimate.names == ("time_ns", "rates", "weight", "covariance")
    assert estimate["time_ns"] == np.int64
    assert estimate["rates"].shape == (3,)
    assert estimate["weight"] == np.float64
    assert estimate["covariance"].shape == (2, 2)
    assert dtype["held"].shape == (4,)
    assert dtype["held"].base == record_dtype(Sample)


def test_a_type_without_a_fixed_size_is_refused():
    class Named:
        name: str

    with pytest.raises(TypeError, match="str declares no fields"):
        record_dtype(Named)


def test_columns_are_the_fields_in_turn():
    class State:
        place: Vector3
        delay: float
        turn: Annotated[Array, 2, 2]

    assert columns_of(State) == (slice(0, 3), slice(3, 4), slice(4, 8))
    numbers = np.arange(8.0)
    record = numbers.view(record_dtype(State))[0]
    for field, column in zip(("place", "delay", "turn"), columns_of(State), strict=True):
        np.testing.assert_array_equal(np.ravel(record[field]), numbers[column])
    with pytest.raises(TypeError, match="Sample: not all fields are float64"):
        columns_of(Sample)
