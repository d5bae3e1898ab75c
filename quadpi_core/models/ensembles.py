# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The two ensembles of the paper: bootstrap and quality-driven. Their common part is :class:`Ensemble`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.stats import norm
from scipy.stats import t as student_t

from quadpi_core.models.ensemble_estimator import Ensemble, Trained, mean_over
from quadpi_core.models.fitted_ensemble import FittedBootstrap, FittedQualityDriven
from quadpi_core.models.interval_rules import AnyRule, NormalRule, TrainedRule
from quadpi_core.models.training_table import Plan, Table

if TYPE_CHECKING:
    from quadpi_core.training.losses import QualityDrivenForm
    from quadpi_core.training.train import Report, Training

NoiseTarget: TypeAlias = Literal["error", "excess"]
Aggregation: TypeAlias = Literal["sd", "sem"]
# Of the normal distribution, for bounds of 95 %.
_QUANTILE = float(norm.ppf(0.975))


@dataclass(eq=False)
class BootstrapEnsemble(Ensemble):
    """Members trained on different subsets, and a network for the variance of the noise.

    Intervals follow from the variance of the members and that of the noise. The paper's rules, given by
    :meth:`paper`, take all samples as independent. The defaults deviate:

    - a member leaves out whole flights instead of single samples, whose neighbours in time it would have
      seen; with too few flights, contiguous parts. It keeps the weights of its best epoch on them;
    - the variance network learns from errors on flights that members left out, by the likelihood of the whole
      variance, which Eq. 19 overestimates. The weights kept are those of the epoch that did best on flights
      that a whole ensemble left out. The noise is at least the typical offset of a whole flight;
    - the variance of a mean of few members counts more: by 1 + 1/B and by Student's quantile;
    - intervals are calibrated on flights left out in turn, with ensembles of their own.

    Args:
        noise_hidden: units of the variance network.
        noise: target of the variance network, "error" by the likelihood of the whole error e² or "excess",
            the paper's max(e² − model variance, 0).
        few_members: whether the members' variance counts more.

    The other arguments are those of :class:`.ensemble_estimator.Ensemble`.
    """

    noise_hidden: int = 25
    noise: NoiseTarget = "error"
    few_members: bool = True

    PAPER: ClassVar[dict[str, Any]] = Ensemble.PAPER | {"noise": "excess", "few_members": False}

    @property
    def _model_share(self) -> float:
        """Weight of the members' variance."""
        if not self.few_members:
            return 1.0
        quantiles = student_t.ppf(0.975, self.members - 1) / norm.ppf(0.975)
        return float((1.0 + 1.0 / self.members) * quantiles**2)

    def _train(self, table: Table, plan: Plan, report: Report | None) -> Trained:
        from quadpi_core.training.losses import SquaredError
        from quadpi_core.training.train import train

        members = train(self._samples(table, plan), SquaredError(), self._schedule(), "members", report)
        outcomes = [self._outcome(members, table, plan, k) for k in range(len(plan))]
        centre, variance, errors = (np.stack(parts) for parts in zip(*outcomes, strict=True))
        floors = self._floors(table, plan, errors)
        noise, level = self._train_noise(table, plan, errors, variance, floors, report)
        spread = np.sqrt(self._model_share * variance + np.square(level))
        parts = [
            {
                "members": own[plan.networks(0)],
                "noise": quiet[:1],
                "model_share": self._model_share,
                "floor": float(floors[0, axis]),
            }
            for axis, (own, quiet) in enumerate(zip(members.networks(), noise.networks(), strict=True))
        ]
        return Trained(parts, centre, spread)

    @staticmethod
    def _outcome(
        members: Training, table: Table, plan: Plan, ensemble: int
    ) -> tuple[npt.NDArray[np.float32], ...]:
        """Mean, variance and errors (A, N) of an ensemble.

        Errors are those of the members that left a sample out, or of all where the ensemble does; NaN where
        neither is so.
        """
        predictions = members.predictions(plan.networks(ensemble))[:, :, 0]
        mean, variance = predictions.mean(axis=1), predictions.var(axis=1, ddof=1)
        unseen = plan.unseen(ensemble) | np.isin(table.flights, plan.left_out[ensemble])
        return mean, variance, table.targets - mean_over(predictions, unseen)

    def _train_noise(
        self,
        table: Table,
        plan: Plan,
        errors: npt.NDArray[np.float32],
        variance: npt.NDArray[np.float32],
        floors: npt.NDArray[np.float32],
        report: Report | None,
    ) -> tuple[Training, npt.NDArray[np.float32]]:
        """The variance networks, one per ensemble, and the noise (E, A, N) that they give."""
        from quadpi_core.training.batches import Samples
        from quadpi_core.training.losses import GaussianNoise
        from quadpi_core.training.train import train

        squares = np.nan_to_num(np.square(errors))
        if self.noise == "error":
            targets = np.stack((squares, self._model_share * variance), axis=-1)
        else:
            targets = np.stack((np.maximum(squares - variance, 0.0), np.zeros_like(variance)), axis=-1)
        trained = np.array([plan.omitted[plan.networks(k)].any(axis=0) for k in range(len(plan))])
        judged = np.zeros_like(trained)
        for k, flights in enumerate(plan.left_out):
            for flight in flights:
                judged[k, plan.unit[table.rows[flight]]] = table.mostly_inside(flight, plan.seen[k])
        samples = Samples(table.features, targets.transpose(2, 1, 0, 3), plan.unit, trained, judged)
        schedule = self._schedule(
            hidden=self.noise_hidden,
            batch=self.batch,
            seed=self.seed + 1,
            keep="best on average" if self.early_stopping else "last",
        )
        loss = GaussianNoise.above(floors.T, schedule.device)
        noise = train(samples, loss, schedule, "noise", report)
        level = np.logaddexp(0.0, noise.predictions(slice(None))[:, :, 0]) + floors.T[:, :, None]
        return noise, level.swapaxes(0, 1)

    def _uncalibrated(self) -> AnyRule:
        return NormalRule()

    def _finish(self, **parts: Any) -> FittedBootstrap:
        return FittedBootstrap(**parts)


@dataclass(eq=False)
class QualityDrivenEnsemble(Ensemble):
    """Members trained to give a lower and an upper bound that cover the target and are narrow.

    The paper's settings are given by :meth:`paper`, aggregated as the code of Pearce does. The defaults
    deviate:

    - members start as trained regressors, with bounds at 1.96 times their error: from random weights, the
      loss has a gradient only at samples beside a bound, and the middle stays far from the target;
    - bounds that cross are penalised;
    - a member leaves out whole flights instead of single samples, whose neighbours in time it would have
      seen; with too few flights, contiguous parts. It keeps the weights of the epoch with the best interval
      score on them. The ensemble's half distance is at least 1.96 times the typical offset of a whole flight;
    - intervals are calibrated on flights left out in turn, with ensembles of their own, for any confidence.

    Args:
        warm_up: epochs as regressors, before `epochs` with the quality-driven loss.
        confidence: that the bounds are trained for.
        form, factor, softening, crossing: of the loss, see
            :class:`~quadpi_core.training.losses.QualityDriven`; factor is its λ.
        aggregation: the members' bounds are moved outward by 1.96 standard deviations, "sd", or standard
            errors of the mean, "sem".

    The other arguments are those of :class:`.ensemble_estimator.Ensemble`.
    """

    warm_up: int = 25
    confidence: float = 0.95
    form: QualityDrivenForm = "sqrt-n"
    factor: float = 15.0
    softening: float = 160.0
    crossing: float = 10.0
    aggregation: Aggregation = "sd"

    PAPER: ClassVar[dict[str, Any]] = Ensemble.PAPER | {
        "warm_up": 0,
        "form": "paper",
        "factor": 1.0,
        "crossing": 0.0,
        "aggregation": "sem",
    }

    @property
    def _outward(self) -> float:
        return _QUANTILE / (float(np.sqrt(self.members)) if self.aggregation == "sem" else 1.0)

    def _train(self, table: Table, plan: Plan, report: Report | None) -> Trained:
        from quadpi_core.training.losses import QualityDriven, SquaredError
        from quadpi_core.training.train import train

        samples = self._samples(table, plan)
        schedule = self._schedule()
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
