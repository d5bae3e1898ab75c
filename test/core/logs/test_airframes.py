# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Multicopters of another number of rotors than the vehicle's are refused by name, other vehicles noted."""

from __future__ import annotations

import pytest

from quadpi_core.errors import LogError
from quadpi_core.logs.reader_steps import Airframe, has_rotors
from quadpi_core.vehicle import Vehicle


@pytest.mark.parametrize(
    ("rotors", "name"), [(3, "a tricopter"), (5, "a vehicle of 5 rotors"), (8, "an octocopter")]
)
def test_other_multicopters_are_refused_by_name(rotors: int, name: str) -> None:
    airframe = Airframe.of_rotors(f"N {rotors}", rotors)
    with pytest.raises(LogError, match=rf"^a\.log: N {rotors} is {name}; vehicle bebop2 has 4 rotors$"):
        has_rotors("a.log", airframe, Vehicle.load("bebop2"))
    assert has_rotors("a.log", airframe, None)


@pytest.mark.parametrize(("mav_type", "its_rotors"), [(0, True), (2, True), (1, False), (21, False)])
def test_what_is_no_multicopter_is_noted(mav_type: int, its_rotors: bool, caplog) -> None:
    assert has_rotors("a.log", Airframe.of_mav_type("MAV_TYPE", mav_type), None) is its_rotors
    assert ("rules out identification, prediction and replay" in caplog.text) is not its_rotors
