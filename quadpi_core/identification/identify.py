# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Identify an aerodynamic model from prepared flights: fit, calibrate the intervals, calibrate the alarm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.alarm_calibration import (
    calibrate_alarm,
    hover_rotor_speed,
    left_out,
    live_errors,
)
from quadpi_core.identification.prepared_flights import DEFAULT_CUTOFF_HZ, PreparedFlight
from quadpi_core.models.aerodynamic import METHODS, AerodynamicModel, TrainingFlight
from quadpi_core.models.alarm_limits import RATE_PER_HOUR
from quadpi_core.models.candidate_pool import CandidatePool
from quadpi_core.models.ensemble_estimator import Ensemble, fit_axes, require_training
from quadpi_core.models.ensembles import BootstrapEnsemble, QualityDrivenEnsemble
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.interval_rules import HeldOutRule, require_confidence
from quadpi_core.models.model_kind import FittedAxis, interval_factors
from quadpi_core.models.polynomial import StepwisePolynomial
from quadpi_core.models.selection import StopRule
from quadpi_core.parallel import Progress, ReportProgress, ignore_progress
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_core.training.train import TrainingState

Settings: TypeAlias = Literal["default", "paper"]
MethodName: TypeAlias = Literal["polynomial", "bootstrap", "quality-driven"]

# Cut-off of the low-pass over all signals, by settings.
CUTOFF_HZ: dict[Settings, float] = {"default": DEFAULT_CUTOFF_HZ, "paper": 100.0}
# Each flight is left out in turn to calibrate the intervals, and a model of the others must remain.
_FEWEST_FLIGHTS = 2


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """How a model is identified.

    Attributes:
        cutoff_hz: of the low-pass that the flights passed; kept with the model.
        method: kind of model.
        settings: "paper" for the paper's rules.
        stop: stop rule of a polynomial other than that of the settings.
        confidence: nominal coverage that the monitor will use; quality-driven bounds are trained for it.
        seed: of an ensemble.
        device: that trains an ensemble, "cpu" or "cuda".
        false_alarms_per_hour: rate that the limits of the alarm are calibrated to, on held-out flights.
    """

    cutoff_hz: float = DEFAULT_CUTOFF_HZ
    method: MethodName = "polynomial"
    settings: Settings = "default"
    stop: StopRule | None = None
    confidence: float = 0.95
    seed: int = 0
    device: str = "cpu"
    false_alarms_per_hour: float = RATE_PER_HOUR

    def check(self, pools: Mapping[str, CandidatePool]) -> None:
        """Refuse options that no flights can satisfy; cheap, so that it can come before flights are read.

        Raises:
            ModelError: for a confidence that the settings cannot give; for an ensemble with a stop rule,
                without PyTorch or the device; naming the axis, for candidates without inputs for networks.
        """
        require_confidence(self.confidence, calibrated=self.settings == "default")
        if self.method == "polynomial":
            return
        if self.stop is not None:
            raise ModelError(f"a stop rule is for polynomials: the {self.method} method has none")
        for axis in AXES:
            if axis in pools and not pools[axis].inputs:
                raise ModelError(f"{axis}: the candidate file lists no `inputs` for networks")
        require_training(self.device)

    def polynomial(self, pool: CandidatePool) -> StepwisePolynomial:
        """The estimator of one axis of a polynomial model, not yet fitted."""
        paper = self.settings == "paper"
        regressor = StepwisePolynomial.paper(pool) if paper else StepwisePolynomial(pool)
        return regressor if self.stop is None else regressor.set_params(stop=self.stop)

    def ensemble(self, pool: CandidatePool) -> Ensemble:
        """The estimator of one axis of an ensemble, not yet fitted."""
        kind = BootstrapEnsemble if self.method == "bootstrap" else QualityDrivenEnsemble
        ensemble = kind.paper(pool.inputs) if self.settings == "paper" else kind(pool.inputs)
        trained_for = {} if self.method == "bootstrap" else {"confidence": self.confidence}
        return ensemble.set_params(seed=self.seed, device=self.device, **trained_for)


def training_progress(state: TrainingState) -> Progress:
    """The progress of an identification after an epoch of training."""
    note = f"loss {state.loss:.3g}"
    if state.coverage is not None:
        note += f" · coverage {state.coverage:.1%}"
    return Progress(f"Training {state.stage}", state.epoch, state.epochs, "epochs", note)


class _Samples(NamedTuple):
    """Samples of all flights.

    Attributes:
        inputs: (N, 19) input vectors.
        wrench: (N, 6) measured.
        flight: (N,) number of the flight.
    """

    inputs: Array
    wrench: Array
    flight: npt.NDArray[np.int64]

    @classmethod
    def of(cls, flights: Sequence[PreparedFlight]) -> _Samples:
        return cls(
            np.concatenate([flight.inputs for flight in flights]),
            np.concatenate([flight.wrench for flight in flights]),
            np.repeat(np.arange(len(flights)), [len(flight.time) for flight in flights]),
        )

    def target(self, axis: str) -> Array:
        """Measured force or moment (N,) of one axis."""
        return self.wrench[:, AXES.index(axis)]


def identify(
    flights: Sequence[PreparedFlight],
    vehicle: Vehicle,
    pools: Mapping[str, CandidatePool],
    options: IdentifyOptions,
    progress: ReportProgress = ignore_progress,
) -> AerodynamicModel:
    """Identify a model of every axis of `pools`, with its envelope and the limits of its alarm.

    Args:
        flights: to identify on; errors of flights left out in turn calibrate the intervals.
        vehicle: the vehicle that flew.
        pools: by axis: candidates of a polynomial, inputs of an ensemble.
        options: method, settings and what they take.
        progress: called before each polynomial, or after each epoch of an ensemble.

    Raises:
        ModelError: see :meth:`IdentifyOptions.check`; for too few flights for the settings; naming the
            flight, for samples that are not finite; naming the axis, for what cannot be identified.
    """
    options.check(pools)
    _require_flights(flights, options.settings)
    samples = _Samples.of(flights)
    axes = [axis for axis in AXES if axis in pools]
    estimators = _fit(samples, {axis: pools[axis] for axis in axes}, options, progress)
    fitted: dict[str, FittedAxis] = {axis: estimators[axis].fitted_ for axis in axes}
    compiled = METHODS[options.method].compile(fitted)
    factors = interval_factors(fitted, options.confidence)

    # Intervals: the held-out errors must be covered for the causal states of the live path too.
    held_out = {axis: errors for axis in axes if (errors := estimators[axis].held_out_) is not None}
    live = live_errors(flights, held_out, lambda rows: compiled.evaluate(rows, factors)) if held_out else []
    rules = {
        axis: rule.covering([flight.errors[axis] for flight in live])
        for axis in held_out
        if isinstance(rule := fitted[axis].rule, HeldOutRule)
    }
    fitted |= {axis: replace(estimators[axis].fitted_, rule=rule) for axis, rule in rules.items()}

    # Alarm: the envelope of all flights, with limits from the flights left out.
    evidence = compiled.evaluate(samples.inputs, factors)
    envelope, limits = calibrate_alarm(
        Envelope.fit(samples.inputs, samples.flight, evidence.leverage, evidence.relative_width),
        left_out(flights, rules, live, options.confidence) if rules else [],
        confidence=options.confidence,
        rate_per_hour=options.false_alarms_per_hour,
        hover_rotor_speed=hover_rotor_speed(
            samples.inputs, samples.wrench, vehicle.mass_kg * vehicle.gravity_m_s2
        ),
    )
    return AerodynamicModel(
        name="",
        vehicle=vehicle.name,
        vehicle_fingerprint=vehicle.fingerprint,
        settings=options.settings,
        cutoff_hz=options.cutoff_hz,
        confidence=options.confidence,
        fitted=fitted,
        envelope=envelope,
        training_range={axis: float(np.ptp(samples.target(axis))) for axis in axes},
        flights=tuple(TrainingFlight(f.name, f.sha256, len(f.time)) for f in flights),
        selection={axis: _selection_log(estimators[axis]) for axis in axes},
        held_out_coverage={
            axis: rules[axis].held_out_coverage(held_out[axis], options.confidence).tolist()
            if axis in rules
            else []
            for axis in axes
        },
        alarm_limits=limits,
        compiled=compiled,
    )


def _fit(
    samples: _Samples,
    pools: Mapping[str, CandidatePool],
    options: IdentifyOptions,
    progress: ReportProgress,
) -> Mapping[str, StepwisePolynomial | Ensemble]:
    """Fitted estimators by axis."""
    if options.method == "polynomial":
        polynomials = {axis: options.polynomial(pool) for axis, pool in pools.items()}
        for done, (axis, polynomial) in enumerate(polynomials.items()):
            progress(Progress(f"Identifying {axis}", done, len(polynomials)))
            # Products this small are over before threads have shared one out: ten flights of a minute take
            # 15 s with one thread of BLAS, 26 s with two.
            with _naming(axis), threadpool_limits(limits=1, user_api="blas"):
                polynomial.fit(samples.inputs, samples.target(axis), samples.flight)
        return polynomials
    ensembles = {axis: options.ensemble(pool) for axis, pool in pools.items()}
    targets = np.column_stack([samples.target(axis) for axis in pools])
    fit_axes(
        ensembles, samples.inputs, targets, samples.flight, lambda state: progress(training_progress(state))
    )
    return ensembles


def _require_flights(flights: Sequence[PreparedFlight], settings: Settings) -> None:
    """Refuse flights that no method can be identified on, whatever the axis."""
    if settings == "default" and len(flights) < _FEWEST_FLIGHTS:
        raise ModelError(
            f"too few flights: {len(flights)} given, {_FEWEST_FLIGHTS} or more needed, each of which is left "
            "out in turn to calibrate the intervals; give more, or take settings paper, which need one and "
            "do not calibrate"
        )
    if not flights:
        raise ModelError("no flights to identify on: at least one is needed")
    for flight in flights:
        samples = np.column_stack((flight.inputs, flight.wrench))
        finite = np.isfinite(samples).all(axis=1)
        if not finite.all():
            raise ModelError(
                f"{flight.name}: {np.sum(~finite)} of {len(samples)} samples are not finite, "
                f"the first is sample {np.argmin(finite)}"
            )


@contextmanager
def _naming(axis: str) -> Iterator[None]:
    """Begin the message of an error with the axis that it concerns."""
    try:
        yield
    except ModelError as error:
        raise ModelError(f"{axis}: {error}") from error


def _selection_log(estimator: StepwisePolynomial | Ensemble) -> list[dict[str, Any]]:
    return estimator.selection_log() if isinstance(estimator, StepwisePolynomial) else []
