# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Silence by a steady clock, and the alarm that says it without a sample."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.messages.result_messages import pack_alarms, unpack_alarms
from quadpi_core.monitor import Monitor
from quadpi_core.monitor.pairing import Pairing
from quadpi_core.monitor.reasons import reasons_by_row
from quadpi_core.monitor.silence import Arrived, Silence
from quadpi_core.results import BAD_DATA, LEVEL_ALARM, UNAVAILABLE

from .conftest import RATE_HZ

MS = 1_000_000


class Watched:
    """A pairing, a clock and what is said of them every tenth of a second."""

    def __init__(self) -> None:
        self.pairing, self.silence = Pairing(), Silence()
        self.now_s, self.stamp_ns = 100.0, 1_700_000_000_000_000_000
        self.silence.follow(self.now_s, self.pairing.arrived)

    def wait(self, seconds: float, *topics: str) -> tuple[str, ...]:
        """Go on with those topics; what is said at the end."""
        for _ in range(round(10.0 * seconds)):
            for _ in range(20):
                self.stamp_ns += 5 * MS
                if "imu" in topics:
                    self.pairing.add_imu(self.stamp_ns, np.zeros(3))
                if "state" in topics:
                    level = np.array([1.0, 0.0, 0.0, 0.0])
                    self.pairing.add_state(self.stamp_ns, np.zeros(3), level, np.zeros(3))
                if "rotors" in topics:
                    self.pairing.add_rotor_speeds(self.stamp_ns, np.ones(4))
                self.pairing.take()
            self.now_s += 0.1
            self.silence.follow(self.now_s, self.pairing.arrived)
        return self.silence.reasons


ALL = ("imu", "state", "rotors")


def test_what_never_came_and_what_stopped_is_told_apart() -> None:
    watched = Watched()
    assert watched.wait(0.2) == ()
    assert watched.wait(0.2) == ("no imu yet", "no rotor speeds yet")
    assert watched.wait(0.4, "imu", "rotors") == ("no state yet",)
    assert watched.wait(0.4, *ALL) == ("no sample is complete yet",)
    assert watched.wait(1.5, *ALL) == ()
    assert watched.wait(0.2) == ()
    assert watched.wait(0.2) == ("no imu for 0.4 s", "no rotor speeds for 0.4 s")
    assert watched.silence.elapsed_s == pytest.approx(0.4)
    assert watched.wait(0.1, *ALL) == ()


def test_what_is_missing_while_the_imu_goes_on_is_said_by_the_samples() -> None:
    """They are given up and judged: that is no silence."""
    watched = Watched()
    watched.wait(1.5, *ALL)
    assert watched.wait(1.0, "imu", "state") == ()
    assert watched.pairing.counts.dropped > 0


def test_stamps_that_stand_still_are_silence() -> None:
    watched = Watched()
    watched.wait(1.5, *ALL)
    last_ns = watched.stamp_ns
    for _ in range(4):
        watched.pairing.add_imu(last_ns, np.zeros(3))
        told = watched.wait(0.1)
    assert told == ("no imu for 0.4 s", "no rotor speeds for 0.4 s")


def test_a_process_that_was_held_up_does_not_blame_the_sensors() -> None:
    silence = Silence()
    silence.follow(0.0, Arrived(1, 1, 1, 1))
    silence.follow(5.0, Arrived(1, 1, 1, 1))
    assert silence.reasons == ()


def test_an_alarm_without_a_sample_says_bad_data_and_changes_nothing(model, vehicle, samples) -> None:
    whole = Monitor(model, vehicle, RATE_HZ)
    expected = whole.step(*samples)[1]
    interrupted, rows = Monitor(model, vehicle, RATE_HZ), []
    for part in (slice(0, 2000), slice(2000, None)):
        rows.append(interrupted.step(*(column[part] for column in samples))[1])
        told = interrupted.unheard(int(samples.time_ns[part][-1]) + 400 * MS)
    np.testing.assert_array_equal(np.concatenate([row.time_ns for row in rows]), expected.time_ns)
    np.testing.assert_array_equal(np.concatenate([row.leverage for row in rows]), expected.leverage)
    assert interrupted.events == whole.events
    reported = unpack_alarms(pack_alarms(told, [("no imu for 0.4 s",)]))
    assert reported.time_ns.tolist() == [int(samples.time_ns[-1]) + 400 * MS]
    assert reported.level.tolist() == [LEVEL_ALARM]
    assert reported.causes.tolist() == [BAD_DATA]
    assert reported.cause_health.tolist() == [[UNAVAILABLE] * 3]
    assert reported.reasons == [("no imu for 0.4 s",)]
    assert not reported.of_samples.any()
    assert unpack_alarms(pack_alarms(expected, reasons_by_row(expected))).of_samples.all()
    assert len(reported.where(reported.of_samples).reasons) == 0
