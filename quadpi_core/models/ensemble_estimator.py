# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What both kinds of ensemble share: parameters, flights left out in turn, calibration and prediction."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.axis_estimator import AxisEstimator, fit_of, require_finite
from quadpi_core.models.ensemble_kernel import CompiledEnsembles
from quadpi_core.models.fitted_ensemble import NOISE_FLOOR, FittedEnsemble
from quadpi_core.models.interval_rules import FlightErrors, Rule, calibrate, flights_peak
from quadpi_core.models.model_kind import Fit, IdentifyOptions, Kind, Pools, TrainingSamples, option
from quadpi_core.models.regressors import Regressor
from quadpi_core.models.training_table import Indices, Plan, Split, Table
from quadpi_core.parallel import Progress, ReportProgress
from quadpi_core.training.networks import Networks

if TYPE_CHECKING:
    from quadpi_core.training.batches import Samples
    from quadpi_core.training.train import Report, Schedule, Training, TrainingState

Calibration: TypeAlias = Literal["held-out", "none"]
Floats: TypeAlias = npt.NDArray[np.float32]
Self = TypeVar("Self", bound="Ensemble")


@dataclass(frozen=True)
class Trained:
    """What training gives.

    Attributes:
        parts: by axis, constructor arguments of the fitted axis other than inputs, scaling and rule.
        centre, spread: (E, A, N) of each ensemble of the plan on all samples, standardised.
    """

    parts: list[dict[str, Any]]
    centre: Floats
    spread: Floats


@dataclass(eq=False)
class Ensemble(AxisEstimator):
    """Base of the ensembles: all but their losses, and what they make of the outputs of their members.

    Training needs PyTorch, prediction does not.
    Networks share their batches, so that all are trained at once: each takes its own samples of a batch.

    Args:
        inputs: of the networks, over the 19 inputs X; None for a table as it is.
        members: B.
        hidden: units of a member.
        epochs: passes over all samples.
        batch: samples of a step that a member sees.
        fewest_steps: of an epoch; few samples are used several times.
        learning_rate: of Adam.
        subset: share of the flights, or samples, that a member is trained on.
        split: "flight" or "sample", what a member leaves out.
        early_stopping: keep the best epoch instead of the last.
        calibration: "held-out" calibrates on flights left out in turn; "none" leaves intervals as they are.
        folds: most turns in which flights are left out, several at a time where there are more flights.
        most_samples: samples used; of more, every k-th of each flight. None for all.
        seed: of subsets, initial weights and batches.
        device: of PyTorch, "cpu" or "cuda".

    Attributes:
        fitted_: the identified ensemble.
        held_out_: errors on each flight of the ensemble without it; None without calibration.
        rejected_: rows that were not finite.
    """

    inputs: Sequence[Regressor] | None = None
    members: int = 10
    hidden: int = 20
    epochs: int = 50
    batch: int = 400
    fewest_steps: int = 100
    learning_rate: float = 1e-3
    subset: float = 0.8
    split: Split = "flight"
    early_stopping: bool = True
    calibration: Calibration = "held-out"
    folds: int = 10
    most_samples: int | None = 100_000
    seed: int = 0
    device: str = "cpu"

    # The class of the fitted axes, and the paper's settings that both kinds share: single samples are left
    # out, the last epoch is kept.
    fitted_type: ClassVar[type[FittedEnsemble]]
    PAPER: ClassVar[dict[str, Any]] = {
        "fewest_steps": 1,
        "split": "sample",
        "early_stopping": False,
        "calibration": "none",
        "most_samples": None,
    }

    @classmethod
    def paper(cls: type[Self], inputs: Sequence[Regressor] | None = None, **changes: Any) -> Self:
        """The settings of the paper, for reproducing its tables."""
        return cls(inputs, **cls.PAPER | changes)

    def fit(
        self: Self, X: Array, y: Array, groups: npt.ArrayLike | None = None, report: Report | None = None
    ) -> Self:
        """Train the networks and calibrate the intervals.

        Args:
            X: (N, 19) input vectors, columns as `quadpi_core.inputs.INPUT_NAMES`; any table (N, D) where
                `inputs` is None.
            y: (N,) target.
            groups: (N,) label of the flight of each sample; samples of a flight in time order. Without it
                five contiguous parts of the samples stand in for flights.
            report: called after each epoch.

        Rows that are not finite are left out with a warning; `rejected_` counts them.

        Raises:
            ModelError: for shapes that do not fit, no finite row, a constant target, too few flights, PyTorch
                missing, or a device that is not there.
        """
        y = np.asarray(y, dtype=float)
        if y.ndim != 1:
            raise ModelError(f"y has shape {y.shape}, expected (N,)")
        fit_axes({"": self}, X, y[:, None], groups, report)
        return self

    def centre_and_spread(self, X: Array) -> tuple[Array, Array]:
        """Centre and spread (N,) for input vectors (N, 19), or for a table like that of the fit.

        Raises:
            ModelError: before `fit`, or naming the sample that is not finite.
        """
        self.require_fitted()
        X = np.ascontiguousarray(X, dtype=float)
        if X.ndim != 2 or X.shape[1] != self.n_features_in_:
            raise ModelError(f"inputs have shape {X.shape}, expected (N, {self.n_features_in_})")
        require_finite(X)
        centre, spread = self.fitted_.centre_and_spread(X)
        return centre, spread

    def _samples(self, table: Table, plan: Plan) -> Samples:
        from quadpi_core.training.batches import Samples

        return Samples(
            table.features, table.targets.T[..., None, None], plan.unit, plan.trained, plan.omitted
        )

    @abstractmethod
    def _outcome(self, members: Training, table: Table, plan: Plan, ensemble: int) -> Sequence[Floats]:
        """Centre, spread and errors (A, N) of an ensemble; errors are NaN where none is honest."""

    def _outcomes(self, members: Training, table: Table, plan: Plan) -> Iterator[Floats]:
        """What :meth:`_outcome` gives, (E, A, N) of all ensembles."""
        outcomes = [self._outcome(members, table, plan, k) for k in range(len(plan))]
        return (np.stack(parts) for parts in zip(*outcomes, strict=True))

    def _schedule(self, **changes: Any) -> Schedule:
        from quadpi_core.training.train import Schedule

        settings: dict[str, Any] = {
            "hidden": self.hidden,
            "epochs": self.epochs,
            # A network sees only the share of a batch that is in its subset.
            "batch": round(self.batch / self.subset),
            "fewest_steps": self.fewest_steps,
            "learning_rate": self.learning_rate,
            "seed": self.seed,
            "device": self.device,
            "keep": "best" if self.early_stopping else "last",
        }
        return Schedule(**settings | changes)

    def _floors(self, table: Table, plan: Plan, errors: Floats) -> Floats:
        """Least standard deviation (E, A) of an error, from errors (E, A, N) that are NaN where not honest.

        How errors differ from place to place is learned from few flights, and a new flight may be off where
        those were not. So each place counts as visited by one more flight, with ordinary errors: of n flights
        inside the envelope of the others, the floor is the median of their mean square errors over n + 1.
        """
        floors = np.full(errors.shape[:2], NOISE_FLOOR, dtype=np.float32)
        if self.split == "sample":
            return floors
        for k, seen in enumerate(plan.seen):
            inside = [
                errors[k][:, table.rows[flight]] for flight in seen if table.mostly_inside(flight, seen)
            ]
            squares = [np.nanmean(np.square(error), axis=1) for error in inside if np.isfinite(error).any()]
            if squares:
                floors[k] = np.maximum(np.sqrt(np.median(squares, axis=0) / (len(squares) + 1)), NOISE_FLOOR)
        return floors

    @abstractmethod
    def _train(self, table: Table, plan: Plan, report: Report | None) -> Trained:
        """Train the networks of all axes and ensembles."""

    @property
    @abstractmethod
    def _uncalibrated(self) -> Rule:
        """The rule of intervals that are not calibrated."""


def require_training(device: str) -> None:
    """Refuse a device that cannot train.

    Raises:
        ModelError: if PyTorch is missing, or the device is not there.
    """
    try:
        from quadpi_core.training.train import device_of
    except ImportError as error:
        raise ModelError(f"training needs PyTorch, installed by quadpi-monitor[train]: {error}") from error
    device_of(device)


def fit_axes(
    estimators: Mapping[str, Ensemble],
    X: Array,
    Y: Array,
    groups: npt.ArrayLike | None = None,
    report: Report | None = None,
) -> None:
    """Fit one estimator per axis to targets Y (N, A), the networks of all axes in one batch.

    By name of the axis, all are of one kind and with the same parameters but for `inputs`; see
    :meth:`Ensemble.fit` for the rest.

    Raises:
        ModelError: naming the axis, see :meth:`Ensemble.fit`; estimators that differ.
    """
    first, *others = estimators.values()
    require_training(first.device)
    wanted = first.get_params() | {"inputs": None}
    if any(type(o) is not type(first) or o.get_params() | {"inputs": None} != wanted for o in others):
        raise ModelError("axes that are trained together must have the same parameters but for their inputs")
    inputs = [None if e.inputs is None else tuple(e.inputs) for e in estimators.values()]
    table = Table.make(inputs, list(estimators), X, Y, groups, first.most_samples)
    count, folds = len(table.rows), 0
    if first.calibration == "held-out":
        if count < 2:
            raise ModelError(
                "one flight is too few: intervals from flights left out in turn need two or more. Without "
                "groups, parts of the flight stand in for flights; calibration='none' does without"
            )
        folds = min(count, first.folds)
    plan = Plan.make(table.flights, first.members, first.subset, first.split, folds, first.seed)
    trained = first._train(table, plan, report)
    for axis, estimator in enumerate(estimators.values()):
        _fit_axis(estimator, table, plan, trained, axis)


def _fit_axis(estimator: Ensemble, table: Table, plan: Plan, trained: Trained, axis: int) -> None:
    """Calibrate the intervals of one axis and put what it holds together."""
    scaling, inputs = table.scalings[axis], None if estimator.inputs is None else tuple(estimator.inputs)

    def errors(
        ensemble: int, flight: int, inside: npt.NDArray[np.bool_], others: Indices | None = None
    ) -> FlightErrors:
        rows = table.rows[flight]
        error = (table.targets[axis, rows] - trained.centre[ensemble, axis, rows]).astype(float)
        spread = trained.spread[ensemble, axis, rows].astype(float)
        width = None
        if others is not None and len(others):
            width = spread / flights_peak(trained.spread[ensemble, axis, table.rows[k]] for k in others)
        return FlightErrors(scaling.target_scale * error, scaling.target_scale * spread, inside, width)

    rule: Rule = estimator._uncalibrated
    estimator.held_out_ = None
    if estimator.calibration == "held-out":
        estimator.held_out_ = [
            errors(k, flight, table.inside(flight, plan.seen[k]), np.setdiff1d(plan.seen[k], flight))
            for k, flights in enumerate(plan.left_out)
            for flight in flights
        ]
        final = [errors(0, k, np.ones(len(rows), dtype=bool)) for k, rows in enumerate(table.rows)]
        rule = calibrate(estimator.held_out_, final)
    width = len(scaling.input_mean)
    parts: dict[str, Any] = {
        # Without the inputs that only other axes have.
        name: replace(part, hidden_weights=np.ascontiguousarray(part.hidden_weights[:, :, :width]))
        if isinstance(part, Networks)
        else part
        for name, part in trained.parts[axis].items()
    }
    rms = float(np.sqrt(np.mean(np.square(trained.spread[0, axis], dtype=float))))
    estimator.fitted_ = estimator.fitted_type(
        inputs=inputs, scaling=scaling, rule=rule, rms_spread=scaling.target_scale * rms, **parts
    )
    estimator.n_features_in_, estimator.rejected_ = table.X.shape[1], table.rejected


def mean_over(predictions: Floats, chosen: npt.NDArray[np.bool_]) -> Floats:
    """Mean (A, N) of predictions (A, B, N) over the members chosen (B, N) for a sample; NaN without any."""
    weights = chosen.astype(np.float32)
    with np.errstate(invalid="ignore"):
        mean: Floats = np.einsum("abn,bn->an", predictions, weights) / weights.sum(axis=0)
    return mean


@dataclass(frozen=True)
class EnsembleKind(Kind):
    """What both kinds of ensemble have in common: the networks of all axes are trained together.

    Attributes:
        estimator: of one axis.
        device: that trains the networks.
    """

    device: Literal["cpu", "cuda"] = option(
        "cpu", "Device to train an ensemble on; it flies on the processor."
    )
    estimator: ClassVar[type[Ensemble]]
    has_paper_settings = True

    def check(self, options: IdentifyOptions, pools: Pools) -> None:
        """Refuse candidates without inputs for networks, and what PyTorch cannot train on.

        Raises:
            ModelError: naming the axis, or what is missing.
        """
        super().check(options, pools)
        for axis in AXES:
            if axis in pools and not pools[axis].inputs:
                raise ModelError(f"{axis}: the candidate file lists no `inputs` for networks")
        require_training(self.device)

    def configured(self, inputs: Sequence[Regressor], options: IdentifyOptions) -> Ensemble:
        """The estimator of one axis, not yet fitted."""
        make = self.estimator.paper if options.settings == "paper" else self.estimator
        return make(inputs).set_params(seed=self.seed, device=self.device)

    def fit(
        self, samples: TrainingSamples, pools: Pools, options: IdentifyOptions, progress: ReportProgress
    ) -> Fit:
        """Train all axes as one batch, reported after each epoch."""
        ensembles = {axis: self.configured(pool.inputs, options) for axis, pool in pools.items()}
        targets = np.column_stack([samples.target(axis) for axis in pools])

        def report(state: TrainingState) -> None:
            progress(training_progress(state))

        fit_axes(ensembles, samples.inputs, targets, samples.flight, report)
        return fit_of(ensembles)

    def compile(self, fitted: Mapping[str, Any]) -> CompiledEnsembles:
        """Pack the axes."""
        return CompiledEnsembles.pack(fitted)


def training_progress(state: TrainingState) -> Progress:
    """The progress of an identification after an epoch of training."""
    note = f"loss {state.loss:.3g}"
    if state.coverage is not None:
        note += f" · coverage {state.coverage:.1%}"
    return Progress(f"Training {state.stage}", state.epoch, state.epochs, "epochs", note)
