# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What both kinds of ensemble share: options, flights left out in turn, calibration."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import ModelError, named_in
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.fitted_ensemble import NOISE_FLOOR, FittedEnsembles, Scaling
from quadpi_core.models.interval_rules import FEWEST_INSIDE, FlightErrors, Rule, calibrate, flights_peak
from quadpi_core.models.model_kind import Fit, IdentifyOptions, Kind, Pools, TrainingSamples, option
from quadpi_core.models.regressors import RegressorProgram
from quadpi_core.parallel import Progress, ReportProgress
from quadpi_core.training.networks import Networks

if TYPE_CHECKING:
    from quadpi_core.training.losses import Samples
    from quadpi_core.training.train import Report, Schedule, Training, TrainingState


@dataclass(frozen=True)
class Table:
    """Samples of A axes.

    Attributes:
        X: (N, 19) input vectors.
        features: (N, A, D) standardised inputs of the networks, zero beyond the last of an axis.
        targets: (A, N) standardised.
        flights: (N,) numbered from 0.
        scalings: of each axis.
    """

    X: Array
    features: npt.NDArray[np.float32]
    targets: npt.NDArray[np.float32]
    flights: Indices
    scalings: tuple[Scaling, ...]

    @classmethod
    def make(cls, samples: TrainingSamples, pools: Pools, most_samples: int | None) -> Table:
        """Prepare samples for the axes of pools.

        Inputs and targets are standardised over all flights, those that will be left out included: a choice
        of units, from which no network learns anything of a flight.

        Raises:
            ModelError: for a constant target, naming the axis.
        """
        rows = _every_other(
            samples.flight, 1 if most_samples is None else -(-len(samples.time) // most_samples)
        )
        X, scaled, scalings, targets = samples.inputs[rows], [], [], []
        for axis, pool in pools.items():
            features, target = RegressorProgram.compile(pool.inputs).evaluate(X), samples.target(axis)[rows]
            with named_in(axis):
                scaling = Scaling.from_samples(features, target)
            scaled.append(scaling.standardised(features))
            scalings.append(scaling)
            targets.append((target - scaling.target_mean) / scaling.target_scale)
        filled = np.zeros((len(X), len(scaled), max(part.shape[1] for part in scaled)), dtype=np.float32)
        for k, part in enumerate(scaled):
            filled[:, k, : part.shape[1]] = part
        return cls(X, filled, np.array(targets, dtype=np.float32), samples.flight[rows], tuple(scalings))

    @cached_property
    def rows(self) -> list[Indices]:
        """Samples of each flight."""
        return [np.flatnonzero(self.flights == flight) for flight in range(int(self.flights.max()) + 1)]

    @cached_property
    def _ranges(self) -> tuple[Array, Array]:
        lowest, highest = ([edge(self.X[rows], axis=0) for rows in self.rows] for edge in (np.min, np.max))
        return np.array(lowest), np.array(highest)

    def inside(self, flight: int, others: Indices) -> Flags:
        """Which samples of a flight lie in the range of the others in every input; none without others."""
        lowest, highest = (edges[np.setdiff1d(others, flight)] for edges in self._ranges)
        X = self.X[self.rows[flight]]
        if len(lowest) == 0:
            return np.zeros(len(X), dtype=bool)
        return ((lowest.min(axis=0) <= X) & (highest.max(axis=0) >= X)).all(axis=1)

    def mostly_inside(self, flight: int, others: Indices) -> bool:
        """Whether the errors on a flight count for intervals (see :class:`.interval_rules.HeldOutRule`)."""
        return float(np.mean(self.inside(flight, others))) >= FEWEST_INSIDE


def _every_other(flights: Indices, step: int) -> Flags:
    """Flags (N,) of every step-th sample of each flight."""
    rows = np.zeros(len(flights), dtype=bool)
    for flight in range(int(flights.max()) + 1):
        rows[np.flatnonzero(flights == flight)[::step]] = True
    return rows


Split: TypeAlias = Literal["flight", "sample"]
Flags: TypeAlias = npt.NDArray[np.bool_]
Indices: TypeAlias = npt.NDArray[np.int64]

# Units that samples are dealt to where single samples are in or out.
_SAMPLE_UNITS = 1000
# Contiguous parts of a flight, which members leave out where there are too few flights to leave out.
_PARTS = 5
_FEWEST_FLIGHTS = 3


@dataclass(frozen=True)
class Plan:
    """Ensembles of B members: the first sees all flights, each other one all but those left out in its turn.

    Networks are numbered ensemble by ensemble, M of them. Of what its ensemble sees, each member leaves some
    out; that judges it, and errors there are those of a network that was not trained on them.

    Attributes:
        members: B.
        unit: (N,) unit of each sample; units are in or out as a whole.
        trained: (M, U) units that a network is trained on.
        omitted: (M, U) units that its ensemble sees, and the network does not.
        left_out: flights that each ensemble does not see.
        seen: flights that each ensemble sees.
    """

    members: int
    unit: npt.NDArray[np.int32]
    trained: Flags
    omitted: Flags
    left_out: tuple[Indices, ...]
    seen: tuple[Indices, ...]

    @classmethod
    def make(cls, flights: Indices, members: int, subset: float, split: Split, folds: int, seed: int) -> Plan:
        """Plan for samples (N,) of flights numbered from 0, which are left out in `folds` turns."""
        random = np.random.default_rng(seed)
        every = np.arange(int(flights.max()) + 1)
        unit, flight_of = _units(flights, split, random)
        left_out = (every[:0], *(np.array_split(every, folds) if folds else ()))
        seen = tuple(np.setdiff1d(every, flights_out) for flights_out in left_out)
        share = 1.0 - subset
        omitted = [_omitted(flight_of, flights_in, members, share, split, random) for flights_in in seen]
        visible = [np.tile(np.isin(flight_of, flights_in), (members, 1)) for flights_in in seen]
        trained = np.concatenate(visible) & ~np.concatenate(omitted)
        return cls(members, unit, trained, np.concatenate(omitted), left_out, seen)

    def __len__(self) -> int:
        """Number of ensembles."""
        return len(self.seen)

    def networks(self, ensemble: int) -> slice:
        """The networks of an ensemble."""
        return slice(ensemble * self.members, (ensemble + 1) * self.members)

    def unseen(self, ensemble: int) -> Flags:
        """Which samples (B, N) the members of an ensemble leave out."""
        return self.omitted[self.networks(ensemble)][:, self.unit]


def _units(
    flights: Indices, split: Split, random: np.random.Generator
) -> tuple[npt.NDArray[np.int32], Indices]:
    """Unit of each sample (N,) and flight of each unit (U,)."""
    count = int(flights.max()) + 1
    parts = _PARTS if split == "flight" else -(-_SAMPLE_UNITS // count)
    part = np.empty(len(flights), dtype=np.int64)
    for flight in range(count):
        mine = np.flatnonzero(flights == flight)
        in_order = np.arange(len(mine)) * parts // len(mine)
        part[mine] = in_order if split == "flight" else random.permutation(in_order)
    return (flights * parts + part).astype(np.int32), np.repeat(np.arange(count), parts)


def _omitted(
    flight_of: Indices, seen: Indices, members: int, share: float, split: Split, random: np.random.Generator
) -> Flags:
    """Units (B, U) that each member of an ensemble leaves out.

    Members take turns through an order that chance gives, so that all are left out about equally often.
    """
    if split == "flight" and len(seen) >= _FEWEST_FLIGHTS:
        pieces = flight_of == seen[:, None]
    else:
        pieces = np.eye(len(flight_of), dtype=bool)[np.isin(flight_of, seen)]
    size = max(1, round(share * len(pieces)))
    rounds = -(-members * size // len(pieces))
    order = np.concatenate([random.permutation(len(pieces)) for _ in range(rounds)])[: members * size]
    return pieces[order].reshape(members, size, -1).any(axis=1)


Floats: TypeAlias = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Trained:
    """What training gives.

    Attributes:
        parts: by axis, fields of the fitted axis other than inputs, scaling, rule and root mean square.
        centre, spread: (E, A, N) of each ensemble of the plan on all samples, standardised.
    """

    parts: list[dict[str, Any]]
    centre: Floats
    spread: Floats


@dataclass(frozen=True)
class Ensemble(Kind):
    """Base of the ensembles: all but their losses, and what they make of the outputs of their members.

    Training needs PyTorch, prediction does not. Networks share their batches, so that those of all axes are
    trained at once: each takes its own samples of a batch.

    Attributes:
        device: of PyTorch.
        members: B.
        hidden: units of a member.
        epochs: passes over all samples.
        batch: samples of a step that a member sees.
        fewest_steps: of an epoch; few samples are used several times.
        learning_rate: of Adam.
        subset: share of the flights, or samples, that a member is trained on.
        split: "flight" or "sample", what a member leaves out.
        early_stopping: keep the best epoch instead of the last.
        folds: most turns in which flights are left out to calibrate the intervals, several at a time where
            there are more flights; 0 leaves the intervals as they are.
        most_samples: samples used; of more, every k-th of each flight. None for all.
    """

    device: Literal["cpu", "cuda"] = option(
        "cpu", "Device to train an ensemble on; it flies on the processor."
    )
    members: int = 10
    hidden: int = 20
    epochs: int = 50
    batch: int = 400
    fewest_steps: int = 100
    learning_rate: float = 1e-3
    subset: float = 0.8
    split: Split = "flight"
    early_stopping: bool = True
    folds: int = 10
    most_samples: int | None = 100_000

    has_paper_settings = True
    fitted_type: ClassVar[type[FittedEnsembles]]

    # The paper's settings that both kinds share: single samples are left out, the last epoch is kept.
    PAPER: ClassVar[dict[str, Any]] = {
        "fewest_steps": 1,
        "split": "sample",
        "early_stopping": False,
        "folds": 0,
        "most_samples": None,
    }

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

    def fit(
        self, samples: TrainingSamples, pools: Pools, options: IdentifyOptions, progress: ReportProgress
    ) -> Fit:
        """Train the networks of all axes as one batch, reported after each epoch, and calibrate intervals.

        Raises:
            ModelError: for a constant target, naming the axis, too few flights, PyTorch missing, or a device
                that is not there.
        """

        def report(state: TrainingState) -> None:
            progress(training_progress(state))

        kind = replace(self, **self.PAPER) if options.settings == "paper" else self
        require_training(kind.device)
        table = Table.make(samples, pools, kind.most_samples)
        folds = min(len(table.rows), kind.folds)
        if folds == 1:
            raise ModelError("one flight is too few: intervals from flights left out in turn need two")
        plan = Plan.make(table.flights, kind.members, kind.subset, kind.split, folds, kind.seed)
        trained = kind._train(table, plan, options.confidence, report)
        axis_type: Any = self.fitted_type.axis_type
        axes, held_out = {}, {}
        for k, (axis, pool) in enumerate(pools.items()):
            rule = kind._uncalibrated(options.confidence)
            if folds:
                held_out[axis], rule = _calibrated(table, plan, trained, k)
            scaling = table.scalings[k]
            rms = float(np.sqrt(np.mean(np.square(trained.spread[0, k], dtype=float))))
            axes[axis] = axis_type(
                inputs=tuple(pool.inputs),
                scaling=scaling,
                rule=rule,
                rms_spread=scaling.target_scale * rms,
                **{name: _without_padding(part, len(pool.inputs)) for name, part in trained.parts[k].items()},
            )
        return Fit(self.fitted_type(axes), held_out)

    def _samples(self, table: Table, plan: Plan) -> Samples:
        from quadpi_core.training.losses import Samples

        return Samples(
            table.features, table.targets.T[..., None, None], plan.unit, plan.trained, plan.omitted
        )

    @abstractmethod
    def _outcome(self, members: Training, table: Table, plan: Plan, ensemble: int) -> Sequence[Floats]:
        """Centre, spread and errors (A, N) of an ensemble; errors: NaN where all members saw the sample."""

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
    def _train(self, table: Table, plan: Plan, confidence: float, report: Report | None) -> Trained:
        """Train the networks of all axes and ensembles; bounds may be trained for one confidence."""

    @abstractmethod
    def _uncalibrated(self, confidence: float) -> Rule:
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


def _calibrated(table: Table, plan: Plan, trained: Trained, axis: int) -> tuple[list[FlightErrors], Rule]:
    """Errors on each flight of an axis of the ensembles without it, and the rule that they give."""
    scale = table.scalings[axis].target_scale

    def errors(
        ensemble: int, flight: int, inside: npt.NDArray[np.bool_], others: Indices | None = None
    ) -> FlightErrors:
        rows = table.rows[flight]
        error = (table.targets[axis, rows] - trained.centre[ensemble, axis, rows]).astype(float)
        spread = trained.spread[ensemble, axis, rows].astype(float)
        width = None
        if others is not None and len(others):
            width = spread / flights_peak(trained.spread[ensemble, axis, table.rows[k]] for k in others)
        return FlightErrors(scale * error, scale * spread, inside, width)

    held_out = [
        errors(k, flight, table.inside(flight, plan.seen[k]), np.setdiff1d(plan.seen[k], flight))
        for k, flights in enumerate(plan.left_out)
        for flight in flights
    ]
    final = [errors(0, k, np.ones(len(rows), dtype=bool)) for k, rows in enumerate(table.rows)]
    return held_out, calibrate(held_out, final)


def _without_padding(part: Any, inputs: int) -> Any:
    """Networks without the inputs that only other axes have; anything else as it is."""
    if not isinstance(part, Networks):
        return part
    return replace(part, hidden_weights=np.ascontiguousarray(part.hidden_weights[:, :, :inputs]))


def mean_over(predictions: Floats, chosen: npt.NDArray[np.bool_]) -> Floats:
    """Mean (A, N) of predictions (A, B, N) over the members chosen (B, N) for a sample; NaN without any."""
    weights = chosen.astype(np.float32)
    with np.errstate(invalid="ignore"):
        mean: Floats = np.einsum("abn,bn->an", predictions, weights) / weights.sum(axis=0)
    return mean


def training_progress(state: TrainingState) -> Progress:
    """The progress of an identification after an epoch of training."""
    note = f"loss {state.loss:.3g}"
    if state.coverage is not None:
        note += f" · coverage {state.coverage:.1%}"
    return Progress(f"Training {state.stage}", state.epoch, state.epochs, "epochs", note)
