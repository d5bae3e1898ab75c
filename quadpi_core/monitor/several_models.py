# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Several models that watch one vehicle at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from quadpi_core.errors import ModelError, SignalError
from quadpi_core.estimator.imu_rate import ImuRate
from quadpi_core.monitor.alarm import MonitorSettings
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.preparation import Prepared
from quadpi_core.results import Alarms, Events, Predictions

if TYPE_CHECKING:
    from quadpi_core.monitor.monitor import Monitor


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
        """Go on with other times and rates of the alarm."""
        for monitor in self._monitors.values():
            monitor.change(settings)

    def reset(self) -> None:
        """Forget the past: as after construction."""
        for monitor in self._monitors.values():
            monitor.reset()

    def retune(self, rate: ImuRate) -> list[str]:
        """Go on with samples of another rate; says which models it is too low for."""
        self._rate = rate
        problems = []
        for name, monitor in self._monitors.items():
            try:
                monitor.retune(rate)
            except SignalError as error:
                problems.append(f"model {name}: {error}")
        return problems

    def step(self, samples: PairedSamples) -> tuple[tuple[Predictions, Alarms, Events], list[Predictions]]:
        """Take K samples, as :meth:`Monitor.step`: what the first says, and the predictions of the others."""
        first, *others = self._monitors.values()
        preparation = first.preparation
        prepared = preparation.step(*samples)
        outputs = first.judge(prepared)
        if not others:
            return outputs, []
        by_preparation: dict[int, Prepared] = {id(preparation): prepared}
        predictions = []
        for monitor in others:
            key = id(monitor.preparation)
            if key not in by_preparation:
                by_preparation[key] = monitor.preparation.step(*samples)
            predictions.append(monitor.predict(by_preparation[key]))
        return outputs, predictions

    def _put(self, name: str, monitor: Monitor) -> None:
        for other in self._monitors.values():
            if other.model.cutoff_hz == monitor.model.cutoff_hz:
                monitor.preparation = other.preparation
                break
        self._monitors[name] = monitor
