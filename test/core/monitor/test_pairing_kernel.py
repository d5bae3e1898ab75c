# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Arrivals taken in stretches are those taken one by one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from quadpi_core.monitor.pairing import (
    CONTINUES,
    IMU,
    ROTORS,
    SET_BACK,
    STATE,
    STEPS_BACK,
    WIND_TOPIC,
    Arriving,
    PairedSamples,
    Pairing,
)
from test.core.monitor.test_pairing import LEVEL, MS, add_imu, add_rotors, add_state, taken


@pytest.mark.parametrize("state_first", [True, False])
def test_what_is_used_first_does_not_depend_on_which_topic_arrives_first(state_first: bool) -> None:
    """States at 100 Hz complete five IMU samples at once, in the instant at which the rate is known too."""
    imu_ns, state_ns = np.arange(600) * 2 * MS, np.arange(0, 600, 5) * 2 * MS
    after_imu = np.concatenate((np.zeros(600), np.full(120, -0.5 if state_first else 0.5)))
    order = np.argsort(np.concatenate((imu_ns, state_ns)) + after_imu, kind="stable")
    kinds, rows = np.repeat([IMU, STATE], [600, 120])[order], np.r_[:600, :120][order]
    states = np.tile(np.concatenate((np.zeros(3), LEVEL, np.zeros(3))), (120, 1))
    arriving = Arriving(
        kind=np.concatenate(([ROTORS, ROTORS], kinds)),
        row=np.concatenate(([0, 1], rows)),
        imu_ns=imu_ns,
        specific_force=np.zeros((600, 3)),
        state_ns=state_ns,
        states=states,
        rotor_ns=np.array([0, 2000 * MS]),
        rotor_speeds=np.full((2, 4), 300.0),
        wind_ns=np.empty(0, dtype=np.int64),
        wind=np.empty((0, 3)),
    )
    used = [part.samples.time_ns for part in Pairing().take_all(arriving) if not part.rate.begins]
    assert np.concatenate(used)[0] == 1000 * MS

    live = Pairing()
    live_ns: list[int] = []
    for kind, row in zip(kinds.tolist(), rows.tolist(), strict=True):
        if row == kind == 0:
            add_rotors(live, 0)
            add_rotors(live, 2000 * MS)
        if kind == IMU:
            add_imu(live, int(imu_ns[row]))
        else:
            add_state(live, int(state_ns[row]))
        samples = taken(live)
        live_ns += [] if live.rate.begins else samples
    np.testing.assert_array_equal(live_ns, np.concatenate(used))


def flight(imu_ns: np.ndarray) -> Arriving:
    """Samples of all topics about those of the IMU, each a little after its stamp; states are slower."""
    rng = np.random.default_rng(len(imu_ns))
    rotor_ns = imu_ns + rng.integers(-MS, MS, len(imu_ns))
    state_ns, wind_ns = imu_ns[::4] - MS // 2, imu_ns[::50]
    arrival = [
        np.arange(len(imu_ns)) + 0.0,
        np.arange(len(imu_ns))[::4] + rng.uniform(0.0, 3.0, len(state_ns)),
        np.arange(len(imu_ns)) + rng.uniform(0.0, 5.0, len(imu_ns)),
        np.arange(len(imu_ns))[::50] + 0.5,
    ]
    kind = np.repeat((IMU, STATE, ROTORS, WIND_TOPIC), [len(times) for times in arrival])
    order = np.argsort(np.concatenate(arrival), kind="stable")
    attitude = rng.normal(size=(len(state_ns), 4))
    states = np.hstack((rng.normal(size=(len(state_ns), 3)), attitude, rng.normal(size=(len(state_ns), 3))))
    states[:, 3:7] /= np.linalg.norm(attitude, axis=1, keepdims=True)
    return Arriving(
        kind=kind[order],
        row=np.concatenate([np.arange(len(times)) for times in arrival])[order],
        imu_ns=imu_ns,
        specific_force=rng.normal(size=(len(imu_ns), 3)),
        state_ns=state_ns,
        states=states,
        rotor_ns=rotor_ns,
        rotor_speeds=rng.uniform(100.0, 900.0, (len(imu_ns), 4)),
        wind_ns=wind_ns,
        wind=rng.normal(size=(len(wind_ns), 3)),
    )


def one_by_one(pairing: Pairing, arriving: Arriving) -> Iterator[PairedSamples]:
    """What is completed after each arrival."""
    for kind, row in zip(arriving.kind.tolist(), arriving.row.tolist(), strict=True):
        if kind == IMU:
            pairing.add_imu(int(arriving.imu_ns[row]), arriving.specific_force[row])
        elif kind == STATE:
            state = arriving.states[row]
            pairing.add_state(int(arriving.state_ns[row]), state[:3], state[3:7], state[7:])
        elif kind == ROTORS:
            pairing.add_rotor_speeds(int(arriving.rotor_ns[row]), arriving.rotor_speeds[row])
        else:
            pairing.add_wind(int(arriving.wind_ns[row]), arriving.wind[row])
        samples = pairing.take()
        if samples is not None:
            yield samples


def falling(stamps: np.ndarray, back_ns: int) -> np.ndarray:
    """The stamps with one more that lies so far before the newest."""
    return np.append(stamps, stamps[-1] - back_ns)


STEADY = np.arange(1, 1500) * 2 * MS
STEPS = {
    "steady": (STEADY, [CONTINUES]),
    "one early stamp": (np.insert(STEADY, 1400, STEADY[1300]), [CONTINUES]),
    "a clock set back": (np.concatenate((STEADY, STEADY - 2000 * MS)), [CONTINUES, SET_BACK]),
    # Twice by less than a second, and more than that behind the newest.
    "steps back": (falling(falling(STEADY, 700 * MS), 700 * MS), [CONTINUES, STEPS_BACK]),
    "a second behind": (falling(STEADY, 1000 * MS), [CONTINUES]),
    "more than a second behind": (falling(STEADY, 1000 * MS + 1), [CONTINUES, SET_BACK]),
}


@pytest.mark.parametrize("name", STEPS)
def test_stretches_are_what_comes_one_by_one_cut_where_the_clock_steps_back(name: str) -> None:
    imu_ns, begins = STEPS[name]
    arriving, whole, live = flight(imu_ns), Pairing(), Pairing()
    stretches = whole.take_all(arriving)
    # One more begins where the rate is known, after a second.
    assert [part.begin for part in stretches if part.begin != CONTINUES] == begins[1:]
    samples = list(one_by_one(live, arriving))
    for column in ("time_ns", "values"):
        np.testing.assert_array_equal(
            np.concatenate([getattr(part.samples, column) for part in stretches]),
            np.concatenate([getattr(part, column) for part in samples]),
        )
    assert whole.counts == live.counts
    assert whole.counts.paired > 900
    assert whole.rate == live.rate
    assert [part.states.start for part in stretches[1:]] == [part.states.stop for part in stretches[:-1]]
    assert stretches[-1].states.stop == len(arriving.state_ns)


def test_what_is_completed_is_the_line_between_the_samples_around_it() -> None:
    """An attitude of either sign, on the short way; wind holds; the specific force is the IMU's own."""
    arriving, pairing = flight(STEADY), Pairing()
    (samples,) = [PairedSamples(*map(np.concatenate, zip(*one_by_one(pairing, arriving), strict=True)))]
    known = ~np.isnan(samples.values).any(axis=1)
    samples = PairedSamples(samples.time_ns[known], samples.values[known])
    rows = np.searchsorted(arriving.imu_ns, samples.time_ns)
    np.testing.assert_array_equal(samples.specific_force, arriving.specific_force[rows])
    attitude = arriving.states[:, 3:7].copy()
    for k in range(1, len(attitude)):
        attitude[k] *= np.sign(attitude[k - 1] @ attitude[k])
    continuous = np.hstack((arriving.states[:, :3], attitude, arriving.states[:, 7:]))
    lines = [np.interp(samples.time_ns, arriving.state_ns, column) for column in continuous.T]
    np.testing.assert_allclose(samples.velocity, np.transpose(lines[:3]), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(samples.rates, np.transpose(lines[7:]), rtol=1e-9, atol=1e-12)
    expected = np.transpose(lines[3:7]) / np.linalg.norm(lines[3:7], axis=0)[:, None]
    np.testing.assert_allclose(np.abs(np.sum(samples.attitude * expected, axis=1)), 1.0, atol=1e-12)
    held = np.searchsorted(arriving.wind_ns, samples.time_ns, side="right") - 1
    np.testing.assert_array_equal(samples.wind, arriving.wind[held])
