# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Hover throttle, thrust over command, saturation, imbalance and drift of exact flights."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from quadpi_core.field.airborne import flown
from quadpi_core.field.field_log import FieldLog, Series, places_of
from quadpi_core.field.field_reading import read_field_log
from quadpi_core.field.motor_use import MotorUse, Turning, motor_use, turning_of
from quadpi_core.reading_options import ReadingOptions
from quadpi_core.rotor_order import LAYOUTS

from .field_examples import AIRBORNE, HOVER, example
from .test_inertia import BEBOP, flight


def use_of(log: FieldLog) -> MotorUse:
    return motor_use(log, flown(log))


def with_commands(log: FieldLog, change: np.ndarray) -> FieldLog:
    return replace(log, commands=Series(log.commands.time, np.clip(log.commands.values + change, 0.0, 1.0)))


def test_hover_is_where_thrust_is_the_weight():
    """The example never stands: the command comes from the curve of thrust over command."""
    use = use_of(example())
    # The mean of commands that differ by motor, as those of the example do, is a little less.
    mean = (HOVER**2 - 0.02**2 / 2.0) ** 0.5
    assert use.hover.value == pytest.approx(mean, rel=1e-3)
    assert use.hover.low <= mean <= use.hover.high


def test_hover_is_the_mean_command_of_a_standing_vehicle():
    log = example()
    still = replace(log.velocity, values=0.01 * log.velocity.values)
    use = use_of(replace(log, velocity=still, imu=None))
    assert use.hover.value == pytest.approx(HOVER, rel=0.02)


def test_gain_of_thrust_over_command():
    """Thrust over weight is (u / HOVER)²: its slope at hover is 2 / HOVER."""
    gain = use_of(example()).thrust_gain
    assert gain.value == pytest.approx(2.0 / HOVER, rel=0.02)
    assert gain.low < gain.value < gain.high < 1.05 * gain.value


def test_a_gain_that_no_propeller_has_is_not_identified():
    """Commands that hold off gusts change much more than thrust does; its drift would err as much."""
    log = example()
    values = log.imu.values.copy()
    values[:, 5] = -9.80665 + 0.2 * (values[:, 5] + 9.80665)
    use = use_of(replace(log, imu=replace(log.imu, values=values)))
    assert use.thrust_gain.value is None
    assert "commands answered to disturbance" in use.thrust_gain.reason
    assert use.drift is None


def test_the_command_at_hover_errs_as_its_interval_says():
    """Each five seconds thrust is off by 3 %, as by gusts up and down."""
    inside = []
    for seed in range(40):
        log, rng = example(), np.random.default_rng(seed)
        values = log.imu.values.copy()
        values[:, 5] *= (1.0 + rng.normal(0.0, 0.03, 12))[np.minimum(log.imu.time // 5.0, 11).astype(int)]
        hover = use_of(replace(log, imu=replace(log.imu, values=values))).hover
        inside.append(hover.low <= HOVER <= hover.high)
    assert np.mean(inside) >= 0.9


def test_a_negative_gain_is_below_0():
    log = example()
    values = log.imu.values.copy()
    values[:, 5] = -2.0 * 9.80665 - values[:, 5]
    said = use_of(replace(log, imu=replace(log.imu, values=values))).thrust_gain.reason
    assert "is below 0" in said


def test_a_constant_command_tells_no_gain():
    log = example()
    inside = (log.commands.time >= AIRBORNE[0]) & (log.commands.time < AIRBORNE[1])
    flat = Series(log.commands.time, np.where(inside, HOVER, 0.05)[:, np.newaxis] * np.ones(4))
    use = use_of(replace(log, commands=flat))
    assert "hardly changed" in use.thrust_gain.reason
    assert use.drift is None


def test_a_motor_that_works_harder_stands_out():
    use = use_of(with_commands(example(), np.array([0.1, 0.0, 0.0, 0.0])))
    harder, *others = use.motors
    assert harder.low > 0.12
    assert harder.value == pytest.approx(0.1 * 0.75 / (HOVER + 0.025), rel=0.05)
    assert all(one.high < 0.0 for one in others)


def test_saturation_is_a_share_of_the_time_in_the_air():
    log = example()
    high = (log.commands.time[:, np.newaxis] % 10.0 < 2.0) * np.array([0.0, 1.0, 0.0, 0.0])
    saturated = use_of(with_commands(log, high)).saturated
    assert saturated.value == pytest.approx(0.2, abs=0.02)
    assert saturated.low < 0.2 < saturated.high
    assert use_of(log).saturated.value == 0.0


def test_a_sagging_pack_shows_as_drift_of_thrust_over_command():
    log = example()
    share = (log.imu.time - AIRBORNE[0]) / (AIRBORNE[1] - AIRBORNE[0])
    values = log.imu.values.copy()
    values[:, 5] *= 1.1 - 0.2 * share
    drift = use_of(replace(log, imu=replace(log.imu, values=values))).drift
    assert drift.value == pytest.approx(-0.2, abs=0.03)
    assert drift.high < 0.0
    steady = use_of(log).drift
    assert steady.low < 0.0 < steady.high


def test_voltage_at_both_ends():
    begin, end, lowest = use_of(example()).volts
    assert (begin, end) == pytest.approx((15.9, 14.9), abs=0.1)
    assert lowest <= end


def test_without_commands_only_the_battery_is_told():
    use = use_of(example(commands=None))
    assert (use.hover, use.saturated, use.motors) == (None, None, ())
    assert use.volts is not None


def test_a_load_that_drops_and_a_pack_that_sags_change_the_command_at_hover(shared_data: Path) -> None:
    """With and without the voltage in the log; good and damaged flights keep their command."""
    folder = shared_data / "rrc_propeller"
    log = read_field_log(folder / "hover_good_1.BIN", ReadingOptions())
    time, flight = log.commands.time, flown(log)
    begin, end = flight.stretches[0].begin, flight.stretches[-1].end
    middle = 0.5 * (begin + end)
    loaded = np.where(time < middle, 1.12, 1.0)[:, np.newaxis]
    dropped = motor_use(replace(log, commands=Series(time, log.commands.values * loaded)), flight).change
    assert dropped.share == pytest.approx(1.0 / 1.12 - 1.0, abs=0.03)
    assert dropped.at_s == pytest.approx(middle, abs=6.0)
    sag = (1.0 + 0.2 * (time - begin) / (end - begin))[:, np.newaxis]
    sagged = motor_use(replace(log, battery=None, commands=Series(time, log.commands.values * sag)), flight)
    assert sagged.change.at_s is None
    assert sagged.change.share == pytest.approx(0.16, abs=0.05)
    for name in ("hover_good_1", "hover_25mm_1", "line_good_1", "line_25mm_1"):
        other = read_field_log(folder / f"{name}.BIN", ReadingOptions())
        assert motor_use(other, flown(other)).change is None


def test_commands_of_outputs_that_are_off_tell_nothing() -> None:
    log = example()
    landed = Series(log.commands.time, (log.commands.values[:, :1] < 0.1) * 1.0)
    off = replace(log, commands=Series(log.commands.time, 0.0 * log.commands.values), landed=landed)
    use = use_of(off)
    assert (use.motors, use.change, use.no_change, use.hover) == ((), None, "not in the log", None)
    assert use.volts is not None


def changed(share: float, **changes: float) -> MotorUse:
    """Slow flight near the weight whose command is another by a share from the middle on."""
    given = {"speed": 0.2, "thrust": 1.0, "noise": 0.0} | changes
    log = example()
    time, piece = log.commands.time, ((log.commands.time - AIRBORNE[0]) // 5.0).astype(int)
    command = HOVER * np.where(time < 30.0, 1.0, 1.0 + share) * (1.0 + given["noise"] * (-1.0) ** piece)
    aloft = (time >= AIRBORNE[0]) & (time < AIRBORNE[1])
    values = log.imu.values.copy()
    values[:, 5] = -9.80665 * given["thrust"]
    velocity = np.tile([given["speed"], 0.0, 0.0], (len(log.velocity), 1))
    return use_of(
        replace(
            log,
            commands=Series(time, np.where(aloft, command, 0.05)[:, np.newaxis] * np.ones(4)),
            imu=replace(log.imu, values=values),
            velocity=replace(log.velocity, values=velocity),
        )
    )


@pytest.mark.parametrize(
    ("changes", "is_told"),
    [
        ({"speed": 2.8}, True),
        ({"speed": 3.2}, False),
        ({"thrust": 1.19}, True),
        ({"thrust": 1.21}, False),
        ({"noise": 0.016}, True),
        ({"noise": 0.045}, False),
    ],
)
def test_a_change_shows_in_slow_flight_near_the_weight_beyond_its_noise(changes, is_told) -> None:
    assert (changed(0.12, **changes).change is not None) == is_told


def test_why_a_change_at_hover_is_not_told() -> None:
    assert changed(0.0).no_change == ""
    assert changed(0.12, speed=3.2).no_change.startswith("takes 6 pieces of slow flight")
    assert use_of(example(imu=None)).no_change == "takes velocity and IMU"


@pytest.mark.parametrize(("share", "is_told"), [(0.2, False), (0.4, True)])
def test_commands_that_hardly_move_tell_no_thrust_over_command(share, is_told) -> None:
    """Those of 1.4 and of 2.8 per cent of their median."""
    log = example()
    mean = np.mean(log.commands.values[(log.commands.time > 6.0) & (log.commands.time < 54.0)])
    values = np.where(log.commands.values > 0.2, mean + share * (log.commands.values - mean), 0.05)
    gain = use_of(replace(log, commands=Series(log.commands.time, values))).thrust_gain
    assert ("hardly changed" not in gain.reason) == is_told


def in_order(log: FieldLog, order: tuple[int, ...]) -> FieldLog:
    values = log.commands.values[:, [motor - 1 for motor in order]]
    return replace(log, commands=Series(log.commands.time, values))


def turned(layout: str, *, secs: float = 40.0, yawed: float = 1.0) -> tuple[FieldLog, np.ndarray]:
    """Moments at random, mixed as the least commands that give them, turn a vehicle of a standard frame."""
    rng, places = np.random.default_rng(4), places_of(LAYOUTS[layout])
    levers = np.stack([-places[:, 1], places[:, 0], -0.2 * places[:, 2], np.ones(len(places))])
    time = np.arange(0.0, secs, 0.004)
    shapes = lfilter([0.03], [1.0, -0.97], rng.normal(0.0, 1.0, (len(time), 4)), axis=0)
    commands = 0.5 + 0.1 * shapes * [1.0, 1.0, yawed * 0.2, 1.0] @ np.linalg.pinv(levers).T
    keep = np.exp(-0.004 / 0.03)
    speeds = lfilter([1.0 - keep], [1.0, -keep], commands, axis=0, zi=keep * commands[:1])[0]
    rates = 0.4 * np.cumsum(speeds**2 @ levers[:3].T, axis=0) + rng.normal(0.0, 0.01, (len(time), 3))
    rates[:, 2] += rng.normal(0.0, 0.02, len(time))
    force = np.tile([0.0, 0.0, -9.81], (len(time), 1))
    log = FieldLog("f", "f", "test", imu=Series(time, np.hstack([rates, force])))
    return replace(log, commands=Series(time, commands)), places


FOUR = np.column_stack([BEBOP.rotor_positions[:, :2], BEBOP.rotor_spins])


@pytest.mark.parametrize("order", [(2, 1, 3, 4), (1, 3, 2, 4), (2, 3, 4, 1), (4, 3, 2, 1), (3, 4, 1, 2)])
def test_commands_in_another_order_are_told(order: tuple[int, ...]):
    log, aloft = flight()
    assert turning_of(log, aloft, FOUR).order == ()
    found = turning_of(in_order(log, order), aloft, np.sign(FOUR))
    assert (found.order, found.is_reversed, found.alike) == (order, False, ())


@pytest.mark.parametrize("layout", ["quad-plus", "hexa-x", "octo-x", "octo-plus", "octo-coaxial-x"])
def test_two_motors_exchanged_are_told_of_any_number(layout: str):
    """Of two on one arm yaw tells which is which."""
    log, places = turned(layout, yawed=2.0)
    aloft = flown(log)
    assert turning_of(log, aloft, places) == Turning()
    motors = range(1, len(places) + 1)
    for pair in combinations(motors, 2):
        order = tuple(pair[::-1][pair.index(motor)] if motor in pair else motor for motor in motors)
        assert turning_of(in_order(log, order), aloft, places) == Turning(order)


@pytest.mark.parametrize(("layout", "is_alike"), [("hexa-x", False), ("octo-coaxial-x", True)])
def test_without_spins_two_on_one_arm_are_alike(layout: str, is_alike: bool):
    log, places = turned(layout)
    told = turning_of(log, flown(log), places * [1.0, 1.0, 0.0])
    if is_alike:
        assert told.endswith("turn the vehicle alike")
    else:
        assert told == Turning(no_spins="not known, or motors hardly explain how the vehicle yaws")


@pytest.mark.parametrize(("yawed", "is_told"), [(0.7, True), (0.4, False)])
def test_spins_the_other_way_are_told_where_the_vehicle_yaws(yawed: float, is_told: bool):
    """Yaw alone scores 0.1 to 0.2, and less than 0.1."""
    log, places = turned("quad-x", yawed=yawed)
    aloft = flown(log)
    told = turning_of(log, aloft, places * [1.0, 1.0, -1.0])
    assert (told.is_reversed, bool(told.no_spins)) == (is_told, not is_told)
    assert not turning_of(log, aloft, places).is_reversed


def test_rotor_speeds_tell_it_where_there_are_no_commands():
    log, places = turned("quad-x")
    speeds = replace(log, commands=None, rotor_speeds=Series(log.commands.time, 900.0 * log.commands.values))
    aloft = flown(speeds)
    assert turning_of(speeds, aloft, places) == Turning()
    assert turning_of(speeds, aloft, places[[1, 0, 2, 3]]).order == (2, 1, 3, 4)
    assert turning_of(speeds, aloft, places * [1.0, 1.0, -1.0]).is_reversed


def test_a_pause_in_a_log_is_no_motion():
    """Commands of half the flight are of another order, behind a pause in which all were zeros before."""
    log, places = turned("quad-x")
    aloft = flown(log)
    kept = (log.imu.time < 8.0) | (log.imu.time > 12.0)
    values = log.imu.values + np.where(log.imu.time < 10.0, 5.0, 0.0)[:, np.newaxis]
    told = turning_of(replace(log, imu=Series(log.imu.time[kept], values[kept])), aloft, places)
    assert told == Turning()


def test_an_imu_turned_by_a_quarter_is_as_commands_in_another_order():
    """So the report names both."""
    log, aloft = flight()
    turned = log.imu.values[:, [1, 0, 2, 4, 3, 5]] * [1.0, -1.0, 1.0, 1.0, -1.0, 1.0]
    told = turning_of(replace(log, imu=Series(log.imu.time, turned)), aloft, np.sign(FOUR)).order
    assert sorted(told) == [1, 2, 3, 4]
    assert all(motor != place for place, motor in enumerate(told, start=1))


def test_constant_commands_and_a_still_gyro_tell_no_order():
    log, aloft = flight()
    still = Series(log.imu.time, np.tile(log.imu.values[:1], (len(log.imu), 1)))
    held = Series(log.commands.time, np.full_like(log.commands.values, 0.5))
    for odd in (replace(log, imu=still), replace(log, commands=held), replace(log, imu=still, commands=held)):
        told = turning_of(odd, aloft, FOUR)
        assert told == "motors hardly explain how the vehicle turns"


@pytest.mark.parametrize(("noise", "is_told"), [(1.0, True), (2.0, False)])
def test_an_order_is_told_where_commands_explain_how_a_vehicle_turns(noise: float, is_told: bool):
    """Its score, of 2 without noise, is 1.25 and 0.64."""
    log, aloft = flight(noise=noise)
    told = turning_of(in_order(log, (2, 1, 3, 4)), aloft, FOUR)
    if is_told:
        assert told.order == (2, 1, 3, 4)
    else:
        assert told == "motors hardly explain how the vehicle turns"


@pytest.mark.parametrize(("part", "is_told"), [(0.65, True), (0.6, False)])
def test_an_order_that_hardly_leads_is_not_told(part: float, is_told: bool):
    """Motors 1 and 2 are exchanged in a part of the flight."""
    log, places = turned("quad-x")
    aloft = flown(log)
    values = log.commands.values.copy()
    end = int(part * len(values))
    values[:end, :2] = values[:end, 1::-1]
    found = turning_of(replace(log, commands=Series(log.commands.time, values)), aloft, places)
    if is_told:
        assert found.order == (2, 1, 3, 4)
    else:
        assert found == "motors 1 and 2 turn the vehicle alike"


def test_why_an_order_is_not_told():
    log, aloft = flight()
    slow = Series(log.commands.time[::50], log.commands.values[::50])
    assert (
        turning_of(log, aloft, None)
        == "takes commands or rotor speeds, gyro and the places of as many motors"
    )
    pauses = log.imu.time % 3.0 < 1.0
    gaps = replace(log, imu=Series(log.imu.time[~pauses], log.imu.values[~pauses]))
    said = "motors and gyro are nowhere without a gap for 3 s in the air"
    assert turning_of(gaps, aloft, FOUR) == said
    told = turning_of(replace(log, commands=slow), aloft, FOUR)
    assert told == "motors or gyro are logged at 10 Hz: 12 Hz are needed"


@pytest.mark.parametrize(
    "name", ["imrc_payload/eckart53", "imrc_brushed/jana00", "nanobench/B7_oval_fast_rep1.csv"]
)
def test_permuted_and_reversed_commands_of_real_flights_are_told(shared_data: Path, name: str):
    """None of these set the limits."""
    log = read_field_log(shared_data / name, ReadingOptions())
    places = np.array([(1, 1, -1), (-1, 1, 1), (-1, -1, -1), (1, -1, 1)], dtype=np.float64)
    aloft = flown(log)
    assert turning_of(log, aloft, places).order == ()
    for order in ((2, 1, 3, 4), (3, 4, 1, 2), (4, 1, 2, 3)):
        assert turning_of(in_order(log, order), aloft, places).order == order
    assert turning_of(log, aloft, places * [1.0, 1.0, -1.0]).is_reversed
