# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Every threshold of the search and of the simulation decides at its value, and has a reason for it."""

from __future__ import annotations

import importlib
import json
import pkgutil
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2, norm
from scipy.stats import t as student

from quadpi_core import discrepancy, screening, simulation
from quadpi_core.discrepancy import (
    acceptance,
    discrepancy_result,
    result_verdicts,
    study,
    unexplained,
    whitening,
)
from quadpi_core.discrepancy.acceptance import (
    Accepted,
    Trial,
    judge_evidence,
    judge_left_out,
    judge_size,
)
from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.by_condition import (
    Range,
    bin_edges,
    largest_deviation,
    second_borders,
    standing_out,
)
from quadpi_core.discrepancy.candidates import candidates, typical_sizes
from quadpi_core.discrepancy.closure import SearchResult
from quadpi_core.discrepancy.discrepancy_result import Coverage, OfFlight
from quadpi_core.discrepancy.effect_regression import Reduction, Regression, noise_of_flight
from quadpi_core.discrepancy.effect_response import Compared, deviations, predicted_flight, quiet
from quadpi_core.discrepancy.evidence import Fit, is_error_of_law, own_sizes, student_weights
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.other_simulations import ModelSimulation, Part, part_columns
from quadpi_core.discrepancy.reflight import growing_by_chance, rollout_floor
from quadpi_core.discrepancy.search import keeps
from quadpi_core.discrepancy.simulations import Tolerances
from quadpi_core.discrepancy.sound_learning import are_enough, learned, predicts
from quadpi_core.discrepancy.whitening import EDGES_HZ, Spectrum
from quadpi_core.errors import DiscrepancyError, SimulationError
from quadpi_core.flight import AXES, Flight, ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.records import Threshold
from quadpi_core.screening.excerpt import Excerpt, innovation
from quadpi_core.screening.flight_runs import long_enough, seldom_topics
from quadpi_core.screening.motion_consistency import MotionFit, judged, small_mistakes, without_repeats
from quadpi_core.screening.rotors_in_flight import (
    Inertial,
    dropped_out,
    has_stopped,
    require_excitation,
    stuck_rotors,
)
from quadpi_core.screening.rotors_in_flight import repeated_speeds as held_readings
from quadpi_core.screening.sample_order import order_of
from quadpi_core.simulation.applied_effects import EFFECTS
from quadpi_core.simulation.effect_definition import shaped
from quadpi_core.simulation.effects.airframe import ground_effect
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.sensor_noise import MotionCapture, SensorSuite
from quadpi_core.simulation.sensors import ideal_recording
from quadpi_core.simulation.simulated_bags import require_reachable
from quadpi_core.simulation.state_records import block_of
from quadpi_core.simulation.truth import Reference
from quadpi_core.vehicle import TERMS, Motors, Vehicle

from .simulation.conftest import START_NS, swing
from .simulation.references import held_still

BEBOP = Vehicle.load("bebop2")
ARM_M = float(np.linalg.norm(BEBOP.rotor_positions[:, :2], axis=1).mean())
SQUARES = np.full(6, 100.0)


def first_axis(value, others=0.0):
    return np.array([value, *[others] * 5])


def beside(gain, *, energy=1e6, law=False, beside_law=False, scales=False, known=False):
    own, other = (
        SimpleNamespace(name=name, form=0.1 * form, effect=SimpleNamespace(scales_existing=scaling))
        for name, form, scaling in (("own", law, scales), ("other", beside_law, False))
    )
    return judge_evidence(
        gain, acceptance.evidence_needed(own, [other], energy, first=8.0, known=known)
    ).passed


def alike_share():
    """Share of the noise of all in that of a flight of which twenty rows are left at zero."""
    return noise_of_flight(np.zeros((6, 20)), np.zeros(20, dtype=int), np.ones((6, 1)))[0, 0]


def needs(lost):
    """Whether intervals need the second of two effects, without which they hold some samples fewer."""

    def held(share):
        return {"Fx": Coverage(0.0, share)}

    two = {"first": {}, "second": {}}
    with (
        patch.object(study, "augmented", lambda *_, **__: AugmentedSimulation(None, two)),
        patch.object(study, "coverages", lambda _, a: held(0.9 - lost if "first" in a[0].effects else 0.1)),
    ):
        found = SimpleNamespace(regression=SimpleNamespace(flights=[None], conditions=()))
        named = [SimpleNamespace(name=name) for name in two]
        flown = SimpleNamespace(coverage=held(0.9))
        return not study._spoiling(SimpleNamespace(found=found, flown=flown, effects=named, checks=()))


def shared_by(lacking):
    """Whether what all but a share of many flights have is no difference between them."""
    values = (np.arange(1000) >= 1000 * lacking).astype(float)
    grams = [1e4 * np.outer((value, 1.0), (value, 1.0)) for value in values]
    own = np.array([1])
    return own_sizes(np.array(grams), np.array([1.0, 0.0]), own, own)[-1, 0] < 0.5


def by_chance(mean):
    """Whether the growth of an error in four flights, by one less and one more than that, may be chance."""
    before = [np.ones((3, 4))] * 4
    growth = 0.01 * (mean + np.array([-1.0, -1.0, 1.0, 1.0]))
    return "position_m" in growing_by_chance(before, [np.full((3, 4), np.exp(2.0 * own)) for own in growth])


def accepted(*, size=1.0, loudness=1.0, instead="", squares=99.0, stated=1.0):
    """Whether a candidate of two parameters is, by such numbers."""
    own = SimpleNamespace(name="own", label="own", free=(0, 1))
    plain = Fit(100.0, (), np.arange(2), np.array([np.sqrt(squares), 0.0]), np.eye(2), np.zeros(2))
    regression = SimpleNamespace(
        candidates=[own],
        flights=[],
        residual=SimpleNamespace(spectra=()),
        size=lambda *_: size,
        loudness=lambda *_: loudness,
        equations=lambda _: SimpleNamespace(parameters=lambda _: np.arange(2)),
        fit=lambda *_, **__: plain,
        energy=lambda *_: 0.0,
        sound=(),
        reduction=lambda *_: Reduction(SQUARES, first_axis(100.0 * stated, -1e6)),
        noise_squares=SQUARES,
        beside=lambda *_: regression,
        once=lambda _, make: make(),
    )
    regression.varied = regression
    none = replace(plain, log_evidence=0.0)
    before = Accepted(regression, (), none)
    trial = Trial(before, 0, plain, instead=instead, broken=np.arange(6) == 0)
    trial.__dict__["refined"] = replace(before, fit=plain)
    return trial.judgement.accepted


def share(left, named, rows):
    return result_verdicts.unexplained_share(left, named, rows)[0]


def refused(error: type[Exception], action: Callable[[], Any]) -> bool:
    try:
        action()
    except error:
        return True
    return False


HOVER_NS = np.arange(0, 5_000_000_000, 1_000_000)


def hover_readings(changed: slice, reading: float = 0.0) -> np.ndarray:
    """Rotor speeds of a hover, 5 s at 1 kHz, the second rotor's changed in between."""
    speeds = np.random.default_rng(0).normal(600.0, 1.0, (5000, 4))
    speeds[changed, 1] = reading
    return speeds


def hover_felt(lift: float = 1.0, turn_rad_s: float = 0.0) -> Inertial:
    """The hover, but for its share of the lift and a turn from 1 s on."""
    late = HOVER_NS >= 1_000_000_000
    rates = np.stack((late * turn_rad_s, 0.0 * late), axis=1)
    return Inertial(HOVER_NS, np.where(late, 9.81 * lift, 9.81), rates)


def drops_out(speeds: np.ndarray) -> bool:
    """Whether readings are left out, though the body feels the rotor stop."""
    return bool(np.any(dropped_out(HOVER_NS, speeds, hover_felt(0.75, 9.0))))


def slow_before_drop_out(share: float) -> bool:
    speeds = hover_readings(slice(850, 1150), 600.0 * share)
    speeds[1000:1020, 1] = 0.0
    return drops_out(speeds)


def stops(left: float = 0.0, turn_rad_s: float = 9.0) -> bool:
    felt = hover_felt(0.75 + 0.25 * left, turn_rad_s)
    return has_stopped(HOVER_NS, hover_readings(slice(1000, None)), 1, 1000, felt)


def named(speeds: np.ndarray, step_ns: int, sway_rad_s: float = 0.1) -> bool:
    time_ns = step_ns * np.arange(len(speeds))
    none = np.zeros((len(speeds), 3))
    sways = none + sway_rad_s * np.sin(2e-9 * np.pi * time_ns)[:, np.newaxis]
    imu = ImuStream(time_ns, sways, none - (0.0, 0.0, 9.81))
    return any(stuck_rotors(Recording("hover", "hover", "", imu, RotorSpeedStream(time_ns, speeds)), 9.81))


def stuck_beside(change_rad_s: float) -> bool:
    """A rotor in steps of 1 rad/s stays the same for a second while the others change."""
    speeds = np.tile(600.0 + np.arange(1000)[:, np.newaxis] % 2, (1, 4))
    speeds[200:1000] = 600.0
    speeds[300, [0, 2, 3]] += change_rad_s
    return named(speeds, 1_000_000)


def stuck_samples(count: int) -> bool:
    speeds = np.random.default_rng(0).normal(600.0, 1.0, (50, 4))
    speeds[20 : 20 + count, 1] = 600.0
    return named(speeds, 100_000_000)


def repeated(share: float) -> bool:
    """Whether a table is held in which this share of the readings comes twice."""
    twice = np.diff(np.floor(share * np.arange(10_001))) > 0.0
    readings = np.random.default_rng(0).normal(600.0, 9.0, (10_000, 4))
    return bool(held_readings(np.repeat(readings, 1 + twice, axis=0)).any())


def held_by(steps: float) -> bool:
    column = np.repeat(np.resize([600.0, 600.0 + steps], 100), 10)
    column[:10] = 601.0
    return bool(held_readings(np.tile(column[:, np.newaxis], (1, 4))).any())


LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def frozen_for(seconds: float, turn_rad: float = 0.2) -> bool:
    """Whether a pose is named that repeats for so long while the gyro turns by an angle."""
    time_ns = np.arange(0, 5_000_000_000, 1_000_000)
    held = slice(1000, 1001 + round(1000.0 * seconds))
    position = np.cumsum(np.ones((5000, 3)), axis=0)
    position[held] = position[1000]
    rates = np.zeros((5000, 3))
    rates[held, 1] = turn_rad / seconds
    imu = ImuStream(time_ns, rates, np.full((5000, 3), [0.0, 0.0, -9.81]))
    return without_repeats(PoseStream(time_ns, position, np.tile(LEVEL, (5000, 1))), imu)[1] is not None


def axes_gain(gain: float) -> bool:
    """Whether other axes of an accelerometer are named that explain so much more."""
    still = np.zeros((1, 250, 3))
    at_rest = Excerpt("mocap/pose", 0.01, np.tile(LEVEL, (1, 251, 1)), np.zeros((1, 251, 3)), still, still)
    found = innovation(at_rest)
    phase = 6.0 * np.pi * np.arange(len(found.force)) / len(found.force)
    along, across = np.cos(phase), np.sin(phase)
    own, other = np.sqrt(0.5 - 0.25 * gain), np.sqrt(0.5 + 0.25 * gain)
    force = np.stack((own * along + other * across, other * along + own * across, -9.8 + 0.0 * phase), axis=1)
    needed = np.stack((along, across, -9.8 + 0.0 * phase), axis=1)
    swapped = small_mistakes(at_rest, replace(found, force=force, needed=needed), measured=True)
    return "accelerometer axes" in [mistake.name for mistake in swapped]


def off(**size: float) -> bool:
    """Whether scale or origin are named that are off so much."""
    sound = {"scale": 1.0, "scale_error": 1e-6, "origin_m": np.zeros(3), "origin_error_m": np.full(3, 1e-6)}
    return any(judged("mocap/pose", MotionFit(**{**sound, **size}), measured=True))


def sorted_in(steps: float) -> bool:
    """Whether a sample that was stored late is sorted into a hole of so many steps."""
    stamps = 1_000_000 * np.arange(100)
    after = stamps[-1] + round(1e6 * steps) + stamps
    return (
        order_of(np.r_[stamps, after, (stamps[-1] + after[0]) // 2, after[-1] + 1_000_000]).late is not None
    )


def with_rotors_at(rate_hz: float) -> Recording:
    """A recording whose rotor speeds come at that rate, and pause once."""
    time_ns = np.round(np.delete(np.arange(200), 100) * 1e9 / rate_hz).astype(np.int64)
    imu = ImuStream(time_ns, *np.zeros((2, 199, 3)))
    return Recording("hover", "", "", imu, RotorSpeedStream(time_ns, np.full((199, 4), 600.0)))


def parts_of(seconds: float) -> list[Recording]:
    """A part of ten seconds, and one that is shorter."""
    stamps = [np.array([0, round(1e9 * length)]) for length in (10.0, seconds)]
    return [Recording("hover", "", "", ImuStream(time_ns, *np.zeros((2, 2, 3)))) for time_ns in stamps]


def hover(seconds=10.0, rate_hz=100.0, **columns) -> Flight:
    """Flight of a level hover, but for some columns."""
    samples = round(seconds * rate_hz)
    none = np.zeros((samples, 3))
    still = Flight(
        name="hover",
        vehicle="bebop2",
        source="hover",
        start_ns=0,
        time=np.arange(samples) / rate_hz,
        position=none,
        attitude=np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1)),
        velocity=none,
        rates=none,
        angular_acceleration=none,
        specific_force=none,
        rotor_speeds=np.linspace([600.0] * 4, [601.0] * 4, samples),
        wind=none,
    )
    return replace(still, **columns)


def in_column(column, values, width=3):
    table = np.zeros((len(values), width))
    table[:, column] = values
    return table


def flown(manoeuvre, **columns) -> bool:
    """Whether a manoeuvre counts as flown in a hover with some columns, beside a flight that turned."""
    turned = hover(rates=np.tile([9.0, 9.0, 0.0], (1000, 1)))
    return manoeuvre not in require_excitation([hover(**columns), turned], BEBOP)


def at_speed(multiple):
    return in_column(0, np.full(1000, multiple * BEBOP.hover_induced_velocity))


def turned_by(heading):
    half = 0.5 * np.linspace(0.0, heading / 0.98, 1000)
    return np.stack((np.cos(half), 0 * half, 0 * half, np.sin(half)), axis=1)


def loaded_by(extent):
    """Rotor speeds whose sum of squares has that extent, tails left out, over its mean."""
    squares = 1.0 + extent / 0.98 * np.linspace(-0.5, 0.5, 1000)
    return 600.0 * np.sqrt(np.tile(squares[:, None], (1, 4)))


def loaded_for(share_of_samples):
    """Whether throttle steps count as flown where rotors turn faster in a share of the samples."""
    fast = np.where(np.arange(10_000) < round(1e4 * share_of_samples), 1200.0, 600.0)
    return flown("throttle steps", seconds=100.0, rotor_speeds=np.tile(fast[:, None], (1, 4)))


def stands_out(energy, p_value=0.0) -> int:
    """Cells of some energies that stand out, where a draw has 1 in each."""
    return standing_out(np.array(energy), 1.0, np.array(p_value), np.ones(len(energy))).sum()


def kept_bins(share_of_samples) -> int:
    few = round(10_000 * share_of_samples)
    return len(bin_edges("u", np.concatenate((np.full(few, 0.5), np.linspace(1.0, 3.99, 10_000 - few))))) - 1


def known_points(seconds, position=(0.0, 0.0), flights=2):
    """Functions of place of flights that hover at points, in spacings of 7 arms, and first at the origin."""
    rate = 1000.0
    places = np.repeat(np.atleast_2d(position), max(1, round(seconds * rate)), axis=0) * 7.0 * ARM_M
    places = np.vstack((np.zeros(2), places))
    thinned = SimpleNamespace(
        position=np.column_stack((places, np.zeros(len(places)))),
        rate_hz=rate,
        attitude=np.tile([1.0, 0.0, 0.0, 0.0], (len(places), 1)),
    )
    flight = SimpleNamespace(simulation=SimpleNamespace(vehicle=BEBOP), thinned=thinned)
    return unexplained.functions_of_place([flight] * flights)


def held(shares):
    """Whether intervals of 95 % hold as much as they say, by their coverage of flights."""
    return unexplained.as_many_as_stated(np.array(shares)[:, None], 0.95).all()


def points_along(count):
    """Number of points that are known where flights stayed at so many of them."""
    names, _ = known_points(0.3, [(float(k), 0.0) for k in range(1, count + 1)])
    return len(names) // 3


def seen_at_origin(spacings):
    """Whether the origin is near a known point, of flights that hover between two points for long."""
    _, values = known_points(30.0, (spacings, 0.0))
    return values[0][0].any()


def tone(frequency_hz):
    """Share of the squares of a tone of 100 s that is among the frequencies compared."""
    time = np.arange(25_000) / 250.0
    wave = np.sin(2.0 * np.pi * frequency_hz * time)
    rows = whitening.spectrum(np.tile(wave[:, None, None], (1, 6, 1)), 250.0).rows[0]
    return float(np.square(rows).sum() / np.square(wave).sum())


def slow_response(frequency_hz):
    """Amplitude of a measured angular acceleration of some frequency that predicted flight keeps."""
    time = np.arange(4000) / 100.0
    wave = np.sin(2.0 * np.pi * frequency_hz * time)
    turning = hover(40.0, angular_acceleration=in_column(0, wave))
    seen = predicted_flight(turning, BEBOP, np.zeros((len(turning), 6)))
    return np.abs(seen.angular_acceleration[1000:3000, 0]).max()


def wandering():
    """Spectral density of the wander of a velocity, from the noise that a drag of 2 N s/m adds."""
    rng = np.random.default_rng(0)
    velocity = rng.normal(size=(500, 3))
    own = SimpleNamespace(
        simulation=SimpleNamespace(own_inputs=True),
        quiet=SimpleNamespace(rotor_speeds=rng.uniform(500.0, 700.0, (500, 4)), velocity=velocity),
        quiet_wrench=np.hstack((2.0 * velocity, np.zeros((500, 3)))),
        step=1,
        thinned=SimpleNamespace(rate_hz=100.0),
    )
    return unexplained.slow_state_noise([own], 1)[0, 0] / 2.0**2 / (100.0 / 2.0)


# What `Regression.moves` asks of a regression whose fit knows one effect, at 1, to within 1.
SURE_OF_ONE = SimpleNamespace(
    points=[np.ones(1)], candidates=[SimpleNamespace(scale=np.ones(1))], deviation=lambda *_: np.ones(1)
)


def beyond_sound(deviations):
    """Whether four flights that leave more by some deviations of their mean are beyond sound ones."""
    sound = SimpleNamespace(left=np.ones((6, 1)), differ=np.full(6, 0.2), flights=12)
    more = 1.0 + deviations * 0.2 * np.sqrt(1.0 / 4.0 + 1.0 / 12.0)
    left = [np.full((6, 10), np.sqrt(more))] * 4
    residual = SimpleNamespace(spectra=[Spectrum(own, np.zeros(10, dtype=np.intp)) for own in left], bands=1)
    regression = SimpleNamespace(
        sound=sound, residual=residual, flights=left, stated_squares=np.zeros(6), left=lambda _: left
    )
    none = SimpleNamespace(left=None)
    return SearchResult(regression, (), none, None, {}, None, ()).beyond_sound.max() > 0.0


def explained_better(probability):
    """Whether flights left out that gain by this probability on average, by Student's t, are explained."""
    roots = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    error = np.std(roots, ddof=1) / np.sqrt(len(roots))
    roots = roots + student.ppf(probability, len(roots) - 1) * error
    return predicts(np.sign(roots) * np.square(roots))


def known_error(evidence_nat):
    """Whether an error of some evidence is known: ½ (r − 1 − ln r) where its square is r of the noise."""
    ratio = brentq(lambda r: 0.5 * (r - 1.0 - np.log(r)) - evidence_nat, 2.0, 99.0)
    band = np.repeat(np.arange(len(EDGES_HZ.value) - 1), 2000)
    rows = np.zeros((6, len(band), 2))
    rows[:, ::2, 0] = np.sqrt(2.0)
    rows[:, 1::2, 1] = 0.1
    # The residual of all axes but one is at right angles to the column.
    rows[1:, :, 1] = 0.0
    aligned = np.sqrt(ratio / (2.0 * np.sum(np.square(rows[0, 1::2, 1]))))
    rows[0, 1::2, 0] = aligned * rows[0, 1::2, 1]
    return bool(learned([Spectrum(rows, band)] * 2, [("one", "x")], np.ones(1)).names)


def loads_with(tmp_path, multiple):
    path = tmp_path / "addition.json"
    path.write_text(
        json.dumps({"simulation": "bebop2", "vehicle": "bebop2", "adjusted": {"thrust": multiple}})
    )
    return not refused(DiscrepancyError, lambda: load_simulation(str(path)))


def reachable(**columns) -> bool:
    """Whether a reference of hover with some columns (2, ·) is accepted."""
    plan = FlightPlan(name="one", scenario="test", vehicle="bebop2", seed=1, duration_s=1.0)
    level = Reference.hover(np.array([0.0, 0.0, -3.0]), 2)
    vehicle = SimulatedVehicle.load("bebop2")
    strong = replace(vehicle.vehicle, rotor_speed_max_rad_s=9e3)
    reference = replace(level, **{name: np.array([values] * 2) for name, values in columns.items()})
    return not refused(SimulationError, lambda: require_reachable(plan, vehicle.altered(strong), reference))


def leaning(degrees):
    """Acceleration along which a vehicle leans by an angle."""
    return [BEBOP.gravity_m_s2 * np.tan(np.radians(degrees)), 0.0, 0.0]


def lost(*, attitude=(1.0, 0.0, 0.0, 0.0), rates=0.0, distance=0.0):
    return held_still(1, attitude=attitude, rates=[0.0, rates, 0.0], aside=distance)[2] == 0


def tilted_to(cosine):
    half = 0.5 * np.arccos(cosine)
    return np.cos(half), np.sin(half), 0.0, 0.0


def commanded(acceleration):
    """Commanded rotor speeds of a level vehicle at rest that is to accelerate."""
    return held_still(1, acceleration=acceleration)[0]


def not_limited(degrees):
    return commanded(leaning(degrees)) != pytest.approx(commanded(leaning(80.0)))


def upward(force):
    return commanded([0.0, 0.0, BEBOP.gravity_m_s2 - force])


def instant(**columns):
    model = RotorLocalModel.load("bebop2")
    still = {"velocity": np.zeros((1, 3)), "rates": np.zeros((1, 3)), "rotor_speeds": np.full((1, 4), 300.0)}
    return block_of(model.states(**still | columns), model.record())


def shaped_force(share_more):
    wrench = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    fx, *others = shaped(wrench, *instant(), np.append(first_axis(share_more), np.zeros(8)))
    return fx.item(), *others


def gain_at(radii):
    state, record = instant(position=np.array([[0.0, 0.0, -radii * BEBOP.rotor_radius_m]]))
    flat = record._replace(rotor_positions=record.rotor_positions * [1.0, 1.0, 0.0])
    return ground_effect.function(state, flat, np.ones(1))[2]


def thrust_at(advance_ratio):
    velocity = np.array([[advance_ratio * 300.0 * BEBOP.rotor_radius_m, 0.0, 0.0]])
    return instant(velocity=velocity)[0].thrusts.tolist()


def largest_jitter():
    """Largest offset of frames from the even grid, in periods, where the jitter asked for is far larger."""
    mocap = MotionCapture(rate=100.0, capture_jitter=1.0)
    poses = ideal_recording(swing(), BEBOP, SensorSuite("test", mocap=mocap), 1).pose
    return np.abs(1e-7 * (poses.time_ns - START_NS) % 1.0 - 0.5).max()


def steady(*, speed=0.0, yaw_rate=0.0, samples=500):
    """A flight straight ahead that turns about its vertical."""
    none, time = np.zeros((samples, 3)), np.arange(samples) / 500.0
    yaw = yaw_rate * time
    return Flight(
        *("steady", "bebop2", "steady", 0),
        time=time,
        position=np.outer(speed * time, [1.0, 0.0, 0.0]),
        attitude=np.column_stack((np.cos(yaw / 2), 0.0 * yaw, 0.0 * yaw, np.sin(yaw / 2))),
        velocity=speed * np.column_stack((np.cos(yaw), -np.sin(yaw), 0.0 * yaw)),
        rates=np.tile([0.0, 0.0, yaw_rate], (samples, 1)),
        angular_acceleration=none,
        specific_force=none - [0.0, 0.0, BEBOP.gravity_m_s2],
        rotor_speeds=np.full((samples, 4), 700.0),
        wind=none,
    )


def rolls_out(**motion):
    return np.isfinite(rollout_floor(steady(**motion), BEBOP)).any()


def common_to_axes():
    """Share of the variance of a coefficient that is in the column of its law."""
    columns = part_columns([Part("lift", np.ones((1, 6)), "lift")], Tolerances(coefficient=0.1))
    (shared,) = (column.wrench for column in columns if column.name == "Fx, Fy and Mz of lift")
    return np.square(shared[0, 0] / 0.1)


def bridged(share):
    """Whether a model that gives nothing for a share of a flight is taken."""
    flight, predicted = steady(samples=10_000), np.ones((10_000, 6))
    predicted[: int(share * len(flight))] = np.nan
    simulation = ModelSimulation("test", BEBOP, SimpleNamespace())
    vars(simulation)["_evaluated"] = lambda _: SimpleNamespace(predicted=predicted)
    return not refused(DiscrepancyError, lambda: simulation.wrench(flight))


def deviations_by_commands(**given: Any) -> list[float]:
    """What one flight may have of its own by motors whose rotors err by 1 %: gain, rotors, lag."""
    usual = {"source": "x", "coefficients": ((0.0,) * TERMS,) * 4, "lag_s": 0.0, "error": (0.01,) * 4}
    return [float(x) for x in deviations(Motors(**usual | given), Vehicle.load("bebop2"), 1)]


# What a value in the unit of a threshold leads to, and where that turns over. The values are those of the
# thresholds, so that neither changes alone.
EXAMINED: dict[str, tuple[float, Callable[[float], Any]]] = {
    "FALSE_ALARMS": (0.01, lambda x: judge_evidence(np.log(20.0 / x), acceptance.least_evidence(20)).passed),
    "FURTHER_SHARE": (0.05, lambda x: beside(1000.0 * x, energy=1000.0)),
    "FURTHER_LEAST": (20.0, lambda x: beside(x, energy=0.0) and beside(x, beside_law=True, scales=True)),
    "FURTHER_NUMBER": (100.0, beside),
    "FURTHER_KNOWN": (40.0, lambda x: beside(x, known=True)),
    "FURTHER_LAW": (200.0, lambda x: beside(x, law=True)),
    "BESIDE_LAW": (350.0, lambda x: beside(x, beside_law=True) and beside(x, law=True, beside_law=True)),
    "SMALLEST": (0.13, lambda x: judge_size({"large": 1.0, "small": x}).passed),
    "LOUDNESS": (0.1, lambda x: accepted(loudness=x)),
    "GROWTH": (0.5, lambda x: judge_left_out(SQUARES, SQUARES + first_axis(100.0 * x), 10).passed),
    "OF_ITSELF": (0.5, lambda x: accepted(stated=x)),
    "FEW_FLIGHTS": (4.0, lambda x: judge_left_out(SQUARES, 9.0 * SQUARES, x).passed),
    "NAMED_ALONE": (4.6, lambda x: x < acceptance.rival_margin(0.0)),
    "ALIKE": (0.1, lambda x: 1000.0 * x < acceptance.rival_margin(1000.0)),
    "PREDICTABLE": (0.3, lambda x: result_verdicts.predictable(first_axis(100.0 * x), 100).any()),
    "LOUD_AXIS": (0.8, lambda x: share(first_axis(100.0 * x), first_axis(9.0, 1e6), 100) > 0.5),
    "PART_OF_AXIS": (0.2, lambda x: share(first_axis(1e3 * x), first_axis(1e3, 1e9), 1) > 0.1),
    "UNSEEN": (0.02, needs),
    "UNEXPLAINED": (0.05, lambda x: result_verdicts.judge_unexplained(x).passed),
    "DIFFERENT": (0.95, lambda x: accepted(squares=float(chi2.ppf(x, 2)))),
    "FAR_COEFFICIENT": (
        5.0,
        lambda x: result_verdicts.judge_coefficients(1.0, x, "far").passed,
    ),
    "COLOURED": (12.0, lambda x: result_verdicts.judge_colour(np.full(6, x), np.ones(6)).passed),
    "LEAST_COVERAGE": (
        0.5,
        lambda x: result_verdicts.judge_coverage({"Fx": Coverage(0.1, 0.95 * x)}, 0.95).passed,
    ),
    "WORSE_COVERAGE": (
        3.0,
        lambda x: result_verdicts.judge_coverage({"Fx": Coverage(0.9, 0.9 - 0.05 * x)}, 0.95).passed,
    ),
    "WORSE_ROLLOUTS": (
        0.02,
        lambda x: result_verdicts.judge_rollouts({"rates": (1.0, 1.0 + x), "none": (0.0, 1.0)}).passed,
    ),
    "DISAGREEMENT": (3.0, lambda x: result_verdicts.judge_agreement("mass", x, 0.9).passed),
    "ALL_BUT_CLOSED": (
        0.05,
        lambda x: result_verdicts.judge_agreement("mass", 9.0, 1.0 - x + 1e-9).passed,
    ),
    "CLOSED": (0.8, lambda x: result_verdicts.judge_closed(x).passed),
    "KEPT": (0.5, lambda x: keeps(x, 1.0)),
    "NEAR_FLOOR": (0.1, lambda x: result_verdicts.judge_closed(0.6, 0.2, x).passed),
    # The others of the room, file by file.
    "DIVERGED_SPEED": (50.0, lambda x: rolls_out(speed=x)),
    "DIVERGED_RATE": (60.0, lambda x: rolls_out(yaw_rate=x)),
    "UNJUDGED_MOST": (0.05, bridged),
    "TOGETHER": (0.5, lambda x: x < common_to_axes()),
    "WANDER_M_S": (0.03, lambda x: x**2 < wandering() * 0.5),
    "WANDER_HZ": (0.5, lambda x: x < 0.03**2 / wandering()),
    "BULK": (0.8, lambda x: stands_out([1.0 + 1e3 * x, 1.0 + 1e3 * (1.0 - x)]) == 2),
    "LEAST_SHARE": (0.03, lambda x: Range("Fx", "u", 0.0, 1.0, x, 0.1, 0.0).is_large),
    "LIFT": (1.5, lambda x: Range("Fx", "u", 0.0, 1.0, 0.1 * x, 0.1, 0.0).is_informative),
    "PRIOR": (
        1.5,
        lambda x: x * typical_sizes(EFFECTS["payload"], BEBOP) < candidates(BEBOP, ["payload"])[0].scale,
    ),
    "SURE_STEP": (2.0, lambda x: Regression.moves(SURE_OF_ONE, 0, None, np.array([1.0 + x]))),
    "MORE_THAN_SOUND": (2.0, beyond_sound),
    # A deviation of three typical ones counts half.
    "ALIKE_ROWS": (20.0, lambda x: 20.0 / (20.0 + x) > 1.0 - alike_share()),
    "BEYOND_CHANCE": (0.95, lambda x: by_chance(student.ppf(x, 3) / np.sqrt(3.0))),
    "BY_CHANCE": (
        0.1,
        lambda x: result_verdicts.judge_rollouts({"rates": (1.0, 1.0 + x)}, {"rates"}).passed,
    ),
    "LACKED": (0.25, shared_by),
    "ERROR_OF_LAW": (1.0, lambda x: is_error_of_law(x, 1.0)),
    "TAILS": (1.0, lambda x: student_weights(2.0 + x) < 0.5),
    "SHOWN": (5.0, known_error),
    "BETTER": (0.95, explained_better),
    "LARGEST": (5.0, lambda x: accepted(size=x, instead="other")),
    "STANDS_OUT": (3.0, lambda x: OfFlight(x, 1.0).stands_out),
    "RATE_HZ": (
        125.0,
        lambda x: (
            Compared(hover(rate_hz=1.5 * x), SimpleNamespace(memoryless=True)).thinned.rate_hz > 1.4 * x
        ),
    ),
    "SLOW_HZ": (1.0, lambda x: slow_response(x) > np.exp(-0.5)),
    "FALSE_RANGE": (
        0.05,
        lambda x: stands_out([9.0], 0.5 * x) == 1 and norm.isf(0.25 * x) > largest_deviation(1),
    ),
    "EFFECT_SIZE": (4.0, lambda x: stands_out([x]) == 1),
    "FEWEST_SAMPLES": (0.01, lambda x: kept_bins(x) > kept_bins(0.0)),
    "SEGMENT_S": (1.0, lambda x: len(second_borders(np.array([0.0, 10.0 * x]))) <= 10),
    "FLOWN_SPEED": (0.25, lambda x: flown("forward and backward flight", velocity=at_speed(x))),
    "FLOWN_CLIMB": (0.12, lambda x: flown("climb and descent", velocity=np.roll(at_speed(x), 2, axis=1))),
    "FLOWN_RATE": (0.6, lambda x: flown("yaw doublets", rates=in_column(2, np.full(1000, x)))),
    "FLOWN_HEADING": (0.8, lambda x: flown("turns of the heading", attitude=turned_by(x))),
    "FLOWN_LOAD": (0.15, lambda x: flown("throttle steps", rotor_speeds=loaded_by(x))),
    "TAIL": (0.01, loaded_for),
    "STUCK_RAD_S": (
        1e-3,
        lambda x: refused(
            DiscrepancyError,
            lambda: flown("climb and descent", rotor_speeds=600.0 + np.linspace([0.0] * 4, [x] * 4, 1000)),
        ),
    ),
    "STUCK_S": (0.5, lambda x: named(hover_readings(slice(1000, 1001 + round(1000.0 * x))), 1_000_000)),
    # A sine's spread, averaged over a fifth of its period.
    "STANDS_RAD_S": (
        0.012,
        lambda x: named(hover_readings(slice(1000, 2000)), 1_000_000, x * np.sqrt(2.0) / np.sinc(0.2)),
    ),
    "STUCK_SAMPLES": (8, lambda x: stuck_samples(int(x))),
    "OTHERS_STEPS": (4.0, stuck_beside),
    "LIFT_LEFT": (0.5, lambda x: stops(left=x)),
    "STOP_TURN_RAD_S": (2.0, lambda x: stops(turn_rad_s=x)),
    "ZERO_RAD_S": (1.0, lambda x: drops_out(hover_readings(slice(1000, 1020), x))),
    "RETURNS_S": (0.15, lambda x: drops_out(hover_readings(slice(1000, 999 + round(1000.0 * x))))),
    "TURNS_SHARE": (0.4, slow_before_drop_out),
    "HELD_SHARE": (0.75, repeated),
    "HELD_STEPS": (3.0, held_by),
    "FROZEN_S": (0.3, frozen_for),
    "SELDOM": (1.2, lambda x: any(seldom_topics(with_rotors_at(10.0 * x)))),
    "SHARE_MAX": (0.5, lambda x: order_of(np.arange(10_000), {"x": np.arange(10_000) < 1e4 * x}).problem()),
    "HOLE_STEPS": (1.5, sorted_in),
    "PART_S": (3.0, lambda x: len(long_enough(parts_of(x))) > 1),
    "FROZEN_TURN_RAD": (0.05, lambda x: frozen_for(0.9, x)),
    "AXES_GAIN": (0.3, axes_gain),
    "SCALE_OFF": (0.025, lambda x: off(scale=1.0 - x)),
    "ORIGIN_ASIDE_M": (0.038, lambda x: off(origin_m=np.array([0.6, 0.0, 0.8]) * x)),
    "ORIGIN_ABOVE_M": (0.06, lambda x: off(origin_m=np.array([0.0, 0.0, -x]))),
    "SURE": (4.0, lambda x: off(scale=1.0 + 0.1 * x, scale_error=0.1)),
    "FEWEST_FLIGHTS": (2, lambda x: refused(DiscrepancyError, lambda: study.require_flights(x))),
    "SPACING": (7.0, lambda x: seen_at_origin(x / 7.0)),
    "STAY_S": (0.25, lambda x: len(known_points(x)[0]) > 0),
    "SHORT_OF": (2.0, lambda x: held([0.94 - 0.01 * x, 0.96 - 0.01 * x])),
    "MISSED": (4.0, lambda x: held([1.0 - 0.05 * x, 1.0])),
    "MOST_POINTS": (60, lambda x: points_along(int(np.ceil(x))) == np.ceil(x)),
    "BAND_HZ": (20.0, lambda x: tone(x) > 0.5),
    "TAPER_S": (0.5, lambda x: whitening.taper(9000, 1000.0)[int(1000.0 * x)] < 1.0),
    "GAIN_LEAST": (0.005, lambda x: deviations_by_commands(gain=x)[0] > 0.005),
    "ROTORS_DIFFER": (0.03, lambda x: deviations_by_commands(error=())[1] > x),
    "LAG_ERROR": (0.15, lambda x: deviations_by_commands(lag_s=1.0)[-1] > x),
    "GAIN_ALIKE": (0.8, discrepancy_result.resembles_gains),
    "HIDDEN": (0.9, lambda x: len(discrepancy_result.hidden_effects({"wind": 1.0}, {"wind": 1.0 - x})) > 0),
    "LEAST_SOUND": (2.0, are_enough),
    # The simulation.
    "FORM_OF_AIR": (0.15, lambda x: x < EFFECTS["rotor_drag"].form),
    "SHAPE_MAX": (3.0, lambda x: shaped_force(x - 1.0)[0] == pytest.approx(x)),
    "NEAREST_SURFACE": (0.5, lambda x: gain_at(x) == gain_at(0.1)),
    "FITTED_ADVANCE_RATIO": (0.6, lambda x: thrust_at(x) == thrust_at(2.0)),
    "TILT_MAX_DEG": (65.0, lambda x: reachable(acceleration=leaning(x)) and not_limited(x)),
    "EXCITED_TILT_MAX_DEG": (75.0, lambda x: reachable(tilt=[np.radians(x), 0.0])),
    "YAW_RATE_MAX_DEG_S": (360.0, lambda x: reachable(yaw_rate=np.radians(x))),
    "SIMULATED_AIRSPEED_M_S": (16.0, lambda x: reachable(velocity=[x, 0.0, 0.0])),
    "SPECIFIC_FORCE_MIN": (2.0, lambda x: upward(x) == upward(0.5)),
    "TILT_COSINE_MIN": (-0.2, lambda x: lost(attitude=tilted_to(x))),
    "RATE_MAX_RAD_S": (40.0, lambda x: lost(rates=x)),
    "POSITION_ERROR_MAX_M": (10.0, lambda x: lost(distance=x)),
    "JITTER_MAX": (0.4, lambda x: x < largest_jitter()),
}
# These are examined by the tests below, which need more than a number.
ALONE = {
    *(
        "ADJUSTED_MAX",
        "AVERAGE_HZ",
        "AXES_OVER_FORM",
        "EDGES_HZ",
        "LAGS_S",
        "MOST_EFFECTS",
        # In test_clock_consistency.
        *("SHARED_S", "LEAST_OFFSET_S", "EXPLAINED", "NEAR_S", "EXPLAINS"),
        # In test_plausibility.
        "BESIDE_IMU",
        # In test_simulated_file.
        "MOTOR_TIME_CONSTANT",
        "NOISE_HZ",
        # In test_unmeasured_states.
        *("INDEPENDENT_HZ", "SEEN_S", "STRETCHES_S", "TRIED_LENGTHS"),
    ),
    "RIDGES",
}


def thresholds() -> dict[str, Threshold]:
    """All thresholds of three rooms by the names that their modules give them."""
    found = {}
    for room in (screening, simulation, discrepancy):
        for module in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
            for name, value in vars(importlib.import_module(module.name)).items():
                if isinstance(value, Threshold):
                    assert found.setdefault(name, value) is value, f"two thresholds are called {name}"
    return found


@pytest.mark.parametrize("name", EXAMINED)
def test_a_threshold_decides_at_its_value(name):
    value, decision = EXAMINED[name]
    assert bool(decision(0.99 * value)) != bool(decision(1.01 * value))
    assert thresholds()[name].value == value


def test_every_threshold_is_examined_and_says_why():
    found = thresholds()
    assert sorted(found) == sorted({*EXAMINED, *ALONE})
    for threshold in found.values():
        assert all((threshold.name, threshold.unit, threshold.reason, threshold.data))
    assert len({threshold.name for threshold in found.values()}) == len(found)


def test_an_adjustment_of_more_than_ten_tolerances_is_refused(tmp_path):
    assert loads_with(tmp_path, 9.9)
    assert not loads_with(tmp_path, 10.1)


def test_noise_counts_as_white_between_edges():
    """A tone on either side of an edge is in another band."""
    edges = thresholds()["EDGES_HZ"].value
    assert edges[0] == 0.0
    frequencies = np.fft.rfftfreq(250_000, 1.0 / 250.0)
    band = whitening.spectrum(np.ones((250_000, 6, 1)), 250.0).band[::2]
    first = [frequencies[np.argmax(band == index)] for index in range(len(edges) - 1)]
    assert first == pytest.approx([0.0, 0.11, 0.3, 0.7, 1.5, 3.0, 5.0, 8.0, 12.0], abs=2e-3)


@pytest.mark.parametrize(
    ("frequency_hz", "kept"), [(11.8, 1.0), (12.2, 1.0 - 0.6 / 8.0), (19.8, 1.0 - 0.6 / 8.0), (20.2, 0.0)]
)
def test_noise_of_a_flight_is_that_between_two_frequencies(frequency_hz, kept):
    """A tone among them is averaged over 0.6 Hz, and the noise over the 8 Hz between them."""
    time = np.arange(20_000) / 100.0
    wave = np.sin(2.0 * np.pi * frequency_hz * time)
    seen = quiet(hover(200.0, rates=in_column(0, wave))).rates[:, 0]
    assert seen @ wave / (wave @ wave) == pytest.approx(kept, abs=0.02)


def test_generic_functions_remember_a_tenth_and_four_tenths_of_a_second(simulation, flights):
    names, values = unexplained.functions(Compared(flights[0], simulation))
    rate_hz = Compared(flights[0], simulation).thinned.rate_hz
    for lag in (0.1, 0.4):
        late, now = values[:, names.index(f"u {lag:g} s ago")], values[:, names.index("u")]
        kept = (late[1:] - now[1:]) @ (late[:-1] - now[1:]) / np.sum(np.square(late[:-1] - now[1:]))
        assert -1.0 / (rate_hz * np.log(kept)) == pytest.approx(lag)


def test_generic_functions_are_shrunk_by_a_ten_thousandth_to_a_tenth():
    """Where flights agree hardly at all, and where they contradict each other."""
    alike = unexplained.left_out_gain(np.ones((4, 1, 1)), np.ones((4, 1)))[1][0]
    assert 1.0 / alike - 1.0 == pytest.approx(1e-4)
    contrary = unexplained.left_out_gain(np.ones((4, 1, 1)), np.array([[1.0], [1.0], [-1.0], [0.0]]))[1][0]
    assert 0.25 / contrary - 1.0 == pytest.approx(0.1)


def test_the_form_of_a_law_may_differ_by_axis_more_than_as_a_whole(found):
    regression = found.discovery.found.regression
    (index,) = found.discovery.found.chosen
    block, candidate = regression.blocks[index], regression.candidates[index]
    axis = AXES.index(candidate.effect.axes[0])
    whole = block.columns.spectra[0].rows @ (regression.points[index] / candidate.scale)
    single = block.form.spectra[0].rows[axis, :, 0]
    assert single == pytest.approx(1.5 * 0.15 * whole[axis])


def test_three_effects_are_the_most(simulation, flights, pushed):
    """Four are there, each plain to see, and looked for."""
    rng = np.random.default_rng(0)
    made = []
    for flight in flights:
        wrench = np.zeros((len(flight), 6))
        wrench[:, 0] = 0.2 - 0.03 * flight.velocity[:, 0] * np.linalg.norm(flight.velocity, axis=1)
        wrench[:, 3:5] = 0.02 - 5e-3 * flight.rates[:, :2]
        wrench[:, 2] = 0.1 * simulation.wrench(flight)[:, 2]
        wrench += rng.standard_normal(wrench.shape) * [0.03, 0.03, 0.03, 3e-4, 3e-4, 3e-4]
        made.append(pushed(flight, simulation.vehicle, wrench))
    names = ["force_bias", "moment_bias", "body_drag", "rate_damping", "thrust_coefficient"]
    discovery_ = study.discover(simulation, made, names=names)
    assert len(discovery_.effects) == 3
    assert any(own.reason.passed for own in discovery_.found.judgements)
