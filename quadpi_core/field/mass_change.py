# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a vehicle has become heavier, or its centre of gravity has moved, against earlier flights.

Heavier, all rotors work harder for the same specific force, near the load more so. A centre of gravity that
has moved makes rotors on its side work harder and those across less, and all together as before. A rotor that
gives less thrust works harder alone. Of what fits all of these are named that cannot be told apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from quadpi_core.field.airborne import Flown, averages
from quadpi_core.field.damage import SCATTER, THRUST_EXPONENT, Sharing, against
from quadpi_core.field.estimates import CONFIDENCE, Estimate, not_identified, within
from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.field.motor_use import MotorUse
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, STANDARD_GRAVITY, Threshold

WEAK, MOVED = "weak motor", "moved centre of gravity"
BY_SPEED, BY_VOLTAGE, BY_COMMAND = "rotor speed", "command and battery voltage", "command"
EFFORT_SCATTER: Mapping[str, Threshold[float]] = {
    by: Threshold(f"standard deviation of thrust at the same {by}, between good flights", value, "", why, of)
    for by, value, why, of in (
        (BY_SPEED, 0.01, "airspeed and air density", "imrc_brushed and indiflight of ../shared/data"),
        (BY_VOLTAGE, 0.035, "packs and motors that warm", "imrc_brushed and nanobench of ../shared/data"),
        (BY_COMMAND, 0.05, "a pack loses a sixth of its voltage", "indiflight of ../shared/data"),
    )
}
SPEED_EXPONENT = Threshold(
    "power of rotor speed with which thrust goes: the least, the usual and the greatest",
    (1.9, 2.0, 2.2),
    "",
    "the thrust coefficient of small propellers grows with the Reynolds number",
    "R. Deters, G. Ananda, M. Selig, Reynolds number effects on small-scale propellers (AIAA 2014-2151)",
)
ANOTHER = Threshold(
    "squares by which one weak motor may fit worse than another and be named beside it",
    3.84,
    "variances",
    "the 95 % quantile of chi-square with one degree of freedom",
    CONVENTION,
)
_STEP_S = 0.1
_Arrays = tuple[Array, ...]


@dataclass(frozen=True)
class MassChange:
    """A flight against earlier ones.

    Attributes:
        share: of the mass that has come, or gone if below 0.
        by: what told it, see :data:`EFFORT_SCATTER`.
        fits: what explains how the rotors share the work: "nothing", "moved centre of gravity", "payload",
            "weak motor 1" …; empty where nothing known does, or the places of the motors are not known.
        side: of a payload or the centre of gravity, in words, if it is one; empty at the middle.
        moved: centre of gravity, forward and right, if all that has changed is it; empty where not told.
    """

    share: Estimate
    by: str
    fits: tuple[str, ...]
    side: str = ""
    moved: tuple[Estimate, ...] = ()

    def weak_motors(self, worst: int) -> tuple[int, ...]:
        """Motors, from 1, that may be weak: the hardest working and others that fit; none if none does."""
        weak = [int(name.split()[-1]) for name in self.fits if name.startswith(WEAK)]
        return tuple(dict.fromkeys((worst, *weak))) if weak or not self.fits else ()

    @property
    def may_be_heavier(self) -> bool:
        """Whether a load may be what has changed, for all that the sharing of the rotors tells."""
        return not all(name.startswith(WEAK) for name in self.fits) or not self.fits


def efforts(log: FieldLog, flight: Flown, *, tachometers_read: bool) -> dict[str, float]:
    """What thrust goes with, over the specific force that it gave, on average of a flight, by what tells it.

    Without an accelerometer the specific force is that of gravity: it is so on average of flights near hover.

    Args:
        log: of the flight.
        flight: its stretches in the air.
        tachometers_read: whether the rotor speeds are those of the rotors.
    """
    found: dict[str, float] = {}
    if log.rotor_speeds is not None and tachometers_read:
        squares = np.mean(log.rotor_speeds.values**2, axis=1, keepdims=True)
        found[BY_SPEED] = _over_force(log, flight, Series(log.rotor_speeds.time, squares))
    if log.commands is not None:
        usual = THRUST_EXPONENT.value[1]
        load = np.mean(np.maximum(log.commands.values, 0.0) ** usual, axis=1, keepdims=True)
        found[BY_COMMAND] = _over_force(log, flight, Series(log.commands.time, load))
        # A battery that never changes was not measured.
        if log.battery is not None and np.ptp(log.battery.values) > 0.0:
            volts = np.maximum(log.battery.at(log.commands.time), 0.0) ** usual
            told = np.isfinite(volts[:, 0])
            found[BY_VOLTAGE] = _over_force(
                log, flight, Series(log.commands.time[told], (load * volts)[told])
            )
    return {by: value for by, value in found.items() if np.isfinite(value) and value > 0.0}


def _over_force(log: FieldLog, flight: Flown, load: Series) -> float:
    force = Series(load.time, np.full((len(load), 1), STANDARD_GRAVITY))
    if log.imu is not None:
        force = Series(log.imu.time, -log.imu.values[:, 5:])
    loads, forces = (own.sum() for own in averages(flight.stretches, _STEP_S, load, force).means)
    return float(loads / forces) if forces > 0.0 else np.nan


def mass_change(
    use: MotorUse, references: Sequence[MotorUse], told: Sharing | str, places: Array | None
) -> MassChange | str:
    """What has changed since earlier flights, or why it cannot be told.

    Args:
        use: of the flight.
        references: of good flights of the same vehicle.
        told: how the motors share the work in all of them, or why that is not known.
        places: of the motors as `FieldLog.places` has them; None where not known.
    """
    known = {by: [one.efforts[by] for one in references if by in one.efforts] for by in EFFORT_SCATTER}
    by = next((by for by, own in known.items() if own and by in use.efforts), None)
    if by is None:
        return "no rotor speeds, and no commands, are both in the flight and in one before"
    before = np.log(known[by])
    ratio, deviation, freedom = against(np.log(use.efforts[by]), before, EFFORT_SCATTER[by].value)
    half = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE.value, freedom)) * deviation
    usual = (SPEED_EXPONENT if by == BY_SPEED else THRUST_EXPONENT).value
    powers = [one / usual[1] for one in usual]
    ends = [float(np.expm1(power * (ratio + side * half))) for power in powers for side in (-1.0, 1.0)]
    count = len(before)
    said = f"by {by}, against {count} flight{'s' * (count > 1)}"
    share = within((float(np.expm1(ratio)), min(ends), max(ends)), "", said)
    if min(ends) <= -1.0:
        share = not_identified("", "thrust is a fraction of what it was")
    if isinstance(told, str) or places is None or not np.isfinite(told.error).all():
        return MassChange(share, by, ())
    if not told.shares.shape[1] == len(places) == 4 or not np.all(places[:, :2]):
        return MassChange(share, by, ())
    # Over the mean of all four a rotor deviates by three quarters of what it does over the others.
    value, scatter, _ = against(told.shares[0], told.shares[1:], 0.75 * SCATTER.value, told.error)
    # The mean takes one of four numbers from the deviations: a rotor by itself deviates by more.
    power, wider = THRUST_EXPONENT.value[1], np.sqrt(4.0 / 3.0)
    pattern = power * value, power * wider * scatter, np.sign(places[:, :2])
    return _explained(share, by, pattern, (ratio, deviation), freedom)


def _explained(share: Estimate, by: str, pattern: _Arrays, thrust: _Arrays, freedom: int) -> MassChange:
    """Which changes fit, of those with the fewest parameters that explain the sharing and the sum."""
    work, deviation, sides = pattern
    rotors, yaw = len(work), sides[:, 0] * sides[:, 1]
    # Of the mean of four, with signs.
    half = 0.5 * float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE.value, freedom) * np.mean(deviation))
    shifts: Array = work @ sides / rotors
    ways = [within((own, own - half, own + half), "of the arm") for own in shifts.tolist()]
    weights = 1.0 / np.append(deviation, max(float(thrust[1]), 1e-9))
    seen = np.append(work, float(thrust[0])) * weights
    moved, mean = np.vstack([sides, np.zeros(2)]), 1.0 / rotors
    # It is commanded more to give what it gave; its torque may differ, which yaw answers.
    lost = [np.column_stack([np.append(own - mean, mean), np.append(yaw, 0.0)]) for own in np.eye(rotors)]
    tried = {"nothing": np.zeros((rotors + 1, 0)), MOVED: moved}
    tried |= {f"{WEAK} {rotor + 1}": columns for rotor, columns in enumerate(lost)}
    tried["payload"] = np.column_stack([moved, np.append(np.zeros(rotors), 1.0)])
    fits: list[tuple[float, str]] = []
    position: Array = np.where(np.abs(shifts) > half, shifts, 0.0)
    for name, columns in tried.items():
        found = np.linalg.lstsq(weights[:, np.newaxis] * columns, seen, rcond=None)[0]
        left = seen - weights[:, np.newaxis] * columns @ found
        # The sum of what rotors give beyond their mean is 0 by definition: one number less is seen.
        open_to = rotors - columns.shape[1]
        chi = float(left @ left) / open_to
        is_possible = not (name.startswith(WEAK) and found[0] <= 0.0) and not (
            name == "payload" and found[2] <= 0.0
        )
        if is_possible and chi < stats.f.ppf(CONFIDENCE.value, open_to, freedom):
            fits.append((float(left @ left), name))
            if name in (MOVED, "payload"):
                position = np.asarray(found[:2], dtype=np.float64)
    if any(name == "nothing" for _, name in fits):
        return MassChange(share, by, ("nothing",), "", tuple(ways))
    best = min((squares for squares, name in fits if name.startswith(WEAK)), default=0.0)
    names = [name for squares, name in fits if not name.startswith(WEAK) or squares < best + ANOTHER.value]
    least, words = float(np.mean(deviation)), (("front", "rear"), ("right", "left"))
    side = (pair[int(one < 0.0)] for one, pair in zip(position, words, strict=True) if abs(one) >= least)
    return MassChange(share, by, tuple(names), " ".join(side), tuple(ways))
