# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page and the summary of `quadpi report`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np

from quadpi_core.field.airborne import velocity_of
from quadpi_core.field.estimates import Estimate
from quadpi_core.field.field_report import ALARM, FieldReport, FlightReport
from quadpi_core.field.inertia import BodyResult
from quadpi_core.field.mass_change import MassChange
from quadpi_core.field.motor_model import Tachometers
from quadpi_core.field.report_record import Untold, VehicleRecord
from quadpi_core.frames import Array
from quadpi_core.report.page import DASHES, Boxes, Figure, Layer, Line, Page, Panel, Scale, flight_remarks
from quadpi_core.report.table import GROUPS, INK, TRAINING, Cell, Column, Mark, Row, Table, number, percent

_ESTIMATES = (
    Column("", is_text=True),
    Column("value", number),
    Column("95\u00a0%", is_text=True),
    Column("unit", is_text=True),
    Column("", is_text=True, wraps=True),
)
# Series by name, and what each allows.
_USES = {
    "imu": "thrust over mass; drag; vibration",
    "attitude": "tilt; drag, with velocity",
    "velocity": "speeds; drag and wind",
    "position": "height",
    "commands": "hover throttle, imbalance, saturation",
    "rotor_speeds": "motors from commands, tachometers",
    "battery": "voltage; motors from commands",
    "landed": "when it was in the air",
    "density": "drag coefficients at standard density",
    "vibe": "vibration, judged",
}


def report_summary(report: FieldReport) -> list[Table]:
    """What the terminal shows."""
    drags = [drag_table(vehicle, report.mass) for vehicle in report.vehicles]
    return [flight_table(report), *drags, settings_table(report), remark_table(report)]


def flight_table(report: FieldReport) -> Table:
    """A row for each flight."""
    columns = [
        Column("flight", is_text=True, chooses_flight=True),
        Column("vehicle", is_text=True),
        Column("aloft s", number),
        Column("m/s", number),
        Column("tilt °", number),
        Column("hover", percent),
        Column("full", percent),
        Column("V", is_text=True),
    ]
    rows: list[Row] = [
        [
            flight.name,
            " ".join(filter(None, (flight.log.stack, flight.log.frame))),
            flight.flown.airborne_s,
            flight.flown.speed_m_s[1] if flight.flown.speed_m_s else None,
            flight.flown.tilt_deg[1] if flight.flown.tilt_deg else None,
            flight.use.hover.value if flight.use.hover else None,
            flight.use.saturated.value if flight.use.saturated else None,
            "{:.2f} → {:.2f}".format(*flight.use.volts) if flight.use.volts else None,
        ]
        for flight in report.flights
    ]
    return Table(columns, rows, title="flown")


def _row(name: str, one: Estimate, factor: float = 1.0, unit: str = "") -> Row:
    value, low, high = (None if end is None else factor * end for end in (one.value, one.low, one.high))
    interval = "" if low is None or high is None else f"{number(low)} to {number(high)}"
    return [name, value, interval, unit or one.unit, Cell(one.reason, Mark.SOFT) if one.reason else ""]


def drag_table(vehicle: VehicleRecord, mass: float | None) -> Table:
    """Drag and wind of a vehicle, with intervals; in newtons too where the mass is known."""
    title, drag = f"drag · {vehicle.name}", vehicle.drag
    body = _body_rows(vehicle.body)
    if isinstance(drag, Untold) or not drag.wind:
        said = f"not identified: {drag.reason}" if isinstance(drag, Untold) else drag.per_mass[0].reason
        row = ["drag over mass, wind", None, "", "1/s", Cell(said, Mark.SOFT)]
        advice = "" if isinstance(drag, Untold) else f"Next: {drag.advice}."
        return Table(
            _ESTIMATES, [row, *body], title=title, note=f"{_sentence(vehicle.doubt)} {advice}".strip()
        )
    ways = dict(zip(("along the nose", "sideways"), drag.per_mass, strict=True))
    rows = [_row(f"drag over mass, {way}", own) for way, own in ways.items()]
    if mass is not None:
        rows += [_row(f"drag, {way}", own, mass, "N/(m/s)") for way, own in ways.items()]
    prefix = vehicle.drag_prefix
    rows.append(_row(f"{prefix}MCOEF" if prefix else "momentum drag", drag.momentum))
    rows += [
        _row(f"{prefix}BCOEF_{axis}" if prefix else f"ballistic coefficient along {axis.lower()}", own)
        for axis, own in zip("XY", drag.ballistic, strict=True)
    ]
    winds = [
        _row(f"wind to the {way}, {flight}", own)
        for flight, pair in zip(vehicle.wind_of, drag.wind, strict=False)
        for way, own in zip(("north", "east"), pair, strict=True)
        if own.value is not None
    ]
    if not winds:
        winds = [["wind", None, "", "m/s", Cell(drag.wind[0][0].reason, Mark.SOFT)]]
    rows += [*winds, *body]
    said = "flights to come" if drag.by_flight else "these flights; others may differ"
    note = (
        f"{drag.usable} usable samples, {drag.speed[0]:.1f} to {drag.speed[1]:.1f} m/s; intervals for {said}."
    )
    notes = (_sentence(vehicle.doubt), note, f"Next: {drag.advice}." if drag.advice else "")
    return Table(_ESTIMATES, rows, title=title, note=" ".join(filter(None, notes)))


def _body_rows(body: BodyResult | None) -> list[Row]:
    """Thrust, inertia and lag of a vehicle whose file says mass and places of the rotors."""
    if body is None:
        return []
    return [
        _row("thrust of a rotor at the command of hover", body.thrust),
        *(_row(f"inertia about {axis}", own) for axis, own in zip("xy", body.inertia, strict=True)),
        _row("lag of the motors behind commands", body.lag),
    ]


def _sentence(said: str) -> str:
    return f"{said[0].upper()}{said[1:]}." if said else ""


def motor_table(flight: FlightReport) -> Table:
    """Motors and vibration of a flight."""
    use, vibration, read = flight.use, flight.vibration, flight.tachometers
    told = (("hover throttle", use.hover), ("thrust over weight, per command", use.thrust_gain))
    rows = [_row(name, one) for name, one in told if one is not None]
    for place, own in enumerate(use.motors, start=1):
        rows.append(_row(f"{flight.log.motor(place)} over the mean command", own, 100.0, "%"))
    if isinstance(flight.losses, str):
        rows.append(["motors against earlier flights", None, "", "%", f"not told: {flight.losses}"])
    elif flight.losses is not None:
        for place, lost in enumerate(flight.losses, start=1):
            rows.append(_row(f"{flight.log.motor(place)}, thrust that it lacks", lost.thrust, 100.0, "%"))
    if isinstance(flight.mass_change, MassChange):
        rows.append(_row("mass, more than in earlier flights", flight.mass_change.share, 100.0, "%"))
        for way, moved in zip(("forward", "to the right"), flight.mass_change.moved, strict=False):
            rows.append(_row(f"centre of gravity, moved {way}", moved, 100.0, "% of the arm"))
        if fits := ", or ".join(flight.mass_change.fits):
            rows.append(["what the motors' shares fit", None, "", "", fits])
    if use.drift is not None:
        rows.append(_row("thrust over command, from begin to end", use.drift, 100.0, "%"))
    if isinstance(vibration, str):
        rows.append(["vibration", None, "", "m/s²", f"not told: {vibration}"])
    else:
        band = f"5 to {vibration.rate_hz / 2.0:.0f} Hz; not judged"
        for axis, own in zip("xyz", vibration.force, strict=False):
            rows.append(_row(f"vibration along {axis}", replace(own, reason=own.reason or band)))
        for axis, most in zip("xyz", vibration.vibe or (), strict=False):
            rows.append([f"VIBE along {axis}", most, "", "m/s²", Cell("95 % are below", Mark.SOFT)])
    if isinstance(read, Tachometers):
        for place, ratio in enumerate(read.ratio, start=1):
            rows.append([f"rotor {place}, over the others at the same command", ratio, "", "", ""])
    return Table(_ESTIMATES, rows)


def motor_sentence(vehicle: VehicleRecord) -> str:
    """How well commands tell the rotor speeds."""
    motors = vehicle.motor_model
    if isinstance(motors, Untold):
        return f"Rotor speed from command: not told, {motors.reason}."
    known = "command and battery" if motors.with_battery else "command alone"
    halves = "flights" if motors.flights > 1 else "halves of the flight"
    return (
        f"Rotor speed from {known}, late by {_about(motors.dead_s)} and with a lag of "
        f"{_between(motors.lag)}, errs by {100.0 * motors.error:.2g} % (RMS, {halves} left out), "
        f"by {100.0 * motors.error_scaled:.2g} % after one gain for each; "
        f"an interval of ±{100.0 * motors.width:.2g} % by what the others err holds "
        f"{100.0 * motors.coverage:.0f} %{', uncalibrated' * (motors.flights == 1)}."
    )


def _about(seconds: float | None) -> str:
    return "a time that is not told" if seconds is None else f"about {1000.0 * seconds:.0f} ms"


def _between(lag: Estimate) -> str:
    if lag.value is None:
        return f"a time that is not told ({lag.reason})"
    if lag.low is None or lag.high is None:
        return f"{_about(lag.value)} ({lag.reason})"
    return f"{1000.0 * lag.value:.0f} ms ({1000.0 * lag.low:.0f} to {1000.0 * lag.high:.0f})"


def settings_table(report: FieldReport) -> Table:
    """What to set, each once, with its present value."""
    found = dict.fromkeys(one for flight in report.flights for one in flight.log.settings)
    rows: list[Row] = [list(astuple(one)) for one in found]
    columns = [Column(name, is_text=True, wraps=True) for name in ("setting", "is", "do", "for")]
    nothing: Row = [Cell("nothing: the logs hold all", Mark.GOOD), "", "", ""]
    return Table(columns, rows or [nothing], title="to log more")


def remark_table(report: FieldReport) -> Table:
    """Warnings and alarms."""
    rows: list[Row] = [
        [flight.name, Cell(remark.sentence, Mark.FAULT if remark.level == ALARM else Mark.WARNING)]
        for flight in report.flights
        for remark in flight.remarks
    ]
    columns = [Column("flight", is_text=True), Column("", is_text=True, wraps=True)]
    # Not "nothing is wrong": a propeller that lacks 25 mm shows in none of them.
    nothing: Row = ["", "none; slight damage shows against earlier flights alone (--against), or not"]
    return Table(columns, rows or [nothing], title="findings", note=_sentence(report.looked_at()))


def topic_table(flight: FlightReport) -> Table:
    """What the log of a flight holds, and what that allows."""
    series = flight.log.series()
    rows: list[Row] = [
        [name.replace("_", " "), len(series[name]), series[name].rate_hz, use]
        if name in series
        else [name.replace("_", " "), Cell("not in the log", Mark.WARNING), None, use]
        for name, use in _USES.items()
    ]
    columns = [Column("topic", is_text=True), Column("samples"), Column("Hz", number)]
    return Table([*columns, Column("allows", is_text=True, wraps=True)], rows)


def share_table(flight: FlightReport) -> Table:
    """Manoeuvres, and how the time in the air was told."""
    flown = flight.flown
    rows: list[Row] = [[name, share] for name, share in flown.shares.items()]
    times = f"{len(flown.stretches)} time{'s' * (len(flown.stretches) > 1)}"
    note = f"In the air {times}, {flown.airborne_s:.0f} of {flown.duration_s:.0f} s, by {flown.told_by}."
    return Table([Column("manoeuvre", is_text=True), Column("of the time", percent)], rows, note=note)


def time_figure(flight: FlightReport) -> Figure:
    """Speed, height, commands, rotors and battery over time, the time in the air shaded."""
    log, velocity = flight.log, velocity_of(flight.log)
    rows: dict[str, tuple[Array, Array]] = {}
    if velocity is not None:
        rows["speed [m/s]"] = (velocity.time, np.hypot(velocity.values[:, :1], velocity.values[:, 1:2]))
    if log.position is not None:
        rows["height [m]"] = (log.position.time, -log.position.values[:, 2:])
    if log.commands is not None:
        rows["command [%]"] = (log.commands.time, 100.0 * log.commands.values)
    if log.rotor_speeds is not None:
        rows["rotors [rad/s]"] = (log.rotor_speeds.time, log.rotor_speeds.values)
    if log.battery is not None:
        rows["battery [V]"] = (log.battery.time, log.battery.values)
    if not rows and log.imu is not None:
        rows["rates [rad/s]"] = (log.imu.time, np.linalg.norm(log.imu.values[:, :3], axis=1, keepdims=True))
    begins, ends = ([getattr(one, end) for one in flight.flown.stretches] for end in ("begin", "end"))
    open_side = np.full(len(begins), np.nan)
    shade = Boxes("in the air", TRAINING, np.array(begins), np.array(ends), open_side, open_side, 0.3)
    panels = [
        Panel([shade, *_lines(time, values)], Scale("time [s]"), Scale(title), 115.0)
        for title, (time, values) in rows.items()
    ]
    return Figure("Flight over time", panels, over_time=True)


def _lines(time: Array, values: Array) -> list[Layer]:
    if values.shape[1] == 1:
        return [Line("", INK, time, values[:, 0])]
    return [
        Line(f"motor {place + 1}", GROUPS[place % len(GROUPS)], time, own, width=1.2, dash=DASHES[place % 4])
        for place, own in enumerate(values.T)
    ]


def _facts(report: FieldReport) -> Iterator[tuple[str, str]]:
    log = report.flights[0].log
    yield "flights", str(len(report.flights))
    if len(report.vehicles) == 1:
        yield "vehicle", report.vehicles[0].name
        if log.firmware:
            yield "firmware", log.firmware
        if log.rotors:
            yield "motors", str(log.rotors)
        yield from log.facts.items()
    yield "checks", report.looked_at()
    yield "mass", f"{report.mass:g} kg" if report.mass else "not given (--mass): forces are per mass"


def write_field_page(path: Path, report: FieldReport) -> None:
    """Write the page; it appears whole or not at all.

    Raises:
        OutputError: if `path` cannot be written.
    """
    flights = {flight.name: flight for flight in report.flights}
    found = [(flight.name, remark.sentence) for flight in report.flights for remark in flight.remarks]
    Page(
        title="quadpi: report",
        about="what do these logs tell of the vehicle?",
        verdict=report.verdict(),
        facts=dict(_facts(report)),
        definitions={
            "Drag over mass": "Specific force along a body axis over the airspeed along it, best for the "
            "speeds flown. The wind, horizontal and slow, is estimated with it, as is the IMU's bias.",
            "95 %": "Confidence interval, from estimates without each piece of flight in turn (jackknife): "
            "gusts make neighbouring samples one. Drag whose interval holds 0 is not told.",
            "MCOEF, BCOEF": "Momentum drag and ballistic coefficients, as PX4 and ArduPilot have them: "
            "−(MCOEF + ½ ρ |v| / BCOEF) v, at standard density. "
            "They hold for the speeds flown.",
            "Vibration": "Root mean square of what was logged, above 5 Hz. Not judged: ArduPilot's limits, "
            "30 and 60 m/s², are of VIBE, from raw samples of 1 kHz and more.",
        },
        figures={},
        flight_figures={name: {"time": time_figure(flight)} for name, flight in flights.items()},
        remarks=[*flight_remarks({}, report.left_out), *found],
    ).write(
        path,
        "field.html",
        table_of_flights=flight_table(report),
        shares={name: share_table(flight) for name, flight in flights.items()},
        topics={name: topic_table(flight) for name, flight in flights.items()},
        settings=settings_table(report),
        notes={name: flight.log.notes for name, flight in flights.items() if flight.log.notes},
        drags={vehicle.name: drag_table(vehicle, report.mass) for vehicle in report.vehicles},
        sentences={vehicle.name: motor_sentence(vehicle) for vehicle in report.vehicles},
        motors={name: motor_table(flight) for name, flight in flights.items()},
        flights={"": list(flights)},
    )
