# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Multicopters that would pass for a quadrotor are refused by name, other vehicles noted, quadrotors read."""

from __future__ import annotations

import pytest

from quadpi_core.errors import LogError
from quadpi_core.logs.airframes import Airframe, has_quadrotor


@pytest.mark.parametrize(
    ("rotors", "name"), [(3, "a tricopter"), (5, "a vehicle of 5 rotors"), (8, "an octocopter")]
)
def test_other_multicopters_are_refused_by_name(rotors: int, name: str) -> None:
    with pytest.raises(LogError, match=rf"^a\.log: N {rotors} is {name}; quadpi supports quadrotors$"):
        has_quadrotor("a.log", Airframe.of_rotors(f"N {rotors}", rotors))


@pytest.mark.parametrize(("mav_type", "is_quadrotor"), [(0, True), (2, True), (1, False), (21, False)])
def test_what_is_no_multicopter_is_noted(mav_type: int, is_quadrotor: bool, caplog) -> None:
    assert has_quadrotor("a.log", Airframe.of_mav_type("MAV_TYPE", mav_type)) is is_quadrotor
    assert ("rules out identification, prediction and replay" in caplog.text) is not is_quadrotor
