# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The consistency check: findings on a recording and its vehicle, each with the likeliest mistake and remedy.

docs/mistakes.md says which mistakes it can and cannot find, experiments/results/mistakes.md how the
thresholds compare with real flights.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from quadpi_core.errors import LogError
from quadpi_core.findings import Finding
from quadpi_core.flight import PoseStream, Recording
from quadpi_core.frames import Array
from quadpi_core.records import STANDARD_GRAVITY
from quadpi_core.screening.clock_consistency import (
    RotorEvidence,
    clock_mistake,
    rotor_clock_finding,
    rotor_evidence,
)
from quadpi_core.screening.excerpt import (
    Excerpt,
    Innovation,
    Pose,
    RotorExcerpt,
    cost,
    excerpt,
    innovation,
    rotor_excerpt,
)
from quadpi_core.screening.flight_runs import is_slow_state
from quadpi_core.screening.motion_consistency import Hypothesis, hypotheses, small_mistakes, without_repeats
from quadpi_core.screening.plausibility import check_plausible, is_slow, thrust_coefficient
from quadpi_core.screening.rotors_in_flight import stuck_rotors
from quadpi_core.screening.wild_samples import Beyond
from quadpi_core.vehicle import ROTORS, Vehicle

# A cost of 1 is what sensors of sound flights differ by (`motion.cost`). Of 139 real flights that any mistake
# explained better by half, none reached 1.8; mistakes on bundled flights begin at 3.5.
IMPLAUSIBLE_COST = 2.0
# Factor by which a hypothesis must lower the cost: real flights of an implausible cost reach 1.05, mistakes
# begin at 2.7.
EXPLAINS_FACTOR = 2.0
# From this cost and factor on a recording is refused.
CERTAIN_COST, CERTAIN_FACTOR = 10.0, 5.0
# Of the mistakes that explain a recording equally well, within this factor, the simplest is named.
_EQUAL_FACTOR = 1.1
# Rigid bodies of motion capture are defined, and IMUs mounted, to a few degrees; clocks keep time.
_SMALLEST_ANGLE_DEG, _SMALLEST_SCALE = 6.0, 1.12
# Rotor speeds as they come through telemetry are up to 30 ms late on real flights.
_LATE_S, _LATE_GAIN = 0.06, 0.1
# Share of the accelerations that the squares of the rotor speeds must explain before more is read from them.
_EXPLAINED = 0.25
# Correlations: real flights have 0.35 and more about roll and pitch, and between −0.2 and 1 about yaw.
_FOLLOWS, _ORDER_GAIN, _OPPOSES = 0.35, 0.5, -0.3
# Inertia times acceleration over arm times thrust is 0.3 to 1.2 on real flights; damping lowers it.
_INERTIA_RATIO = 1.35
# A rotor that reads low leaves roll, pitch and yaw unbalanced alike. Rotors of real flights differ by 5 %.
# In fewer windows a manoeuvre looks like that, by the root of their number: rotors of a bundled flight differ
# by 9 % over two windows.
_ROTOR_LOW, _ROTOR_LEFT, _ROTOR_WINDOWS = 0.07, 0.35, 4
# Thrust coefficient over that of the vehicle file: in hover, and where no state tells when that is. Flying
# through air lowers it, at 16 m/s to half. In hover sound flights have 0.97 to 1.07; a mass of 0.8 or 1.2
# times the true one leads to 0.78 to 0.85 and to 1.17 and more.
_HOVER_RATIO, _THRUST_RATIO = (0.88, 1.12), (0.4, 1.18)
# Share of the fast accelerations that the squares explain beyond chance: 0.37 and more in sound flights, 0.51
# where they are not processed; up to 0.23 with the rotor speeds of another flight of the same programme (0.37
# in flights of less than 5 s).
_OWN_SHARE = 0.3
# Growth of the thrust with Σω²: 0.69 to 1.43 in sound flights, and half of that where ω holds squares.
_SQUARES_GROWTH = 0.63
# Moment of inertia about z over mass times squared arm, where the moments look small, too: quadrotors have
# 0.29 to 0.7; arms of 1.5 times the length or half the inertia lead to 0.19 and less.
_YAW_INERTIA, _MOMENTS_SMALL = 0.2, 0.8


def checked(
    recording: Recording,
    vehicle: Vehicle,
    beyond: Mapping[str, Sequence[Beyond]] | None = None,
    *,
    filtered: bool = False,
) -> Recording:
    """The recording with the findings of the check in its `quality`.

    Of `filtered` signals only the motion is checked, as little is left of what rotors add.

    Raises:
        LogError: naming file and topic, for units and axes that cannot be right, and certain mistakes.
    """
    check_plausible(recording, vehicle, beyond)
    mistakes = tuple(findings(recording, None) if filtered else contradictions(recording, vehicle))
    for finding in mistakes:
        if finding.certain:
            raise LogError(f"{recording.source}: {finding}")
    return replace(recording, quality=replace(recording.quality, findings=mistakes))


def contradictions(recording: Recording, vehicle: Vehicle | None) -> Iterator[Finding]:
    """Those of :func:`findings`, and rotors whose sensor fails or that stop in flight.

    Speeds of a sensor that fails say nothing of the vehicle, so nothing else is made of them.

    Args:
        recording: with finite values and increasing stamps.
        vehicle: that flew.
    """
    # Commands that stand at full throttle are no sensor that fails.
    gravity = vehicle.gravity_m_s2 if vehicle else STANDARD_GRAVITY
    sensors = () if recording.commanded else tuple(stuck_rotors(recording, gravity))
    fails = any(finding.leave_out for finding in sensors)
    yield from findings(recording, None if fails else vehicle)
    yield from sensors


def findings(recording: Recording, vehicle: Vehicle | None) -> Iterator[Finding]:
    """Contradictions in a recording; without a vehicle, only the motion is checked.

    Args:
        recording: with finite values and increasing stamps.
        vehicle: that flew.
    """
    rotors = rotor_excerpt(recording)
    turned: Array | None = None
    # Slow states err by more than what is looked for here.
    slow = recording.odometry is None or is_slow_state(recording.odometry)
    given = (recording.pose, None if slow else recording.odometry)
    states: list[Pose] = [state for state in given if state is not None]
    for state in states:
        moving, frozen = without_repeats(state, recording.imu)
        if frozen is not None:
            yield frozen
        sample = excerpt(recording, moving)
        clock = clock_mistake(recording, moving, sample)
        mistakes = [] if sample is None else _motion(sample, measured=isinstance(state, PoseStream))
        if clock is not None and all(
            clock.cost < cost(after, before.motion) for _, before, after in mistakes
        ):
            yield clock.finding
            # Nothing else is made of what is stamped wrong.
            imu_alone = replace(recording, pose=None, twist=None)
            recording = imu_alone if isinstance(state, PoseStream) else replace(recording, odometry=None)
            continue
        for mistake in mistakes:
            culprit, gyro = "", mistake[0].gyro
            if gyro is not None and rotors is not None and vehicle is not None:
                imu_is_wrong = _rotors_follow_better(rotors, vehicle, gyro)
                turned = gyro if imu_is_wrong else turned
                culprit = f"; the rotor speeds agree with {state.topic if imu_is_wrong else 'the IMU'}"
            yield _finding(state.topic, mistake, culprit)
        if mistakes:
            # A mistake of the IMU shows in every state.
            break
    apart = rotor_clock_finding(recording, vehicle)
    if apart is not None:
        yield apart
    if vehicle is None:
        return
    if rotors is not None and turned is not None:
        rotors = replace(rotors, rates=rotors.rates @ turned.T)
    evidence = None if rotors is None else rotor_evidence(rotors, vehicle)
    if evidence is not None:
        yield from _rotor_findings(recording, evidence, vehicle)
    yield from _thrust(recording, vehicle)


_Mistake: TypeAlias = tuple[Hypothesis, Innovation, Innovation]


def _motion(sample: Excerpt, *, measured: bool) -> list[_Mistake]:
    """The mistakes that explain the innovations, each with those before and after its reversal."""

    def undone(of: Excerpt, found: Innovation, mistakes: Iterable[Hypothesis]) -> list[_Mistake]:
        return [(one, found, innovation(one.undo(of))) for one in mistakes]

    before = innovation(sample)
    small = undone(sample, before, small_mistakes(sample, before, measured=measured))
    if cost(before, before.motion) >= IMPLAUSIBLE_COST:
        tried = undone(sample, before, hypotheses(sample, before)) + small
        prices = [cost(after, before.motion) for _, _, after in tried]
        place = next(place for place, price in enumerate(prices) if price <= _EQUAL_FACTOR * min(prices))
        found, _, after = tried[place]
        tiny = found.angle_deg is not None and found.angle_deg < _SMALLEST_ANGLE_DEG
        near = found.scale is not None and max(found.scale, 1.0 / found.scale) < _SMALLEST_SCALE
        if prices[place] * EXPLAINS_FACTOR <= cost(before, before.motion) and not tiny and not near:
            if tried[place] in small:
                return [tried[place]]
            # Without it, smaller ones show.
            rest = found.undo(sample)
            small = undone(rest, after, small_mistakes(rest, after, measured=measured))
            return [tried[place], *_plausible(small)]
    return _plausible(small)


def _plausible(small: list[_Mistake]) -> list[_Mistake]:
    """Those that leave nothing unexplained: of motion that nothing explains, small mistakes say nothing."""
    return [one for one in small if cost(one[2], one[1].motion) < IMPLAUSIBLE_COST]


def _finding(topic: str, mistake: _Mistake, culprit: str) -> Finding:
    hypothesis, before, after = mistake
    worse, better = (cost(one, before.motion) for one in (before, after))
    text = (
        f"{hypothesis.looks}: {hypothesis.remedy} lowers the innovation of the attitude from "
        f"{before.turn_rad_s:.2g} to {after.turn_rad_s:.2g} rad/s and that of the acceleration from "
        f"{before.fall_m_s2:.2g} to {after.fall_m_s2:.2g} m/s²{culprit}"
    )
    certain = worse >= CERTAIN_COST and worse >= CERTAIN_FACTOR * better
    return Finding(hypothesis.name, topic, text, certain)


def _rotors_follow_better(rotors: RotorExcerpt, vehicle: Vehicle, gyro: Array) -> bool:
    """Whether the rotor speeds agree better with the IMU once a mistake in its axes (3, 3) is reversed."""
    undone = replace(rotors, rates=rotors.rates @ gyro.T)
    before, after = (rotor_evidence(one, vehicle) for one in (rotors, undone))
    if before is None or after is None:
        return True
    return float(np.sum(after.correlation)) > float(np.sum(before.correlation))


def _of_rotors(mistake: str, text: str) -> Finding:
    return Finding(mistake, "rotor_speeds", text)


def _rotor_findings(recording: Recording, evidence: RotorEvidence, vehicle: Vehicle) -> Iterator[Finding]:
    if evidence.same is not None:
        one, other = (rotor + 1 for rotor in evidence.same)
        yield _of_rotors(
            "one channel",
            f"rotors {one} and {other} read the same in nearly every sample: two columns of one channel; "
            "give each rotor its own",
        )
        return
    followed = evidence.followed
    if followed is not None and followed < _OWN_SHARE:
        yield _of_rotors(
            "foreign rotors",
            f"the speeds explain {max(followed, 0.0):.0%} of the fast accelerations beyond chance, where "
            "other flights have 37 % and more: they look like those of another flight, held for long, or "
            "stamped by a clock that is off by more than 0.3 s; take those of this flight",
        )
        return
    # At speed, or in motion no louder than noise, the thrust is rather what the air makes of it.
    growth = evidence.growth if followed is not None else None
    if growth is not None and growth < _SQUARES_GROWTH and is_slow(recording, vehicle):
        yield _of_rotors(
            "squared speeds",
            f"the thrust grows with the power {2.0 * growth:.1f} of the rotor speeds where 2 is "
            "expected: they look squared; take the square root",
        )
        return
    if evidence.explained < _EXPLAINED:
        return
    if abs(evidence.lag_s) >= _LATE_S and evidence.explained - evidence.explained_now >= _LATE_GAIN:
        side = "late" if evidence.lag_s > 0.0 else "early"
        yield _of_rotors(
            "rotor stamps",
            f"the stamps look {abs(evidence.lag_s) * 1e3:.0f} ms too {side}: shifting them raises what the "
            f"rotor speeds explain of the accelerations from {max(evidence.explained_now, 0.0):.0%} to "
            f"{evidence.explained:.0%}",
        )
    ordered = _order_finding(evidence, vehicle)
    if ordered is not None:
        yield ordered
        return
    ratio = float(evidence.ratio.max())
    if min(evidence.correlation[:2]) >= _FOLLOWS and ratio >= _INERTIA_RATIO:
        yield _of_rotors(
            "inertia",
            f"inertia times acceleration is {ratio:.2g} times arm times thrust: the vehicle's inertia looks "
            f"{ratio:.2g} times too large, or its mass or arms too small by that factor",
        )
    arm_squared = float(np.mean(np.sum(vehicle.rotor_positions[:, :2] ** 2, axis=1)))
    shape = float(vehicle.inertia[2, 2]) / (vehicle.mass_kg * arm_squared)
    # These two were set on quadrotors: of others, inertia may be spread otherwise, or a servo turn about z.
    if vehicle.rotor_count != ROTORS:
        return
    if shape < _YAW_INERTIA and ratio < _MOMENTS_SMALL:
        yield _of_rotors(
            "arms",
            f"inertia times acceleration is {ratio:.2g} times arm times thrust, and the inertia about z is "
            f"{shape:.2g} times mass times squared arm, where quadrotors have 0.29 to 0.7: the vehicle's "
            f"arms look up to {np.sqrt(0.5 / shape):.1f} times too long, or its inertia too small",
        )
    yield from _low_rotor(evidence, vehicle)


def _order_finding(evidence: RotorEvidence, vehicle: Vehicle) -> Finding | None:
    """Rotors in another order, at other places or with other spins than in the vehicle file."""
    now, best = evidence.correlation, evidence.order_correlation
    gain = float(np.sum(best * np.abs(best)) - np.sum(now * np.abs(now)))
    same = evidence.order == tuple(range(vehicle.rotor_count))
    if min(best[:2]) < _FOLLOWS or (same and not evidence.spins_inverted):
        return None
    rises = (", ".join(f"{value:.2f}" for value in values) for values in (now, best))
    rise = f"the correlation of the moments with the motion rises from {' to '.join(rises)}"
    if same:
        if now[2] > _OPPOSES:
            return None
        return _of_rotors(
            "spins inverted",
            "all spins of the vehicle look inverted (clockwise is as seen from above): with the other ones "
            + rise,
        )
    if gain < _ORDER_GAIN:
        return None
    for axis, words in ((1, "left to right"), (0, "front to rear")):
        if evidence.spins_inverted and evidence.order == _mirrored(vehicle, axis):
            return _of_rotors(
                "vehicle mirrored",
                f"the places of the vehicle's rotors look mirrored {words} (forward-right-down expected): "
                f"otherwise {rise}",
            )
    moved = [rotor + 1 for rotor, column in enumerate(evidence.order) if rotor != column]
    columns = ", ".join(str(column + 1) for column in evidence.order)
    swapped = f"rotors {moved[0]} and {moved[1]} look swapped" if len(moved) == 2 else "the order looks wrong"
    spins = " and all spins inverted" if evidence.spins_inverted else ""
    if len(moved) != 2 and vehicle.rotor_count > ROTORS:
        # Commands of so many move four ways alone, which several orders explain.
        return _of_rotors("rotor order", f"the order looks wrong: in another one {rise}")
    return _of_rotors("rotor order", f"{swapped}: with the columns in the order {columns}{spins} {rise}")


def _mirrored(vehicle: Vehicle, axis: int) -> tuple[int, ...]:
    """For each rotor, the one in its mirror image across a body axis."""
    places = vehicle.rotor_positions[:, :2]
    image = places.copy()
    image[:, axis] *= -1.0
    return tuple(int(np.argmin(np.abs(places - one).sum(axis=1))) for one in image)


def _low_rotor(evidence: RotorEvidence, vehicle: Vehicle) -> Iterator[Finding]:
    """One rotor whose speeds, multiplied by a factor, would balance roll, pitch and yaw over the flight."""
    squares = evidence.mean_squares / evidence.mean_squares.mean()
    places = vehicle.rotor_positions[:, :2] / np.abs(vehicle.rotor_positions[:, :2]).mean(axis=0)
    levers = np.stack((-places[:, 1], places[:, 0], -vehicle.rotor_spins))
    unbalanced = levers @ squares
    missing = -(levers.T @ unbalanced) / np.sum(levers**2, axis=0)
    off = np.linalg.norm(unbalanced[:, np.newaxis] + levers * missing, axis=0)
    rotor = int(np.argmin(off))
    truly = squares[rotor] + missing[rotor]
    # One that reads 0 throughout is a finding of its own.
    if min(truly, squares[rotor]) <= 0.0 or off[rotor] > _ROTOR_LEFT * float(np.linalg.norm(unbalanced)):
        return
    reads = float(np.sqrt(squares[rotor] / truly))
    if abs(reads - 1.0) >= _ROTOR_LOW * max(_ROTOR_WINDOWS / evidence.windows, 1.0) ** 0.5:
        yield _of_rotors(
            "one rotor",
            f"rotor {rotor + 1} looks as if it read {reads:.2f} times its speed: with {1.0 / reads:.2f} "
            "times as much, roll, pitch and yaw are balanced",
        )


def _thrust(recording: Recording, vehicle: Vehicle) -> Iterator[Finding]:
    if vehicle.thrust_coefficient is None:
        return
    (low, high), where = _HOVER_RATIO, "in hover "
    flown = thrust_coefficient(recording, vehicle, in_hover=True)
    if flown is None:
        (low, high), where = _THRUST_RATIO, ""
        flown = thrust_coefficient(recording, vehicle)
    if flown is not None and not low < (ratio := flown / vehicle.thrust_coefficient) < high:
        yield _of_rotors(
            "thrust",
            f"{where}thrust over Σω² gives C_T = {flown:.3g}, {ratio:.2f} times the vehicle file's "
            f"{vehicle.thrust_coefficient:.3g}: the mass looks {ratio:.2f} times what it is, or the rotor "
            f"speeds {np.sqrt(1.0 / ratio):.2f} times (pole pairs?), or another vehicle, or wind blew",
        )
