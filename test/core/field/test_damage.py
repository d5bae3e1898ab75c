# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Motors against earlier flights, and motors that follow no more: by formulas, and on real damage."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.field.airborne import flown
from quadpi_core.field.damage import RotorLoss, Sharing, frozen_motors, losses, sharing
from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.field.field_report import FlightReport, report_on
from quadpi_core.logs.dataflash import decode_dataflash
from quadpi_core.reading_options import ReadingOptions

from .field_examples import example


def told(*flights: tuple[float, ...], error: float = 0.0) -> Sharing:
    """Of mean commands, the flight's first."""
    commands = np.array(flights)
    shares = commands / commands.mean(axis=1, keepdims=True) - 1.0
    return Sharing(shares, np.full(commands.shape[1], error))


def lost(found: tuple[RotorLoss, ...] | str) -> list[float]:
    return [one.thrust.value for one in found]


EVEN = (0.5, 0.5, 0.5, 0.5)


def test_a_rotor_that_needs_more_command_lacks_thrust() -> None:
    found = losses(told((0.5, 0.55, 0.5, 0.5), *[EVEN] * 5))
    assert found[1].excess.value == pytest.approx(0.1)
    assert lost(found)[1] == pytest.approx(1.0 - 1.1**-1.5)
    assert found[1].thrust.low > 0.0
    assert all(one.thrust.high < found[1].thrust.high for one in found[::2])


@pytest.mark.parametrize(("more", "alone", "of_four"), [(0.03, 0, 0), (0.042, 1, 0), (0.055, 1, 1)])
def test_the_hardest_working_of_four_must_stand_out_of_four(more: float, alone: bool, of_four: bool) -> None:
    (first, *_) = losses(told((0.5 * (1.0 + more), 0.5, 0.5, 0.5), *[EVEN] * 5))
    assert (first.thrust.low > 0.0, first.beyond_chance) == (alone, of_four)


def test_the_battery_and_the_weight_cancel() -> None:
    (first, *_) = losses(told((0.6, 0.66, 0.6, 0.63), (0.4, 0.44, 0.4, 0.42)))
    assert first.excess.value == pytest.approx(0.0)


def test_more_flights_before_narrow_the_interval_unless_they_scatter() -> None:
    flight, even = (0.52, 0.5, 0.5, 0.5), [EVEN] * 6
    uneven = [(0.5 + 0.05 * (-1) ** number, 0.5, 0.5, 0.5) for number in range(6)]
    widths = [losses(told(flight, *refs))[0].excess.half_width for refs in (even[:1], even, uneven)]
    assert widths[1] < 0.6 * widths[0] < widths[2]
    assert losses(told(flight, *even, error=0.05))[0].excess.half_width > 2.0 * widths[1]


def test_what_cannot_be_held_against_each_other() -> None:
    log = example()
    three = replace(log, commands=Series(log.commands.time, log.commands.values[:, :3]))
    for flight, before in ((replace(log, commands=None), log), (log, three)):
        found = sharing([(one, flown(log)) for one in (flight, before)])
        assert found == "the flight, or those before, have no commands"


@pytest.mark.parametrize("command", [0.0, 0.02])
def test_a_motor_that_hardly_turns_tells_no_thrust(command: float) -> None:
    stands, *others = losses(told((command, 0.6, 0.6, 0.6), *[EVEN] * 5))
    assert stands.thrust.value is None
    assert stands.excess.value == pytest.approx(command / 0.6 - 1.0)
    assert all(one.thrust.value == pytest.approx(others[0].thrust.value) for one in others)


def test_a_motor_that_has_all_the_command_compares_with_none() -> None:
    with np.errstate(all="raise"):
        assert isinstance(losses(told((1.0, 0.0, 0.0, 0.0), EVEN)), str)


def in_wind(seed: int, wind: float, *, weak: float = 0.0) -> FieldLog:
    """Airspeed along x, which moves work from the motors behind to those in front; motor 2 may be weak."""
    log = example(seed)
    time, commands = log.commands.time, log.commands.values.copy()
    force = wind * (1.0 + 0.3 * np.sin(0.3 * time + seed))
    values = log.imu.values.copy()
    values[:, 3] = force + np.random.default_rng(seed).normal(0.0, 0.1, len(force))
    commands *= 1.0 + 0.08 * force[:, np.newaxis] * np.array([1.0, -1.0, 1.0, -1.0])
    commands[:, 1] *= 1.0 + weak
    return replace(log, commands=Series(time, commands), imu=Series(log.imu.time, values))


def test_motors_are_compared_without_the_wind() -> None:
    logs = [in_wind(1, 1.5, weak=0.1), in_wind(2, -0.5), in_wind(3, 0.5)]
    flights = [(one, flown(one)) for one in logs]
    found = losses(sharing(flights))
    assert found[1].excess.value == pytest.approx(0.1, abs=0.01)
    assert [one.beyond_chance for one in found] == [False, True, False, False]
    # Without accelerometer the wind is taken for weak motors.
    blind = losses(sharing([(replace(log, imu=None), flight) for log, flight in flights]))
    assert [one.excess.value > 0.08 for one in blind] == [True, False, True, False]


def with_motor(log: FieldLog, motor: int, values: np.ndarray) -> FieldLog:
    commands = log.commands.values.copy()
    commands[:, motor] = values
    return replace(log, commands=Series(log.commands.time, commands))


def test_a_command_that_stays_as_it_is_in_flight() -> None:
    log = example()
    time, own = log.commands.time, log.commands.values[:, 2]
    cut = with_motor(log, 2, np.where(time > 30.0, np.where(time > 32.0, 0.0, 0.5), own))
    ((motor, since),) = frozen_motors(cut, flown(cut))
    assert motor == 3
    assert since == pytest.approx(30.0, abs=0.02)


@pytest.mark.parametrize("floor", ["full", "least", "slow", "short"])
def test_motors_at_the_ends_of_their_range_do_follow(floor: str) -> None:
    log = example()
    time, own = log.commands.time, log.commands.values[:, 2]
    late = time > 30.0
    values = {
        "full": np.where(late, 1.0, own),
        "least": np.where(late, log.commands.values.min() + 0.01, own),
        # Reached as saturation is, by a cap that falls with the battery.
        "slow": np.where(late, np.minimum(own, 0.38), own),
        "short": np.where(late & (time < 30.5), 0.5, own),
    }
    capped = with_motor(log, 2, values[floor])
    assert frozen_motors(capped, flown(log)) == []


OPTIONS = ReadingOptions()


def flights(folder: Path, names: list[str], before: list[str]) -> list[FlightReport]:
    report = report_on([folder / one for one in names], OPTIONS, against=[folder / one for one in before])
    return list(report.flights)


def test_a_propeller_short_by_25_mm_is_told_and_good_flights_are_not_named(shared_data: Path) -> None:
    """20 mm too; of 5 and 10 mm no motor is beyond the scatter, once the wind is taken out."""
    folder = shared_data / "rrc_propeller"
    good = ["hover_good_1.BIN", "line_good_1.BIN"]
    for kind in ("hover", "line"):
        cuts = flights(folder, [f"{kind}_{mm}mm_1.BIN" for mm in (5, 10, 20, 25)], good)
        first = [one.losses[0].thrust for one in cuts]
        assert [one.low > 0.0 for one in first] == [False, False, True, True]
        assert not any(one.thrust.low > 0.0 for cut in cuts for one in cut.losses[1:])
        assert first[3].value > first[2].value > max(first[0].value, first[1].value)
        assert "motor 1 (front right) works harder" in cuts[3].remarks[0].sentence
        assert cuts[2].remarks[0].sentence.startswith("motor 1 (front right)")
    for flight in flights(folder, good, good):
        assert all(one.thrust.low < 0.0 for one in flight.losses)


def test_motors_at_full_command_are_not_compared(shared_data: Path) -> None:
    """Of eight flights two saturate for a third of the time and more: their motors looked weak."""
    folder = shared_data / "nanobench"
    names = sorted(path.name for path in folder.glob("*.csv"))
    told = {one.name: one for one in flights(folder, names, names)}
    full = {name for name, one in told.items() if isinstance(one.losses, str)}
    assert full == {"B6_linear_ramp_rep1", "B9_trefoil_fast_rep1"}
    assert "full command" in told["B6_linear_ramp_rep1"].losses
    assert not [one for name in set(told) - full for one in told[name].losses if one.beyond_chance]


def test_structural_changes_of_crazyflies(shared_data: Path) -> None:
    """A cut of 3 mm and a nut near motor 3 are told, 1 mm and tape are within the scatter."""
    folder = shared_data / "crazypad"
    for body in ("E8", "E9"):
        normal = sorted(one.name for one in folder.iterdir() if one.name.startswith(f"normal_flight_{body}"))
        cut = sorted(one.name for one in folder.iterdir() if f"M3_3mm_{body}" in one.name)
        for flight in flights(folder, cut, normal):
            assert [one.thrust.low > 0.0 for one in flight.losses] == [False, False, True, False]
            assert flight.remarks[0].sentence.startswith("motor 3 (rear left)")
        for flight in flights(folder, normal, normal):
            assert all(one.thrust.low < 0.0 for one in flight.losses)
    # Two propellers short by 2 mm each.
    both = sorted(one.name for one in folder.iterdir() if one.name.startswith("cut_M2"))
    for flight in flights(folder, both, normal):
        assert "motor 1 (front right), or motor 2 (rear right)" in flight.remarks[0].sentence
    # A lack of 0 to 1 %, by the near end, that is within the scatter of all motors is not said.
    for flight in flights(
        folder, ["cut_propeller_M3_1mm_E8_log02"], [one.name for one in folder.glob("normal_*E8*")]
    ):
        assert not flight.remarks
    nut = [f"add_weight_W3_near_M3_E9_log0{number}" for number in (0, 2, 3)]
    for flight in flights(folder, nut, normal):
        assert "motor 3 (rear left) works harder" in flight.remarks[0].sentence
        assert "or the vehicle has become heavier near it" in flight.remarks[0].sentence


@pytest.mark.parametrize(
    ("name", "motors"), [("hexa-x_m1", [1]), ("quad-plus_m2", [2]), ("quad-x_m1m2", [1, 2])]
)
def test_motors_that_are_cut_in_flight(shared_data: Path, name: str, motors: list[int]) -> None:
    """Within half a second of the parameter that cut them."""
    path = shared_data / "rrc_sitl" / f"{name}.bin"
    messages = decode_dataflash(str(path), path.read_bytes()).messages
    set_at, names = messages["PARM"].time_ns(), messages["PARM"].text("Name")
    begin = messages["IMU"].where("I", 0).time_ns()[0]
    (flight,) = report_on([path], OPTIONS).flights
    found = dict(frozen_motors(flight.log, flight.flown))
    for motor in motors:
        cut = [stamp for stamp, one in zip(set_at, names, strict=True) if one == f"SERVO{motor}_FUNCTION"]
        assert found[motor] == pytest.approx((max(cut) - begin) * 1e-9, abs=0.5)
    assert list(found)[: len(motors)] == motors
    said = [one.sentence for one in flight.remarks if "follows no more" in one.sentence]
    assert said[0].startswith(f"motor {motors[0]}")


@pytest.mark.slow
def test_no_motor_of_good_flights_follows_no_more(shared_data: Path) -> None:
    for folder in ("imrc_brushless", "imrc_brushed", "indiflight", "nanobench", "crazypad", "rrc_propeller"):
        for path in sorted((shared_data / folder).iterdir()):
            if path.suffix != ".yaml" and path.name != "LICENSE":
                (flight,) = report_on([path], OPTIONS).flights
                assert frozen_motors(flight.log, flight.flown) == []
