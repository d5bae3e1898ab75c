# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The monitor: from paired samples to predictions and the alarm, the same code in a node and in replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import NamedTuple, TypeAlias

import numpy as np

from quadpi_core import array_checks
from quadpi_core.core import compiled
from quadpi_core.errors import ModelError, SignalError
from quadpi_core.estimator.filter_state import RATE_BEFORE_HZ, ImuRate
from quadpi_core.flight import AXES, NO_STAMP, STAMP_MAX_NS, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.aerodynamic import LOAD_MODEL, AerodynamicModel, unchecked_evaluation
from quadpi_core.models.model_kind import compiled_model
from quadpi_core.monitor.adaptive import MEMORY, AdaptiveIntervals
from quadpi_core.monitor.alarm import Alarm, MonitorSettings
from quadpi_core.monitor.alarm_kernel import ROW
from quadpi_core.monitor.alarm_log import EventLog
from quadpi_core.monitor.pairing import PairedSamples, Pairing, Said
from quadpi_core.monitor.preparation import CONDITIONS, STATE_ERRORS, Preparation, Prepared
from quadpi_core.monitor.wind_state import SampleContext
from quadpi_core.records import Records
from quadpi_core.results import Alarms, Events, PredictionRows, Predictions
from quadpi_core.signals.chain import channels
from quadpi_core.vehicle import Vehicle


class _Arrays(NamedTuple):
    """What compiled code knows and remembers of a monitor, but for its preparation.

    Attributes:
        limits, alarm: see :class:`Alarm`.
        adaptive: see :class:`AdaptiveIntervals`; empty where intervals do not adapt.
        factors: (6,) half width of each axis' interval per unit of spread.
        model: None for one that Python evaluates.
    """

    limits: Records
    alarm: Records
    adaptive: Records
    factors: Array
    model: compiled.Model | None


_AXES = len(AXES)
# Samples whose erring inputs, 18 of each, are evaluated together.
_ERRING_BLOCK = 256
# Room for predictions of K samples: stamps (K,), and predicted, lower, upper, measured and relative width
# (5, K, 6).
_Room: TypeAlias = tuple[Stamps, Array]


def _room(samples: int) -> _Room:
    return np.empty(samples, np.int64), np.empty((5, samples, _AXES))


def _predictions(room: _Room, count: int) -> Predictions:
    """The first ones."""
    time_ns, wrenches = room
    if count < len(time_ns):
        time_ns, wrenches = time_ns[:count], wrenches[:, :count]
    # Faster one by one than by *wrenches.
    return Predictions(time_ns, wrenches[0], wrenches[1], wrenches[2], wrenches[3], wrenches[4])


_NOTHING_SAID, _NOTHING_ADDED = np.empty((5, 0, _AXES)), np.empty((0, _AXES))
_NO_ALARM = np.empty(0, ROW)
_NO_EVENTS: Events = []


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
        self._channels = channels(vehicle.rotor_count)
        self.preparation = Preparation(vehicle, rate_hz, model.cutoff_hz, goes_with_air=model.goes_with_air)
        self._alarm = Alarm(
            model.envelope,
            model.alarm_limits,
            settings,
            np.array([axis in model.axes for axis in AXES]),
            model.interval_ratio(self.confidence),
            vehicle,
            model.change_limits,
        )
        self._log = EventLog()
        self._adaptive = (
            AdaptiveIntervals(self.confidence, rate_hz or RATE_BEFORE_HZ, model.moving_centre)
            if settings.adaptive
            else None
        )
        own = compiled_model(model.fitted)
        self._is_compiled = own is not None
        adaptive = np.empty(0, MEMORY) if self._adaptive is None else self._adaptive.memory
        factors = model.fitted.factors(self.confidence)
        self._compiled = compiled.Monitor(
            _Arrays(self._alarm.limits, self._alarm.state, adaptive, factors, own)
        )

    def step(
        self, time_ns: Stamps, values: Array, conditions: Records | None = None
    ) -> tuple[Predictions, Alarms, Events]:
        """Take K samples; blocks of any length give the same rows, bit for bit.

        A sample that is not finite, not plausible or not later than the one before gives no prediction and
        counts as BAD_DATA. After a gap or a jump of the stamps the low-pass starts again; adaptive intervals
        go on, as their coverage is that of all samples so far.

        Args:
            time_ns: (K,) stamps.
            values: (K, 16 + rotors), see :class:`quadpi_core.monitor.pairing.PairedSamples`.
            conditions: (K,) of :func:`.preparation.conditions`, where more is known of the samples.

        Raises:
            ArgumentError: for arrays of other shapes, another number of stamps than rows, and stamps that are
                no whole nanoseconds.
        """
        if not array_checks.are_samples(time_ns, values, self._channels):
            time_ns = array_checks.stamps("time_ns", time_ns)
            values = array_checks.floats(
                "values", values, self._channels, rows=len(time_ns), of="time_ns", finite=False
            )
        if conditions is None:
            return self._step(time_ns, values)
        conditions = array_checks.records(
            "conditions", conditions, CONDITIONS, rows=len(time_ns), of="time_ns"
        )
        return self._judge(self.preparation.step(time_ns, values, conditions))

    def _step(self, time_ns: Stamps, values: Array) -> tuple[Predictions, Alarms, Events]:
        if not self._is_compiled:
            return self._judge(self.preparation.step(time_ns, values))
        # Judge and filter the samples, predict, gather evidence: all of it in the core.
        room = _room(len(time_ns))
        alarms = self._alarm.room(len(time_ns))
        memory = self.preparation.memory
        predicted, raised = compiled.step_monitor(self._compiled, memory, time_ns, values, *room, alarms)
        return self._results(room, predicted, raised)

    def judge(self, prepared: Prepared) -> tuple[Predictions, Alarms, Events]:
        """Take K samples as a :class:`Preparation` of the model's cut-off gives them; see :meth:`step`.

        Raises:
            ArgumentError: for arrays that do not fit each other.
        """
        return self._judge(array_checks.instance("prepared", prepared, Prepared).checked())

    def _judge(self, prepared: Prepared) -> tuple[Predictions, Alarms, Events]:
        room = _room(len(prepared.inputs))
        return self._results(room, *self._filled(prepared, room, self._alarm.room(len(prepared.verdicts))))

    def predict(self, prepared: Prepared) -> Predictions:
        """Predictions alone, without an alarm; see :meth:`judge`."""
        return self._predict(array_checks.instance("prepared", prepared, Prepared).checked())

    def _predict(self, prepared: Prepared) -> Predictions:
        room = _room(len(prepared.inputs))
        predicted, _ = self._filled(prepared, room, _NO_ALARM)
        return _predictions(room, predicted)

    def _filled(self, prepared: Prepared, room: _Room, alarms: Records) -> tuple[int, int]:
        """How many rows of predictions and of the alarm, unless there is room for none, samples fill.

        A sample one of whose numbers overflows is no longer usable.
        """
        said = _NOTHING_SAID
        if not self._is_compiled:
            said = np.stack(
                unchecked_evaluation(self.model, prepared.inputs, self.confidence, prepared.derivatives)
            )
        return compiled.judge_prepared(self._compiled, prepared, self._added(prepared), said, *room, alarms)

    def _added(self, prepared: Prepared) -> Array:
        """Squares (U, 6) of what the errors of the states add to half widths; (0, 6) where none are known."""
        if len(prepared.erring) == 0:
            return _NOTHING_ADDED
        added = np.empty((len(prepared.erring), _AXES))
        quantile = NormalDist().inv_cdf(0.5 + 0.5 * self.confidence)
        for start in range(0, len(added), _ERRING_BLOCK):
            part = slice(start, start + _ERRING_BLOCK)
            inputs = prepared.erring[part].reshape(-1, len(INPUT_NAMES))
            derivatives = np.repeat(prepared.derivatives[part], 2 * STATE_ERRORS)
            said = unchecked_evaluation(self.model, inputs, self.confidence, derivatives)
            ways = said.predicted.reshape(-1, STATE_ERRORS, 2, _AXES)
            added[part] = np.sum(np.square(0.5 * quantile * (ways[:, :, 0] - ways[:, :, 1])), axis=1)
        return added

    def _results(self, room: _Room, predicted: int, raised: int) -> tuple[Predictions, Alarms, Events]:
        alarms = self._alarm.taken(raised)
        # Alarms that were raised or cleared, with their reasons.
        events = self._log.take(alarms) if raised else []
        return _predictions(room, predicted), alarms, events

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

    def fly_in(self, density: float) -> None:
        """Go on in air of a density [kg/m³]; 0 where only the vehicle file tells.

        A model whose flights did not tell their air stays with the air that it was identified in.
        """
        self.preparation.fly_in(density)

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


class Judged(NamedTuple):
    """What monitors say of samples.

    Attributes:
        samples: how many they are.
        predictions: of each monitor, the first one first; the next samples overwrite them.
        alarms, events: of the first.
    """

    samples: int
    predictions: Sequence[PredictionRows]
    alarms: Alarms
    events: Events


class _PairedArrays(NamedTuple):
    """What compiled code knows of a monitor that judges what the samples of a pairing complete.

    Attributes:
        preparation: see :class:`Preparation`.
        wrenches: (5, R, 6) see :class:`PredictionRows`; R is what may wait in the pairing.
        alarms: (R,) room for rows of the alarm.
    """

    pairing: compiled.Pairing
    monitor: compiled.Monitor
    preparation: Records
    wrenches: Array
    alarms: Records


class _PairedMonitor:
    """A monitor whose model is compiled, with the pairing that it takes its samples from."""

    def __init__(self, monitor: Monitor, pairing: Pairing) -> None:
        self.pairing = pairing
        self._alarm, self._log = monitor._alarm, monitor._log
        self._wrenches, self._rows = np.empty((5, pairing.capacity, _AXES)), np.empty(pairing.capacity, ROW)
        memory = monitor.preparation.memory
        self.compiled = compiled.PairedMonitor(
            _PairedArrays(pairing.compiled, monitor._compiled, memory, self._wrenches, self._rows)
        )

    def judged(self, said: Said) -> Judged:
        """See :meth:`Monitors.judged`."""
        samples, time_ns, raised = said
        alarms, events = self._alarm.no_rows, _NO_EVENTS
        if raised:
            alarms = self._alarm.alarms(self._rows[:raised].copy())
            events = self._log.take(alarms)
        return Judged(samples, (PredictionRows(time_ns, self._wrenches),), alarms, events)


class Monitors:
    """Monitors of one vehicle, by name. The first gives predictions and the alarm, the others predictions.

    What monitors of one cut-off share, the low-pass above all, runs once for all of them.
    """

    def __init__(self, monitors: Mapping[str, Monitor]) -> None:
        self._monitors: dict[str, Monitor] = {}
        # Of the first model.
        self.sample_context = SampleContext(None, None)
        self._rate: ImuRate | None = None
        self._density = 0.0
        self._paired: _PairedMonitor | None = None
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

    def fly_in(self, density: float) -> None:
        """Go on in air of a density; see :meth:`Monitor.fly_in`."""
        self._density = density
        for monitor in self._monitors.values():
            monitor.fly_in(density)

    def reset(self) -> None:
        """Forget the past: as after construction."""
        for monitor in self._monitors.values():
            monitor.reset()
        self.sample_context.reset()

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
        time_ns, values, conditions = self.sample_context.of(samples)
        if not others and conditions is None:
            return first._step(time_ns, values), []
        prepared = first.preparation.step(time_ns, values, conditions)
        results = first._judge(prepared)
        by_preparation = {first.preparation: prepared}
        predictions = []
        for monitor in others:
            if monitor.preparation not in by_preparation:
                prepared = monitor.preparation.step(time_ns, values, conditions)
                by_preparation[monitor.preparation] = prepared
            predictions.append(monitor._predict(by_preparation[monitor.preparation]))
        return results, predictions

    def paired(self, pairing: Pairing) -> compiled.PairedMonitor | None:
        """What judges the samples of a pairing as they are completed, in the call that adds the last part.

        None where :meth:`judge` must take them instead: but for a single monitor whose model is compiled, and
        where states are less sure than in its flights, or the wind is to be told.
        """
        if self.sample_context.is_needed:
            return None
        if self._paired is None or self._paired.pairing is not pairing:
            first, *others = self._monitors.values()
            if others or not first._is_compiled:
                return None
            self._paired = _PairedMonitor(first, pairing)
        return self._paired.compiled

    def judged(self, said: Said) -> Judged:
        """What :meth:`paired` said of samples that it was given."""
        assert self._paired
        return self._paired.judged(said)

    def judge(self, samples: PairedSamples) -> Judged:
        """Take K samples, see :meth:`step`."""
        (first, alarms, events), others = self.step(samples)
        rows = [PredictionRows.from_predictions(predictions) for predictions in (first, *others)]
        return Judged(len(samples.time_ns), rows, alarms, events)

    def _put(self, name: str, monitor: Monitor) -> None:
        self._paired = None
        monitor.fly_in(self._density)
        for other in self._monitors.values():
            alike = other.preparation.goes_with_air == monitor.preparation.goes_with_air
            if alike and other.model.cutoff_hz == monitor.model.cutoff_hz:
                monitor.preparation = other.preparation
                break
        self._monitors[name] = monitor
        if name == next(iter(self._monitors)):
            before = self.sample_context
            self.sample_context = SampleContext(monitor.model, monitor.vehicle, before.wind_since_ns)
            self.sample_context.go_on_from(before)
