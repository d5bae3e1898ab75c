# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The monitor with named arrays: the bits of the internal one, in blocks of any length; what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sklearn.linear_model import Ridge

import quadpi_core as qp
from quadpi_core.errors import ArgumentError
from quadpi_core.flight import AXES
from quadpi_core.models.interval_rules import WindDrag
from quadpi_core.monitor.monitor import Monitor as BlockMonitor
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.wind_state import WindState
from quadpi_core.results import CAUSES, EXTRAPOLATION

NAMES = ("velocity", "attitude", "rates", "specific_force", "rotor_speeds", "wind")
SAMPLES = 3000
DRAG = WindDrag(
    per_mass_x_1_s=0.3, per_mass_y_1_s=0.3, noise_x_m_s2=0.1, noise_y_m_s2=0.1, wind_m_s=6.0, known_m_s=0.5
)


def samples(flights, count=SAMPLES, **change):
    """Stamps and named arrays of the first samples of a flight."""
    flight = flights.prepared[0].flight
    arrays = {name: getattr(flight, name)[:count].copy() for name in NAMES}
    return flight.stamps_ns[:count], arrays | change


def test_rows_are_those_of_the_internal_monitor(quick, unseen):
    stamps, arrays = samples(unseen)
    rows = qp.Monitor(quick, rate_hz=500.0).step(stamps, **arrays)
    block = np.hstack([arrays[name] for name in NAMES])
    said, _, _ = BlockMonitor(quick.model_, unseen.vehicle, 500.0).step(stamps, block)
    assert [row.time_ns for row in rows] == said.time_ns.tolist()
    held = np.isin(AXES, quick.axes_)
    for name in ("predicted", "lower", "upper"):
        own = np.array([getattr(row, name) for row in rows])
        assert np.array_equal(own[:, held], getattr(said, name)[:, held])
        assert np.isnan(own[:, ~held]).all()
    assert np.array_equal([row.measured for row in rows], said.measured)
    outside = (said.measured < said.lower) | (said.measured > said.upper)
    for row, missed in zip(rows, outside, strict=True):
        assert row.outside == tuple(axis for axis in ("Fx", "Fz") if missed[AXES.index(axis)])
    assert {row.alarm for row in rows} == {"ok"}
    assert not any(row.cause for row in rows)


def test_a_wind_that_is_not_given_is_told_by_the_drag_of_the_model(quick, unseen):
    model = replace(quick.model_, wind=DRAG)
    stamps, arrays = samples(unseen)
    windless = np.zeros((SAMPLES, 3))
    given = PairedSamples.join(stamps, **arrays | {"wind": windless})
    state = WindState(DRAG, model.alarm_limits.hover_rotor_speed)
    blown, deviation = state.take(given)
    conditions = state.conditions(blown.attitude, deviation, None)
    del arrays["wind"]
    monitor = qp.Monitor(model, rate_hz=500.0)
    for more, expected in (
        ({}, (*blown, conditions)),
        ({"wind": windless}, given),
        ({}, (*blown, conditions)),
    ):
        said, _, _ = BlockMonitor(model, unseen.vehicle, 500.0).step(*expected)
        rows = monitor.step(stamps, **arrays, **more)
        for name in ("predicted", "lower"):
            own = np.array([getattr(row, name) for row in rows])[:, np.isin(AXES, quick.axes_)]
            np.testing.assert_array_equal(own, getattr(said, name)[:, np.isin(AXES, quick.axes_)])
        monitor.reset()


def test_one_by_one_as_in_a_block_while_the_rate_is_measured(quick, unseen):
    stamps, arrays = samples(unseen)
    block = qp.Monitor(quick).step(stamps, **arrays)
    monitor, single = qp.Monitor(quick), []
    for k in range(SAMPLES):
        single += monitor.step(int(stamps[k]), **{name: own[k] for name, own in arrays.items()})
    # The first second tells the rate.
    assert block[0].time_ns == stamps[500]
    assert len(block) == len(single) == SAMPLES - 500
    for one, other in zip(block, single, strict=True):
        assert np.array_equal(one.predicted, other.predicted, equal_nan=True)
        assert (one.time_ns, one.outside, one.alarm, one.cause) == (
            other.time_ns,
            other.outside,
            other.alarm,
            other.cause,
        )
    monitor.reset()
    again = monitor.step(stamps, **arrays)
    expected = [row.predicted for row in block]
    assert np.array_equal([row.predicted for row in again], expected, equal_nan=True)


def test_it_says_why_it_warns(quick, unseen):
    """At thrice the speed of training; the alarm of a row is that of the internal monitor at its stamp."""
    stamps, arrays = samples(unseen)
    arrays["velocity"][1000:] += 20.0
    monitor = qp.Monitor(quick, rate_hz=500.0)
    rows = monitor.step(stamps, **arrays)
    alarmed = [row for row in rows if row.alarm == "alarm"]
    assert alarmed
    assert alarmed[0].time_ns > stamps[1000]
    assert "x the training range" in alarmed[-1].cause
    assert monitor.events[0].cause == EXTRAPOLATION == CAUSES[0]
    assert repr(monitor).endswith(": alarm>")
    assert "alarm: " in repr(alarmed[-1])
    block = np.hstack([arrays[name] for name in NAMES])
    said, alarms, _ = BlockMonitor(quick.model_, unseen.vehicle, 500.0).step(stamps, block)
    place = np.searchsorted(alarms.time_ns, said.time_ns, side="right") - 1
    levels = np.where(place < 0, 0, alarms.level[np.maximum(place, 0)])
    assert [row.alarm for row in rows] == [("ok", "warning", "alarm")[level] for level in levels]


def test_samples_that_cannot_be_used_give_no_row(quick, unseen):
    stamps, arrays = samples(unseen, 1000)
    arrays["rates"][700] = np.nan
    rows = qp.Monitor(quick, rate_hz=500.0).step(stamps, **arrays)
    assert stamps[700] not in [row.time_ns for row in rows]
    assert len(rows) == 999


def test_wind_may_be_left_out(quick, unseen):
    stamps, arrays = samples(unseen, 800)
    still = qp.Monitor(quick, rate_hz=500.0).step(stamps, **arrays | {"wind": np.zeros((800, 3))})
    del arrays["wind"]
    rows = qp.Monitor(quick, rate_hz=500.0).step(stamps, **arrays)
    expected = [row.predicted for row in still]
    assert np.array_equal([row.predicted for row in rows], expected, equal_nan=True)


def test_the_old_call_warns_and_gives_what_it_gave(quick, unseen):
    stamps, arrays = samples(unseen)
    block = np.hstack([arrays[name] for name in NAMES])
    with pytest.warns(DeprecationWarning, match="name the quantities, step"):
        said, alarms, events = qp.Monitor(quick.model_, unseen.vehicle, 500.0).step(stamps, block)
    expected, of_alarm, _ = BlockMonitor(quick.model_, unseen.vehicle, 500.0).step(stamps, block)
    assert np.array_equal(said.upper, expected.upper)
    assert np.array_equal(alarms.level, of_alarm.level)
    assert events == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rates": None}, "rates: expected numbers, found None; only wind may be left out"),
        ({"rotor_speeds": np.zeros((9, 3))}, r"rotor_speeds: expected shape \(9, 4\) for time_ns"),
        ({"attitude": np.zeros(4)}, r"attitude: expected shape \(9, 4\) for time_ns"),
        ({"velocity": [[0.0], [0.0, 1.0]]}, "velocity: expected numbers, found list"),
        ({"velocity": "fast"}, "velocity: expected numbers, found"),
    ],
)
def test_bad_arrays_are_refused_by_name(quick, unseen, change, message):
    stamps, arrays = samples(unseen, 9)
    with pytest.raises(qp.QuadpiError, match=message):
        qp.Monitor(quick).step(stamps, **arrays | change)


def test_stamps_that_are_no_nanoseconds_are_refused(quick, unseen):
    _, arrays = samples(unseen, 1)
    with pytest.raises(qp.QuadpiError, match="time_ns: expected whole nanoseconds"):
        qp.Monitor(quick).step(0.5, **arrays)


def test_what_is_no_model_is_refused(training):
    with pytest.raises(qp.QuadpiError, match=r"not fitted: call fit\(flights\) first"):
        qp.Monitor(qp.WrenchModel())
    with pytest.raises(qp.QuadpiError, match="expected a kind of model, found str 'my-model'; load_model"):
        qp.Monitor("my-model")
    own = qp.WrenchModel(Ridge(), axes=["Fx"]).fit(training[:2])
    with pytest.raises(qp.QuadpiError, match="a regressor of your own judges flights offline"):
        qp.Monitor(own)


def test_what_may_be_known_beside_the_samples(quick, unseen):
    stamps, arrays = samples(unseen, 700)
    plain = qp.Monitor(quick, rate_hz=500.0).step(stamps, **arrays)
    unsure = np.diag(np.r_[np.full(3, 0.25), np.full(3, 0.01), np.full(3, 0.01)])
    monitor = qp.Monitor(quick, rate_hz=500.0)
    known = monitor.step(
        stamps,
        **arrays,
        air_density=1.0,
        state_covariance=unsure,
    )
    held = np.isin(AXES, quick.axes_)
    assert len(known) == len(plain)
    for row, own in zip(known, plain, strict=True):
        # Its flights did not tell their air: it stays in that one.
        assert np.array_equal(row.predicted[held], own.predicted[held])
        assert np.all((row.upper - row.lower)[held] > (own.upper - own.lower)[held])
    for name, wrong in (("air_density", 101325.0), ("state_covariance", np.eye(3))):
        with pytest.raises(ArgumentError, match=name):
            monitor.step(stamps, **arrays, **{name: wrong})
