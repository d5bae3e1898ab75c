# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From complete sensor samples to predictions and the alarm: the same code in a node and in replay."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.estimator.imu_rate import RATE_BEFORE_HZ, ImuRate
from quadpi_core.flight import AXES, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.monitor.adaptive import AdaptiveFactor
from quadpi_core.monitor.alarm import Alarm, Judged, MonitorSettings
from quadpi_core.monitor.events import EventLog
from quadpi_core.monitor.preparation import Preparation, Prepared
from quadpi_core.results import Alarms, Events, Predictions
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_core.models.aerodynamic import AerodynamicModel


class Monitor:
    """Watches one vehicle with one model; memory and time per sample are constant.

    Args:
        model: identified for this vehicle.
        vehicle: as in its vehicle file.
        rate_hz: sample rate of the IMU; None until :meth:`retune` says it: no sample is used before.
        confidence: nominal coverage of the intervals.
        settings: of the alarm, and whether intervals adapt.

    Raises:
        ModelError: if the model belongs to another vehicle or cannot support the confidence.
        SignalError: if the sample rate is too low for the cut-off that the model was identified with.
    """

    def __init__(
        self,
        model: AerodynamicModel,
        vehicle: Vehicle,
        rate_hz: float | None,
        confidence: float | None = None,
        settings: MonitorSettings | None = None,
    ) -> None:
        model.require(vehicle)
        self.model = model
        self.confidence = model.confidence if confidence is None else confidence
        settings = settings or MonitorSettings()
        self.preparation = Preparation(vehicle, rate_hz, model.cutoff_hz)
        self._alarm = Alarm(
            model.envelope,
            model.alarm_limits,
            settings,
            np.array([axis in model.axes for axis in AXES]),
            model.interval_ratio(self.confidence),
        )
        self._events = EventLog()
        self._adaptive = (
            AdaptiveFactor(self.confidence, rate_hz or RATE_BEFORE_HZ) if settings.adaptive else None
        )
        model.evaluate(np.zeros((1, len(INPUT_NAMES))), self.confidence)

    def reset(self) -> None:
        """Forget the past: as after construction."""
        self.preparation.reset()
        self._alarm.reset()
        self._events.reset()
        if self._adaptive is not None:
            self._adaptive.reset()

    def retune(self, rate: ImuRate) -> None:
        """Go on with samples of another rate; without one that fits, every sample is BAD_DATA.

        Raises:
            SignalError: see :meth:`Preparation.retune`.
        """
        if self._adaptive is not None and rate.filter_hz > 0.0:
            self._adaptive.retune(rate.filter_hz)
        self.preparation.retune(rate)

    def step(self, time_ns: Stamps, values: Array) -> tuple[Predictions, Alarms, Events]:
        """Take K samples; blocks of any length give the same rows, bit for bit.

        A sample that is not finite, not plausible or not later than the one before gives no prediction and
        counts as BAD_DATA. After a gap or a jump of the stamps the low-pass starts anew; adaptive intervals
        go on, as their coverage is that of all samples so far.

        Args:
            time_ns: (K,) stamps.
            values: (K, 20), see :class:`quadpi_core.monitor.pairing.PairedSamples`.
        """
        return self.judge(self.preparation.step(time_ns, values))

    def judge(self, prepared: Prepared) -> tuple[Predictions, Alarms, Events]:
        """Take K samples as a :class:`Preparation` of the model's cut-off gives them; see :meth:`step`."""
        predictions, usable, judged = self._evaluate(prepared)
        alarms = self._alarm.step(prepared.time_ns, usable, prepared.faults, judged)
        return predictions, alarms, self._events.take(alarms)

    def predict(self, prepared: Prepared) -> Predictions:
        """Predictions alone, without an alarm; see :meth:`judge`."""
        return self._evaluate(prepared)[0]

    def change(self, settings: MonitorSettings) -> None:
        """Go on with other times and rates of the alarm; which intervals go out stays as it is."""
        self._alarm.change(settings)

    def unheard(self, time_ns: int) -> Alarms:
        """The alarm at an instant without a sample, see :meth:`Alarm.unheard`; the log of events has none."""
        return self._alarm.unheard(time_ns)

    @property
    def events(self) -> Events:
        """The last events of the alarm, the oldest first."""
        return self._events.events

    def _evaluate(self, prepared: Prepared) -> tuple[Predictions, npt.NDArray[np.bool_], Judged]:
        """Predictions of the usable samples, which samples these are, and what the alarm goes by."""
        time_ns, usable, inputs, measured, velocity, _, settled = prepared
        used_ns = time_ns if len(inputs) == len(time_ns) else time_ns[usable]
        predicted, own_lower, own_upper, leverage, relative_width = self.model.evaluate(
            inputs, self.confidence
        )
        lower, upper = own_lower, own_upper
        if self._adaptive is not None:
            lower, upper = self._adaptive.step(measured, lower, upper)
        predictions = Predictions(used_ns, predicted, lower, upper, measured, relative_width)
        judged = Judged(inputs, velocity, leverage, relative_width, measured, own_lower, own_upper, settled)
        finite = np.empty(len(inputs), dtype=np.bool_)
        if not _all_finite(lower, upper, measured, leverage, inputs, finite):
            usable = usable.copy()
            usable[usable] = finite
            predictions = Predictions(
                *(getattr(predictions, column.name)[finite] for column in fields(predictions))
            )
            judged = Judged._make(column[finite] for column in judged)
        return predictions, usable, judged


@njit(cache=True)
def _all_finite(lower: Any, upper: Any, measured: Any, leverage: Any, inputs: Any, finite: Any) -> bool:
    """Mark the samples of which every number is finite; True if all are."""
    everywhere = True
    for i in range(finite.size):
        total = lower[i].sum() + upper[i].sum() + measured[i].sum() + leverage[i].sum() + inputs[i].sum()
        finite[i] = np.isfinite(total)
        everywhere &= finite[i]
    return everywhere
