# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.models.fitted_physical import PhysicalFit
from quadpi_core.models.kinds.physical import PhysicalStudy
from quadpi_core.models.physical_fit import PhysicalFlight, Sensing
from quadpi_core.models.physical_terms import (
    delay_untold,
    delay_words,
    missing_flying,
    physical_vehicle,
    wrenches,
)
from quadpi_core.records import Records
from test.core.models.physical_flights import NOISE, REFERENCE, VEHICLE, flown, known_parameters


def fitted(*flights: PhysicalFlight) -> PhysicalFit:
    return PhysicalStudy.from_flights(flights, VEHICLE, sensing=Sensing()).fit(choose=False)


def measured(flight: PhysicalFlight, motion: Records) -> PhysicalFlight:
    """A flight with another motion, which needs not obey any controller, and its noisy wrench."""
    wrench = wrenches(motion, physical_vehicle(VEHICLE, REFERENCE), known_parameters())
    noise = NOISE * np.random.default_rng(3).normal(size=wrench.shape)
    return replace(flight, motion=motion, wrench=wrench + noise)


@pytest.fixture(scope="module")
def hover() -> PhysicalFlight:
    return flown(10.0, 1, speed=0.0)


@pytest.fixture(scope="module")
def throttled(hover: PhysicalFlight) -> PhysicalFlight:
    """Hover with steps of all rotors, 15 % up and down."""
    motion = hover.motion.copy()
    motion["rotor_speeds"] *= 1.0 + 0.15 * np.sign(np.sin(2.0 * hover.time))[:, np.newaxis]
    return measured(hover, motion)


@pytest.fixture(scope="module")
def rolling(hover: PhysicalFlight) -> PhysicalFlight:
    """Hover with rotors that differ one way and the other, as rolls, pitches and yaw need."""
    motion = hover.motion.copy()
    signs = np.array([[1, 1, -1, -1], [1, -1, -1, 1], [1, -1, 1, -1]])
    waves = np.sin(np.outer(hover.time, [2.0, 3.1, 4.3]))
    motion["rotor_speeds"] *= 1.0 + 0.15 * waves @ signs
    return measured(hover, motion)


def test_hover_asks_for_everything_but_hover(hover: PhysicalFlight) -> None:
    notes = fitted(hover).notes
    assert "thrust" not in notes
    assert notes["drag_x"] == "not identified by these flights: fly forward and backward flight"
    assert notes["damping_r"].endswith("fly yaw turns")
    assert notes["inertia_z"].endswith("fly fast turns")
    assert notes["drag_z"].endswith("fly fast climbs and descents")
    assert not [note for note in notes.values() if "fly hover" in note]
    said = "not identified by these flights, which hardly tell it from incline_x: fly throttle steps"
    assert notes["bias_x"] == said


@pytest.mark.parametrize(
    ("names", "flight"),
    [
        (("bias_x", "bias_y", "bias_z"), "throttled"),
        (("torque_rotor_1", "torque_rotor_2", "torque_rotor_3"), "rolling"),
    ],
)
def test_the_manoeuvre_that_is_asked_for_tells(
    hover: PhysicalFlight, names: tuple[str, ...], flight: str, request: pytest.FixtureRequest
) -> None:
    asked = {"throttled": "fly throttle steps", "rolling": "fly fast rolls and pitches"}[flight]
    before = fitted(hover)
    after = fitted(hover, request.getfixturevalue(flight))
    assert set(names) <= {name for name, note in before.notes.items() if note.endswith(asked)}
    assert not set(names) & set(after.notes)


@pytest.mark.parametrize("speeds", [(4.0,), (1.0, 3.0, 6.0)])
def test_one_speed_does_not_tell_powers_of_the_speed_apart(
    hover: PhysicalFlight, speeds: tuple[float, ...]
) -> None:
    """Lift with h², h³/ω and ω h, of which flights at one speed know the sum alone."""
    flights = []
    for speed in speeds:
        motion = hover.motion.copy()
        motion["velocity"] = [0.0, speed, 0.0]
        flights.append(measured(hover, motion))
    note = fitted(*flights).notes.get("thrust_in_plane", "")
    assert note.endswith("fly fast flight in all directions at several speeds") == (len(speeds) == 1)


def test_what_to_fly_is_summed_up() -> None:
    names = ["drag_x", "bias_x", "pitch_u"]
    assert missing_flying(names, 98) == (
        "3 of 98 parameters are not identified by these flights; what would tell them, and how many: "
        "forward and backward flight (2), throttle steps (1)"
    )
    assert missing_flying([], 98) == ""


def test_hover_leaves_the_delay_open(hover: PhysicalFlight) -> None:
    study = PhysicalStudy.from_flights([hover], VEHICLE)
    assert study.sensing.rotor_delay_s == 0.0
    assert study.delay_range_s == (0.0, 0.015)
    assert delay_words(0.0, study.delay_range_s, 0.015) == (
        "rotor speeds are taken to act 0 ms after they were measured, as these flights do not tell delays of "
        "0 to 15 ms apart: fly fast rolls and pitches"
    )


def test_words_on_delays() -> None:
    assert delay_words(0.005, None, 0.015) == "rotor speeds act 5 ms after they were measured"
    assert delay_words(0.005, (0.0025, 0.0075), 0.015).endswith("were measured (2.5 to 7.5 ms)")
    assert delay_words(0.015, (0.015, 0.015), 0.015).endswith("measured, or later: no longer delay is tried")
    assert "or later" in delay_words(0.0125, (0.005, 0.015), 0.015)
    # A range without the default is told, however wide; one with it where it is narrow.
    assert not delay_untold((0.0025, 0.015))
    assert not delay_untold((0.0, 0.0075))
    assert delay_untold((0.0, 0.01))
