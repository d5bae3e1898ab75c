# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From flights to a model: the offline main path, between `prepared` and `judging`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.identification.alarm_calibration import (
    calibrate_alarm,
    hover_rotor_speed,
    left_out,
    live_errors,
)
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.models.aerodynamic import METHODS, AerodynamicModel, TrainingFlight
from quadpi_core.models.alarm_limits import RATE_PER_HOUR
from quadpi_core.models.candidate_pool import CandidatePool
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.interval_rules import HeldOutRule, require_confidence
from quadpi_core.models.methods import FittedAxis
from quadpi_core.models.polynomial import StepwisePolynomial
from quadpi_core.models.selection import StopRule
from quadpi_core.training.bootstrap_ensemble import BootstrapEnsemble
from quadpi_core.training.ensemble_estimator import Ensemble, fit_axes, require_training
from quadpi_core.training.quality_driven import QualityDrivenEnsemble
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_core.training.train import Progress

Settings: TypeAlias = Literal["default", "paper"]
MethodName: TypeAlias = Literal["polynomial", "bootstrap", "quality-driven"]

# Low-pass over all signals: the paper's, and one that keeps what rotors and measured moments still share
# (their coherence is gone above about 25 Hz on two data sets).
CUTOFF_HZ: dict[Settings, float] = {"default": 30.0, "paper": 100.0}
# Each is left out in turn to calibrate the intervals.
_FEWEST_FLIGHTS = 2


class Step(str):
    """Words on how far an identification has come, with the numbers to draw it by.

    Attributes:
        task: what is being done.
        done: axes or epochs that are finished.
        total: of them.
        loss: of networks, see :class:`quadpi_core.training.train.Progress`.
        coverage: see there.
    """

    task: str
    done: int
    total: int
    loss: float | None
    coverage: float | None

    @classmethod
    def fitting(cls, axis: str, done: int, total: int) -> Step:
        """Before a polynomial is fitted."""
        step = cls(f"Identifying {axis}")
        step.task, step.done, step.total, step.loss, step.coverage = str(step), done, total, None, None
        return step

    @classmethod
    def training(cls, state: Progress) -> Step:
        """After an epoch."""
        covered = "" if state.coverage is None else f", coverage {state.coverage:.1%} of what it has not seen"
        task = f"Training {state.stage}"
        step = cls(f"{task}: epoch {state.epoch} of {state.epochs}, loss {state.loss:.3g}{covered}")
        step.task, step.done, step.total = task, state.epoch, state.epochs
        step.loss, step.coverage = state.loss, state.coverage
        return step


def identify(
    flights: Sequence[PreparedFlight],
    vehicle: Vehicle,
    pools: dict[str, CandidatePool],
    *,
    cutoff_hz: float,
    method: MethodName = "polynomial",
    settings: Settings = "default",
    stop: StopRule | None = None,
    confidence: float = 0.95,
    seed: int = 0,
    device: str = "cpu",
    false_alarms_per_hour: float = RATE_PER_HOUR,
    progress: Callable[[Step], None] = lambda _: None,
) -> AerodynamicModel:
    """Identify a model of every axis of `pools`, with its envelope and the limits of its alarm.

    Args:
        flights: to identify on; errors of flights left out in turn calibrate the intervals.
        vehicle: the vehicle that flew.
        pools: by axis: candidates of a polynomial, inputs of an ensemble.
        cutoff_hz: of the low-pass that the flights passed; kept with the model.
        method: kind of model.
        settings: "paper" for the paper's rules.
        stop: stop rule of a polynomial other than that of the settings.
        confidence: nominal coverage that the monitor will use, and quality-driven bounds are trained for.
        seed: of an ensemble.
        device: that trains an ensemble, "cpu" or "cuda".
        false_alarms_per_hour: that the limits of the alarm are calibrated to, on the flights left out.
        progress: called before each polynomial, or after each epoch of an ensemble.

    Raises:
        ModelError: see :func:`require_options`; for too few flights for the settings; naming the flight, for
            samples that are not finite; naming the axis, for what cannot be identified.
    """
    require_options(pools, method=method, settings=settings, stop=stop, confidence=confidence, device=device)
    _require_flights(flights, settings)
    inputs = np.concatenate([flight.inputs for flight in flights])
    wrench = np.concatenate([flight.wrench for flight in flights])
    labels = np.repeat(np.arange(len(flights)), [len(flight.time) for flight in flights])
    axes = [axis for axis in AXES if axis in pools]
    targets = wrench[:, [AXES.index(axis) for axis in axes]]
    estimators: Mapping[str, StepwisePolynomial | Ensemble]
    if method == "polynomial":
        polynomials = {axis: _polynomial(pools[axis], settings, stop) for axis in axes}
        for column, axis in enumerate(axes):
            progress(Step.fitting(axis, column, len(axes)))
            with _naming(axis):
                polynomials[axis].fit(inputs, targets[:, column], labels)
        estimators = polynomials
    else:
        ensembles = {
            axis: _ensemble(pools[axis], method, settings, confidence, seed, device) for axis in axes
        }
        fit_axes(ensembles, inputs, targets, labels, lambda state: progress(Step.training(state)))
        estimators = ensembles
    fitted: dict[str, FittedAxis] = {axis: estimators[axis].fitted_ for axis in axes}
    compiled = METHODS[method].compile(fitted)
    factors = compiled.factors(confidence)
    evidence = compiled.evaluate(inputs, factors)
    held_out = {axis: errors for axis in axes if (errors := estimators[axis].held_out_) is not None}
    live = live_errors(flights, held_out, lambda rows: compiled.evaluate(rows, factors)) if held_out else []
    rules = {
        axis: rule.covering([flight.errors[axis] for flight in live])
        for axis in held_out
        if isinstance(rule := fitted[axis].rule, HeldOutRule)
    }
    fitted |= {axis: replace(estimators[axis].fitted_, rule=rule) for axis, rule in rules.items()}
    envelope, limits = calibrate_alarm(
        Envelope.fit(inputs, labels, evidence.leverage, evidence.relative_width),
        left_out(flights, rules, live, confidence) if rules else [],
        confidence=confidence,
        rate_per_hour=false_alarms_per_hour,
        hover_rotor_speed=hover_rotor_speed(inputs, wrench, vehicle.mass_kg * vehicle.gravity_m_s2),
    )
    return AerodynamicModel(
        name="",
        vehicle=vehicle.name,
        vehicle_fingerprint=vehicle.fingerprint,
        settings=settings,
        cutoff_hz=cutoff_hz,
        confidence=confidence,
        fitted=fitted,
        envelope=envelope,
        training_range={axis: float(np.ptp(targets[:, column])) for column, axis in enumerate(axes)},
        flights=tuple(TrainingFlight(f.name, f.sha256, len(f.time)) for f in flights),
        selection={axis: _selection_log(estimators[axis]) for axis in axes},
        held_out_coverage={
            axis: rules[axis].held_out_coverage(held_out[axis], confidence).tolist() if axis in rules else []
            for axis in axes
        },
        alarm_limits=limits,
    )


def require_options(
    pools: Mapping[str, CandidatePool],
    *,
    method: MethodName,
    settings: Settings,
    stop: StopRule | None,
    confidence: float,
    device: str,
) -> None:
    """Refuse what no flights can be identified with; to be asked before they are read, which takes longer.

    Args are those of :func:`identify`.

    Raises:
        ModelError: for a confidence that the settings cannot give; for an ensemble with a stop rule, without
            PyTorch or the device; naming the axis, for candidates without inputs for networks.
    """
    require_confidence(confidence, calibrated=settings == "default")
    if method == "polynomial":
        return
    if stop is not None:
        raise ModelError(f"a stop rule is for polynomials: the {method} method has none")
    for axis in AXES:
        if axis in pools and not pools[axis].inputs:
            raise ModelError(f"{axis}: the candidate file lists no `inputs` for networks")
    require_training(device)


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


def _polynomial(pool: CandidatePool, settings: Settings, stop: StopRule | None) -> StepwisePolynomial:
    regressor = StepwisePolynomial.paper(pool) if settings == "paper" else StepwisePolynomial(pool)
    return regressor if stop is None else regressor.set_params(stop=stop)


def _ensemble(
    pool: CandidatePool,
    method: MethodName,
    settings: Settings,
    confidence: float,
    seed: int,
    device: str,
) -> Ensemble:
    kind = BootstrapEnsemble if method == "bootstrap" else QualityDrivenEnsemble
    ensemble = kind.paper(pool.inputs) if settings == "paper" else kind(pool.inputs)
    trained_for = {} if method == "bootstrap" else {"confidence": confidence}
    return ensemble.set_params(seed=seed, device=device, **trained_for)


@contextmanager
def _naming(axis: str) -> Iterator[None]:
    """Say in an error which axis it is of."""
    try:
        yield
    except ModelError as error:
        raise ModelError(f"{axis}: {error}") from error


def _selection_log(estimator: StepwisePolynomial | Ensemble) -> list[dict[str, Any]]:
    return estimator.selection_log() if isinstance(estimator, StepwisePolynomial) else []
