# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.core import compiled
from quadpi_core.frames import Array
from quadpi_core.identification.change_calibration import evidence
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.alarm_limits import FALSE_FLIGHTS, AlarmLimits, ChangeLimits, RepeatingPart
from quadpi_core.models.envelope import Envelope
from quadpi_core.monitor.alarm import Alarm
from quadpi_core.monitor.alarm_kernel import geometry_record
from quadpi_core.monitor.alarm_log import Explained, reasons
from quadpi_core.monitor.change import (
    BLOCK_S,
    CHANGE,
    found_columns,
    mean_arm,
    nothing_found,
    sound_noise,
)
from quadpi_core.monitor.preparation import ROTOR_HALF
from quadpi_core.records import Records
from quadpi_core.results import (
    ACTIVE,
    CHANGED_CENTRE_FORWARD,
    CHANGED_CENTRE_RIGHT,
    CHANGED_FORCE_FORWARD,
    CHANGED_FORCE_RIGHT,
    CHANGED_MASS,
    CHANGED_ROTOR,
    EXTRAPOLATION,
    UNAVAILABLE,
    UNCALIBRATED,
    UNCALIBRATED_WORDS,
    UNCHANGED,
    WAITING,
)
from quadpi_core.results import (
    CHANGE as CHANGE_CAUSE,
)
from quadpi_core.vehicle import Vehicle

from .alarm_samples import LIMITS, RATE_HZ, SETTINGS, LiftingAlarm, Samples
from .sound_flights_of_blocks import limits_of, sound_blocks, weaken, weight

COLUMN = 3  # of the cause


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("crazyflie_rpm")


def found_in(blocks: Records, limits: ChangeLimits, vehicle: Vehicle) -> tuple[Array, dict[str, Array]]:
    """The evidence after each block, and what was found at the end."""
    memory, gathered = np.zeros(1, CHANGE), np.empty(len(blocks))
    memory["found"] = nothing_found(1)
    noise, rotors = sound_noise(limits, vehicle), geometry_record(vehicle, 0.0)
    compiled.gather_evidence(noise, rotors, blocks, memory, gathered)
    return gathered, found_columns(memory["found"], vehicle)


def test_of_sound_flights_fewer_than_stated_raise_the_alarm(vehicle: Vehicle) -> None:
    rng = np.random.default_rng(1)
    limits = limits_of(vehicle)
    raised = [evidence(limits, vehicle, sound_blocks(vehicle, 40.0, rng)).max() >= 20.0 for _ in range(200)]
    assert np.mean(raised) <= 0.05


@pytest.mark.parametrize("rotor", range(4))
@pytest.mark.parametrize("start", [0, 60])
def test_a_weak_rotor_is_named_with_its_size(vehicle: Vehicle, rotor: int, start: int) -> None:
    blocks = sound_blocks(vehicle, 10.0, np.random.default_rng(10 + rotor))
    weaken(blocks, vehicle, rotor, 0.05, start)
    gathered, found = found_in(blocks, limits_of(vehicle), vehicle)
    begun = int(np.argmax(gathered >= 20.0))
    assert start <= begun <= start + 10
    assert (found["changed"][0], found["changed_rotor"][0]) == (CHANGED_ROTOR, rotor + 1)
    assert found["change_lower"][0] - 0.01 < 0.05 < found["change_upper"][0] + 0.01
    assert abs(found["change_since_ns"][0] * 1e-9 / BLOCK_S - (1000 + start)) <= 5
    assert found["change_from_start"][0] == (start == 0)


def test_payload_push_and_balance_are_named_with_their_sizes(vehicle: Vehicle) -> None:
    newton, arm = weight(vehicle), mean_arm(vehicle)
    cases = [
        # Measured force is mass times specific force: 12 % more mass is 1 − 1/1.12 less of it.
        (CHANGED_MASS, 2, lambda lift: (1.0 - 1.0 / 1.12) * lift, 0.12 * vehicle.mass_kg),
        (CHANGED_MASS, 2, lambda lift: (1.0 - 1.0 / 0.95) * lift, -0.05 * vehicle.mass_kg),
        (CHANGED_FORCE_FORWARD, 0, lambda lift: 0.05 * newton + 0.0 * lift, 0.05 * newton),
        (CHANGED_FORCE_RIGHT, 1, lambda lift: -0.05 * newton + 0.0 * lift, -0.05 * newton),
        (CHANGED_CENTRE_FORWARD, 4, lambda lift: -lift * 0.02 * arm, 0.02 * arm),
        (CHANGED_CENTRE_RIGHT, 3, lambda lift: lift * 0.02 * arm, 0.02 * arm),
    ]
    for kind, axis, change, size in cases:
        blocks = sound_blocks(vehicle, 8.0, np.random.default_rng(5))
        blocks["residual"][40:, axis] += change(blocks["lift"][40:])
        gathered, found = found_in(blocks, limits_of(vehicle), vehicle)
        assert 40 <= int(np.argmax(gathered >= 20.0)) <= 55
        assert found["changed"][0] == kind
        assert found["change_size"][0] == pytest.approx(size, rel=0.25)


def test_one_violent_block_is_no_change(vehicle: Vehicle) -> None:
    for seed in range(20):
        blocks = sound_blocks(vehicle, 8.0, np.random.default_rng(seed))
        sound = evidence(limits_of(vehicle), vehicle, blocks).max()
        blocks["residual"][40, :3] += 2.0 * weight(vehicle)
        assert (evidence(limits_of(vehicle), vehicle, blocks).max() >= 20.0) == (sound >= 20.0)


def test_a_burst_shorter_than_the_cap_allows_is_no_evidence(vehicle: Vehicle) -> None:
    blocks = sound_blocks(vehicle, 8.0, np.random.default_rng(6))
    blocks["residual"][40:42, 3] += 0.1 * weight(vehicle) / 4 * mean_arm(vehicle)
    assert evidence(limits_of(vehicle), vehicle, blocks).max() < 20.0


def test_half_a_second_counts_for_more_after_the_first_second_of_a_flight(vehicle: Vehicle) -> None:
    def gathered(begun: int) -> float:
        found = []
        for seed in range(20):
            blocks = sound_blocks(vehicle, 8.0, np.random.default_rng(seed))[: begun + 5]
            weaken(blocks, vehicle, seed % 4, 0.24, begun)
            found.append(float(evidence(limits_of(vehicle), vehicle, blocks).max()))
        return float(np.median(found))

    assert 200.0 < gathered(4) < 400.0
    assert 1000.0 < gathered(15) < 2200.0


def test_what_is_larger_than_any_bet_has_no_name(vehicle: Vehicle) -> None:
    blocks = sound_blocks(vehicle, 8.0, np.random.default_rng(7))
    blocks["residual"][40:, 2] += 1.5 * weight(vehicle)
    gathered, found = found_in(blocks, limits_of(vehicle), vehicle)
    assert gathered.max() >= 20.0
    assert (found["changed"][0], found["change_size"][0]) == (UNCHANGED, 0.0)


def test_without_limits_or_of_other_rotors_nothing_is_known(vehicle: Vehicle) -> None:
    limits = limits_of(vehicle)
    for one, other in (
        (None, vehicle),
        (limits, None),
        (replace(limits, levers=limits.levers[:3]), vehicle),
    ):
        assert sound_noise(one, other)["evidence"][0] == 0.0
    assert sound_noise(limits, vehicle)["evidence"][0] == 20.0
    assert sound_noise(replace(limits, largest=33.0), vehicle)["evidence"][0] == 33.0


def samples_of(vehicle: Vehicle, seconds: float, newton: float, start_s: float) -> Samples:
    """Samples whose measured force along z has white noise, and a change from an instant on."""
    samples = Samples(seconds)
    noise = np.random.default_rng(3).standard_normal((len(samples.time_ns), 6))
    samples.measured = 1e-5 * weight(vehicle) * noise
    samples.measured[samples.between(start_s, seconds), 2] += newton
    samples.rotor_speeds[:] = 1500.0
    return samples


def alarm_of(
    vehicle: Vehicle,
    limits: AlarmLimits = LIMITS,
    change: bool = True,
    largest: float = 0.0,
    repeating: RepeatingPart | None = None,
) -> Alarm:
    count = len(INPUT_NAMES)
    inputs = np.stack((np.full(count, -1.0), np.full(count, 1.0)))
    envelope = Envelope.fit(inputs, np.zeros(2, int), np.full((2, 6), 0.01), np.ones((2, 6)))
    sound = replace(limits_of(vehicle), largest=largest, repeating=repeating) if change else None
    return LiftingAlarm(envelope, limits, SETTINGS, vehicle=vehicle, change=sound)


def test_the_alarm_says_what_has_changed_and_any_blocks_give_the_same(vehicle: Vehicle) -> None:
    samples = samples_of(vehicle, 6.0, 0.05, 3.0)
    whole = samples.run(alarm_of(vehicle))
    for block in (1, 7, 1000):
        parts = samples.run(alarm_of(vehicle), block)
        for name in ("time_ns", "cause_level", "cause_evidence", "changed", "change_size", "change_since_ns"):
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    raised = whole.cause_level[:, COLUMN] == 2
    first = float(1e-9 * whole.time_ns[raised][0])
    assert 4.0 < first < 4.7
    assert raised[np.argmax(raised) :].all()
    assert whole.causes[-1] & CHANGE_CAUSE
    assert whole.changed[-1] == CHANGED_MASS
    said = reasons(whole, len(whole) - 1, CHANGE_CAUSE)[0]
    assert said.endswith("g heavier, or less thrust of all rotors since 4.0 s")
    assert (whole.changed[~raised] == UNCHANGED).all()


def test_what_repeats_where_inputs_change_is_no_evidence_in_blocks_of_any_length(vehicle: Vehicle) -> None:
    quiet, samples = (samples_of(vehicle, 6.0, 0.0, 0.0) for _ in range(2))
    number = samples.time_ns // round(1e9 * BLOCK_S)
    speed = np.random.default_rng(8).uniform(-0.9, 0.9, number[-1] + 1)
    speed[: number[0]] = speed[number[0]]
    samples.inputs[:, 0] = speed[number]
    samples.measured[:, 2] += 0.1 * (speed[number] - speed[number - 1])
    none, ends = dict.fromkeys(INPUT_NAMES, (0.0, 0.0)), dict.fromkeys(INPUT_NAMES, 2.0)
    part = RepeatingPart(dict.fromkeys(INPUT_NAMES, -2.0), ends, {"Fz": none | {"u": (0.1, 0.0)}})
    assert samples.run(alarm_of(vehicle)).cause_health[-1, COLUMN] == UNCALIBRATED
    whole, sound = samples.run(alarm_of(vehicle, repeating=part)), quiet.run(alarm_of(vehicle))
    assert whole.cause_health[-1, COLUMN] == ACTIVE
    np.testing.assert_allclose(whole.cause_evidence[-20:, COLUMN], sound.cause_evidence[-20:, COLUMN], 1e-6)
    for block in (1, 7, 1000):
        parts = samples.run(alarm_of(vehicle, repeating=part), block)
        np.testing.assert_array_equal(parts.cause_evidence, whole.cause_evidence)


def test_health_says_where_a_change_is_not_judged(vehicle: Vehicle) -> None:
    samples = samples_of(vehicle, 5.0, 0.0, 0.0)
    assert set(samples.run(alarm_of(vehicle)).cause_health[:, COLUMN]) == {ACTIVE}
    told = alarm_of(vehicle, largest=1.0 / FALSE_FLIGHTS.value), alarm_of(vehicle, largest=20.1)
    for alarm, health in zip(told, (ACTIVE, UNCALIBRATED), strict=True):
        assert set(samples.run(alarm).cause_health[:, COLUMN]) == {health}
    assert set(samples.run(alarm_of(vehicle, change=False)).cause_health[:, COLUMN]) == {UNAVAILABLE}
    samples.settled[samples.between(0.0, 2.0)] = False
    rows = samples.run(alarm_of(vehicle))
    early = 1e-9 * rows.time_ns < 2.9
    assert set(rows.cause_health[early, COLUMN]) == {WAITING}
    assert set(rows.cause_health[~early, COLUMN][2:]) == {ACTIVE}


def test_residuals_louder_than_on_any_sound_flight_are_uncalibrated(vehicle: Vehicle) -> None:
    samples = samples_of(vehicle, 6.0, 0.0, 0.0)
    wave = 0.2 * weight(vehicle) * np.sign(np.sin(2 * np.pi * 2.5 * 1e-9 * samples.time_ns))
    samples.measured[samples.between(2.0, 6.0), 0] += wave[samples.between(2.0, 6.0)]
    health: Array = samples.run(alarm_of(vehicle)).cause_health[:, COLUMN]
    assert health[5] == ACTIVE
    assert health[-1] == UNCALIBRATED


def test_after_a_manoeuvre_beyond_training_no_share_is_stated(vehicle: Vehicle) -> None:
    samples = samples_of(vehicle, 6.0, 0.0, 0.0)
    samples.inputs[samples.between(2.0, 2.1), INPUT_NAMES.index("q")] = 2.0
    rows = samples.run(alarm_of(vehicle))
    unlike = rows.cause_health[:, COLUMN] == UNCALIBRATED
    seconds = 1e-9 * rows.time_ns - 1.0
    assert unlike[(seconds > 2.01) & (seconds < 4.05)].all()
    assert not unlike[(seconds < 1.99) | (seconds > 4.15)].any()
    # Far beyond, nothing counts against the vehicle for a second more, and it is uncalibrated for as long.
    samples.inputs[samples.between(2.0, 2.3), INPUT_NAMES.index("q")] = 20.0
    far = samples.run(alarm_of(vehicle))
    after = 1e-9 * far.time_ns - 1.0 > 4.5
    assert (far.cause_health[after, COLUMN] == UNCALIBRATED)[:5].all()
    assert (far.cause_health[1e-9 * far.time_ns - 1.0 > 5.4, COLUMN] == ACTIVE).all()
    said = [UNCALIBRATED_WORDS in words for words in Explained().rows(rows)]
    np.testing.assert_array_equal(said, unlike)
    # Those of the other causes are not its own.
    assert UNCALIBRATED_WORDS not in reasons(rows, int(np.argmax(unlike)), EXTRAPOLATION)
    assert UNCALIBRATED_WORDS in reasons(rows, int(np.argmax(unlike)), CHANGE_CAUSE)


def test_a_change_is_judged_only_where_it_is_wanted(vehicle: Vehicle) -> None:
    samples = samples_of(vehicle, 6.0, 0.05, 3.0)
    alarm = alarm_of(vehicle)
    alarm.change(replace(SETTINGS, change=False))
    rows = samples.run(alarm)
    assert set(rows.cause_health[:, COLUMN]) == {UNAVAILABLE}
    assert not (rows.causes & CHANGE_CAUSE).any()
    alarm = alarm_of(vehicle)
    *_, last = samples.parts(alarm, 100)
    assert last.causes[-1] & CHANGE_CAUSE
    # Turned off in flight, an alarm that stands is over.
    alarm.change(replace(SETTINGS, change=False))
    samples.time_ns += 6_000_000_000
    rows = samples.run(alarm)
    assert not (rows.causes & CHANGE_CAUSE).any()
    assert (rows.changed == UNCHANGED).all()


def beyond_training(vehicle: Vehicle, share: float, axis: int = 2) -> Samples:
    """Samples of which those from 2 to 5 s are too fast, and off by a share of the weight."""
    samples = samples_of(vehicle, 7.0, 0.0, 0.0)
    fast = samples.between(2.0, 5.0)
    samples.inputs[fast, INPUT_NAMES.index("u")] = 2.0
    samples.measured[fast, axis] += share * weight(vehicle)
    return samples


def named_as(alarm: Alarm, samples: Samples) -> int:
    rows = samples.run(alarm)
    return int(rows.changed[-1]) if rows.causes[-1] & CHANGE_CAUSE else UNCHANGED


@pytest.mark.parametrize("name", ["u", "p", "omega_avg", "mu_v_in"])
def test_outside_the_training_range_a_force_is_no_evidence_but_where_inputs_of_thrust_alone_are(
    vehicle: Vehicle, name: str
) -> None:
    samples = samples_of(vehicle, 5.0, 0.0, 0.0)
    samples.measured[samples.between(2.0, 5.0), 0] += 0.2 * weight(vehicle)
    samples.inputs[:, INPUT_NAMES.index(name)] = 2.0
    of_thrust = name in {"omega_avg", "mu_v_in"}
    assert named_as(alarm_of(vehicle), samples) == (CHANGED_FORCE_FORWARD if of_thrust else UNCHANGED)
    # A sensor that fails is not the vehicle.
    samples.faults[:] = ROTOR_HALF
    assert named_as(alarm_of(vehicle), samples) == UNCHANGED


@pytest.mark.parametrize("start_s", [0.0, 0.5])
def test_after_an_alarm_of_extrapolation_a_small_change_since_take_off_is_no_evidence(
    vehicle: Vehicle, start_s: float
) -> None:
    """Of the same flight: the next one is bet on from its own take-off."""
    forward, limits = CHANGED_FORCE_FORWARD, replace(LIMITS, hover_rotor_speed=1500.0)
    late = samples_of(vehicle, 9.0, 0.0, 0.0)
    late.measured[:, 0] += 0.0092 * weight(vehicle)
    late.inputs[late.between(0.5, 0.8), INPUT_NAMES.index("u")] = 20.0
    late.wind_unknown[late.between(0.0, 5.0)] = True
    assert named_as(alarm_of(vehicle), late) == UNCHANGED
    for share, far, lands, named in (
        (0.0092, False, False, forward),
        (0.0092, True, False, UNCHANGED),
        (0.0092, True, True, forward),
        (0.0184, True, False, forward),
    ):
        samples = samples_of(vehicle, 7.0 + 1.5 * lands, 0.0, 0.0)
        samples.velocity[:, 0] = 2.0
        samples.measured[:, 0] += share * weight(vehicle)
        if far:
            samples.inputs[samples.between(start_s, start_s + 0.3), INPUT_NAMES.index("u")] = 20.0
        if lands:
            landed = samples.between(1.0, 1.5)
            samples.rotor_speeds[landed], samples.velocity[landed] = 0.0, 0.0
        assert named_as(alarm_of(vehicle, limits), samples) == named


def test_a_model_that_is_off_beyond_its_flights_is_no_change_there_nor_as_it_returns(
    vehicle: Vehicle,
) -> None:
    for share in (0.03, 0.05, -0.05, 0.08, -0.08):
        assert named_as(alarm_of(vehicle), beyond_training(vehicle, share)) == UNCHANGED


def test_a_mass_beyond_the_training_flights_is_found_at_once_with_its_size(vehicle: Vehicle) -> None:
    load = 0.12
    samples = beyond_training(vehicle, load / (1.0 + load))
    rows = samples.run(alarm_of(vehicle))
    raised = rows.cause_level[:, COLUMN] == 2
    assert 3.3 < 1e-9 * rows.time_ns[raised][0] < 3.9
    assert rows.changed[-1] == CHANGED_MASS
    assert rows.change_lower[-1] < load * vehicle.mass_kg < rows.change_upper[-1]
    # What the model may be off by there is part of the interval.
    assert rows.change_upper[-1] - rows.change_lower[-1] > 2 * 0.05 * vehicle.mass_kg
    assert 1e-9 * rows.change_since_ns[-1] == pytest.approx(3.0)
    assert set(rows.cause_health[raised & (rows.time_ns < 6e9), COLUMN]) == {UNCALIBRATED}
    for block in (1, 7, 1000):
        parts = samples.run(alarm_of(vehicle), block)
        np.testing.assert_array_equal(parts.cause_evidence, rows.cause_evidence)


def test_a_load_is_found_at_once_whatever_sound_flights_gathered_and_less_is_not(vehicle: Vehicle) -> None:
    for share, until_s in ((0.12, 0.55), (0.05, np.inf)):
        samples = samples_of(vehicle, 3.0, share * weight(vehicle), 0.0)
        rows = samples.run(alarm_of(vehicle, largest=1e300))
        raised = rows.cause_level[:, COLUMN] == 2
        first = 1e-9 * (rows.time_ns[raised][0] - samples.time_ns[0]) if raised.any() else np.inf
        assert 0.35 < first <= until_s
        assert (first == np.inf) == (until_s == np.inf)
        if raised.any():
            # Four blocks at the most that one counts for, of a prior of a half, 0.8 of it on three sizes.
            won = 0.5 * 0.8 / 3.0 * np.exp(4 * 2.5)
            said = rows.cause_evidence[raised, COLUMN][0]
            assert said == pytest.approx(np.log(won) / np.log(400.0), rel=1e-3)


def test_beyond_the_training_flights_neither_a_rotor_nor_a_short_burst_nor_a_bad_sensor_is_a_mass(
    vehicle: Vehicle,
) -> None:
    alarm, fast = alarm_of(vehicle), slice(1000, 2500)
    rotor, arm = beyond_training(vehicle, 0.12), vehicle.rotor_positions[1, :2]
    rotor.measured[fast, 3:5] += 0.12 * weight(vehicle) * np.array([arm[1], -arm[0]])
    burst = beyond_training(vehicle, 0.0)
    burst.measured[burst.between(2.0, 2.3), 2] += 0.12 * weight(vehicle)
    broken, wide = beyond_training(vehicle, 0.12), beyond_training(vehicle, 0.12)
    broken.faults[fast] = ROTOR_HALF
    wide.width[fast, 2] = 1e3
    for samples in (rotor, burst, broken, wide):
        alarm.reset()
        assert named_as(alarm, samples) == UNCHANGED


def test_on_the_ground_a_change_is_forgotten(vehicle: Vehicle) -> None:
    samples = samples_of(vehicle, 7.0, 0.05, 1.0)
    samples.rotor_speeds[samples.between(5.0, 7.0)] = 0.0
    samples.velocity[samples.between(0.0, 5.0), 0] = 2.0
    rows = samples.run(alarm_of(vehicle, replace(LIMITS, hover_rotor_speed=1500.0)))
    assert (rows.causes & CHANGE_CAUSE).any()
    assert not rows.causes[-1] & CHANGE_CAUSE
    assert rows.changed[-1] == UNCHANGED
    assert rows.cause_health[-1, COLUMN] == WAITING
    assert RATE_HZ == 500
