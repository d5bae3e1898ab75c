# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Heavier vehicles, moved centres of gravity and weak motors against earlier flights, made up and real."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.field.airborne import flown
from quadpi_core.field.damage import THRUST_EXPONENT, Sharing
from quadpi_core.field.field_log import Series
from quadpi_core.field.field_report import report_on
from quadpi_core.field.mass_change import BY_COMMAND, BY_SPEED, BY_VOLTAGE, MassChange, efforts, mass_change
from quadpi_core.field.motor_use import MotorUse
from quadpi_core.reading_options import ReadingOptions

from .field_examples import example

# Front right, rear right, rear left, front left.
PLACES = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
POWER = THRUST_EXPONENT.value[1]


def shares(thrusts: list[float]) -> np.ndarray:
    """Of motors that give these thrusts, 1 each before."""
    commands = np.array(thrusts) ** (1.0 / POWER)
    return commands / commands.mean() - 1.0


def use(thrusts: list[float], by: str = BY_SPEED) -> MotorUse:
    return MotorUse(efforts={by: float(np.mean(thrusts))})


def changed(thrusts: list[float], by: str = BY_SPEED) -> MassChange:
    told = Sharing(np.array([shares(thrusts), *[shares([1.0] * 4)] * 6]), np.zeros(4))
    found = mass_change(use(thrusts, by), [use([1.0] * 4, by)] * 6, told, PLACES)
    assert isinstance(found, MassChange)
    return found


def test_a_load_in_the_middle_is_a_mass() -> None:
    found = changed([1.2] * 4)
    assert found.share.value == pytest.approx(0.2)
    assert found.share.low < 0.2 < found.share.high < 0.26
    assert (found.fits, found.side) == (("payload",), "")


def test_a_load_at_a_side_is_told_with_its_side() -> None:
    found = changed([1.1, 1.1, 1.3, 1.3])
    assert (found.fits, found.side) == (("payload",), "left")


def test_a_centre_that_moved_makes_no_mass() -> None:
    found = changed([1.0, 0.85, 1.0, 1.15])
    assert found.share.value == pytest.approx(0.0)
    assert "moved centre of gravity" in found.fits
    assert found.side == "front left"
    assert not found.weak_motors(4)


@pytest.mark.parametrize(("front", "right"), [(0.0, 0.0), (0.1, 0.0), (-0.05, 0.08)])
def test_how_far_the_centre_of_gravity_has_moved_has_an_interval(front: float, right: float) -> None:
    """Of the arm, as thrust that rotors on a side give more; a scatter of 1.5 % of it hides 2 to 4 %."""
    found = changed((1.0 + PLACES[:, :2] @ [front, right]).tolist())
    for one, true in zip(found.moved, (front, right), strict=True):
        assert one.value == pytest.approx(true, abs=0.01)
        assert 0.015 < one.half_width < 0.03


def test_a_weak_motor_works_harder_alone() -> None:
    found = changed([1.0, 1.0, 1.25, 1.0])
    assert found.fits == ("weak motor 3",)
    assert (found.weak_motors(3), found.may_be_heavier) == ((3,), False)


def test_what_is_within_the_scatter_is_nothing() -> None:
    found = changed([1.0, 1.02, 0.99, 1.0], BY_COMMAND)
    assert found.fits == ("nothing",)
    assert found.share.low < 0.0 < found.share.high
    assert found.weak_motors(2) == ()


def test_what_tells_less_has_a_wider_interval() -> None:
    widths = [changed([1.2] * 4, by).share.half_width for by in (BY_SPEED, BY_VOLTAGE, BY_COMMAND)]
    assert widths == sorted(widths)


@pytest.mark.parametrize(("by", "half"), [(BY_SPEED, 0.018), (BY_VOLTAGE, 0.076), (BY_COMMAND, 0.109)])
def test_the_interval_of_mass_is_the_scatter_of_good_flights(by: str, half: float) -> None:
    assert changed([1.0] * 4, by).share.half_width == pytest.approx(half, rel=0.05)


@pytest.mark.parametrize(("first", "count"), [(1.04, 3), (1.03, 1)])
def test_another_motor_that_fits_a_little_worse_is_named_beside_the_first(first: float, count: int) -> None:
    """Its squares are less than 3.84 more than those of motor 3, or up to twice as many."""
    fits = changed([first, 1.0, 1.06, 1.0]).fits
    assert "weak motor 3" in fits
    assert len(fits) == count


def test_of_good_flights_one_in_twenty_is_more_than_nothing() -> None:
    """Against many earlier flights, which tell the scatter."""
    rng, changed_ones, count = np.random.default_rng(0), 0, 400
    for _ in range(count):
        scattered = rng.normal(1.0, 0.015, (31, 4))
        told = Sharing(scattered / scattered.mean(axis=1, keepdims=True) - 1.0, np.zeros(4))
        own, *before = (MotorUse(efforts={BY_SPEED: float(one)}) for one in rng.normal(1.0, 0.01, 31))
        found = mass_change(own, before, told, PLACES)
        assert isinstance(found, MassChange)
        changed_ones += found.fits != ("nothing",)
    assert changed_ones / count < 0.07


def test_flights_without_commands_tell_nothing() -> None:
    assert isinstance(mass_change(MotorUse(), [use([1.0] * 4)], "no commands", PLACES), str)
    told = Sharing(np.zeros((2, 4)), np.zeros(4))
    for given, places in ((told, None), ("no commands", PLACES)):
        assert mass_change(use([1.2] * 4), [use([1.0] * 4)], given, places).fits == ()


def test_efforts_are_over_the_specific_force_and_a_battery_that_never_changes_is_none() -> None:
    log = example()
    flight = flown(log)
    whole = efforts(log, flight, tachometers_read=False)
    doubled = replace(log, imu=Series(log.imu.time, 2.0 * log.imu.values))
    assert efforts(doubled, flight, tachometers_read=False)[BY_COMMAND] == pytest.approx(
        0.5 * whole[BY_COMMAND]
    )
    held = replace(log, battery=Series(log.commands.time, np.full((len(log.commands), 1), 3.7)))
    assert BY_VOLTAGE not in efforts(held, flight, tachometers_read=False)


def flights(paths: list[Path], before: list[Path]) -> list[MassChange]:
    return [one.mass_change for one in report_on(paths, ReadingOptions(), against=before).flights]


def test_a_real_payload_is_told_from_two_reports(shared_data: Path) -> None:
    """7.4 g with hook and cable on 37 g, by rotor speeds; where tachometers read half, by commands."""
    bare = sorted((shared_data / "imrc_brushless").glob("eckart*"))
    loaded = [shared_data / "imrc_payload" / f"eckart{number}" for number in (14, 17, 20, 24, 46, 51, 62, 82)]
    found = flights(loaded, bare)
    assert all(one.share.low > 0.09 for one in found)
    assert np.median([one.share.value for one in found]) * 37.0 == pytest.approx(7.4, rel=0.15)
    assert [one.by for one in found].count(BY_VOLTAGE) == 1
    assert all(one.share.low < 0.0 < one.share.high for one in flights(bare[6:], bare[:6]))


def test_a_nut_near_a_motor_and_a_short_propeller_are_told_and_normal_flights_are_not(
    shared_data: Path,
) -> None:
    folder = shared_data / "crazypad"
    normal = sorted(folder.glob("normal_flight_E9*"))
    for kind in ("add_weight_W3", "cut_propeller_M3_3mm"):
        for one in flights(sorted(folder.glob(f"{kind}*E9*")), normal):
            assert 3 in one.weak_motors(3)
            # Yaw grows as by a weak motor, which a nut beside its propeller makes too.
            assert one.side == ("rear left" if kind == "add_weight_W3" else "")
    for one in flights(normal, normal):
        assert (one.fits, one.side) == (("nothing",), "")
        assert all(own.low < 0.0 < own.high for own in one.moved)


def test_a_battery_that_is_logged_late_spoils_no_sample() -> None:
    """What thrust goes with is a mean over steps, of the commands from the first voltage on."""
    log = example()
    late = replace(log, battery=Series(log.battery.time[10:], log.battery.values[10:]))
    whole, part = (efforts(one, flown(one), tachometers_read=False)[BY_VOLTAGE] for one in (log, late))
    begin = replace(log, commands=Series(log.commands.time[2000:], log.commands.values[2000:]))
    assert part == pytest.approx(efforts(begin, flown(log), tachometers_read=False)[BY_VOLTAGE], rel=1e-3)
    assert part == pytest.approx(whole, rel=0.02)
