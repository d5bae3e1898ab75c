# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.monitor import preparation
from quadpi_core.monitor.preparation import Preparation, fault_words
from quadpi_core.vehicle import Vehicle
from test.core.monitor.conftest import CUTOFF_HZ, RATE_HZ, fly

COUNT = 2000


class Flight:
    """Samples of a flight without a fault, to be damaged by a test."""

    def __init__(self, vehicle: Vehicle) -> None:
        samples = fly(COUNT / RATE_HZ, vehicle)
        self.vehicle = vehicle
        self.samples = samples._replace(time_ns=samples.time_ns.copy(), values=samples.values.copy())

    def __getitem__(self, name: str) -> np.ndarray:
        return getattr(self.samples, name)

    def words(self, block: int = COUNT) -> list[set[str]]:
        """What is said of each sample."""
        preparation = Preparation(self.vehicle, RATE_HZ, CUTOFF_HZ)
        bits = [
            preparation.step(*(column[start : start + block] for column in self.samples)).verdicts["faults"]
            for start in range(0, COUNT, block)
        ]
        return [set(fault_words(int(found))) for found in np.concatenate(bits)]


@pytest.fixture
def flight(vehicle) -> Flight:
    return Flight(vehicle)


def said(words: list[set[str]]) -> set[str]:
    return set().union(*words)


def test_nothing_is_said_of_a_good_flight(flight):
    assert said(flight.words()) == set()


def test_stamps(flight):
    flight["time_ns"][100] = flight["time_ns"][99]
    flight["time_ns"][200] -= 5_000_000
    flight["time_ns"][300:] += 500_000_000
    words = flight.words()
    assert words[100] == {"stamp repeated"}
    assert words[200] == {"stamp runs backward"}
    assert words[300] == {"gap in the samples"}
    assert sum(map(bool, words)) == 3


def test_missing_and_broken_samples(flight):
    flight["velocity"][10], flight["attitude"][10] = np.nan, np.nan
    flight["rotor_speeds"][20] = np.nan
    for name in ("velocity", "attitude", "rotor_speeds"):
        flight[name][30] = np.nan
    flight["rates"][40, 1] = np.inf
    flight["specific_force"][50, 0] = 1e5
    words = flight.words()
    assert words[10] == {"state missing"}
    assert words[20] == {"rotor speeds missing"}
    assert words[30] == {"state or rotor speeds missing"}
    assert words[40] == {"sample not finite"}
    assert words[50] == {"sample not plausible"}


@pytest.mark.parametrize(
    ("name", "word"), [("rates", "gyro frozen"), ("specific_force", "accelerometer frozen")]
)
@pytest.mark.parametrize("creep", [0.0, 1e-3])
def test_frozen_inertial_sensor_is_found_while_its_bias_is_corrected(flight, name, word, creep):
    frozen = np.repeat(flight[name][800:801], 200, axis=0)
    frozen += creep * (np.arange(200) // 4)[:, None]
    flight[name][800:1000] = frozen
    words = flight.words()
    first = next(k for k, found in enumerate(words) if found)
    assert 815 <= first <= 830
    assert said(words[:800]) == said(words[1001:]) == set()
    assert said(words) == {word}


def test_sensor_that_repeats_every_reading_once_or_rests_in_quantisation_is_none(flight):
    flight["rates"][1::2] = flight["rates"][::2]
    flight["specific_force"][:] = np.round(flight["specific_force"], 2)
    assert said(flight.words()) == set()


@pytest.mark.parametrize("rotor", range(4))
def test_rotor_that_reads_half_is_named(flight, rotor):
    flight["rotor_speeds"][600:, rotor] *= 0.5
    words = flight.words()
    assert words[600] == {f"rotor {rotor + 1} jumps"}
    assert words[-1] == {f"rotor {rotor + 1} reads half"}
    first = next(k for k, found in enumerate(words) if f"rotor {rotor + 1} reads half" in found)
    # The mean over 0.3 s of its square is then a third of the others': balanced, but for 7 %, once doubled.
    assert 0.6 * RATE_HZ < first - 600 < 0.8 * RATE_HZ


def test_rotor_that_reads_nearly_nothing_differs_and_one_that_stays_is_frozen(flight):
    flight["rotor_speeds"][:, 1] *= 0.1
    flight["rotor_speeds"][500:, 2] = flight["rotor_speeds"][500, 2]
    assert flight.words()[-1] == {"rotor 2 differs from the others", "rotor 3 frozen"}


def test_spikes_are_told_where_they_are(flight):
    flight["rotor_speeds"][700, 0] *= 1.6
    words = flight.words()
    assert [k for k, found in enumerate(words) if found] == [700, 701]
    assert said(words) == {"rotor 1 jumps"}


def test_an_inertial_sensor_is_frozen_after_30_ms_and_eight_samples():
    assert (preparation.frozen_s(500.0), preparation.frozen_s(100.0)) == (0.03, 0.08)


@pytest.mark.parametrize(
    ("name", "creep", "frozen"),
    [
        ("rates", 0.009, True),
        ("rates", 0.011, False),
        ("specific_force", 0.045, True),
        ("specific_force", 0.055, False),
    ],
)
def test_a_frozen_reading_creeps_by_no_more_than_the_estimator_corrects(flight, name, creep, frozen):
    """In rad/s and m/s², at every fourth sample."""
    flight[name][800:1000] = flight[name][800] + creep * (np.arange(200) // 4)[:, None]
    assert any("frozen" in word for word in said(flight.words())) == frozen


@pytest.mark.parametrize(("seconds", "frozen"), [(0.49, False), (0.51, True)])
def test_a_speed_controller_may_repeat_a_reading_for_half_a_second(flight, seconds, frozen):
    last = 500 + round(seconds * RATE_HZ)
    flight["rotor_speeds"][500 : last + 1, 2] = flight["rotor_speeds"][500, 2]
    assert ("rotor 3 frozen" in said(flight.words())) == frozen


@pytest.mark.parametrize(
    ("step", "others_step", "frozen"),
    [
        # Without a change for 2 s: coarse readings rest, fine ones and those of a moving flight do not.
        (1.1e-3, 0.0, False),
        (0.9e-3, 0.0, True),
        (1.1e-3, 3.5e-3, False),
        (1.1e-3, 4.5e-3, True),
    ],
)
def test_the_resolution_of_the_stream_decides_what_is_no_change(flight, step, others_step, frozen):
    """Rotors at 700 rad/s that go up and down by one step; then one, or none, changes."""
    speeds = flight["rotor_speeds"]
    speeds[:] = 700.0 * (1.0 + step * ((np.arange(COUNT) // 10 + np.arange(4)[:, np.newaxis]) % 2).T)
    speeds[1000:] = speeds[1000]
    speeds[1150:, :3] += 700.0 * others_step
    assert ("rotor 4 frozen" in said(flight.words())) == frozen


@pytest.mark.parametrize(
    ("every", "share", "jumps"), [(1, 0.17, False), (1, 0.21, True), (5, 0.33, False), (5, 0.37, True)]
)
def test_a_rotor_jumps_by_more_than_15_percent_and_2_percent_a_millisecond(flight, every, share, jumps):
    flight["rotor_speeds"][700, 0] = flight["rotor_speeds"][700 - every, 0] * (1.0 - share)
    thinned = np.arange(0, COUNT, every)
    preparation = Preparation(flight.vehicle, RATE_HZ / every, CUTOFF_HZ)
    faults = preparation.step(*(column[thinned] for column in flight.samples)).verdicts["faults"]
    assert ("rotor 1 jumps" in fault_words(int(faults[700 // every]))) == jumps


def constant(flight: Flight, *speeds: float) -> set[str]:
    """What is said in the end of rotors that turn at constant speeds, but for noise."""
    noise = 1e-3 * np.random.default_rng(3).standard_normal((COUNT, 4))
    flight["rotor_speeds"][:] = np.array(speeds) * (1.0 + noise)
    return flight.words()[-1]


@pytest.mark.parametrize(("share", "differs"), [(0.39, True), (0.41, False), (1.88, False), (1.92, True)])
def test_a_rotor_differs_from_the_others_below_0_4_and_above_1_9_of_their_speed(flight, share, differs):
    assert (
        "rotor 2 differs from the others" in constant(flight, 700.0, 700.0 * share, 700.0, 700.0)
    ) == differs


@pytest.mark.parametrize(("share", "half"), [(0.58, True), (0.62, False)])
def test_a_rotor_that_reads_half_is_below_0_6_of_the_others(flight, share, half):
    """Of others so unequal that doubling its reading balances the yaw moment either way."""
    pair_square = share**2 + 0.75
    spins = flight.vehicle.rotor_spins
    squares = np.where(spins == spins[0], 3.0 - 2.0 * pair_square, pair_square)
    squares[0] = share**2
    assert ("rotor 1 reads half" in constant(flight, *(700.0 * np.sqrt(squares)))) == half


@pytest.mark.parametrize(("speed", "jumps"), [(45.0, False), (55.0, True)])
def test_nothing_is_said_of_rotors_below_50_rad_s(flight, speed, jumps):
    flight["rotor_speeds"][:] = speed
    flight["rotor_speeds"][700, 1] = 30.0
    assert ("rotor 2 jumps" in said(flight.words())) == jumps


def test_blocks_give_the_same_bits(flight):
    rng = np.random.default_rng(1)
    flight["values"][rng.random(flight["values"].shape) < 0.01] = np.nan
    flight["rates"][800:900] = flight["rates"][800]
    flight["rotor_speeds"][600:, 1] *= 0.5
    assert flight.words(1) == flight.words(7) == flight.words()


def test_bits_do_not_overlap():
    single = [getattr(preparation, name) for name in ("NOT_FINITE", "GAP", "STATE_MISSING", "GYRO_FROZEN")]
    per_rotor = [
        first << k
        for first in (
            preparation.ROTOR_FROZEN,
            preparation.ROTOR_HALF,
            preparation.ROTOR_JUMPS,
            preparation.ROTOR_DIFFERS,
        )
        for k in range(4)
    ]
    assert len(set(single + per_rotor)) == len(single) + len(per_rotor)
    assert all(list(fault_words(bit)) for bit in single + per_rotor)
