# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The monitor: from paired samples to predictions and the alarm, the same code in a node and in replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from quadpi_core import array_checks
from quadpi_core.core import compiled
from quadpi_core.errors import ModelError, SignalError
from quadpi_core.estimator.imu_rate import RATE_BEFORE_HZ, ImuRate
from quadpi_core.flight import AXES, NO_STAMP, STAMP_MAX_NS, Stamps
from quadpi_core.frames import Array
from quadpi_core.models.aerodynamic import LOAD_MODEL, AerodynamicModel, unchecked_evaluation
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.monitor.adaptive import AdaptiveFactor
from quadpi_core.monitor.alarm import Alarm, MonitorSettings
from quadpi_core.monitor.alarm_log import EventLog
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.preparation import Preparation, Prepared
from quadpi_core.results import Alarms, Events, Predictions
from quadpi_core.signals.chain import CHANNELS
from quadpi_core.vehicle import Vehicle


class Monitor:
    """Watches one vehicle with one model; memory and time per sample are constant.

    Args:
        model: identified for this vehicle.
        vehicle: as in its vehicle file.
        rate_hz: sample rate of the IMU; None until :meth:`retune` gives it: no sample is used before.
        confidence: nominal coverage of the intervals; the model's own unless given.
        settings: of the alarm, and whether intervals adapt.

    Raises:
        ArgumentError: for what is no model, vehicle, rate, confidence or settings.
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
        array_checks.instance("model", model, AerodynamicModel, LOAD_MODEL)
        model.require(vehicle)
        self.model = model
        if rate_hz is not None:
            rate_hz = array_checks.number("rate_hz", rate_hz, above=0.0)
        if confidence is not None:
            confidence = array_checks.number("confidence", confidence)
        self.confidence = model.confidence if confidence is None else confidence
        settings = MonitorSettings() if settings is None else settings
        array_checks.instance("settings", settings, MonitorSettings)
        self.vehicle = vehicle
        self.preparation = Preparation(vehicle, rate_hz, model.cutoff_hz)
        self._alarm = Alarm(
            model.envelope,
            model.alarm_limits,
            settings,
            np.array([axis in model.axes for axis in AXES]),
            model.interval_ratio(self.confidence),
            vehicle,
        )
        self._log = EventLog()
        self._adaptive = (
            AdaptiveFactor(self.confidence, rate_hz or RATE_BEFORE_HZ) if settings.adaptive else None
        )

    def step(self, time_ns: Stamps, values: Array) -> tuple[Predictions, Alarms, Events]:
        """Take K samples; blocks of any length give the same rows, bit for bit.

        A sample that is not finite, not plausible or not later than the one before gives no prediction and
        counts as BAD_DATA. After a gap or a jump of the stamps the low-pass starts again; adaptive intervals
        go on, as their coverage is that of all samples so far.

        Args:
            time_ns: (K,) stamps.
            values: (K, 20), see :class:`quadpi_core.monitor.pairing.PairedSamples`.

        Raises:
            ArgumentError: for arrays of other shapes, another number of stamps than rows, and stamps that are
                no whole nanoseconds.
        """
        if not array_checks.are_samples(time_ns, values, CHANNELS):
            time_ns = array_checks.stamps("time_ns", time_ns)
            values = array_checks.floats(
                "values", values, CHANNELS, rows=len(time_ns), of="time_ns", finite=False
            )
        # Judge the data; from the samples that can be used, filter inputs and measured wrench.
        prepared = self.preparation.step(time_ns, values)
        return self._judge(prepared)

    def judge(self, prepared: Prepared) -> tuple[Predictions, Alarms, Events]:
        """Take K samples as a :class:`Preparation` of the model's cut-off gives them; see :meth:`step`.

        Raises:
            ArgumentError: for arrays that do not fit each other.
        """
        return self._judge(array_checks.instance("prepared", prepared, Prepared).checked())

    def _judge(self, prepared: Prepared) -> tuple[Predictions, Alarms, Events]:
        # The model's prediction, its own interval, leverage and width of each usable sample.
        predictions, prepared, evaluation = self._evaluate(prepared)
        # Evidence of the three causes, their charges and levels; rows where something changes.
        alarms = self._alarm.step(prepared, evaluation)
        # Alarms that were raised or cleared, with their reasons.
        events = self._log.take(alarms) if len(alarms.time_ns) else []
        return predictions, alarms, events

    def predict(self, prepared: Prepared) -> Predictions:
        """Predictions alone, without an alarm; see :meth:`judge`."""
        return self._evaluate(array_checks.instance("prepared", prepared, Prepared).checked())[0]

    def _evaluate(self, prepared: Prepared) -> tuple[Predictions, Prepared, Evaluation]:
        """Predictions, the samples that stay usable, and the model's evaluation with its own intervals.

        A sample one of whose numbers overflows is no longer usable.
        """
        inputs, measured = prepared.inputs, prepared.measured
        evaluation = unchecked_evaluation(self.model, inputs, self.confidence, prepared.derivatives)
        predicted, lower, upper, leverage, relative_width = evaluation
        if self._adaptive is not None:
            lower, upper = self._adaptive.step(measured, lower, upper)
        if not compiled.all_finite(*map(np.ascontiguousarray, (lower, upper, leverage))):
            every = np.concatenate((lower, upper, leverage), axis=1)
            finite = np.asarray(np.isfinite(every).all(axis=1))
            prepared = prepared.where(finite)
            evaluation = Evaluation._make(column[finite] for column in evaluation)
            predicted, _, _, _, relative_width = evaluation
            lower, upper, measured = lower[finite], upper[finite], prepared.measured
        predictions = Predictions(prepared.usable_ns, predicted, lower, upper, measured, relative_width)
        return predictions, prepared, evaluation

    def reset(self) -> None:
        """Forget the past: as after construction."""
        self.preparation.reset()
        self._alarm.reset()
        self._log.reset()
        if self._adaptive is not None:
            self._adaptive.reset()

    def retune(self, rate: ImuRate) -> None:
        """Go on with samples of another rate; without one that fits, every sample is BAD_DATA.

        Raises:
            SignalError: see :meth:`Preparation.retune`.
        """
        array_checks.instance("rate", rate, ImuRate)
        if self._adaptive is not None and rate.filter_hz > 0.0:
            self._adaptive.retune(rate.filter_hz)
        self.preparation.retune(rate)

    def change(self, settings: MonitorSettings) -> None:
        """Update alarm settings in flight; the interval type cannot change."""
        array_checks.instance("settings", settings, MonitorSettings)
        self._alarm.change(settings)

    def alarm_without_sample(self, time_ns: int) -> Alarms:
        """The alarm at an instant without a sample, see :meth:`Alarm.without_sample`; it is not logged."""
        return self._alarm.without_sample(array_checks.whole("time_ns", time_ns, NO_STAMP, STAMP_MAX_NS))

    @property
    def events(self) -> Events:
        """The last events of the alarm, the oldest first."""
        return self._log.events


class Monitors:
    """Monitors of one vehicle, by name. The first gives predictions and the alarm, the others predictions.

    What monitors of one cut-off share, the low-pass above all, runs once for all of them.
    """

    def __init__(self, monitors: Mapping[str, Monitor]) -> None:
        self._monitors: dict[str, Monitor] = {}
        self._rate: ImuRate | None = None
        for name, monitor in monitors.items():
            self._put(name, monitor)

    @property
    def names(self) -> Sequence[str]:
        """Names of the monitors, the first one first."""
        return list(self._monitors)

    def __getitem__(self, name: str) -> Monitor:
        return self._monitors[name]

    def replace(self, name: str, monitor: Monitor) -> None:
        """Put a new monitor in the place of one; with the same cut-off, the low-pass goes on.

        Raises:
            ModelError: if there is none of that name, or the rate of the IMU is too low for the new one.
        """
        if name not in self._monitors:
            raise ModelError(f"no model flies as `{name}`; those that fly: {', '.join(self._monitors)}")
        if self._rate is not None:
            try:
                monitor.retune(self._rate)
            except SignalError as error:
                raise ModelError(f"{monitor.model.identity}: {error}") from error
        self._put(name, monitor)

    def change(self, settings: MonitorSettings) -> None:
        """Update the alarm settings of all models in flight; see :meth:`Monitor.change`."""
        for monitor in self._monitors.values():
            monitor.change(settings)

    def reset(self) -> None:
        """Forget the past: as after construction."""
        for monitor in self._monitors.values():
            monitor.reset()

    def retune(self, rate: ImuRate) -> list[str]:
        """Go on with samples of another rate; returns a sentence for each model that it is too low for."""
        self._rate = rate
        problems = []
        for name, monitor in self._monitors.items():
            try:
                monitor.retune(rate)
            except SignalError as error:
                problems.append(f"model {name}: {error}")
        return problems

    def step(self, samples: PairedSamples) -> tuple[tuple[Predictions, Alarms, Events], list[Predictions]]:
        """Take K samples: the results of the first monitor, see :meth:`Monitor.step`; others' predictions."""
        first, *others = self._monitors.values()
        prepared = first.preparation.step(*samples)
        results = first._judge(prepared)
        if not others:
            return results, []
        by_preparation = {first.preparation: prepared}
        predictions = []
        for monitor in others:
            if monitor.preparation not in by_preparation:
                by_preparation[monitor.preparation] = monitor.preparation.step(*samples)
            predictions.append(monitor._evaluate(by_preparation[monitor.preparation])[0])
        return results, predictions

    def _put(self, name: str, monitor: Monitor) -> None:
        for other in self._monitors.values():
            if other.model.cutoff_hz == monitor.model.cutoff_hz:
                monitor.preparation = other.preparation
                break
        self._monitors[name] = monitor
