# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Samples and limits that the tests of the alarm share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.inputs import DERIVATIVES, INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.monitor.alarm import Alarm, MonitorSettings
from quadpi_core.monitor.preparation import VERDICT, Prepared
from quadpi_core.results import Alarms

RATE_HZ = 500
STEP_NS = 1_000_000_000 // RATE_HZ
SETTINGS = MonitorSettings(persistence_s=0.1, release_s=0.5, alarm_rate_hz=10.0)
U, Q = INPUT_INDEX["u"], INPUT_INDEX["q"]
ALLOWANCE = 0.128
LIMITS = AlarmLimits(ALLOWANCE, np.full(6, 1.0), flights=20, hours=0.5)
FX, FZ, MY = 0, 2, 4


class Samples:
    """Samples well inside the envelope, to be disturbed by a test; intervals are 1 on either side."""

    def __init__(self, seconds: float) -> None:
        count = round(seconds * RATE_HZ)
        self.time_ns = 1_000_000_000 + STEP_NS * np.arange(count, dtype=np.int64)
        self.usable = np.ones(count, dtype=np.bool_)
        self.inputs = np.zeros((count, len(INPUT_NAMES)))
        self.leverage = np.full((count, 6), 0.005)
        self.width = np.ones((count, 6))
        self.velocity = np.zeros((count, 3))
        self.rates = np.zeros((count, 3))
        self.specific_force = np.full((count, 3), [0.0, 0.0, -9.81])
        self.rotor_speeds = np.zeros((count, 4))
        self.measured, self.predicted = np.zeros((2, count, 6))
        self.faults = np.zeros(count, dtype=np.int64)
        self.settled = np.ones(count, dtype=np.bool_)
        self.wind_unknown = np.zeros(count, dtype=np.bool_)

    def between(self, start_s: float, stop_s: float) -> slice:
        return slice(round(start_s * RATE_HZ), round(stop_s * RATE_HZ))

    def parts(self, alarm: Alarm, block: int) -> Iterator[Alarms]:
        """What the alarm says of one block after the other."""
        for start in range(0, len(self.time_ns), block):
            keep = slice(start, start + block)
            used = self.usable[keep]
            verdicts = np.zeros(len(used), VERDICT)
            for name in (
                *("time_ns", "usable", "faults", "settled", "wind_unknown"),
                *("velocity", "rates", "specific_force", "rotor_speeds"),
            ):
                verdicts[name] = getattr(self, name)[keep]
            inputs, measured = self.inputs[keep][used], self.measured[keep][used]
            still = np.zeros(len(inputs), DERIVATIVES)
            prepared = Prepared(verdicts, inputs, measured, self.time_ns[keep][used], still)
            said = self.predicted[keep][used]
            leverage, width = self.leverage[keep][used], self.width[keep][used]
            yield step(alarm, prepared, Evaluation(said, said - 1.0, said + 1.0, leverage, width))

    def run(self, alarm: Alarm, block: int | None = None) -> Alarms:
        parts = list(self.parts(alarm, block or len(self.time_ns)))
        return Alarms(
            **{
                field.name: np.concatenate([getattr(part, field.name) for part in parts])
                for field in fields(Alarms)
            }
        )


def step(alarm: Alarm, prepared: Prepared, evaluation: Evaluation) -> Alarms:
    """Let an alarm take samples, and what a model says of the usable ones with its own intervals."""
    if isinstance(alarm, LiftingAlarm):
        lifted = evaluation.predicted.copy()
        lifted[:, 2] = -0.363
        wide = 0.5 * np.ones_like(lifted)
        prepared = prepared._replace(measured=prepared.measured + lifted)
        evaluation = evaluation._replace(lower=lifted - wide, upper=lifted + wide)
    said, rows = map(np.ascontiguousarray, evaluation[1:]), alarm.room(len(prepared.verdicts))
    given = (prepared.verdicts, prepared.inputs, prepared.measured)
    return alarm.taken(compiled.advance_alarm(alarm.limits, alarm.state, *given, *said, rows))


class LiftingAlarm(Alarm):
    """An alarm whose model says that the rotors carry the vehicle."""


def changes(rows: Alarms) -> list[tuple[float, int, int]]:
    """(seconds since the first sample, level, causes) where the published state changes."""
    state = np.stack((rows.level, rows.causes), axis=1)
    new = np.r_[True, np.any(np.diff(state.astype(int), axis=0) != 0, axis=1)]
    seconds = (rows.time_ns - 1_000_000_000) * 1e-9
    return [
        (round(float(seconds[i]), 6), int(rows.level[i]), int(rows.causes[i])) for i in np.flatnonzero(new)
    ]


def missing_shares(samples: Samples, axis: int, share: float, start_s: float, stop_s: float) -> None:
    """Misses of one axis, evenly spread, between two instants."""
    keep = samples.between(start_s, stop_s)
    count = len(samples.time_ns[keep])
    missed = np.floor(share * np.arange(1, count + 1)) > np.floor(share * np.arange(count))
    samples.measured[keep, axis] = np.where(missed, 2.0, 0.0)
