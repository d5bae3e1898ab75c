# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Thrust over command as PX4 and ArduPilot have it, and the thrust of hover, from logged commands.

    T / T_max = e u² + (1 − e) u,      e = THR_MDL_FAC = MOT_THST_EXPO,

over the command u of a motor, between the ends of the range in which it turns. The relative slope at hover,
g = (dT/T) / (du/u), tells e without the thrust of full command: e = (g − 1) / (g (1 − u) + 2 u − 1).
Source: PX4's FunctionMotors.hpp; ArduPilot's AP_MotorsMulticopter, apply_thrust_curve_and_volt_scaling.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadpi_core.field.estimates import Estimate, not_identified, within
from quadpi_core.field.field_log import FieldLog
from quadpi_core.field.motor_use import MotorUse

_UNIT = "of full thrust"
# Of an exponent between 0 and 1: a wider interval tells a straight line from a parabola no more.
_WIDEST = 0.6
# By how much an exponent may lie outside 0 to 1: the slope is that at the usual command, not at hover itself.
_BEYOND = 0.1


class ThrustCurve(NamedTuple):
    """Of one vehicle.

    Attributes:
        exponent: e, between 0, thrust linear in command, and 1, quadratic.
        hover: thrust of hover over that of full command.
    """

    exponent: Estimate
    hover: Estimate


def untold_curve(reason: str) -> ThrustCurve:
    """No curve, and why."""
    return ThrustCurve(not_identified("", reason), not_identified(_UNIT, reason))


def thrust_curve(flights: Sequence[tuple[FieldLog, MotorUse]]) -> ThrustCurve:
    """The curve of a vehicle: the mean over its flights, with an interval that holds those of all.

    Args:
        flights: logs, and what their commands tell.
    """
    curves = [_of_flight(log, use) for log, use in flights]
    return ThrustCurve(*(_together([getattr(one, name) for one in curves]) for name in ThrustCurve._fields))


def _together(all_of: Sequence[Estimate]) -> Estimate:
    told = [one for one in all_of if one.value is not None and one.low is not None and one.high is not None]
    if not told:
        return all_of[0]
    values, lows, highs = zip(*((one.value, one.low, one.high) for one in told), strict=True)
    reason = told[0].reason if len(told) == 1 else f"{told[0].reason}; of {len(told)} flights"
    return Estimate(float(np.mean(values)), min(lows), max(highs), told[0].unit, reason)


def _of_flight(log: FieldLog, use: MotorUse) -> ThrustCurve:
    hover, gain = use.hover, use.thrust_gain
    if hover is None or hover.value is None or hover.low is None or hover.high is None:
        said = "commands of no hover in the log" if hover is None else hover.reason or "no interval of hover"
        return untold_curve(said.removeprefix("not identified: "))
    if (present := log.parameters.get("THR_MDL_FAC", 0.0)) != 0.0:
        # PX4 logs commands before that curve, at which they are thrust already.
        said = (
            f"commands in the log are before the present THR_MDL_FAC, {present:g}: set it to 0 and fly again"
        )
        return ThrustCurve(not_identified("", said), _kept(hover, f"with THR_MDL_FAC {present:g} as it is"))
    low = log.parameters.get("MOT_SPIN_MIN", 0.0)
    span = log.parameters.get("MOT_SPIN_MAX", 1.0) - low
    # The ends of hover with the slopes that go with them: both intervals are worst together.
    commands = [(end - low) / span for end in (hover.value, hover.low, hover.high)]
    exponent = _exponent(gain, span, commands)
    if exponent.value is not None and exponent.low is not None and exponent.high is not None:
        pairs = zip(commands, (exponent.value, exponent.high, exponent.low), strict=True)
        thrust = [e * u * u + (1.0 - e) * u for u, e in pairs]
        return ThrustCurve(exponent, within(thrust, _UNIT, "with this exponent, at the logs' weight and air"))
    if "MOT_THST_EXPO" in log.parameters:
        e = log.parameters["MOT_THST_EXPO"]
        thrust = [e * u * u + (1.0 - e) * u for u in commands]
        return ThrustCurve(exponent, within(thrust, _UNIT, f"with MOT_THST_EXPO {e:g} as it is"))
    return ThrustCurve(exponent, _kept(hover, "with thrust taken as linear in command"))


def _kept(hover: Estimate, condition: str) -> Estimate:
    return Estimate(hover.value, hover.low, hover.high, _UNIT, condition)


def _exponent(gain: Estimate | None, span: float, commands: Sequence[float]) -> Estimate:
    """Exponent with its interval; values beyond 0 to 1 are of no motor."""
    if gain is None or gain.value is None or gain.low is None or gain.high is None:
        said = "thrust over command" if gain is None else gain.reason.removeprefix("not identified: ")
        return not_identified("", said)
    u = commands[0]
    slopes = np.array([gain.value, gain.low, gain.high]) * span * u
    found = (slopes - 1.0) / (slopes * (1.0 - u) + 2.0 * u - 1.0)
    value, low, high = found.tolist()
    if (
        not (0.0 < u < 1.0 and np.all(slopes * (1.0 - u) + 2.0 * u > 1.0))
        or high < -_BEYOND
        or low > 1.0 + _BEYOND
    ):
        return not_identified("", "no motor gives thrust as these commands say: they answered to disturbance")
    value, low, high = np.clip([value, low, high], 0.0, 1.0).tolist()
    if high - low > _WIDEST:
        return not_identified("", "its interval is too wide: climb and descend", low, high)
    return Estimate(value, low, high, "", "over the range in which the motors turn")
