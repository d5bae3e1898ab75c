# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The monitor with named arrays and a record for each sample; `monitor.monitor` is what it drives."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.core import compiled
from quadpi_core.errors import ArgumentError
from quadpi_core.estimator.filter_state import METER, ImuRate
from quadpi_core.flight import AXES, STAMP_MAX_NS
from quadpi_core.frames import Array
from quadpi_core.library import Guessable
from quadpi_core.library.wrench_model import WrenchModel, only_axes
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.monitor.alarm import MonitorSettings
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.monitor.monitor import Monitor as BlockMonitor
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.preparation import conditions
from quadpi_core.monitor.wind_state import SampleContext
from quadpi_core.records import Records
from quadpi_core.results import Alarms, Events
from quadpi_core.vehicle import Vehicle

LEVELS = ("ok", "warning", "alarm")
# Numbers per sample of each quantity.
_WIDTHS = {"velocity": 3, "attitude": 4, "rates": 3, "specific_force": 3, "wind": 3}


class MonitorRow(NamedTuple):
    """What a monitor says of one sample; (6,) arrays have the columns Fx, Fy, Fz [N], Mx, My, Mz [Nm].

    Attributes:
        time_ns: its stamp.
        predicted, lower, upper: (6,) the model's prediction and interval; NaN for axes that it does not hold.
        measured: (6,) the wrench that the sample measured.
        outside: names of the axes whose measurement lies outside the interval.
        alarm: "ok", "warning" or "alarm", as of this sample.
        cause: why it is not ok, in plain words; empty where it is.
    """

    time_ns: int
    predicted: Array
    lower: Array
    upper: Array
    measured: Array
    outside: tuple[str, ...]
    alarm: str
    cause: str

    def __repr__(self) -> str:
        outside, why = " ".join(self.outside) or "none", f": {self.cause}" if self.cause else ""
        return f"<MonitorRow {self.time_ns} ns: outside {outside}, {self.alarm}{why}>"


class Monitor(Guessable):
    """Watches one vehicle with one model, sample by sample or in blocks of any length, with the same results.

    The live nodes run the same code and give the same bits.

    Args:
        model: of `load_model` or `WrenchModel.fit`; a regressor of your own is for use offline alone.
        vehicle: that flies; the one that the model was identified for unless given.
        rate_hz: sample rate; unless given it is measured in the first second, which gives no rows.
        confidence: of the intervals; the model's own unless given.
        settings: of the alarm, and whether intervals adapt.

    Raises:
        ArgumentError: for what is no model, vehicle, rate, confidence or settings.
        ModelError: if the model is not fitted, of another vehicle, or cannot support the confidence.
        SignalError: if the rate is too low for the low-pass of the model.
    """

    def __init__(
        self,
        model: WrenchModel | AerodynamicModel,
        vehicle: Vehicle | str | Path | None = None,
        rate_hz: float | None = None,
        confidence: float | None = None,
        settings: MonitorSettings | None = None,
    ) -> None:
        fitted: Any = model
        hint = "load_model(folder) reads one"
        if isinstance(model, WrenchModel):
            fitted = model.fitted
            hint = "a regressor of your own judges flights offline; docs/add-a-kind-of-model.md goes on"
        if not isinstance(fitted, AerodynamicModel):
            found = array_checks.description(fitted)
            raise ArgumentError(f"model: expected a kind of model, found {found}; {hint}")
        flown = vehicle if isinstance(vehicle, Vehicle) else fitted.load_vehicle(vehicle)
        self._monitor = BlockMonitor(fitted, flown, rate_hz, confidence, settings)
        self._wind = SampleContext(fitted, flown).wind
        # Of the stamps; None where it was given.
        self._rate = ImuRate() if rate_hz is None else None
        self._meter = np.zeros(1, METER)
        self._level, self._cause = 0, ""

    def step(
        self,
        time_ns: npt.ArrayLike,
        values: Array | None = None,
        *,
        velocity: npt.ArrayLike | None = None,
        attitude: npt.ArrayLike | None = None,
        rates: npt.ArrayLike | None = None,
        specific_force: npt.ArrayLike | None = None,
        rotor_speeds: npt.ArrayLike | None = None,
        wind: npt.ArrayLike | None = None,
        air_density: npt.ArrayLike | None = None,
        state_covariance: npt.ArrayLike | None = None,
    ) -> list[MonitorRow]:
        """Take one sample or K of them; returns a list with a :class:`MonitorRow` for each that can be used.

        Samples are raw, as sensors and estimator give them: the monitor low-passes them, which those of
        `load_flights` have been already. One that is not finite, not plausible or not later than the one
        before gives no row and shows in the alarm of the next. So do the samples of the first second where
        the rate is measured.

        Args:
            time_ns: int64 stamp, or (K,).
            values: (K, 16 + rotors), deprecated, with the results of
                `quadpi_core.monitor.monitor.Monitor.step`.
            velocity: (3,) or (K, 3) m/s over ground, body axes.
            attitude: (4,) or (K, 4) unit quaternions w, x, y, z, body to world (north-east-down).
            rates: (3,) or (K, 3) rad/s, body axes.
            specific_force: (3,) or (K, 3) m/s², body axes: z near −9.8 in hover.
            rotor_speeds: (rotors,) or (K, rotors) rad/s, rotors in the order of the vehicle file.
            wind: (3,) or (K, 3) m/s of the air, world. Unless given it is as drag tells it, for a model whose
                flights by GPS did so and a vehicle that flies in the open; else none.
            air_density: kg/m³, one or (K,); that of the vehicle file unless given. It counts for models
                whose flights told theirs; others stay in the air that they were identified in.
            state_covariance: (9, 9) or (K, 9, 9) of velocity, attitude and rates, by what they are less sure
                than in the flights of the model, see `monitor.preparation.Conditions`; it widens intervals.

        Raises:
            ArgumentError: naming the quantity that is absent or of another shape.
        """
        if values is not None:
            warnings.warn(
                "Monitor.step(time_ns, values): name the quantities, step(time_ns, velocity=…, attitude=…, "
                "rates=…, specific_force=…, rotor_speeds=…), which gives a record for each sample",
                DeprecationWarning,
                stacklevel=2,
            )
            return self._monitor.step(np.asarray(time_ns), values)  # type: ignore[return-value]
        stamps = array_checks.stamps("time_ns", np.atleast_1d(_array("time_ns", time_ns)))
        given = {
            "velocity": velocity,
            "attitude": attitude,
            "rates": rates,
            "specific_force": specific_force,
            "rotor_speeds": rotor_speeds,
            "wind": np.zeros((len(stamps), 3)) if wind is None else wind,
        }
        widths = {**_WIDTHS, "rotor_speeds": self._monitor.vehicle.rotor_count}
        block = np.hstack([_columns(name, values, stamps, widths[name]) for name, values in given.items()])
        known = conditions(
            len(stamps),
            None if air_density is None else _array("air_density", air_density),
            None if state_covariance is None else _array("state_covariance", state_covariance),
        )
        if self._wind is not None and wind is not None:
            self._wind.is_measured = True
        rows: list[MonitorRow] = []
        begin = 0
        for place in self._new_rates(stamps):
            rows += self._rows(stamps, block, known, slice(begin, place))
            self._rate = ImuRate.from_meters(self._meter, 0.0)
            self._monitor.retune(self._rate)
            begin = place
        return rows + self._rows(stamps, block, known, slice(begin, None))

    def _new_rates(self, stamps: npt.NDArray[np.int64]) -> Iterator[int]:
        """Places of the samples from which on another rate is known; none where it was given."""
        if self._rate is None:
            return
        for place, stamp in enumerate(stamps.tolist()):
            changes = int(self._meter["changes"][0])
            compiled.follow_rate(self._meter, stamp)
            if int(self._meter["changes"][0]) != changes:
                yield place

    def _rows(
        self, stamps: npt.NDArray[np.int64], block: Array, known: Records | None, part: slice
    ) -> list[MonitorRow]:
        stamps = stamps[part]
        if len(stamps) == 0 or (self._rate is not None and self._rate.begins):
            return []
        known = None if known is None else known[part]
        samples = PairedSamples(stamps, np.ascontiguousarray(block[part]))
        if self._wind is not None:
            samples, deviation = self._wind.take(samples)
            known = self._wind.conditions(samples.attitude, deviation, known)
        predictions, alarms, _ = self._monitor.step(*samples, known)
        axes = self._monitor.model.axes
        bounds = (predictions.predicted, predictions.lower, predictions.upper)
        predicted, lower, upper = (only_axes(array, axes) for array in bounds)
        missed = ~inside_interval(predictions.measured, predictions.lower, predictions.upper)
        rows, next_alarm = [], 0
        for k, stamp in enumerate(predictions.time_ns.tolist()):
            next_alarm = self._take(alarms, next_alarm, stamp)
            outside = tuple(axis for axis in axes if missed[k, AXES.index(axis)])
            of_wrench = (predicted[k], lower[k], upper[k], predictions.measured[k])
            rows.append(MonitorRow(stamp, *of_wrench, outside, LEVELS[self._level], self._cause))
        self._take(alarms, next_alarm, STAMP_MAX_NS)
        return rows

    def _take(self, alarms: Alarms, place: int, until_ns: int) -> int:
        """Follow the alarm from a place up to a stamp; the place after it."""
        while place < len(alarms) and alarms.time_ns[place] <= until_ns:
            self._level = int(alarms.level[place])
            self._cause = "; ".join(reasons(alarms, place)) if self._level else ""
            place += 1
        return place

    def reset(self) -> None:
        """Forget the past: as after construction."""
        self._monitor.reset()
        if self._wind is not None:
            self._wind.reset()
        self._level, self._cause = 0, ""
        if self._rate is not None:
            self._meter, self._rate = np.zeros(1, METER), ImuRate()

    @property
    def events(self) -> Events:
        """The last times that a cause spent at alarm level, the oldest first."""
        return self._monitor.events

    def __repr__(self) -> str:
        model = self._monitor.model
        name = model.name or "a model not saved"
        return f"<Monitor of {model.vehicle:.40} with {name:.40}: {LEVELS[self._level]}>"


def _array(name: str, given: npt.ArrayLike) -> npt.NDArray[Any]:
    try:
        return np.asarray(given)
    except ValueError:
        raise ArgumentError(f"{name}: expected numbers, found {array_checks.description(given)}") from None


def _columns(name: str, given: npt.ArrayLike | None, stamps: npt.NDArray[np.int64], width: int) -> Array:
    """A quantity of each sample (K, width); it need not be finite."""
    if given is None:
        raise ArgumentError(f"{name}: expected numbers, found None; only wind may be left out")
    values = _array(name, given)
    values = values[np.newaxis] if values.ndim == 1 and len(stamps) == 1 else values
    return array_checks.floats(name, values, width, rows=len(stamps), of="time_ns", finite=False)
