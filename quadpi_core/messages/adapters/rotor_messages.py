# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""ESC reports as rotor speeds.

Each message becomes four speeds and four marks, numbers that change with every report of an ESC. Autopilots
and bridges repeat an ESC's last report: a row without a new report is no sample, and neither is one in
which an ESC has been silent for SILENT_NS.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.flight import RotorSpeedStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.messages.adapters.adapter_definition import Reading
from quadpi_core.messages.adapters.adapter_settings import RotorSettings
from quadpi_core.messages.cdr import Columns, header_stamps
from quadpi_core.messages.foreign_messages import Items
from quadpi_core.messages.payloads import Indices
from quadpi_core.rotor_order import ERPM, RotorOrder
from quadpi_core.unusable_readings import SILENT_NS, UnusableReports, Verdict
from quadpi_core.vehicle import ROTORS, Vehicle

# PX4's `actuator_function` of the first motor and of the last.
MOTORS = (101, 112)


class EscReports(NamedTuple):
    """Reports of the vehicle's rotors in N messages, in rotor order.

    Attributes:
        time_ns: (N,).
        rpm: (N, 4); any number where there is no sample.
        marks: (N, 4) change with every report of the ESC.
        verdict: (N,) see :class:`Verdict`.
    """

    time_ns: Stamps
    rpm: Array
    marks: Indices
    verdict: npt.NDArray[np.uint8]


def reports_in_esc_order(columns: Columns, array: Items, marks: Indices, order: Indices) -> EscReports:
    """Reports of messages with a header and an array in which the place is the number of the ESC.

    Args:
        columns: of the messages.
        array: of reports, with their `rpm`.
        marks: (M,) of all reports.
        order: (4,) numbers of the vehicle's ESCs, from 0.
    """
    time_ns = header_stamps(columns)
    rpm = array.columns["rpm"].astype(np.float64)
    return EscReports(time_ns, *_numbered(array.counts, rpm, marks, order))


@njit(cache=True)
def _numbered(
    counts: Indices, rpm: Array, marks: Indices, order: Indices
) -> tuple[Array, Indices, npt.NDArray[np.uint8]]:
    """Reports of the wanted ESCs, where the place in the array is the number of the ESC.

    Args:
        counts: (N,) reports in each message.
        rpm: (M,) of all reports.
        marks: (M,).
        order: (4,) numbers from 0.
    """
    speeds, own_marks = np.zeros((len(counts), len(order))), np.zeros((len(counts), len(order)), np.int64)
    verdict = np.zeros(len(counts), np.uint8)
    start = 0
    for n in range(len(counts)):
        if counts[n] == 0:
            verdict[n] = Verdict.NONE_ANNOUNCED
        elif counts[n] <= order.max():
            verdict[n] = Verdict.TOO_FEW
        elif np.count_nonzero(rpm[start : start + counts[n]]) > len(order):
            verdict[n] = Verdict.MORE_ROTORS
        else:
            for rotor in range(len(order)):
                speeds[n, rotor] = rpm[start + order[rotor]]
                own_marks[n, rotor] = marks[start + order[rotor]]
        start += counts[n]
    return speeds, own_marks, verdict


@njit(cache=True)
def reports_of_motors(
    functions: Indices, rpm: Array, marks: Indices, online: Indices, wanted: Indices
) -> tuple[Array, Indices, npt.NDArray[np.uint8]]:
    """Reports of the wanted motors, where each report names its motor.

    Args:
        functions: (N E,) what each of the E reports of N messages is of.
        rpm: (N E,).
        marks: (N E,) 0 where the ESC has never reported.
        online: (N,) bits, by place in the array.
        wanted: (4,) functions.
    """
    count = len(online)
    each = len(functions) // max(count, 1)
    speeds, own_marks = np.zeros((count, len(wanted))), np.zeros((count, len(wanted)), np.int64)
    verdict = np.zeros(count, np.uint8)
    for n in range(count):
        turning = 0
        for place in range(n * each, (n + 1) * each):
            turning += functions[place] >= MOTORS[0] and functions[place] <= MOTORS[1] and rpm[place] != 0.0
        for rotor in range(len(wanted)):
            found, own = -1, 0
            for place in range(each):
                if functions[n * each + place] != wanted[rotor]:
                    continue
                if found >= 0:
                    verdict[n] = Verdict.MOTOR_TWICE
                found, own = place, marks[n * each + place]
            if found < 0:
                verdict[n] = Verdict.MOTOR_MISSING
            elif (online[n] >> found) & 1 == 0:
                verdict[n] = Verdict.OFFLINE
            elif own == 0:
                verdict[n] = Verdict.NEVER_REPORTED
            else:
                speeds[n, rotor] = rpm[n * each + found]
                own_marks[n, rotor] = own
        if turning > len(wanted) and verdict[n] != Verdict.MOTOR_TWICE:
            verdict[n] = Verdict.MORE_ROTORS
    return speeds, own_marks, verdict


@njit(cache=True)
def _judge_news(
    time_ns: Stamps, marks: Indices, verdict: npt.NDArray[np.uint8], latest: Indices, heard_ns: Stamps
) -> None:
    """Find rows that hold nothing new, or in which an ESC has been silent for SILENT_NS.

    Args:
        time_ns: (N,).
        marks: (N, 4).
        verdict: (N,) changed where a row that was a sample is none.
        latest: (4,) state: the marks of the last row; -1 before the first.
        heard_ns: (4,) state: when they changed.
    """
    for n in range(len(time_ns)):
        if verdict[n] != Verdict.SAMPLE:
            continue
        news, silent = False, False
        for rotor in range(len(latest)):
            if marks[n, rotor] != latest[rotor]:
                latest[rotor], heard_ns[rotor] = marks[n, rotor], time_ns[n]
                news = True
            elif time_ns[n] - heard_ns[rotor] > SILENT_NS:
                silent = True
        if not news:
            verdict[n] = Verdict.REPEATED
        elif silent:
            verdict[n] = Verdict.SILENT


class RotorReader:
    """Rotor speeds from the reports of any message; keeps the marks that distinguish new from repeated ones.

    Attributes:
        unusable: the messages that gave no sample.
    """

    def __init__(self, order: RotorOrder, vehicle: Vehicle | None) -> None:
        if order.unit == ERPM:
            order.speeds(np.zeros(ROTORS), vehicle)
        self._order = order
        self._vehicle = vehicle
        self._latest = np.full(ROTORS, -1, dtype=np.int64)
        self._heard_ns = np.zeros(ROTORS, dtype=np.int64)
        self.unusable = UnusableReports()

    def judged(self, reports: EscReports) -> tuple[RotorSpeedStream, npt.NDArray[np.uint8]]:
        """Speeds of all reports, and which of them form a sample (N,), see :class:`Verdict`."""
        time_ns, rpm, marks, verdict = reports
        _judge_news(time_ns, marks, verdict, self._latest, self._heard_ns)
        return RotorSpeedStream(time_ns, self._order.speeds(rpm, self._vehicle)), verdict

    def read(self, reports: EscReports) -> RotorSpeedStream:
        """The samples among the reports."""
        stream, verdict = self.judged(reports)
        self.unusable.add(stream.time_ns, verdict)
        return stream.take(verdict == Verdict.SAMPLE) if verdict.any() else stream


def start_of_rotors(
    reports: Callable[[Columns, dict[str, Items], Indices], EscReports],
) -> Callable[[RotorSettings, Vehicle | None], Reading]:
    """`Adapter.start` of messages whose reports `reports` gives, for numbers (4,) of ESCs or motors."""

    def start(settings: RotorSettings, vehicle: Vehicle | None) -> Reading:
        order = settings.order(vehicle)
        numbers, reader = np.array(order.controllers), RotorReader(order, vehicle)
        return Reading(
            lambda columns, items: reader.read(reports(columns, items, numbers)),
            lambda: reader.unusable.by_reason,
            reader.unusable.left_out,
        )

    return start
