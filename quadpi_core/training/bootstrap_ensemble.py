# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bootstrap ensemble: members trained on different subsets, and a network for the variance of the noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.stats import norm
from scipy.stats import t as student_t

from quadpi_core.models.fitted_ensemble import FittedBootstrap
from quadpi_core.models.interval_rules import AnyRule, NormalRule
from quadpi_core.models.regressors import Regressor
from quadpi_core.training.ensemble_estimator import Calibration, Ensemble, Trained, mean_over
from quadpi_core.training.training_table import Plan, Split, Table

if TYPE_CHECKING:
    from quadpi_core.training.train import Report, Training

NoiseTarget: TypeAlias = Literal["error", "excess"]


class BootstrapEnsemble(Ensemble):
    """Regression by an ensemble of small networks, and intervals from their variance and that of the noise.

    Works on plain arrays with the scikit-learn protocol (`fit`, `predict`, `score`, `get_params`,
    `set_params`, fitted attributes with a trailing underscore). Training needs PyTorch, nothing else does.

    The paper's rules, given by :meth:`paper`, take all samples as independent. The defaults deviate:

    - a member leaves out whole flights, not single samples, whose neighbours it would have seen all the same;
      of too few flights, contiguous parts. It is kept as it was after the epoch that did best on them;
    - the variance network learns from errors on flights that members left out, by the likelihood of the whole
      variance, which Eq. 19 overestimates. It is kept as it was after the epoch that did best on flights that
      a whole ensemble left out. What it gives is no less than a flight is typically off as a whole;
    - the variance of a mean of few members counts more: by 1 + 1/B and by Student's quantile;
    - intervals are calibrated on flights left out in turn, with ensembles of their own.

    Networks share their batches, so that all are trained at once: of each, a network takes its own samples.

    Args:
        inputs: of the networks, over the 19 inputs X; None for a table as it is.
        members: B.
        hidden: units of a member.
        noise_hidden: units of the variance network.
        epochs: how often all samples are gone through.
        batch: samples of a step that a member sees.
        fewest_steps: of an epoch; few samples are gone through several times.
        learning_rate: of Adam.
        subset: share of the flights, or samples, that a member is trained on.
        split: "flight" or "sample", what a member leaves out.
        early_stopping: keep the best epoch instead of the last.
        noise: what the variance network learns, "error" by the likelihood of the whole error e² or "excess",
            the paper's max(e² − model variance, 0).
        few_members: whether the members' variance counts more.
        calibration: "held-out" calibrates on flights left out in turn; "none" takes the normal quantile.
        folds: most turns in which flights are left out, several at a time where there are more flights.
        most_samples: samples used; of more, every k-th of each flight. None for all.
        seed: of subsets, initial weights and batches.
        device: of PyTorch, "cpu" or "cuda".

    Attributes:
        fitted_: the identified :class:`FittedBootstrap`.
        held_out_: errors on each flight of the ensemble without it; None without calibration.
        rejected_: rows that were not finite.
    """

    def __init__(
        self,
        inputs: Sequence[Regressor] | None = None,
        members: int = 10,
        hidden: int = 20,
        noise_hidden: int = 25,
        epochs: int = 50,
        batch: int = 400,
        fewest_steps: int = 100,
        learning_rate: float = 1e-3,
        subset: float = 0.8,
        split: Split = "flight",
        early_stopping: bool = True,
        noise: NoiseTarget = "error",
        few_members: bool = True,
        calibration: Calibration = "held-out",
        folds: int = 10,
        most_samples: int | None = 100_000,
        seed: int = 0,
        device: str = "cpu",
    ) -> None:
        self.inputs = inputs
        self.members = members
        self.hidden = hidden
        self.noise_hidden = noise_hidden
        self.epochs = epochs
        self.batch = batch
        self.fewest_steps = fewest_steps
        self.learning_rate = learning_rate
        self.subset = subset
        self.split: Split = split
        self.early_stopping = early_stopping
        self.noise: NoiseTarget = noise
        self.few_members = few_members
        self.calibration: Calibration = calibration
        self.folds = folds
        self.most_samples = most_samples
        self.seed = seed
        self.device = device

    @classmethod
    def paper(cls, inputs: Sequence[Regressor] | None = None, **changes: Any) -> BootstrapEnsemble:
        """The settings of the paper, for reproducing its tables."""
        settings: dict[str, Any] = {
            "fewest_steps": 1,
            "split": "sample",
            "early_stopping": False,
            "noise": "excess",
            "few_members": False,
            "calibration": "none",
            "most_samples": None,
        }
        return cls(inputs, **settings | changes)

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

        schedule = self._schedule(keep="best" if self.early_stopping else "last")
        members = train(self._samples(table, plan), SquaredError(), schedule, "members", report)
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
        import torch

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
        loss = GaussianNoise(torch.from_numpy(floors.T.copy()).to(schedule.device))
        noise = train(samples, loss, schedule, "noise", report)
        level = np.logaddexp(0.0, noise.predictions(slice(None))[:, :, 0]) + floors.T[:, :, None]
        return noise, level.swapaxes(0, 1)

    def _uncalibrated(self) -> AnyRule:
        return NormalRule()

    def _finish(self, **parts: Any) -> FittedBootstrap:
        return FittedBootstrap(**parts)
