# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The aerodynamic model of a vehicle: one fitted regressor per axis, and all that belongs to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from quadpi_core.config_schema import Within
from quadpi_core.errors import ModelError, named_in
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.models.ensemble_kernel import CompiledEnsembles
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.fitted_ensemble import FittedBootstrap, FittedQualityDriven
from quadpi_core.models.fitted_polynomial import CompiledPolynomials, FittedPolynomial
from quadpi_core.models.interval_rules import HeldOutRule
from quadpi_core.models.model_kind import CompiledAxes, Evaluation, FittedAxis, Method, interval_factors
from quadpi_core.vehicle import Vehicle

METHODS: dict[str, Method] = {
    FittedPolynomial.method: Method(FittedPolynomial.stored, CompiledPolynomials.pack),
    FittedBootstrap.method: Method(FittedBootstrap.stored, CompiledEnsembles.pack),
    FittedQualityDriven.method: Method(FittedQualityDriven.stored, CompiledEnsembles.pack),
}


@dataclass(frozen=True)
class TrainingFlight:
    """A flight that a model was identified on."""

    name: str
    sha256: str
    samples: Annotated[int, Within(0)]


@dataclass(frozen=True)
class AerodynamicModel:
    """Wrench model of one vehicle with prediction intervals.

    Attributes:
        name: of the model folder.
        vehicle: name of the vehicle file.
        vehicle_fingerprint: of the vehicle's numbers (see `Vehicle.fingerprint`).
        settings: "default" or "paper".
        cutoff_hz: of the low-pass that every signal passed before identification, and must pass before use.
        confidence: nominal coverage that the monitor uses unless told otherwise.
        fitted: axes by name, in the order of `AXES`, all of one method.
        envelope: what the training flights showed.
        training_range: per axis, range (max − min) of the measured training data, the denominator of NMPIW.
        flights: that the model was identified on.
        selection: per axis, the selection log (see `StepwisePolynomial.selection_log`).
        held_out_coverage: per axis, the coverage of each of `flights` by model and intervals of the others;
            empty under the paper's settings.
        identity: name and the first 12 digits of the hash of the stored model; empty before it is saved.
        alarm_limits: of the alarm, beside those of `envelope`; uncalibrated unless given.
        compiled: `fitted` packed for evaluation; packed at first use unless given.
    """

    name: str
    vehicle: str
    vehicle_fingerprint: str
    settings: str
    cutoff_hz: float
    confidence: float
    fitted: dict[str, FittedAxis]
    envelope: Envelope
    training_range: dict[str, float]
    flights: tuple[TrainingFlight, ...]
    selection: dict[str, list[dict[str, Any]]]
    held_out_coverage: dict[str, list[float]]
    identity: str = ""
    alarm_limits: AlarmLimits = field(default_factory=AlarmLimits)
    compiled: CompiledAxes | None = field(default=None, repr=False, compare=False)

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes held, in the order of `AXES`."""
        return tuple(axis for axis in AXES if axis in self.fitted)

    @property
    def method(self) -> str:
        """Name of the method, one of :data:`METHODS`."""
        return next(iter(self.fitted.values())).method

    def load_vehicle(self, given: str | Path | None = None) -> Vehicle:
        """The vehicle that the model was identified for: of the file given, else of the name that it holds.

        Raises:
            VehicleError: if the file cannot be read; of the model's own name, naming the model too.
            ModelError: if it is another vehicle.
        """
        if given is None:
            with named_in(f"model {self.name}: its vehicle"):
                vehicle = Vehicle.load(self.vehicle)
        else:
            vehicle = Vehicle.load(given)
        self.require(vehicle)
        return vehicle

    def require(self, vehicle: Vehicle) -> None:
        """Refuse a vehicle other than the one that the model was identified for.

        Raises:
            ModelError: if name or numbers differ.
        """
        if vehicle.name != self.vehicle:
            raise ModelError(f"model {self.name} is of vehicle {self.vehicle}, not {vehicle.name}")
        if vehicle.fingerprint != self.vehicle_fingerprint:
            raise ModelError(
                f"model {self.name} was identified with another mass, inertia or rotor geometry than vehicle "
                f"file {vehicle.name} gives now"
            )

    def calibration(self) -> str:
        """What the width of the intervals rests on, in a sentence."""
        rule = next(iter(self.fitted.values())).rule
        if not isinstance(rule, HeldOutRule):
            return (
                f"intervals by the {rule.kind} rule, as in the paper, not calibrated on held-out flights: "
                f"expect less coverage on new flights"
            )
        total, inside = len(rule.flight_factors), rule.flights_inside
        if inside == 0:
            return (
                f"no flight of {total} lies in the envelope of the others: intervals from the training "
                f"residuals, expect less coverage on new flights"
            )
        rest = "" if inside == total else f"; {total - inside} outside the envelope of the others"
        return f"intervals calibrated on {inside} of {total} flights, each left out in turn{rest}"

    @cached_property
    def _compiled(self) -> CompiledAxes:
        return self.compiled or METHODS[self.method].compile(self.fitted)

    @cached_property
    def _factors(self) -> Callable[[float], Array]:
        return lru_cache(maxsize=16)(lambda confidence: interval_factors(self.fitted, confidence))

    def evaluate(self, inputs: Array, confidence: float | None = None) -> Evaluation:
        """Predictions, bounds and evidence for input vectors (N, 19), all axes at once.

        Raises:
            ModelError: for a confidence that the calibration cannot support.
        """
        if confidence is None:
            confidence = self.confidence
        return self._compiled.evaluate(inputs, self._factors(confidence))

    def interval_ratio(self, confidence: float) -> Array:
        """Width (6,) of the intervals of the model's own confidence over that of another; 1 where not held.

        Raises:
            ModelError: for a confidence that the calibration cannot support.
        """
        own, other = self._factors(self.confidence), self._factors(confidence)
        ratio: Array = np.divide(own, other, out=np.ones(len(AXES)), where=other > 0.0)
        return ratio

    def __getstate__(self) -> dict[str, Any]:
        """What travels to another process, which compiles for itself."""
        return {column.name: getattr(self, column.name) for column in fields(self)} | {"compiled": None}

    def save(self, folder: str | Path) -> AerodynamicModel:
        """Write the model as a folder of JSON and safetensors; returns it with its identity."""
        # Storage knows this class, so it is imported when needed.
        from quadpi_core.models.model_folder import save_model

        return save_model(self, Path(folder))

    @classmethod
    def load(cls, folder: str | Path) -> AerodynamicModel:
        """Read a model folder; nothing in it is executed.

        Raises:
            ModelError: naming the file that is missing, altered or not understood.
        """
        from quadpi_core.models.model_folder import load_model

        return load_model(Path(folder))
