# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights by GPS in a wind that nothing measures: drag tells it, in identification and sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from quadpi_core.config_schema import parse_config
from quadpi_core.errors import ModelError
from quadpi_core.estimator.fusion import fuse
from quadpi_core.estimator.slow_states import with_slow_state
from quadpi_core.flight import NO_STAMP, OdometryStream, Recording
from quadpi_core.frames import Array
from quadpi_core.identification.found_wind import in_found_wind, with_found_wind
from quadpi_core.identification.prepared_flights import PreparedFlight, prepare_recording
from quadpi_core.inputs import VELOCITY_INPUTS
from quadpi_core.models.interval_rules import SETTLED, WindDrag
from quadpi_core.monitor.pairing import PairedSamples, Pairing
from quadpi_core.monitor.replay import recorded_flight
from quadpi_core.monitor.wind_state import SampleContext, WindState
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.sensors import sense
from quadpi_core.simulation.simulated_bags import fly_plan
from quadpi_core.vehicle import Vehicle
from test.core.flights_by_gps import state_by_gps

VEHICLE = Vehicle.load("bebop2")
GPS = np.array([1.0, 0.03, 0.1])
WINDS = ((3.0, -2.0), (-1.0, 3.5), (0.5, -4.0))


def by_gps(folder: Path, wind: tuple[float, float], seed: int) -> Recording:
    """A flight to and fro with turns, its state at 5 Hz with the errors of GPS in place of motion capture."""
    rng = np.random.default_rng(seed)

    def sine(unit: str, fastest: float) -> list[dict[str, dict[str, float]]]:
        hz = float(rng.uniform(0.06, 0.12))
        return [
            {
                "sine": {
                    f"amplitude_{unit}": fastest / (2.0 * np.pi * hz),
                    "frequency_hz": hz,
                    "phase_deg": float(rng.uniform(0.0, 360.0)),
                    "start_s": 1.0,
                    "duration_s": 58.0,
                    "fade_s": 5.0,
                }
            }
        ]

    motion = {"x": sine("m", 5.0), "y": sine("m", 5.0), "yaw": sine("deg", 30.0)}
    effects = {
        "wind": {"north_m_s": wind[0], "east_m_s": wind[1]},
        "gust": {"intensity_m_s": 0.5, "time_s": 2.0},
    }
    content = {
        "description": "wind",
        "vehicle": "bebop2",
        "seed": seed,
        "duration_s": 60.0,
        "height_m": 20.0,
        "flights": {f"windy{seed}": {"motion": motion, "effects": effects}},
    }
    path = folder / f"windy{seed}.yaml"
    path.write_text(yaml.safe_dump(content))
    truth = fly_plan(load_scenario(path).flights[0], SimulatedVehicle.load("bebop2"))
    recording = sense(truth, VEHICLE, SensorSuite.load("paper"), {}, (), seed).recording
    assert recording.wind is None
    full = fuse(recording, VEHICLE, 30.0)
    return state_by_gps(recording, full, rng, GPS)


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    folder = tmp_path_factory.mktemp("windy")
    return [by_gps(folder, wind, seed) for seed, wind in enumerate(WINDS)]


@pytest.fixture(scope="module")
def prepared(recordings: Sequence[Recording]) -> list[PreparedFlight]:
    return [prepare_recording(one, VEHICLE, 30.0) for one in recordings]


def test_the_wind_of_each_flight_is_found_with_the_drag(prepared: Sequence[PreparedFlight]) -> None:
    found, drag = with_found_wind(prepared, VEHICLE)
    assert drag is not None
    for one, wind in zip(found, WINDS, strict=True):
        np.testing.assert_allclose(one.flight.wind.mean(axis=0)[:2], wind, atol=0.6)
        assert not one.wind_unknown
    # By the drag of the others' model, the wind of a flight that it has not seen is the same.
    alone = in_found_wind(prepared[0], drag, VEHICLE)
    np.testing.assert_array_equal(alone.inputs, found[0].inputs)
    settled = found[0].live.known & (found[0].time > 20.0)
    off = (found[0].live.inputs - found[0].inputs)[settled][:, VELOCITY_INPUTS]
    assert np.sqrt(np.mean(np.square(off[:, :2]))) < 1.0
    assert 0.1 < drag.known_m_s < 1.5


def test_no_wind_is_sought_in_a_hall_and_where_it_was_measured(recordings: Sequence[Recording]) -> None:
    hall = replace(VEHICLE, noise=replace(VEHICLE.noise, wind_m_s=0.0))
    flight = prepare_recording(recordings[0], hall, 30.0)
    assert not flight.wind_unknown
    flights, drag = with_found_wind([flight], hall)
    assert flights[0] is flight
    assert drag is None


def paired(flight: PreparedFlight) -> PairedSamples:
    own = flight.flight
    return PairedSamples.join(
        own.stamps_ns,
        velocity=own.velocity,
        attitude=own.attitude,
        rates=own.rates,
        specific_force=own.specific_force,
        rotor_speeds=own.rotor_speeds,
        wind=np.zeros((len(own), 3)),
    )


def test_the_wind_is_told_sample_by_sample(prepared: Sequence[PreparedFlight]) -> None:
    _, drag = with_found_wind(prepared, VEHICLE)
    samples = paired(prepared[0])
    whole, deviation = WindState(drag, 0.0).take(samples)
    late = samples.time_ns > samples.time_ns[0] + 25_000_000_000
    off = whole.wind[late, :2] - WINDS[0]
    # Gusts of 0.5 m/s are part of it.
    assert np.abs(off).mean() < 1.0
    assert np.mean(np.abs(off) < 2.0 * np.hypot(deviation[late], 0.5)[:, np.newaxis]) > 0.9
    assert deviation[0] == 6.0
    assert deviation[late].max() < 1.5

    parts, state = [], WindState(drag, 0.0)
    for begin in range(0, 20_000, 37):
        rows = slice(begin, min(begin + 37, 20_000))
        parts.append(state.take(PairedSamples(samples.time_ns[rows], samples.values[rows]))[0].wind)
    np.testing.assert_array_equal(np.concatenate(parts), whole.wind[:20_000])


def test_a_wind_that_a_topic_tells_counts(prepared: Sequence[PreparedFlight]) -> None:
    _, drag = with_found_wind(prepared, VEHICLE)
    samples = paired(prepared[0])
    samples.wind[:] = [1.0, 2.0, 0.0]
    state = WindState(drag, 0.0)
    told, deviation = state.take(samples)
    assert state.is_measured
    assert told is samples
    assert not deviation.any()
    assert state.conditions(told.attitude, deviation, None) is None


def in_blocks(samples: PairedSamples, drag: WindDrag, length: int) -> tuple[Array, Array]:
    """Wind and its deviation by a state that takes so many samples at a time."""
    state, parts = WindState(drag, 0.0), []
    for begin in range(0, len(samples.time_ns), length):
        rows = slice(begin, begin + length)
        told, deviation = state.take(PairedSamples(samples.time_ns[rows], samples.values[rows]))
        parts.append((told.wind, deviation))
    wind, deviations = zip(*parts, strict=True)
    return np.concatenate(wind), np.concatenate(deviations)


DRAG = WindDrag(
    per_mass_x_1_s=0.3, per_mass_y_1_s=0.3, noise_x_m_s2=0.1, noise_y_m_s2=0.1, wind_m_s=6.0, known_m_s=0.5
)


def drifting(count: int = 1000) -> PairedSamples:
    """Level and at rest in a wind from behind that nothing measures, at 100 Hz."""
    still = np.zeros((count, 3))
    return PairedSamples.join(
        10**18 + 10_000_000 * np.arange(count),
        velocity=still,
        attitude=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
        rates=still,
        specific_force=np.tile([0.9, 0.0, -9.8], (count, 1)),
        rotor_speeds=np.full((count, 4), 800.0),
        wind=still,
    )


@pytest.mark.parametrize("length", [1, 37])
def test_a_topic_that_begins_inside_a_block_counts_from_there(length: int) -> None:
    samples = drifting()
    samples.wind[500:] = [3.0, 0.0, 0.0]
    wind, deviation = in_blocks(samples, DRAG, 1000)
    parts, deviations = in_blocks(samples, DRAG, length)
    np.testing.assert_array_equal(parts, wind)
    np.testing.assert_array_equal(deviations, deviation)
    assert 2.0 < wind[499, 0] < 3.0
    assert deviation[499] > 0.0
    np.testing.assert_array_equal(wind[500:], samples.wind[500:])
    assert not deviation[500:].any()


def test_an_anemometer_that_reads_0_is_heard() -> None:
    pairing, stamp_ns = Pairing(), 10**9
    level = np.array([1.0, 0.0, 0.0, 0.0])
    pairing.add_wind(stamp_ns, np.zeros(3))
    pairing.add_state(stamp_ns, np.ones(3), level, np.zeros(3))
    pairing.add_rotor_speeds(stamp_ns, np.full(4, 500.0))
    pairing.add_imu(stamp_ns, np.zeros(3))
    samples = pairing.take()
    state = WindState(DRAG, 0.0)
    told, deviation = state.take(samples)
    assert state.is_measured
    assert deviation == 0.0
    np.testing.assert_array_equal(told.velocity - told.wind, np.ones((1, 3)))


@pytest.mark.parametrize(
    ("quantity", "wild"),
    [
        ("specific_force", 1.7e308),
        ("specific_force", 1e5),
        ("velocity", 1e3),
        ("rates", 1e3),
        ("attitude", 30.0),
        ("attitude", 1e200),
    ],
)
def test_samples_that_data_quality_refuses_tell_no_wind(quantity: str, wild: float) -> None:
    sound, samples = drifting(), drifting()
    getattr(samples, quantity)[500:502, 1] = wild
    wind, deviation = in_blocks(samples, DRAG, 1000)
    expected, known = in_blocks(sound, DRAG, 1000)
    np.testing.assert_allclose(wind, expected, atol=1e-9)
    np.testing.assert_allclose(deviation, known, atol=1e-9)
    np.testing.assert_array_equal(in_blocks(samples, DRAG, 37)[0], wind)


@pytest.mark.parametrize("jump_s", [-100, 700])
def test_a_stamp_far_off_forgets_no_wind_and_a_clock_that_is_set_does(jump_s: int) -> None:
    samples = drifting()
    samples.time_ns[500] += jump_s * 1_000_000_000
    wind, deviation = in_blocks(samples, DRAG, 1000)
    np.testing.assert_allclose(wind[-1], in_blocks(drifting(), DRAG, 1000)[0][-1], atol=1e-9)
    np.testing.assert_array_equal(in_blocks(samples, DRAG, 1)[1], deviation)
    samples.time_ns[501:] += jump_s * 1_000_000_000
    wind, deviation = in_blocks(samples, DRAG, 1000)
    assert deviation[530] == 6.0
    assert deviation[-1] < 1.1 * in_blocks(drifting(450), DRAG, 1000)[1][-1]
    np.testing.assert_array_equal(in_blocks(samples, DRAG, 37)[0], wind)


@pytest.mark.slow
def test_a_wind_is_sought_by_slow_velocities_in_the_open_alone(
    recordings: Sequence[Recording], prepared: Sequence[PreparedFlight]
) -> None:
    _, drag = with_found_wind(prepared, VEHICLE)
    model = SimpleNamespace(wind=drag, state=SETTLED, alarm_limits=SimpleNamespace(hover_rotor_speed=0.0))
    samples = paired(prepared[0])

    def sought(recording: Recording, vehicle: Vehicle = VEHICLE) -> bool:
        context = SampleContext(model, vehicle, recorded_flight(recording, vehicle).wind_since_ns)
        given = context.of(samples)[1][:, -3:].any()
        assert given == context.is_needed
        assert given == prepare_recording(recording, vehicle, 30.0).wind_unknown
        return bool(given)

    assert sought(recordings[0])
    slow = with_slow_state(recordings[0], VEHICLE)
    assert sought(slow)
    assert not sought(replace(slow, twist=None))
    assert not sought(recordings[0], replace(VEHICLE, noise=replace(VEHICLE.noise, wind_m_s=0.0)))
    own = prepared[0].flight
    fast = OdometryStream(
        own.stamps_ns, own.position, own.attitude, own.velocity, own.rates, np.zeros((len(own), 3))
    )
    assert not sought(replace(recordings[0], odometry=fast.take(slice(None, None, 5))))


def test_what_drag_cannot_tell_is_handed_to_the_model(prepared: Sequence[PreparedFlight]) -> None:
    _, drag = with_found_wind(prepared, VEHICLE)
    state = WindState(drag, 0.0)
    rolled = np.tile([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0], (2, 1))
    found = state.conditions(rolled, np.array([drag.known_m_s, 6.0]), None)
    assert found["wind_unknown"].tolist() == [0, 1]
    variances: Array = found["covariance"][:, :3, :3]
    np.testing.assert_allclose(variances[0], 0.0)
    # By a quarter of a turn about x, y points down: no part of the wind is along it.
    beyond = 36.0 - drag.known_m_s**2
    np.testing.assert_allclose(variances[1], np.diag([beyond, 0.0, beyond]), atol=1e-12)


def test_the_ground_tells_no_wind(prepared: Sequence[PreparedFlight]) -> None:
    _, drag = with_found_wind(prepared, VEHICLE)
    hover = float(np.sqrt(np.mean(np.square(prepared[0].flight.rotor_speeds))))
    samples = paired(prepared[0])
    samples.rotor_speeds[:] = 0.3 * hover
    _, deviation = WindState(drag, hover).take(samples)
    assert deviation.min() == 6.0


def context_of(drag: WindDrag) -> SampleContext:
    model = SimpleNamespace(wind=drag, state=SETTLED, alarm_limits=SimpleNamespace(hover_rotor_speed=0.0))
    return SampleContext(model, VEHICLE, wind_since_ns=NO_STAMP)


def test_a_wind_that_is_known_to_twice_what_it_was_in_training_lets_forces_be_judged() -> None:
    level = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    for known in (0.3, 0.5):
        state = WindState(replace(DRAG, known_m_s=known), 0.0)
        found = state.conditions(level, known * np.array([1.98, 2.02]), None)
        assert found["wind_unknown"].tolist() == [0, 1]


@pytest.mark.parametrize(("gap_s", "kept"), [(590, True), (610, False)])
def test_a_wind_is_forgotten_after_ten_minutes(gap_s: int, kept: bool) -> None:
    samples = drifting()
    samples.time_ns[500:] += gap_s * 1_000_000_000
    wind, _ = in_blocks(samples, DRAG, 1000)
    assert (wind[530, 0] > 2.0) == kept


def test_a_model_of_the_same_drag_goes_on_with_the_wind_that_is_known() -> None:
    before, samples = context_of(DRAG), drifting()
    before.of(samples)
    for drag in (replace(DRAG), replace(DRAG, per_mass_x_1_s=0.4)):
        after = context_of(drag)
        after.go_on_from(before)
        assert (after.wind.deviation == before.wind.deviation) == (drag == DRAG)
        assert (after.wind.deviation < 6.0) == (drag == DRAG)


def test_the_wind_is_sought_since_it_is_known_to_be_unknown() -> None:
    samples = drifting()
    whole, since = context_of(DRAG).of(samples), context_of(DRAG)
    since.wind_since_ns = int(samples.time_ns[99])
    _, values, conditions = since.of(samples)
    assert not values[:100, -3:].any()
    assert not conditions["covariance"][:100].any()
    later = PairedSamples(samples.time_ns[100:], samples.values[100:])
    np.testing.assert_array_equal(values[100:], context_of(DRAG).of(later)[1])
    assert np.abs(values[-1, -3:] - whole[1][-1, -3:]).max() < 0.5
    # A clock that is set back does not unlearn it.
    since.reset()
    set_back = PairedSamples(samples.time_ns - 3_600_000_000_000, samples.values)
    np.testing.assert_array_equal(since.of(set_back)[1], context_of(DRAG).of(set_back)[1])


def test_after_a_reset_no_topic_measures_the_wind() -> None:
    context, samples = context_of(DRAG), drifting()
    samples.wind[:] = 1.0
    context.of(samples)
    assert not context.is_needed
    context.reset()
    assert context.is_needed
    assert context.of(drifting())[1][-1, -3] > 2.0


def test_flights_without_live_samples_tell_a_drag_that_can_be_kept(
    prepared: Sequence[PreparedFlight],
) -> None:
    _, drag = with_found_wind([replace(one, live=None) for one in prepared], VEHICLE)
    assert drag is not None
    assert drag.known_m_s == drag.wind_m_s


def test_a_drag_without_noise_is_refused() -> None:
    content = asdict(DRAG)
    assert parse_config(WindDrag, content, "a model", ModelError) == DRAG
    for name in ("noise_x_m_s2", "noise_y_m_s2"):
        with pytest.raises(ModelError, match=name):
            parse_config(WindDrag, content | {name: 0.0}, "a model", ModelError)
