# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Rotor speeds from commands, and tachometers that read another multiple."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.field.airborne import Stretch, flown
from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.field.field_reading import read_field_log
from quadpi_core.field.motor_model import MotorModel, Tachometers, motor_model, tachometers
from quadpi_core.reading_options import ReadingOptions

from .field_examples import DEAD_S, LAG_S, example


def model_of(*logs: FieldLog) -> MotorModel:
    model = motor_model([(log, flown(log)) for log in logs])
    assert isinstance(model, MotorModel), model
    return model


def read(*scales: float) -> FieldLog:
    log = example()
    return replace(
        log, rotor_speeds=Series(log.rotor_speeds.time, log.rotor_speeds.values * np.array(scales))
    )


def test_an_exact_motor_is_found():
    model = model_of(example())
    assert model.error < 2.5e-3
    assert model.lag.value == pytest.approx(LAG_S, abs=0.005)
    assert model.lag.low < LAG_S < model.lag.high
    assert model.lag.half_width < 0.01
    assert model.dead_s == pytest.approx(DEAD_S, abs=0.005)
    assert (model.with_battery, model.flights) == (True, 1)


def test_a_battery_that_is_not_logged_is_a_gain_of_each_flight():
    fresh, low = read(1.05, 1.05, 1.05, 1.05), read(0.95, 0.95, 0.95, 0.95)
    model = model_of(*(replace(log, battery=None) for log in (fresh, low, fresh, low)))
    assert (model.with_battery, model.flights) == (False, 4)
    assert model.error > 0.06
    assert model.error_scaled < 0.5 * model.error


def test_an_interval_by_other_flights_holds_what_is_left_out_of_all():
    """Flights that differ by a gain, beside one that differs by more, which the others do not cover."""
    rng = np.random.default_rng(3)
    logs = [example(seed) for seed in range(5)]
    noisy = [
        replace(
            log,
            rotor_speeds=Series(
                log.rotor_speeds.time,
                log.rotor_speeds.values + rng.normal(0.0, 20.0, log.rotor_speeds.values.shape),
            ),
        )
        for log in logs
    ]
    model = model_of(*noisy)
    assert model.width == pytest.approx(1.96 * model.error, rel=0.1)
    assert model.coverage == pytest.approx(0.95, abs=0.01)
    odd = replace(
        noisy[0], rotor_speeds=Series(logs[0].rotor_speeds.time, 1.1 * noisy[0].rotor_speeds.values)
    )
    assert model_of(odd, *noisy[1:]).coverage < 0.9


def test_a_half_reading_tachometer_is_named():
    log = read(1.0, 1.0, 0.5, 1.0)
    found = tachometers(log, flown(log))
    assert isinstance(found, Tachometers)
    assert found.odd == (3,)
    assert found.ratio[2] == pytest.approx(0.5, abs=0.02)
    sound = tachometers(example(), flown(example()))
    assert isinstance(sound, Tachometers)
    assert sound.odd == ()


def test_a_lag_at_the_end_of_the_grid_is_not_told():
    """Speeds that follow at once, as of a simulator, and ones that follow a quarter of a minute late."""
    log = example()
    for speeds in (log.commands.values, np.roll(log.commands.values, 3000, axis=0)):
        turning = Series(log.commands.time, 300.0 + 1500.0 * speeds)
        assert model_of(replace(log, rotor_speeds=turning)).lag.value is None


@pytest.mark.parametrize("seconds", np.arange(2.0, 2.06, 0.005))
def test_a_flight_is_too_short_for_every_dead_time_or_for_none(seconds):
    log = example()
    short = {name: own.during(10.0, 10.0 + seconds) for name, own in log.series().items()}
    log = replace(replace(log, **short), battery=None)
    flight = replace(flown(example()), stretches=(Stretch(10.0, 10.0 + seconds),))
    found = motor_model([(log, flight)])
    assert found == "the flight is too short" or found.error < 0.01


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rotor_speeds": None}, "has not both commands and rotor speeds"),
        ({"commands": Series(np.arange(0.0, 60.0, 0.1), np.full((600, 4), 0.4))}, "logged at 10 Hz"),
        ({"commands": Series(np.arange(0.0, 60.0, 0.01), np.full((6000, 6), 0.4))}, "6 commands for 4"),
    ],
)
def test_what_is_lacking_is_said(changes, said):
    log = example(**changes)
    assert said in motor_model([(log, flown(log))])
    assert said in tachometers(log, flown(log))


@pytest.mark.parametrize(
    ("flights", "most", "scaled"),
    [
        ("imrc_brushless/eckart*", 0.006, 0.006),
        ("imrc_payload/eckart*", 0.009, 0.009),
        ("indiflight/*", 0.03, 0.02),
        ("imrc_brushed/*", 0.012, 0.012),
    ],
)
def test_errors_on_unseen_real_flights(shared_data: Path, flights: str, most: float, scaled: float):
    """Every flight that reads: each fifth is judged by a fit on the others."""
    logs = [read_field_log(path, ReadingOptions()) for path in sorted(shared_data.glob(flights))]
    known = [(log, flown(log)) for log in logs]
    sound = [(log, own) for log, own in known if not getattr(tachometers(log, own), "odd", ())]
    model = motor_model(sound)
    assert isinstance(model, MotorModel)
    assert model.error <= most
    assert model.error_scaled <= scaled


def test_real_half_reading_tachometers_are_found_and_no_others(shared_data: Path):
    odd = {}
    for path in sorted((shared_data / "imrc_payload").iterdir()):
        log = read_field_log(path, ReadingOptions())
        found = tachometers(log, flown(log))
        assert isinstance(found, Tachometers)
        odd[path.name] = found.odd
    assert {name: rotors for name, rotors in odd.items() if rotors} == {
        "eckart51": (3,),
        "eckart52": (3,),
        "eckart53": (3,),
    }


@pytest.mark.parametrize("order", [[1, 0, 2, 3], [3, 2, 1, 0]])
def test_commands_in_another_order_than_the_rotors_are_told(shared_data: Path, order: list[int]) -> None:
    log = read_field_log(shared_data / "imrc_brushless" / "eckart06", ReadingOptions())
    assert tachometers(log, flown(log)).order == ()
    swapped = replace(log, commands=Series(log.commands.time, log.commands.values[:, order]))
    assert tachometers(swapped, flown(log)).order == tuple(one + 1 for one in np.argsort(order))


def test_one_rotor_has_none_to_be_compared_with():
    log = example()
    commands, speeds = (Series(one.time, one.values[:, :1]) for one in (log.commands, log.rotor_speeds))
    said = tachometers(replace(log, rotors=1, commands=commands, rotor_speeds=speeds), flown(log))
    assert said == "one rotor has none beside it"
