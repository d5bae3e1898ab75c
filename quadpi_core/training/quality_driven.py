# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Quality-driven ensemble: members trained to give bounds that cover, and are narrow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.stats import norm

from quadpi_core.models.fitted_ensemble import FittedQualityDriven
from quadpi_core.models.interval_rules import AnyRule, TrainedRule
from quadpi_core.models.regressors import Regressor
from quadpi_core.training.ensemble_estimator import Calibration, Ensemble, Trained, mean_over
from quadpi_core.training.training_table import Plan, Split, Table

if TYPE_CHECKING:
    from quadpi_core.training.losses import QualityDrivenForm
    from quadpi_core.training.train import Report, Training

Aggregation: TypeAlias = Literal["sd", "sem"]
# Of the normal distribution, for bounds of 95 %.
_QUANTILE = float(norm.ppf(0.975))


class QualityDrivenEnsemble(Ensemble):
    """Regression by an ensemble of small networks that give a lower and an upper bound.

    Works on plain arrays with the scikit-learn protocol (`fit`, `predict`, `score`, `get_params`,
    `set_params`, fitted attributes with a trailing underscore). Training needs PyTorch, nothing else does.

    The paper's settings are given by :meth:`paper`. The defaults deviate:

    - members start as trained regressors, with bounds at 1.96 times their error: from random weights, the
      loss has nothing to pull on but samples beside a bound, and the middle stays far from the target;
    - bounds that cross are penalised;
    - a member leaves out whole flights, not single samples, whose neighbours it would have seen all the same;
      of too few flights, contiguous parts. It is kept as it was after the epoch whose bounds had the best
      interval score on them. The ensemble's half distance is no less than 1.96 times what a flight is
      typically off as a whole;
    - intervals are calibrated on flights left out in turn, with ensembles of their own, for any confidence.

    Networks share their batches, so that all are trained at once: of each, a network takes its own samples.

    Args:
        inputs: of the networks, over the 19 inputs X; None for a table as it is.
        members: B.
        hidden: units of a member.
        warm_up: epochs as regressors, before `epochs` with the quality-driven loss.
        epochs: how often all samples are gone through.
        batch: samples of a step that a member sees.
        fewest_steps: of an epoch; few samples are gone through several times.
        learning_rate: of Adam.
        subset: share of the flights, or samples, that a member is trained on.
        split: "flight" or "sample", what a member leaves out.
        early_stopping: keep the best epoch instead of the last.
        confidence: that the bounds are trained for.
        form, factor, softening, crossing: of the loss, see
            :class:`~quadpi_core.training.losses.QualityDriven`; factor is its λ.
        aggregation: the members' bounds are moved outward by 1.96 standard deviations, "sd", or standard
            errors of the mean, "sem".
        calibration: "held-out" calibrates on flights left out in turn; "none" takes the bounds as they are.
        folds: most turns in which flights are left out, several at a time where there are more flights.
        most_samples: samples used; of more, every k-th of each flight. None for all.
        seed: of subsets, initial weights and batches.
        device: of PyTorch, "cpu" or "cuda".

    Attributes:
        fitted_: the identified :class:`FittedQualityDriven`.
        held_out_: errors on each flight of the ensemble without it; None without calibration.
        rejected_: rows that were not finite.
    """

    def __init__(
        self,
        inputs: Sequence[Regressor] | None = None,
        members: int = 10,
        hidden: int = 20,
        warm_up: int = 25,
        epochs: int = 50,
        batch: int = 400,
        fewest_steps: int = 100,
        learning_rate: float = 1e-3,
        subset: float = 0.8,
        split: Split = "flight",
        early_stopping: bool = True,
        confidence: float = 0.95,
        form: QualityDrivenForm = "sqrt-n",
        factor: float = 15.0,
        softening: float = 160.0,
        crossing: float = 10.0,
        aggregation: Aggregation = "sd",
        calibration: Calibration = "held-out",
        folds: int = 10,
        most_samples: int | None = 100_000,
        seed: int = 0,
        device: str = "cpu",
    ) -> None:
        self.inputs = inputs
        self.members = members
        self.hidden = hidden
        self.warm_up = warm_up
        self.epochs = epochs
        self.batch = batch
        self.fewest_steps = fewest_steps
        self.learning_rate = learning_rate
        self.subset = subset
        self.split: Split = split
        self.early_stopping = early_stopping
        self.confidence = confidence
        self.form: QualityDrivenForm = form
        self.factor = factor
        self.softening = softening
        self.crossing = crossing
        self.aggregation: Aggregation = aggregation
        self.calibration: Calibration = calibration
        self.folds = folds
        self.most_samples = most_samples
        self.seed = seed
        self.device = device

    @classmethod
    def paper(cls, inputs: Sequence[Regressor] | None = None, **changes: Any) -> QualityDrivenEnsemble:
        """The settings of the paper, for reproducing its tables; aggregated as the code of Pearce does."""
        settings: dict[str, Any] = {
            "warm_up": 0,
            "fewest_steps": 1,
            "split": "sample",
            "early_stopping": False,
            "form": "paper",
            "factor": 1.0,
            "crossing": 0.0,
            "aggregation": "sem",
            "calibration": "none",
            "most_samples": None,
        }
        return cls(inputs, **settings | changes)

    @property
    def _outward(self) -> float:
        return _QUANTILE / (float(np.sqrt(self.members)) if self.aggregation == "sem" else 1.0)

    def _train(self, table: Table, plan: Plan, report: Report | None) -> Trained:
        from quadpi_core.training.losses import QualityDriven, SquaredError
        from quadpi_core.training.train import train

        samples = self._samples(table, plan)
        schedule = self._schedule(keep="best" if self.early_stopping else "last")
        start = None
        if self.warm_up:
            start = train(samples, SquaredError(), replace(schedule, epochs=self.warm_up), "warm-up", report)
        loss = QualityDriven(
            self.confidence, self.batch, self.form, self.factor, self.softening, self.crossing
        )
        members = train(samples, loss, schedule, "bounds", report, start)
        outcomes = [self._outcome(members, table, plan, k) for k in range(len(plan))]
        centre, half, errors = (np.stack(parts) for parts in zip(*outcomes, strict=True))
        floors = _QUANTILE * self._floors(table, plan, errors)
        parts = [
            {"members": own[plan.networks(0)], "outward": self._outward, "floor": float(floors[0, axis])}
            for axis, own in enumerate(members.networks())
        ]
        return Trained(parts, centre, np.maximum(half, floors[..., None]))

    def _outcome(
        self, members: Training, table: Table, plan: Plan, ensemble: int
    ) -> tuple[npt.NDArray[np.float32], ...]:
        """Middle, half distance and errors (A, N) of an ensemble's bounds.

        Errors are those of the members that left a sample out; NaN where there is none.
        """
        bounds = members.predictions(plan.networks(ensemble))
        mean, deviation = bounds.mean(axis=1), bounds.std(axis=1, ddof=1)
        half = 0.5 * (mean[:, 1] - mean[:, 0]) + self._outward * deviation.mean(axis=1)
        errors = table.targets - mean_over(bounds.mean(axis=2), plan.unseen(ensemble))
        return mean.mean(axis=1), np.abs(half), errors

    def _uncalibrated(self) -> AnyRule:
        return TrainedRule(self.confidence)

    def _finish(self, **parts: Any) -> FittedQualityDriven:
        return FittedQualityDriven(**parts)
