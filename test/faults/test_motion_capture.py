# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Motion capture that fails, from the third second of a flight on; see README.md."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.estimator.filter_state import EstimatorStatus, Outcome
from quadpi_core.results import BAD_DATA
from test.faults.onboard import deviation

AT_S = 3.0
DEGRADED, LOST, OK = EstimatorStatus.DEGRADED, EstimatorStatus.LOST, EstimatorStatus.OK
CLEARED_S = 0.62


@pytest.mark.parametrize("for_s", [0.2, 1.0, 1.9])
def test_drop_out_that_the_estimator_bridges(failing, calm, for_s):
    flown = failing("dropout", "mocap/pose", AT_S, for_s)
    assert flown.states(AT_S, AT_S + for_s) == ({OK} if for_s < 0.25 else {OK, DEGRADED})
    assert flown.states(AT_S + for_s + 0.05, 8.0) == {OK}
    assert not flown.alarms.level.any()
    np.testing.assert_array_equal(flown.odometry_ns, calm.odometry_ns)
    assert deviation(flown, calm, 0.0) < 1.0
    assert deviation(flown, calm, AT_S + for_s + 0.3) < 0.1


def test_drop_out_that_loses_the_state(failing, calm):
    flown = failing("dropout", "mocap/pose", AT_S, 3.0)
    assert flown.states(AT_S + 2.02, AT_S + 3.0) == {LOST}
    assert_lost_and_found(flown, calm)


def assert_lost_and_found(flown, calm):
    """A lost estimator says nothing, which is bad data; the first poses that come bring both back."""
    assert any("missing" in text for text in flown.words(BAD_DATA))
    assert flown.raised(BAD_DATA) == [pytest.approx(AT_S + 2.05, abs=0.2)]
    assert flown.not_ok(BAD_DATA)[1] < AT_S + 3.0 + CLEARED_S
    assert flown.states(AT_S + 3.05, 8.0) == {OK}
    lost = calm.seconds(np.setdiff1d(calm.predictions.time_ns, flown.predictions.time_ns))
    assert AT_S + 1.99 < lost.min() <= lost.max() < AT_S + 3.05
    assert deviation(flown, calm, AT_S + 3.3) < 0.1


@pytest.mark.parametrize("for_s", [1.0, 3.0])
def test_frozen(failing, calm, for_s):
    """Its stamps go on, its poses do not: the vehicle moves, so they cannot be new."""
    flown = failing("frozen", "mocap/pose", AT_S, for_s)
    assert flown.poses[Outcome.FROZEN] == pytest.approx(120 * for_s, abs=2)
    assert DEGRADED in flown.states(AT_S, AT_S + for_s)
    if for_s > 2.0:
        assert_lost_and_found(flown, calm)
    else:
        assert not flown.alarms.level.any()
        np.testing.assert_array_equal(flown.predictions.time_ns, calm.predictions.time_ns)
        assert deviation(flown, calm, AT_S + for_s + 0.3) < 0.1


@pytest.mark.parametrize("metres", [0.3, 2.0, -1000.0])
def test_jump_for_a_moment(failing, calm, metres):
    flown = failing("jump", "mocap/pose", AT_S, 0.2, size_m=metres)
    assert flown.poses[Outcome.REJECTED] == 24
    assert flown.states(AT_S + 0.05, AT_S + 0.2) == {DEGRADED}
    assert flown.states(AT_S + 0.25, 8.0) == {OK}
    assert not flown.alarms.level.any()
    assert deviation(flown, calm, 0.0) < 0.1


@pytest.mark.parametrize(("metres", "at_s"), [(0.3, AT_S), (2.0, AT_S), (0.3, 4.3), (2.0, 5.6)])
def test_jump_for_good(failing, calm, metres, at_s):
    """The world of motion capture was set anew: poses that persist and agree are believed."""
    flown = failing("jump", "mocap/pose", at_s, 9.0, size_m=metres)
    assert flown.poses[Outcome.REJECTED] == pytest.approx(49, abs=3)
    assert not flown.alarms.level.any()
    # For a moment, when they are believed, it is open which of position, velocity and attitude was wrong. The
    # estimator is degraded until its covariance says that this is known.
    settled_s = flown.seconds(flown.arrived_ns[max(k for k, s in enumerate(flown.status) if s != OK)])
    assert flown.states(at_s + 0.05, settled_s) == {DEGRADED}
    assert at_s + 0.5 < settled_s < at_s + 0.7
    assert 0.5 < deviation(flown, calm, 0.0) < 4.0
    assert deviation(flown, calm, settled_s) < 0.5
    assert deviation(flown, calm, at_s + 1.5) < 0.1


def test_delay_step(altered, calm):
    """Everything comes 60 ms later, and is stamped so."""

    def alter(sent, seconds):
        later = np.where(seconds >= AT_S, 60_000_000, 0)
        stream = replace(sent.stream, time_ns=sent.stream.time_ns + later)
        return replace(sent, stream=stream, arrival_ns=sent.arrival_ns + later)

    flown = altered("mocap/pose", alter)
    assert flown.poses[Outcome.REJECTED] == pytest.approx(49, abs=5)
    assert DEGRADED in flown.states(AT_S, AT_S + 0.5)
    assert flown.states(AT_S + 0.7, 8.0) == {OK}
    assert not flown.alarms.level.any()
    np.testing.assert_array_equal(flown.predictions.time_ns, calm.predictions.time_ns)
    assert deviation(flown, calm, AT_S + 1.5) < 0.2


def test_late_arrival(altered, calm):
    """The network is slow from now on; the stamps are right."""

    def alter(sent, seconds):
        return replace(sent, arrival_ns=sent.arrival_ns + np.where(seconds >= AT_S, 200_000_000, 0))

    flown = altered("mocap/pose", alter)
    assert flown.states(1.5, 8.0) <= {OK, DEGRADED}
    assert flown.states(AT_S + 0.5, 8.0) == {OK}
    assert not flown.alarms.level.any()
    assert flown.poses[Outcome.TOO_LATE] == 0
    assert deviation(flown, calm, 0.0) < 0.5
