# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The report of flights as logged: what was flown, what the logs tell of the vehicles, what they lack."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.field.airborne import Flown, flown
from quadpi_core.field.damage import RotorLoss, frozen_motors, losses, sharing
from quadpi_core.field.drag import DragResult, drag_samples, identify_drag, piece_lengths_s
from quadpi_core.field.estimates import Estimate
from quadpi_core.field.field_log import FieldLog, Setting
from quadpi_core.field.field_reading import read_field_log
from quadpi_core.field.inertia import identify_body, rotors_of
from quadpi_core.field.mass_change import BY_SPEED, MOVED, MassChange, efforts, mass_change
from quadpi_core.field.motor_model import USUAL_THRUST, Tachometers, motor_model, tachometers
from quadpi_core.field.motor_use import (
    BATTERY_DRIFT,
    IMBALANCE,
    SATURATED,
    HoverChange,
    MotorUse,
    Turning,
    motor_use,
    turning_of,
)
from quadpi_core.field.report_record import (
    FlightRecord,
    Remark,
    ReportRecord,
    TopicRecord,
    Untold,
    VehicleRecord,
)
from quadpi_core.field.vibration import VIBE, Vibration, vibration_of
from quadpi_core.flight_files import (
    FlightFile,
    FlightLeftOut,
    LeftOutFlights,
    leave_out,
    named_files,
    once_each,
    require_flights_left,
)
from quadpi_core.paths import finite_json
from quadpi_core.reading_options import ReadingOptions
from quadpi_core.records import Threshold
from quadpi_core.vehicle import SILENT_SHARE, Vehicle

_Lost = tuple[RotorLoss, ...] | str | None
WARNING, ALARM = "warning", "alarm"
# Flights of an airframe, the longest, whose drag is identified together: more take minutes and tell no more.
DRAG_FLIGHTS_MOST = 60
ONE_VEHICLE = Threshold(
    "leap of rotor speed by command, or of hover throttle, from flight to flight that is another vehicle's",
    1.15,
    "",
    "both change by up to 12 % within one pack, by neighbouring flights less",
    "imrc_brushless, imrc_brushed and crazypad of ../shared/data",
)
LOSS_ALARM = Threshold(
    "thrust, in per cent, that a rotor lacks against earlier flights, by the near end, that is an alarm",
    5.0,
    "%",
    "good flights never reached it; a propeller short by a fifth or more did",
    "good flights of imrc_brushless, imrc_brushed and indiflight of ../shared/data",
)
WRONG_MASS = Threshold(
    "mass that rotor speeds carry over that given, beyond which one is wrong: less, and more",
    (0.75, 1.35),
    "",
    "good flights have 0.94 to 1.14, at 14 m/s too; a thrust coefficient of a bench errs by a tenth",
    "indiflight, nanodrone and neurobem of ../shared/data",
)
# Parameters of motors and their outputs that no flight learns.
_OUTPUTS = re.compile(
    r"MOT_(?!THST_HOVER|BAT)|CA_(AIRFRAME|ROTOR)|PWM_|SERVO\d+_(FUNCTION|MIN|MAX)|motor_|(min|max)throttle"
)


@dataclass(frozen=True)
class FlightReport:
    """What one log tells; in place of what it does not tell stands why.

    Attributes:
        name: of the flight.
        log: as read.
        flown: what was flown.
        use: of the motors and the battery.
        vibration: of the body.
        tachometers: rotor speeds against commands.
        turning: as which motors the commands turn the vehicle.
        losses: each rotor against earlier flights; None where none was given.
        mass_change: mass and its place against those.
        remarks: what looks wrong.
    """

    name: str
    log: FieldLog
    flown: Flown
    use: MotorUse
    vibration: Vibration | str
    tachometers: Tachometers | str
    turning: Turning | str
    losses: _Lost
    mass_change: MassChange | str | None
    remarks: tuple[Remark, ...]

    def looked_at(self) -> dict[str, str]:
        """What can look wrong; empty where it was looked at, else why not."""
        use, read, turned = self.use, self.tachometers, self.turning
        told = use.drift or use.thrust_gain
        thrust = "the log has not both IMU and commands" if told is None else told.reason
        name, lost = "motors against earlier flights", self.losses
        compared = {} if lost is None else {name: lost if isinstance(lost, str) else ""}
        return {
            "motor commands": "" if use.motors else "not in the log",
            "thrust over command along the flight": thrust,
            "command at hover along the flight": use.no_change,
            "tachometers": read if isinstance(read, str) else "",
            "order of the motors": turned if isinstance(turned, str) else "",
            "spins of the motors": turned if isinstance(turned, str) else turned.no_spins,
            "vibration": "only ArduPilot's VIBE can be judged" if self.log.vibe is None else "",
            **compared,
        }

    def hidden_loss(self) -> float | None:
        """Share of thrust that a rotor may lack against earlier flights and not be named; None: not told."""
        told = [] if self.losses is None or isinstance(self.losses, str) else self.losses
        ends = [(one.thrust.value, one.thrust.low) for one in told]
        widths = [value - low for value, low in ends if value is not None and low is not None]
        return max(widths, default=None)

    def record(self) -> FlightRecord:
        """Its entry in `report.json`."""
        log = self.log
        return FlightRecord(
            self.name,
            *(log.source, log.stack, log.firmware, log.frame, log.rotors),
            dict(log.facts),
            {name: TopicRecord(len(own), own.rate_hz) for name, own in log.series().items()},
            *(self.flown, self.use),
            *(_or_untold(self.vibration), _or_untold(self.tachometers)),
            *(_or_untold(self.losses), _or_untold(self.mass_change)),
            looked_at=self.looked_at(),
            remarks=self.remarks,
            settings=tuple(log.settings),
            notes=tuple(log.notes),
        )


@dataclass(frozen=True)
class FieldReport:
    """The report of one call.

    Attributes:
        flights: by log.
        vehicles: by airframe.
        mass: kg, as the user gave it; None where not.
        left_out: logs that gave no report.
    """

    flights: tuple[FlightReport, ...]
    vehicles: tuple[VehicleRecord, ...]
    mass: float | None
    left_out: tuple[FlightLeftOut, ...]

    @property
    def alarmed(self) -> bool:
        """Whether any flight has an alarm."""
        return any(remark.level == ALARM for flight in self.flights for remark in flight.remarks)

    def looked_at(self) -> str:
        """What was looked at for warnings and alarms, and what was not, with the first reason."""
        checks = [flight.looked_at() for flight in self.flights]
        done, lacking = [], []
        for name in checks[0]:
            reasons = [check[name] for check in checks if check[name]]
            if len(reasons) < len(checks):
                share = f" of {len(checks) - len(reasons)} of {len(checks)} flights" if reasons else ""
                done.append(f"{name}{share}")
            if reasons:
                lacking.append(f"{name} ({reasons[0]})")
        if hidden := [100.0 * own for own in (one.hidden_loss() for one in self.flights) if own is not None]:
            ends = dict.fromkeys(f"{end:.0f}" for end in (min(hidden), max(hidden)))
            unseen = f"{' to '.join(ends)} % of thrust, or weight have moved by as much of the arm"
            done[-1] += f", where a rotor may lack {unseen}, unseen"
        parts = (("looked at: ", done), ("not looked at: ", lacking))
        return "; ".join(word + ", ".join(names) for word, names in parts if names)

    def verdict(self) -> str:
        """The report in a sentence."""
        count, seconds = len(self.flights), sum(flight.flown.airborne_s for flight in self.flights)
        parts = [f"{count} flight{'s' * (count > 1)}, {seconds:.0f} s in the air"]
        for vehicle in self.vehicles[:1]:
            if isinstance(vehicle.drag, DragResult) and vehicle.drag.per_mass[0].value is not None:
                parts.append(f"drag {vehicle.drag.per_mass[0].value:.2f} 1/s along the nose")
        if len(self.vehicles) > 1:
            parts.append(f"{len(self.vehicles)} airframes, each by itself")
        remarks = [(own.name, one) for own in self.flights for one in own.remarks]
        alarms = [(name, one.sentence) for name, one in remarks if one.level == ALARM]
        is_blind = all(all(flight.looked_at().values()) for flight in self.flights)
        quiet = f"{len(remarks)} warning{'s' * (len(remarks) != 1)}, no alarm"
        quiet += ", as nothing could be looked at" * is_blind
        parts.append(": ".join(alarms[0][count == 1 :]) if alarms else quiet)
        return "; ".join(parts) + "."

    def to_json(self) -> dict[str, Any]:
        """The content of `report.json`, see :class:`.ReportRecord`."""
        flights = tuple(flight.record() for flight in self.flights)
        record = ReportRecord(
            self.verdict(), self.alarmed, self.mass, self.vehicles, flights, left_out=self.left_out
        )
        return finite_json(asdict(record))


_Told = TypeVar("_Told")


def _or_untold(told: _Told | str) -> _Told | Untold:
    return Untold(told) if isinstance(told, str) else told


def report_on(
    paths: Sequence[Path],
    options: ReadingOptions,
    vehicle: Vehicle | int | None = None,
    mass: float | None = None,
    against: Sequence[Path] = (),
) -> FieldReport:
    """Report on logs; those that hold no flight of a multirotor are left out.

    Args:
        paths: of the logs.
        options: topics of bags, mapping of tables.
        vehicle: of the user's file, or its pairs of poles alone, for electrical rotor speeds.
        mass: kg; None where it is not known.
        against: logs of good flights of the same vehicle before, which each flight is held against.

    Raises:
        NoFlightLeftError: if none is left, naming each.
        LogError: for a log to hold flights against that holds none, or is given twice; for a mass of several
            airframes.
    """
    if isinstance(vehicle, Vehicle) and mass is not None:
        vehicle = replace(vehicle, mass_kg=mass)
    before = [(digest, _flight_report(log)) for _, (digest, log) in _read(against, options, vehicle, None)]
    flights: list[FlightReport] = []
    left_out: list[FlightLeftOut] = []
    for file, (digest, log) in _read(paths, options, vehicle, left_out):
        others = [flight for own, flight in before if own != digest]
        try:
            flight = _flight_report(log, others if before else None, vehicle)
        except QuadpiError as error:
            leave_out(file, error, left_out)
            continue
        is_judged = mass is None or (isinstance(vehicle, Vehicle) and BY_SPEED in flight.use.efforts)
        notes = () if is_judged else ("mass: as given; rotor speeds and a vehicle file would judge it",)
        own, said = replace(log, notes=(*log.notes, *notes)), _mass_doubts(flight.use, vehicle)
        flights.append(replace(flight, log=own, remarks=(*flight.remarks, *said)))
    require_flights_left(len(flights), left_out)
    vehicles = tuple(_vehicles(flights, vehicle))
    differ = len({_identity(one.log) for one in flights}) > 1
    if differ and (mass is not None or isinstance(vehicle, Vehicle)):
        names = ", ".join(f"{one.name} ({one.flights[0]} …)" for one in vehicles)
        raise LogError(
            f"mass and vehicle file are of one airframe, the logs of {names}: report on each by itself"
        )
    return FieldReport(tuple(flights), vehicles, mass, tuple(left_out))


def _read(
    paths: Sequence[Path], options: ReadingOptions, vehicle: Vehicle | int | None, left_out: LeftOutFlights
) -> list[tuple[FlightFile, tuple[str, FieldLog]]]:
    """Logs with their digests, each once: a copy tells nothing more, and would narrow every interval."""
    found = []
    said = ("not in the vehicle file", "set it there, of a bench or a model", "whether the mass is right")
    is_lacking = isinstance(vehicle, Vehicle) and not vehicle.thrust_coefficient
    wanted = (Setting("thrust_coefficient", *said),) if is_lacking else ()
    for file in named_files(paths):
        try:
            log = read_field_log(file.path, options, vehicle)
            log = replace(log, name=file.name, settings=(*log.settings, *wanted))
            found.append((file, (_digest(log), log)))
        except QuadpiError as error:
            leave_out(file, error, left_out)
    return once_each(found, itemgetter(0), left_out)


def _digest(log: FieldLog) -> str:
    """The same for copies of a log under any name: of its IMU, else of all that it holds."""
    digest = hashlib.sha256()
    for name, own in log.series().items() if log.imu is None else (("imu", log.imu),):
        digest.update(name.encode())
        digest.update(np.round((own.time - own.time[0]) * 1e6).astype("<i8").tobytes())
        digest.update((own.values + 0.0).astype("<f4").tobytes())
    return digest.hexdigest()


def _flight_report(
    log: FieldLog, before: Sequence[FlightReport] | None = None, vehicle: Vehicle | int | None = None
) -> FlightReport:
    flight = flown(log)
    places = rotors_of(log, vehicle) if isinstance(vehicle, Vehicle) else log.places
    turning = turning_of(log, flight, places)
    use, vibration, read = motor_use(log, flight), vibration_of(log, flight), tachometers(log, flight)
    all_read = isinstance(read, Tachometers) and not read.odd
    use = replace(use, efforts=efforts(log, flight, tachometers_read=all_read))
    lost: _Lost = None
    heavier: MassChange | str | None = None
    if before is not None:
        alike = [one for one in before if (one.log.stack, one.log.rotors) == (log.stack, log.rotors)]
        alike = [one for one in alike if not _is_saturated(one.use)]
        lost = heavier = "the flights before are none, or of another vehicle, or at full command"
        if _is_saturated(use):
            lost = heavier = "a motor is at full command too long: its share tells nothing"
        elif alike:
            told = sharing([(log, flight), *((one.log, one.flown) for one in alike)])
            lost = told if isinstance(told, str) else losses(told)
            heavier = mass_change(use, [one.use for one in alike], told, log.places)
    remarks = [*_motor_remarks(log, flight, lost, heavier)]
    if isinstance(heavier, MassChange):
        remarks += _mass_remarks(heavier)
    remarks += _remarks(log, use, vibration, read)
    word = "commands" if log.commands else "rotor speeds"
    if isinstance(turning, Turning) and (order := turning.order):
        said = f"{word} 1 to {len(order)} turn the vehicle as motors {', '.join(map(str, order))} would"
        also = f", or with {' and '.join(map(str, turning.alike))} exchanged" if turning.alike else ""
        remarks.append(Remark(WARNING, f"{said}{also}: an order, or the IMU's orientation, is wrong"))
    if isinstance(turning, Turning) and turning.is_reversed:
        said = f"{word} yaw the vehicle as if each rotor turned the other way: their spins"
        remarks.append(Remark(WARNING, f"{said}, in the vehicle file or the autopilot, are wrong"))
    return FlightReport(log.name, log, flight, use, vibration, read, turning, lost, heavier, tuple(remarks))


def _is_saturated(use: MotorUse) -> bool:
    return use.saturated is not None and (use.saturated.value or 0.0) > SATURATED.value[1]


def _identity(log: FieldLog) -> tuple[object, ...]:
    """What flights of one vehicle have in common; that of another may be the same."""
    outputs = tuple(sorted(own for own in log.parameters.items() if _OUTPUTS.match(own[0])))
    return (
        *(log.stack, log.frame, log.rotors, outputs),
        *(log.facts.get(name) for name in ("board", "airframe", "craft", "vehicle", "poles", "commands")),
    )


def _apart(flights: Sequence[FlightReport], values: Sequence[float | None]) -> Iterator[list[FlightReport]]:
    """Flights by a value, apart where it leaps; those without one by themselves."""
    last = None
    group: list[FlightReport] = []
    known = [(value, flight) for value, flight in zip(values, flights, strict=True) if value is not None]
    for value, flight in sorted(known, key=lambda pair: pair[0]):
        if last is not None and value > ONE_VEHICLE.value * last:
            yield group
            group = []
        group.append(flight)
        last = value
    unknown = [flight for value, flight in zip(values, flights, strict=True) if value is None]
    if last is None or last <= ONE_VEHICLE.value * min(value for value, _ in known):
        group, unknown = group + unknown, []
    yield from filter(None, (group, unknown))


def _airframes(flights: Sequence[FlightReport]) -> Iterator[tuple[list[FlightReport], str]]:
    """Flights of a vehicle each, and what is not sure of that."""
    alike: dict[tuple[object, ...], list[FlightReport]] = {}
    for flight in flights:
        alike.setdefault(_identity(flight.log), []).append(flight)
    for kind in alike.values():
        gains = [None if isinstance(one.tachometers, str) else one.tachometers.gain for one in kind]
        groups = [
            group
            for turning in _apart(kind, gains)
            for group in _apart(turning, [one.use.hover.value if one.use.hover else None for one in turning])
        ]
        for group in groups:
            said = []
            if len(groups) > 1:
                said.append("rotor speed by command, or hover throttle, sets these flights apart from others")
            facts = group[0].log.facts
            if len(group) > 1 and not any(facts.get(name) for name in ("board", "craft", "vehicle")):
                said.append("taken as one vehicle: nothing in the logs names it")
            group.sort(key=flights.index)
            yield group, "; ".join(said)


def _vehicles(flights: Sequence[FlightReport], vehicle: Vehicle | int | None) -> Iterator[VehicleRecord]:
    airframes = sorted(_airframes(flights), key=lambda pair: flights.index(pair[0][0]))
    names_of = [" ".join(filter(None, (own[0].log.stack, own[0].log.frame))) for own, _ in airframes]
    for (own, said), kind in zip(airframes, names_of, strict=True):
        name = f"{kind} of {own[0].name}" if names_of.count(kind) > 1 else kind
        longest = sorted(own, key=lambda flight: -flight.flown.airborne_s)[:DRAG_FLIGHTS_MOST]
        lengths = piece_lengths_s([flight.flown.airborne_s for flight in longest])
        found = {
            flight.name: drag_samples(flight.log, flight.flown, length)
            for flight, length in zip(longest, lengths, strict=True)
        }
        samples = {key: one for key, one in found.items() if not isinstance(one, str)}
        drag = identify_drag(list(samples.values())) if samples else str(next(iter(found.values())))
        # Tachometers that count otherwise would spoil the model of all.
        odd = {one.name for one in own if isinstance(one.tachometers, Tachometers) and one.tachometers.odd}
        sound = [(one.log, one.flown) for one in own if one.name not in odd]
        motors = motor_model(sound) if sound else "the tachometers of no flight read what the commands give"
        body = None
        if isinstance(vehicle, Vehicle):
            blind = [replace(one.log, rotor_speeds=None) if one.name in odd else one.log for one in longest]
            spun = [(log, one.flown) for log, one in zip(blind, longest, strict=True)]
            told = (
                {} if isinstance(drag, str) else {key: drag.likely_wind(n) for n, key in enumerate(samples)}
            )
            winds = [told.get(one.name, np.zeros(2)) for one in longest]
            body = identify_body(spun, vehicle, winds)
        names = tuple(flight.name for flight in own)
        yield VehicleRecord(
            *(name, names, said, _or_untold(drag), tuple(samples)),
            *(_or_untold(motors), own[0].log.drag_prefix, body),
        )


def _level(estimate: Estimate, limits: tuple[float, ...]) -> str:
    """Warning or alarm by the end of the interval that is nearer to 0; without one a warning at most."""
    value, low, high = estimate.value or 0.0, estimate.low, estimate.high
    if low is None or high is None:
        return WARNING if abs(value) > limits[0] else ""
    near = max(low, -high)
    return ALARM if near > limits[1] else WARNING if near > limits[0] else ""


def _shortness(estimate: Estimate) -> str:
    return f" ({estimate.reason})" if estimate.reason else ""


def _motor_remarks(
    log: FieldLog, flight: Flown, lost: _Lost, heavier: MassChange | str | None
) -> Iterator[Remark]:
    for motor, since in frozen_motors(log, flight):
        said = f"{log.motor(motor)} follows no more from {since:.1f} s on: its command stays as it is"
        yield Remark(ALARM, said)
    if not lost or isinstance(lost, str):
        return
    worst = max(range(len(lost)), key=lambda rotor: lost[rotor].thrust.low or 0.0)
    value, low, high = (100.0 * (end or 0.0) for end in astuple(lost[worst].thrust)[:3])
    weak: tuple[int, ...] = (worst + 1,)
    cause = "the vehicle has become heavier near it"
    # The scatter of all motors together may hide one that is beyond chance by itself.
    if isinstance(heavier, MassChange) and not (heavier.fits == ("nothing",) and lost[worst].beyond_chance):
        weak = heavier.weak_motors(worst + 1)
        if side := heavier.side:
            moved = f"the centre of gravity has moved to the {side}, or {cause}"
            cause = moved if MOVED in heavier.fits else f"{cause}, by a load on the {side}"
    names = ", or ".join(log.motor(motor) for motor in weak)
    if low > 0.0 and weak:
        yield Remark(
            ALARM if low > LOSS_ALARM.value else WARNING,
            f"{names} works harder than in earlier flights: it gives {value:.0f} % less "
            f"thrust ({low:.0f} to {high:.0f} %), or {cause}",
        )


def _mass_remarks(change: MassChange) -> Iterator[Remark]:
    value, low, high = (100.0 * (end or 0.0) for end in astuple(change.share)[:3])
    place = f", its load on the {change.side}" if change.side and "payload" in change.fits else ""
    if change.share.value is not None and change.may_be_heavier and (low > 0.0 or high < 0.0):
        word = "heavier" if value > 0.0 else "lighter"
        ends = sorted((abs(low), abs(high)))
        yield Remark(
            WARNING,
            f"{abs(value):.0f} % {word} than in earlier flights ({ends[0]:.0f} to {ends[1]:.0f} %, "
            f"{change.share.reason}){place}, or thrust has changed by as much",
        )
    elif change.fits and set(change.fits) <= {MOVED, "payload"} and change.side:
        said = f"the centre of gravity has moved to the {change.side}: a battery mounted elsewhere, or a load"
        yield Remark(WARNING, said)


def _mass_doubts(use: MotorUse, vehicle: Vehicle | int | None) -> Iterator[Remark]:
    """A mass that rotor speeds contradict, by the thrust coefficient of the vehicle file or a usual one."""
    if not isinstance(vehicle, Vehicle) or BY_SPEED not in use.efforts:
        return
    disc = vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
    own, by = USUAL_THRUST.value[::2], "any usual propeller of their radius"
    if known := vehicle.thrust_coefficient:
        own, by = (known, known), "the vehicle file's thrust_coefficient"
    carried = [one * disc * vehicle.rotor_count * use.efforts[BY_SPEED] for one in own]
    low, high = WRONG_MASS.value
    if carried[1] < low * vehicle.mass_kg or carried[0] > high * vehicle.mass_kg:
        ends = " to ".join(dict.fromkeys(f"{one:.2g}" for one in carried))
        yield Remark(WARNING, f"rotor speeds carry {ends} kg by {by}, not {vehicle.mass_kg:g} kg")


def _change_cause(change: HoverChange, volts: tuple[float, float, float] | None) -> str:
    """Since when hover takes another command, and what does that."""
    grows = change.share > 0.0
    if change.at_s is not None:
        causes = "a load taken up, or a rotor that gives less" if grows else "a load dropped"
        return f"from {change.at_s:.0f} s on: {causes}"
    if not grows:
        return "at the end: the vehicle becomes lighter, or its motors give more"
    if volts is None:
        return "at the end: the battery sags, whose voltage is not logged, or motors give less"
    return f"at the end, the battery at {volts[1]:.2f} V after {volts[0]:.2f} V: it sags, or motors give less"


def _remarks(
    log: FieldLog, use: MotorUse, vibration: Vibration | str, read: Tachometers | str
) -> Iterator[Remark]:
    if use.saturated is not None and (level := _level(use.saturated, SATURATED.value)):
        share = f"{100.0 * (use.saturated.value or 0.0):.0f} % of the time in the air"
        yield Remark(level, f"a motor is at full command for {share}{_shortness(use.saturated)}")
    # The largest alone: where a motor does not give what it should, the others answer.
    worst = max(range(len(use.motors)), key=lambda motor: abs(use.motors[motor].value or 0.0), default=None)
    if worst is not None and (level := _level(use.motors[worst], IMBALANCE.value)):
        share = f"{100.0 * (use.motors[worst].value or 0.0):+.0f} % of command over the mean of all"
        yield Remark(level, f"{log.motor(worst + 1)} gets {share}{_shortness(use.motors[worst])}")
    if isinstance(vibration, Vibration) and vibration.worst and vibration.worst[1] > VIBE.value[0]:
        axis, most = vibration.worst
        level = ALARM if most > VIBE.value[1] else WARNING
        yield Remark(level, f"VIBE along {axis} is above {most:.0f} m/s² in a twentieth of the flight")
    if isinstance(read, Tachometers):
        if read.order:
            order = ", ".join(map(str, read.order))
            said = f"rotor speeds 1 to {len(read.order)} follow commands {order}: an order is wrong"
            yield Remark(WARNING, said)
        for rotor in read.odd:
            ratio = read.ratio[rotor - 1]
            said = f"the tachometer of rotor {rotor} reads {ratio:.2f} times what its command gives others"
            if ratio < SILENT_SHARE.value:
                said = f"rotor {rotor} stands, or its tachometer is silent"
            yield Remark(ALARM, said)
    if (change := use.change) is not None:
        more = "more" if change.share > 0.0 else "less"
        said = f"hover takes {100.0 * abs(change.share):.0f} % {more} command"
        yield Remark(WARNING, f"{said} {_change_cause(change, use.volts)}")
    if use.drift is not None and _level(use.drift, (BATTERY_DRIFT.value, np.inf)):
        share = f"{100.0 * (use.drift.value or 0.0):+.0f} %"
        said = f"thrust over command changes by {share} along the flight{_shortness(use.drift)}"
        yield Remark(WARNING, said)
