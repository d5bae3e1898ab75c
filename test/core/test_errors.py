# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Errors that a user sees: one printable line of bounded length, which names what was given."""

import pickle

import pytest

from quadpi_core.errors import LogError, QuadpiError, SampleError, VehicleError, named_in, require_library


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("flight.mcap: topic imu: it has gaps", "flight.mcap: topic imu: it has gaps"),
        ("two\nlines\r\nor three", "two lines or three"),
        ("a bell \x07 and a byte \udc80", r"a bell \x07 and a byte \udc80"),
        ("größer als 3 m/s²", "größer als 3 m/s²"),
    ],
)
def test_a_message_is_one_printable_line(message, shown):
    assert str(QuadpiError(message)) == shown


def test_a_long_message_keeps_both_ends():
    """A damaged file may hold a name of megabytes."""
    assert str(QuadpiError("x" * 1600)) == "x" * 1600
    long = str(QuadpiError("flight.bag: " + "x" * 10**6 + ": no such topic"))
    assert long.startswith("flight.bag: xxx")
    assert long.endswith("xxx: no such topic")
    assert len(long) == 1603


def test_a_sample_counts_from_the_first_of_all_also_in_another_process():
    error = SampleError(3, "the stamp repeats").after(100)
    assert (error.sample, str(error)) == (103, "sample 103: the stamp repeats")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), again.sample, again.reason) == (SampleError, 103, "the stamp repeats")
    assert isinstance(again, LogError)


def test_where_an_error_was_referred_to_is_put_before_it():
    with (
        pytest.raises(VehicleError, match=r"^mine\.yaml: vehicle: bebop3\.yaml: no such file$"),
        named_in("mine.yaml: vehicle"),
    ):
        raise VehicleError("bebop3.yaml: no such file")
    with pytest.raises(ValueError, match=r"^not ours$"), named_in("mine.yaml"):
        raise ValueError("not ours")


def test_a_library_that_is_missing_is_named_with_what_brings_it():
    assert require_library("json", "logs").loads("1") == 1
    with pytest.raises(
        LogError, match=r"^this needs nowhere, which the extra `logs` brings: pip install .*\[logs\]"
    ):
        require_library("nowhere.at.all", "logs")
