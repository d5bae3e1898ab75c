# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.monitor.pairing import PairedSamples, Pairing

MS = 1_000_000
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def add_imu(pairing: Pairing, time_ns: int) -> None:
    pairing.add_imu(time_ns, np.array([0.0, 0.0, -9.8]))


def add_state(pairing: Pairing, time_ns: int) -> None:
    pairing.add_state(time_ns, np.full(3, time_ns / 1e9), LEVEL, np.zeros(3))


def add_rotors(pairing: Pairing, time_ns: int) -> None:
    pairing.add_rotor_speeds(time_ns, np.full(4, float(time_ns)))


def taken(pairing: Pairing) -> list[int]:
    samples = pairing.take()
    return [] if samples is None else samples.time_ns.tolist()


def test_a_sample_waits_for_a_rotor_speed_at_or_after_its_stamp() -> None:
    pairing = Pairing()
    add_rotors(pairing, 1 * MS)
    add_state(pairing, 2 * MS)
    add_imu(pairing, 2 * MS)
    assert pairing.take() is None
    add_rotors(pairing, 5 * MS)
    samples = pairing.take()
    assert samples is not None
    assert samples.time_ns.tolist() == [2 * MS]
    np.testing.assert_allclose(samples.rotor_speeds, np.full((1, 4), 2.0 * MS))
    assert pairing.take() is None


def test_a_sample_waits_for_its_state() -> None:
    pairing = Pairing()
    add_state(pairing, 1 * MS)
    add_rotors(pairing, 1 * MS)
    add_rotors(pairing, 3 * MS)
    add_imu(pairing, 2 * MS)
    assert pairing.take() is None
    add_state(pairing, 2 * MS)
    assert taken(pairing) == [2 * MS]


def test_an_estimate_is_an_imu_sample_and_a_state() -> None:
    apart, together = Pairing(), Pairing()
    force, velocity, rates = np.arange(3.0), np.arange(3.0, 6.0), np.arange(6.0, 9.0)
    for pairing in (apart, together):
        add_rotors(pairing, 1 * MS)
    apart.add_imu(1 * MS, force)
    apart.add_state(1 * MS, velocity, LEVEL, rates)
    together.add_estimate(1 * MS, np.concatenate((LEVEL, velocity, rates, force)))
    one, other = apart.take(), together.take()
    assert one
    assert other
    assert one.time_ns.tolist() == other.time_ns.tolist() == [1 * MS]
    np.testing.assert_array_equal(one.values, other.values)


def test_whole_flight_equals_np_interp() -> None:
    rng = np.random.default_rng(1)
    imu_ns = np.arange(0, 400, 2) * MS
    rotor_ns = np.cumsum(rng.integers(1, 4, 250)) * MS - 3 * MS
    speeds = rng.uniform(100, 900, (len(rotor_ns), 4))
    events = [(t, 0, i) for i, t in enumerate(imu_ns)] + [(t, 1, i) for i, t in enumerate(rotor_ns)]
    pairing = Pairing()
    blocks: list[PairedSamples] = []
    for time_ns, kind, index in sorted(events):
        if kind == 0:
            add_state(pairing, int(time_ns))
            add_imu(pairing, int(time_ns))
        else:
            pairing.add_rotor_speeds(int(time_ns), speeds[index])
        block = pairing.take()
        if block is not None:
            blocks.append(block)
    paired_ns = np.concatenate([block.time_ns for block in blocks])
    inside = (imu_ns >= rotor_ns[0]) & (imu_ns <= rotor_ns[-1])
    np.testing.assert_array_equal(paired_ns, imu_ns[inside])
    expected = np.stack([np.interp(paired_ns, rotor_ns, column) for column in speeds.T], axis=1)
    np.testing.assert_allclose(np.concatenate([b.rotor_speeds for b in blocks]), expected, rtol=1e-12)
    assert pairing.counts.paired == inside.sum()
    assert pairing.counts.dropped == 0


def test_silent_rotors_give_samples_up_as_unknown_and_recover() -> None:
    pairing = Pairing(timeout_s=0.02)
    add_rotors(pairing, 0)
    add_state(pairing, 0)
    given_up = []
    for k in range(1, 51):
        add_state(pairing, 2 * k * MS)
        add_imu(pairing, 2 * k * MS)
        samples = pairing.take()
        if samples is not None:
            assert np.isnan(samples.rotor_speeds).all()
            assert np.isfinite(samples.specific_force).all()
            given_up += samples.time_ns.tolist()
    assert given_up == list(range(2 * MS, 80 * MS, 2 * MS))
    assert pairing.counts.dropped == len(given_up)
    add_rotors(pairing, 100 * MS)
    assert taken(pairing) == list(range(80 * MS, 101 * MS, 2 * MS))
    assert pairing.counts.paired == 11


def test_samples_before_the_first_state_are_early_not_dropped() -> None:
    pairing = Pairing()
    for k in range(10):
        add_imu(pairing, k * MS)
        add_rotors(pairing, k * MS)
    add_state(pairing, 9 * MS)
    assert taken(pairing) == [9 * MS]
    assert (pairing.counts.early, pairing.counts.dropped) == (9, 0)


@pytest.mark.parametrize(("timeout_s", "left"), [(0.1, 101), (10.0, 255)])
def test_a_sample_waits_for_a_tenth_of_a_second_and_256_samples_at_most(timeout_s: float, left: int) -> None:
    """What is left to be completed, of 300 samples a millisecond apart."""
    pairing = Pairing() if timeout_s == 0.1 else Pairing(timeout_s)
    add_state(pairing, 0)
    add_rotors(pairing, 0)
    for k in range(1, 301):
        add_state(pairing, k * MS)
        add_imu(pairing, k * MS)
        pairing.take()
    add_rotors(pairing, 300 * MS)
    assert len(taken(pairing)) == left


def test_a_bag_that_starts_over_is_followed() -> None:
    pairing = Pairing()
    for start_ns in (100_000 * MS, 0):
        for k in range(5):
            add_state(pairing, start_ns + k * MS)
            add_rotors(pairing, start_ns + k * MS)
            add_imu(pairing, start_ns + k * MS)
        assert taken(pairing) == [start_ns + k * MS for k in range(5)]
    assert pairing.counts.disordered == 0


@pytest.mark.parametrize("late_ns", [5 * MS, 4 * MS])
def test_a_stamp_that_does_not_advance_is_refused_and_counted(late_ns: int) -> None:
    pairing = Pairing()
    add_state(pairing, 5 * MS)
    add_rotors(pairing, 5 * MS)
    add_imu(pairing, 5 * MS)
    add_imu(pairing, late_ns)
    assert taken(pairing) == [5 * MS]
    assert pairing.counts.disordered == 1
    assert pairing.take() is None


def test_wind_holds_its_last_value_and_is_calm_before() -> None:
    pairing = Pairing()
    pairing.add_wind(2 * MS, np.array([3.0, 0.0, 0.0]))
    for k in range(1, 4):
        add_state(pairing, k * MS)
        add_rotors(pairing, k * MS)
        add_imu(pairing, k * MS)
    samples = pairing.take()
    assert samples is not None
    np.testing.assert_array_equal(samples.wind[:, 0], [0.0, 3.0, 3.0])


@pytest.mark.parametrize("rotors", [True, False], ids=["rotor speeds", "state"])
def test_nothing_is_interpolated_across_a_gap(rotors: bool) -> None:
    """The sample is given up as soon as the gap is known, and only what lies in the gap is unknown."""
    pairing = Pairing()
    gappy, whole = (add_rotors, add_state) if rotors else (add_state, add_rotors)
    for time_ns in range(0, 300, 2):
        whole(pairing, time_ns * MS)
    gappy(pairing, 0)
    gappy(pairing, 150 * MS)
    add_imu(pairing, 148 * MS)
    samples = pairing.take()
    assert samples is not None
    assert np.isnan(samples.rotor_speeds).all() == rotors
    assert np.isnan(samples.velocity).all() == (not rotors)
    assert (pairing.counts.paired, pairing.counts.dropped) == (0, 1)


def test_states_from_before_a_jump_back_are_forgotten() -> None:
    pairing = Pairing()
    for time_ns in (3000, 4000):
        add_state(pairing, time_ns * MS)
        add_rotors(pairing, time_ns * MS)
        add_imu(pairing, time_ns * MS)
    pairing.take()
    add_imu(pairing, 2500 * MS)
    for time_ns in (2500, 3502):
        add_rotors(pairing, time_ns * MS)
    add_state(pairing, 3500 * MS)
    add_imu(pairing, 3500 * MS)
    assert taken(pairing) == [3500 * MS]
