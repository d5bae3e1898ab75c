# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of quadpi: all are built, and their definitions say what numbers mean."""

from __future__ import annotations

from pathlib import Path

import pytest
from quadpi import msg as quadpi_msg

MESSAGES = ("AlarmEvent", "Erpm", "ExtrapolationAlarm", "MotorCommands", "RotorSpeeds", "WrenchPrediction")


def test_alarm_constants_are_distinct_bits() -> None:
    alarm = quadpi_msg.ExtrapolationAlarm
    assert (alarm.EXTRAPOLATION, alarm.MISCOVERAGE, alarm.BAD_DATA) == (1, 2, 4)
    assert (alarm.LEVEL_OK, alarm.LEVEL_WARNING, alarm.LEVEL_ALARM) == (0, 1, 2)


def test_every_definition_is_built() -> None:
    definitions = Path(__file__).parents[2] / "msg"
    assert {path.stem for path in definitions.glob("*.msg")} == set(MESSAGES)
    assert all(hasattr(quadpi_msg, name) for name in MESSAGES)


@pytest.mark.parametrize("name", MESSAGES)
def test_every_number_names_its_unit(name: str) -> None:
    definition = (Path(__file__).parents[2] / "msg" / f"{name}.msg").read_text()
    fields = [
        line for line in definition.splitlines() if line.startswith(("float64", "uint8", "geometry_msgs"))
    ]
    values = [line for line in fields if "=" not in line.split("#")[0]]
    assert values
    assert all(line.rstrip().endswith("]") for line in values)
