# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The aerodynamic model of a vehicle: one fitted regressor per axis, and all that belongs to it."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from quadpi_core import array_checks
from quadpi_core.config_schema import Flag, NotEmpty, OneOf, ReadBy, Real, Text, Within, parse_config
from quadpi_core.core import compiled
from quadpi_core.errors import ArgumentError, ModelError, named_in
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import ASSUMED, INPUT_NAMES, density_range, derivatives_like, whole_derivatives
from quadpi_core.messages.result_messages import DescribedModel
from quadpi_core.models.alarm_limits import AlarmLimits, ChangeLimits
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.interval_rules import (
    SETTLED,
    HeldOutRule,
    LevelSupport,
    MovingCentre,
    StateDeviation,
    WindDrag,
)
from quadpi_core.models.kind_registry import kind_named
from quadpi_core.models.model_folder import (
    MODEL_FILE,
    FolderContent,
    damage_named,
    read_folder,
    write_folder,
)
from quadpi_core.models.model_kind import (
    Evaluation,
    Fitted,
    Kind,
    StoredAxes,
    compiled_model,
    named_arrays,
)
from quadpi_core.models.rollout_model import RolloutModel
from quadpi_core.models.sound_flights import SoundFlights
from quadpi_core.records import Records
from quadpi_core.signals.wrench import as_recorded
from quadpi_core.vehicle import LOAD_VEHICLE, Vehicle
from quadpi_core.version import __version__

# What to call for a model, in refusals of anything else.
LOAD_MODEL = "AerodynamicModel.load(folder) reads one, and `model_` of a WrenchModel is one"
# Keys in model.json of roll-outs and of the residuals of sound flights; the names of their arrays begin so.
_ROLLOUTS, _SOUND = "rollouts", "sound_flights"
# Fields that model.json keeps by their names.
_AS_DESCRIBED = (
    *("vehicle", "vehicle_fingerprint", "settings", "cutoff_hz", "confidence", "envelope", "flights"),
    *("moving_centre", "state", "wind"),
)
_Part = TypeVar("_Part")


@dataclass(frozen=True)
class TrainingFlight:
    """A flight that a model was identified on; `air`: what told its density, see `quadpi_core.inputs`."""

    name: str
    sha256: str
    samples: Annotated[int, Within(0)]
    air: str = ASSUMED

    def to_json(self) -> dict[str, Any]:
        """For model folders and reports, where air that nothing told is left out."""
        return {key: value for key, value in asdict(self).items() if (key, value) != ("air", ASSUMED)}


@runtime_checkable
class Motion(Protocol):
    """All that a model needs to know of a flight: a `PreparedFlight` is one.

    Attributes:
        time: (N,) s.
        inputs: (N, 19) input vectors, columns as `quadpi_core.inputs.INPUT_NAMES`.
        derivatives: (N,) what the motion has beside them, see `quadpi_core.inputs.Derivatives`.
    """

    @property
    def time(self) -> Array:
        """See above."""

    @property
    def inputs(self) -> Array:
        """See above."""

    @property
    def derivatives(self) -> Records:
        """See above."""


# Compared and hashed by identity: arrays have no truth value.
@dataclass(frozen=True, eq=False)
class AerodynamicModel:
    """Wrench model of one vehicle with prediction intervals.

    Attributes:
        name: of the model folder.
        vehicle: name of the vehicle file.
        vehicle_fingerprint: of the vehicle's numbers (see `Vehicle.fingerprint`).
        settings: "default" or "paper".
        cutoff_hz: of the low-pass that every signal passed before identification, and must pass before use.
        confidence: nominal coverage that the monitor uses by default.
        fitted: what the kind of model keeps, its axes in the order of `AXES`.
        envelope: what the training flights showed.
        training_range: per axis, range (max − min) of the measured training data, the denominator of NMPIW.
        flights: that the model was identified on.
        selection: per axis, the selection log (see `model_kind.Fit.log`).
        held_out_coverage: per axis, the coverage of each of `flights` by model and intervals of the others;
            empty under the paper's settings.
        identity: name and the first 12 digits of the hash of the stored model; empty before it is saved.
        rollouts: predicts the state ahead; None for a model that cannot.
        alarm_limits: limits of the alarm other than those of `envelope`; uncalibrated by default.
        change_limits: what the alarm tells a change of the vehicle by; None for a model of too few flights.
        moving_centre: how intervals that adapt move; None where no flights left out told.
        state: how unsure the states of its flights were.
        wind: drag that told the wind of its flights; None where it was measured, or taken to be nil.
        by_flight: standard errors of its small model by leaving out each flight, by what they are of.
        sound: what flights leave of a model identified without them; None where they do not tell.
        left_out: `fitted` without each of `flights` in turn; empty in a model that was read.
        flown: the vehicle of the flights; None for a model of an earlier version, which knows its name.
    """

    name: str
    vehicle: str
    vehicle_fingerprint: str
    settings: str
    cutoff_hz: float
    confidence: float
    fitted: Fitted
    envelope: Envelope
    training_range: dict[str, float]
    flights: tuple[TrainingFlight, ...]
    selection: dict[str, list[dict[str, Any]]]
    held_out_coverage: dict[str, list[float]]
    identity: str = ""
    rollouts: RolloutModel | None = None
    alarm_limits: AlarmLimits = field(default_factory=AlarmLimits)
    change_limits: ChangeLimits | None = None
    moving_centre: MovingCentre | None = None
    state: StateDeviation = SETTLED
    wind: WindDrag | None = None
    by_flight: Mapping[str, float] = field(default_factory=dict)
    sound: SoundFlights | None = None
    left_out: tuple[Fitted, ...] = field(default=(), repr=False, compare=False)
    flown: Vehicle | None = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        return (
            f"<AerodynamicModel {self.name or 'not saved':.40}: {self.method} of {self.vehicle:.40}, "
            f"{' '.join(self.axes)}, {len(self.flights)} flights, confidence {self.confidence:g}>"
        )

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes held, in the order of `AXES`."""
        return tuple(axis for axis in AXES if axis in self.fitted.axes)

    @property
    def method(self) -> str:
        """Name of the kind of model."""
        return self.fitted.method

    @property
    def kind(self) -> Kind:
        """The kind of model, with its attributes."""
        return kind_named(self.method)

    def load_vehicle(self, given: str | Path | None = None) -> Vehicle:
        """The vehicle that the model was identified for: of the file given, else the one that it holds.

        Folders of older versions hold its name alone, which then must be one of config/vehicles.

        Raises:
            VehicleError: if the file cannot be read; of the model's own name, naming the model too.
            ModelError: if it is another vehicle.
        """
        if given is not None:
            vehicle = Vehicle.load(given)
            if self.flown is not None and self.flown.motors is not None:
                vehicle = replace(vehicle, motors=self.flown.motors)
        elif self.flown is not None:
            vehicle = self.flown
        else:
            with named_in(f"model {self.name}: its vehicle"):
                vehicle = Vehicle.load(self.vehicle)
        self.require(vehicle)
        return vehicle

    def described(self) -> DescribedModel:
        """Identity, vehicle, low-pass and ranges of training, as they are published and written into bags."""
        return DescribedModel(
            self.identity, self.vehicle, self.envelope.lower, self.envelope.upper, self.cutoff_hz
        )

    def share_of_air(self) -> tuple[float, float]:
        """Least and largest factor on a coefficient that the air densities of its flights allow.

        1 where it was measured: coefficients are those in air of the vehicle file's density.
        """
        told = [density_range(one.air, self.load_vehicle().air_density_kg_m3) for one in self.flights]
        thinnest, densest = (sum(ends) / len(told) for ends in zip(*told, strict=True))
        return 1.0 / densest, 1.0 / thinnest

    @property
    def goes_with_air(self) -> bool:
        """Whether predictions scale with air density: True if a training flight recorded its air."""
        return any(flight.air != ASSUMED for flight in self.flights)

    def learned_from(self, sha256: str) -> bool:
        """Whether the flight of a hash is a training flight, so that results on it are in sample."""
        array_checks.instance("sha256", sha256, str)
        return bool(sha256) and any(flight.sha256 == sha256 for flight in self.flights)

    def require(self, vehicle: Vehicle) -> None:
        """Refuse a vehicle other than the one that the model was identified for.

        Raises:
            ArgumentError: for what is no vehicle.
            ModelError: if name or numbers differ.
        """
        array_checks.instance("vehicle", vehicle, Vehicle, LOAD_VEHICLE)
        model = f"model {self.name}".rstrip()  # one that is not saved has no name
        if vehicle.name != self.vehicle:
            raise ModelError(f"{model} is of vehicle {self.vehicle}, not {vehicle.name}")
        if vehicle.fingerprint != self.vehicle_fingerprint:
            raise ModelError(
                f"{model} was identified with another mass, inertia or rotor geometry than vehicle "
                f"file {vehicle.name} gives now"
            )
        if self.rollouts is not None:
            with named_in(f"model {self.name}"):
                self.rollouts.require_rotors(vehicle)

    def simulation_section(self) -> dict[str, Any]:
        """The key `simulation` of a vehicle file that flies as the model says, its motors apart.

        Raises:
            ModelError: for a model of some axes, or of a kind that is no simulation.
        """
        lacking = [axis for axis in AXES if axis not in self.fitted.axes]
        if lacking:
            raise ModelError(f"model {self.name}: lacks {', '.join(lacking)}; a simulation has all six axes")
        with named_in(f"model {self.name}"):
            return self.fitted.simulation_section()

    @property
    def sections_left_out(self) -> list[dict[str, Any]]:
        """:meth:`simulation_section` of the model identified without each of its flights in turn."""
        return [fitted.simulation_section() for fitted in self.left_out]

    def require_rollouts(self) -> RolloutModel:
        """What predicts the state ahead.

        Raises:
            ModelError: saying why this model cannot.
        """
        if self.rollouts is None:
            why = "predicts the wrench of single samples: it is no simulation"
            if self.kind.is_simulation:
                why = (
                    "was identified on flights shorter than the longest horizon, or by a version that kept "
                    "no roll-outs: identify it again on longer flights"
                )
            raise ModelError(f"model {self.name} ({self.kind.label}) {why}")
        return self.rollouts

    def calibration(self) -> str:
        """A sentence that says how the width of the intervals was calibrated."""
        rule = next(iter(self.fitted.axes.values())).rule
        if not isinstance(rule, HeldOutRule):
            return f"intervals by the paper's {rule.kind} rule, uncalibrated: they cover less of new flights"
        total, inside = len(rule.flight_factors), rule.flights_inside
        if inside == 0:
            return (
                f"no flight of {total} lies in the envelope of the others: intervals from the training "
                f"residuals, expect less coverage on new flights"
            )
        rest = "" if inside == total else f"; {total - inside} outside the envelope of the others"
        return f"intervals calibrated on {inside} of {total} flights, each left out in turn{rest}"

    def support(self, confidence: float) -> LevelSupport:
        """What a confidence means for flights to come, by the flights that calibrated the intervals."""
        confidence = array_checks.number("confidence", confidence)
        rules = [axis.rule for axis in self.fitted.axes.values()]
        inside = min(rule.flights_inside if isinstance(rule, HeldOutRule) else 0 for rule in rules)
        return LevelSupport.from_flights(confidence, inside)

    @cached_property
    def _factors(self) -> Callable[[float], Array]:
        return lru_cache(maxsize=16)(self.fitted.factors)

    @property
    def force_bandwidth_hz(self) -> float | None:
        """See :attr:`.model_kind.Fitted.force_bandwidth_hz`."""
        return self.fitted.force_bandwidth_hz

    def evaluate(
        self,
        flight: Motion | Array,
        confidence: float | None = None,
        derivatives: Records | None = None,
    ) -> Evaluation:
        """Predictions, bounds and evidence for each sample of a flight, all axes at once.

        Where the measured forces of the training flights ended at a lower frequency than the other signals,
        those predicted for a flight are what it would have recorded (`quadpi_core.signals.wrench`).

        Args:
            flight: one of `prepare_flights`; or input vectors (N, 19) alone, columns as
                `quadpi_core.inputs.INPUT_NAMES`.
            confidence: of the intervals; the model's own unless given.
            derivatives: (N,) of input vectors alone, see `quadpi_core.inputs.Derivatives`; a kind of model
                that does not use them needs none.

        Raises:
            ArgumentError: for arrays of other shapes, lengths that differ, numbers that are not finite, and
                input vectors alone where the kind of model uses their derivatives.
            ModelError: for a confidence that the calibration cannot support, and inputs for which the model
                gives no finite wrench.
        """
        time = None
        if isinstance(flight, Motion):
            if derivatives is not None:
                raise ArgumentError("derivatives: a flight has its own: leave them out")
            time, inputs, derivatives = flight.time, flight.inputs, flight.derivatives
        else:
            inputs = flight
        inputs = array_checks.floats("inputs", inputs, len(INPUT_NAMES))
        if derivatives is not None:
            derivatives = array_checks.records(
                "derivatives", derivatives, derivatives_like(derivatives), rows=len(inputs), of="inputs"
            )
        elif self.kind.uses_derivatives:
            raise ArgumentError(
                f"inputs: a {self.kind.label} needs to know how rotor speeds and rates change: pass a flight "
                "of prepare_flights, or derivatives=flight.derivatives beside its inputs"
            )
        if confidence is not None:
            confidence = array_checks.number("confidence", confidence)
        if time is None:
            evaluation = unchecked_evaluation(self, inputs, confidence, derivatives)
        else:
            time = array_checks.floats("time", time, rows=len(inputs), of="inputs")
            evaluation = _recorded_evaluation(self, time, inputs, derivatives, confidence)
        finite = np.isfinite(np.concatenate(evaluation, axis=1)).all(axis=1)
        if not finite.all():
            raise ModelError(
                f"model {self.name}: sample {np.argmin(finite)}: beyond what the model can predict: "
                "its numbers overflow"
            )
        return evaluation

    def interval_ratio(self, confidence: float) -> Array:
        """Width (6,) of the intervals of the model's own confidence over that of another; 1 where not held.

        Raises:
            ArgumentError: for what is no number.
            ModelError: for a confidence that the calibration cannot support.
        """
        confidence = array_checks.number("confidence", confidence)
        own, other = self._factors(self.confidence), self._factors(confidence)
        return np.divide(own, other, out=np.ones(len(AXES)), where=other > 0.0)

    def __getstate__(self) -> dict[str, Any]:
        """State for pickling, without what is cached."""
        return {column.name: getattr(self, column.name) for column in fields(self)}

    def save(self, folder: str | Path) -> AerodynamicModel:
        """Write the model as a folder, whole or not at all; returns it with name and identity.

        Raises:
            OutputError: if the folder cannot be written, or holds what is not part of a model.
        """
        folder = array_checks.path("folder", folder)
        stored = self.fitted.store()
        each = ("training_range", "selection", "held_out_coverage")
        axes = {
            axis: {**entry, **{name: getattr(self, name)[axis] for name in each}}
            for axis, entry in stored.entries.items()
        }
        versions = {"quadpi": __version__, "numpy": np.__version__, "python": platform.python_version()}
        described = {
            "method": self.method,
            "settings": self.settings,
            "vehicle": self.vehicle,
            "vehicle_fingerprint": self.vehicle_fingerprint,
            "vehicle_file": self.flown and self.flown.to_file(),
            "cutoff_hz": self.cutoff_hz,
            "confidence": self.confidence,
            "axes": axes,
            "envelope": self.envelope.to_json(),
            "alarm": self.alarm_limits.to_json(),
            "change": self.change_limits and self.change_limits.to_json(),
            "moving_centre": self.moving_centre and self.moving_centre.to_json(),
            "state": None if self.state == SETTLED else asdict(self.state),
            "wind": self.wind and asdict(self.wind),
            "errors_by_flight": dict(self.by_flight) or None,
            "flights": [flight.to_json() for flight in self.flights],
            "versions": versions,
        }
        description = {key: value for key, value in described.items() if value is not None}
        arrays = dict(stored.arrays)
        for name, part in ((_ROLLOUTS, self.rollouts), (_SOUND, self.sound)):
            if part is not None:
                description[name] = part.to_json()
                arrays |= {f"{name}.{key}": own for key, own in part.arrays().items()}
        identity = write_folder(FolderContent(description, arrays, stored.files), folder)
        return replace(self, name=folder.name, identity=identity, left_out=())

    @classmethod
    def load(cls, folder: str | Path) -> AerodynamicModel:
        """Read a model folder; nothing in it is executed.

        Raises:
            ModelError: naming the file that is missing, altered or not understood.
        """
        folder = array_checks.path("folder", folder)
        content, identity = read_folder(folder)
        with damage_named(folder, content.description["format"]):
            entries = content.description.get("axes", {})
            described = parse_config(
                _Description, content.description, f"{MODEL_FILE}: not a quadpi model", ModelError
            )
            with named_in(MODEL_FILE):
                kind = kind_named(described.method)
            axes, held = described.axes, vars(described)
            model = cls(
                name=folder.name,
                **{key: held[key] for key in _AS_DESCRIBED},
                fitted=kind.fitted_type.read(StoredAxes(entries, content.arrays, content.files)),
                training_range={axis: entry.training_range for axis, entry in axes.items()},
                selection={axis: entries[axis]["selection"] for axis in axes},
                held_out_coverage={axis: entry.held_out_coverage for axis, entry in axes.items()},
                identity=identity,
                rollouts=_stored_part(content, _ROLLOUTS, RolloutModel.stored),
                alarm_limits=described.alarm,
                change_limits=described.change,
                by_flight=described.errors_by_flight,
                sound=_stored_part(content, _SOUND, SoundFlights.stored),
                flown=described.flown(),
            )
            # A confidence that has no intervals is the fault of the file, not of whoever asks for them.
            model.fitted.factors(model.confidence)
            return model


def unchecked_evaluation(
    model: AerodynamicModel,
    inputs: Array,
    confidence: float | None = None,
    derivatives: Records | None = None,
) -> Evaluation:
    """As :meth:`AerodynamicModel.evaluate`, for arrays (N, 19) and (N,) that are known to fit each other.

    Samples for which the model's numbers overflow are not finite.

    Raises:
        ModelError: for a confidence that the calibration cannot support.
    """
    if confidence is None:
        confidence = model.confidence
    if derivatives is not None and not model.goes_with_air and derivatives["density_excess"].any():
        derivatives = derivatives.copy()
        derivatives["density_excess"] = 0.0
    evaluation = model.fitted.evaluate(inputs, model._factors(confidence), derivatives)
    if derivatives is None or compiled_model(model.fitted) or not derivatives["density_excess"].any():
        return evaluation
    # One that Python evaluates knows nothing of the density of the air.
    scaled = np.stack(evaluation)
    compiled.scale_by_density(whole_derivatives(derivatives), scaled)
    return Evaluation(*scaled)


def _recorded_evaluation(
    model: AerodynamicModel,
    time: Array,
    inputs: Array,
    derivatives: Records | None,
    confidence: float | None = None,
) -> Evaluation:
    """As :func:`unchecked_evaluation`, with the forces of a flight (N,) as it would have recorded them."""
    exact = unchecked_evaluation(model, inputs, confidence, derivatives)
    if model.force_bandwidth_hz is None:
        return exact
    predicted = as_recorded(time, inputs, exact.predicted, model.force_bandwidth_hz)
    change = predicted - exact.predicted
    return exact._replace(predicted=predicted, lower=exact.lower + change, upper=exact.upper + change)


def _stored_part(
    content: FolderContent, name: str, stored: Callable[[Any, Mapping[str, Array]], _Part]
) -> _Part | None:
    """A part of a model, read by what gives it; None where the folder holds nothing of it."""
    if name not in content.description:
        return None
    return stored(content.description[name], named_arrays(content.arrays, name))


# model.json is written by quadpi alone: what its types do not declare is passed over, not refused.


@dataclass(frozen=True, kw_only=True)
class _Step:
    """A step of the selection of regressors, see :attr:`.model_kind.Fit.log`."""

    term: Text
    fixed: Flag
    coefficient: Real | None
    r2: Real | None
    removed: tuple[Text, ...] = ()
    sse: Real | None = None
    criterion: Real | None = None


@dataclass(frozen=True, kw_only=True)
class _AxisEntry:
    """Keys of an axis that every kind of model has."""

    training_range: Real
    selection: tuple[_Step, ...]
    held_out_coverage: list[Real]


@dataclass(frozen=True, kw_only=True)
class _Description:
    """The content of model.json, the keys of a kind apart."""

    method: Text
    settings: str
    vehicle: str
    vehicle_fingerprint: str
    cutoff_hz: Real
    confidence: Real
    axes: Annotated[dict[Annotated[str, OneOf(*AXES)], _AxisEntry], NotEmpty()]
    envelope: Annotated[Envelope, ReadBy(Envelope.from_json)]
    alarm: Annotated[AlarmLimits, ReadBy(AlarmLimits.from_json)]
    flights: tuple[TrainingFlight, ...]
    arrays_sha256: str
    vehicle_file: dict[str, Any] | None = None
    change: Annotated[ChangeLimits, ReadBy(ChangeLimits.from_json)] | None = None
    moving_centre: Annotated[MovingCentre, ReadBy(MovingCentre.from_json)] | None = None
    state: StateDeviation = SETTLED
    wind: WindDrag | None = None
    errors_by_flight: dict[str, Annotated[float, Within(0.0)]] = field(default_factory=dict)

    def flown(self) -> Vehicle | None:
        """The vehicle of the flights, where the model holds it."""
        if self.vehicle_file is None:
            return None
        flown = Vehicle.from_content(self.vehicle_file, self.vehicle, f"{MODEL_FILE}: vehicle_file")
        if flown.fingerprint != self.vehicle_fingerprint:
            raise ModelError(
                f"{MODEL_FILE}: vehicle_file: is another vehicle than the model was identified for"
            )
        return flown
