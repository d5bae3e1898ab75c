# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.monitor import data_quality
from quadpi_core.monitor.data_quality import fault_words
from quadpi_core.monitor.preparation import Preparation
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
    assert first < 600 + 1.5 * RATE_HZ


def test_rotor_that_reads_nearly_nothing_differs_and_one_that_stays_is_frozen(flight):
    flight["rotor_speeds"][:, 1] *= 0.1
    flight["rotor_speeds"][500:, 2] = flight["rotor_speeds"][500, 2]
    assert flight.words()[-1] == {"rotor 2 differs from the others", "rotor 3 frozen"}


def test_spikes_are_told_where_they_are(flight):
    flight["rotor_speeds"][700, 0] *= 1.6
    words = flight.words()
    assert [k for k, found in enumerate(words) if found] == [700, 701]
    assert said(words) == {"rotor 1 jumps"}


def test_blocks_give_the_same_bits(flight):
    rng = np.random.default_rng(1)
    flight["values"][rng.random(flight["values"].shape) < 0.01] = np.nan
    flight["rates"][800:900] = flight["rates"][800]
    flight["rotor_speeds"][600:, 1] *= 0.5
    assert flight.words(1) == flight.words(7) == flight.words()


def test_bits_do_not_overlap():
    single = [getattr(data_quality, name) for name in ("NOT_FINITE", "GAP", "STATE_MISSING", "GYRO_FROZEN")]
    per_rotor = [
        first << k
        for first in (
            data_quality.ROTOR_FROZEN,
            data_quality.ROTOR_HALF,
            data_quality.ROTOR_JUMPS,
            data_quality.ROTOR_DIFFERS,
        )
        for k in range(4)
    ]
    assert len(set(single + per_rotor)) == len(single) + len(per_rotor)
    assert all(list(fault_words(bit)) for bit in single + per_rotor)
    assert all(bit & data_quality.IN_FLIGHT_ONLY for bit in per_rotor)
