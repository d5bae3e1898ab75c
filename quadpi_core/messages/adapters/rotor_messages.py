# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""ESC reports as rotor speeds.

Each message becomes a speed and a mark of each rotor, a number that changes with every report of its ESC.
Autopilots and bridges repeat an ESC's last report: a row without a new report is no sample, and neither is
one in which an ESC has been silent for 0.1 s.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import SampleError
from quadpi_core.findings import UnusableReports, Verdict
from quadpi_core.flight import BatteryStream, MotorCommandStream, RotorSpeedStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.messages.adapters.adapter_definition import Reading, start_of_numbers
from quadpi_core.messages.adapters.adapter_settings import CommandSettings, RotorSettings
from quadpi_core.messages.cdr import Columns, header_stamps
from quadpi_core.messages.definitions import Items
from quadpi_core.messages.payloads import Indices
from quadpi_core.records import ROTORS_MAX, record_dtype
from quadpi_core.rotor_order import ERPM, RotorOrder
from quadpi_core.vehicle import Vehicle

# PX4's `actuator_function` of the first motor and of the last.
MOTORS = (compiled.FIRST_MOTOR, compiled.LAST_MOTOR)


class EscReports(NamedTuple):
    """Reports of the vehicle's rotors in N messages, in rotor order.

    Attributes:
        time_ns: (N,).
        rpm: (N, rotors); any number where there is no sample.
        marks: (N, rotors) change with every report of the ESC.
        verdict: (N,) see :class:`Verdict`.
    """

    time_ns: Stamps
    rpm: Array
    marks: Indices
    verdict: npt.NDArray[np.uint8]

    @classmethod
    def none(cls, time_ns: Stamps, rotors: int) -> EscReports:
        """Room for the reports of messages with these stamps (N,)."""
        count = len(time_ns)
        return cls(
            time_ns,
            np.zeros((count, rotors)),
            np.zeros((count, rotors), dtype=np.int64),
            np.zeros(count, dtype=np.uint8),
        )


class _EscMemory:
    """That of core/include/quadpi/messages/rotor_messages.hpp."""

    latest: Annotated[Indices, ROTORS_MAX]
    heard_ns: Annotated[Indices, ROTORS_MAX]


_MEMORY = record_dtype(_EscMemory)


def reports_in_esc_order(columns: Columns, array: Items, marks: Indices, order: Indices) -> EscReports:
    """Reports of messages with a header and an array by number of the ESC; `order` (R,) of each rotor's."""
    reports = EscReports.none(header_stamps(columns), len(order))
    rpm = array.columns["rpm"].astype(np.float64)
    compiled.take_numbered_escs(array.counts, rpm, marks, order, reports)
    return reports


def reports_of_motors(
    functions: Indices, rpm: Array, marks: Indices, online: Indices, wanted: Indices, time_ns: Stamps
) -> EscReports:
    """Reports of the wanted motors, where each report names its motor.

    Args:
        functions: (N E,) what each of the E reports of N messages is of.
        rpm: (N E,).
        marks: (N E,) 0 where the ESC has never reported.
        online: (N,) bits, by place in the array.
        wanted: (rotors,) functions.
        time_ns: (N,).
    """
    reports = EscReports.none(time_ns, len(wanted))
    compiled.take_escs_of_motors(functions, rpm, marks, online, wanted, reports)
    return reports


class RotorReader:
    """Rotor speeds from the reports of any message; keeps the marks that distinguish new from repeated ones.

    Attributes:
        unusable: the messages that gave no sample.
    """

    def __init__(self, order: RotorOrder, vehicle: Vehicle | None) -> None:
        if order.unit == ERPM:
            order.speeds(np.zeros(len(order.controllers)), vehicle)
        self._order = order
        self._vehicle = vehicle
        self._memory = np.zeros(1, _MEMORY)
        self._memory["latest"] = -1
        self.unusable = UnusableReports()

    def judged(self, reports: EscReports) -> tuple[RotorSpeedStream, npt.NDArray[np.uint8]]:
        """Speeds of all reports, and which of them form a sample (N,), see :class:`Verdict`."""
        compiled.judge_esc_news(reports, self._memory)
        speeds = self._order.speeds(reports.rpm, self._vehicle)
        return RotorSpeedStream(reports.time_ns, speeds), reports.verdict

    def read(self, reports: EscReports) -> RotorSpeedStream:
        """The samples among the reports."""
        stream, verdict = self.judged(reports)
        self.unusable.add(stream.time_ns, verdict)
        return stream.take(verdict == Verdict.SAMPLE) if verdict.any() else stream


def start_of_rotors(
    reports: Callable[[Columns, dict[str, Items], Indices], EscReports],
) -> Callable[[RotorSettings, Vehicle | None], Reading]:
    """`Adapter.start` of messages whose reports `reports` gives, for numbers (rotors,) of ESCs or motors."""

    def start(settings: RotorSettings, vehicle: Vehicle | None) -> Reading:
        order = settings.order(vehicle)
        numbers, reader = np.array(order.controllers), RotorReader(order, vehicle)
        return Reading(
            lambda columns, items: reader.read(reports(columns, items, numbers)),
            lambda: reader.unusable.by_reason,
            reader.unusable.left_out,
        )

    return start


# µs; motors do not turn at pulses up to the second.
_PULSE_MIN, _PULSE_REST, _OUTPUT_FULL = 800.0, 1000.0, 2000.0


def start_of_commands(
    column: str, stamps: Callable[[Columns], Stamps], scaled: Callable[[Array], Array], layout: str = ""
) -> Callable[[CommandSettings, Vehicle | None], Reading]:
    """`Adapter.start` of messages with the commands of all outputs in one array.

    Args:
        column: that holds them (N, outputs).
        stamps: gives those of N messages.
        scaled: gives commands of values; 0 for a motor that stands.
        layout: of the motors unless the settings say it; the usual one unless given.
    """

    def start(settings: CommandSettings, vehicle: Vehicle | None) -> Reading:
        order = list(settings.order(vehicle, layout).controllers)
        dropped: Counter[str] = Counter()

        def read(columns: Columns, _items: object) -> MotorCommandStream:
            values, time_ns = columns[column].astype(np.float64), stamps(columns)
            if values.shape[1] <= max(order):
                if np.any(values) and isinstance(settings.rotors, tuple):
                    raise SampleError(
                        0,
                        f"{column} has {values.shape[1]} outputs, and `rotors` names output {max(order) + 1}",
                    )
                # Before the autopilot is heard, and of another vehicle.
                few = "fewer outputs than the vehicle has motors"
                dropped[few if np.any(values) else "no output is announced yet"] += len(values)
                return MotorCommandStream(time_ns[:0], np.empty((0, len(order))))
            return MotorCommandStream(time_ns, scaled(np.nan_to_num(values[:, order], nan=0.0)))

        return Reading(read, lambda: dropped)

    return start


def shares_of_outputs(outputs: Array) -> Array:
    """Commands of PX4's outputs (N, R): pulses in µs or steps of DShot, which does not matter to motors.

    Those that are identified on them know their scale. All outputs at one pulse of at most 1000 µs are of a
    vehicle that is disarmed; at rest steps of DShot are 0.
    """
    first = outputs[:, :1]
    disarmed = (outputs == first).all(axis=1, keepdims=True) & (first >= _PULSE_MIN) & (first <= _PULSE_REST)
    return np.where(disarmed, 0.0, outputs / _OUTPUT_FULL)


def start_of_battery(
    column: str, stamps: Callable[[Columns], Stamps]
) -> Callable[[object, Vehicle | None], Reading]:
    """`Adapter.start` of messages with a voltage [V] in a column; what is not above 0 was not measured."""
    return start_of_numbers(
        column,
        stamps,
        BatteryStream,
        lambda volts: np.isfinite(volts) & (volts > 0.0),
        "the voltage is not known",
    )
