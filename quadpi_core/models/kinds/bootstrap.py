# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bootstrap ensembles: members trained on different subsets, and a network for the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from quadpi_core.config_schema import Positive, ReadBy
from quadpi_core.models.ensemble import Ensemble, Floats, Plan, Table, Trained, mean_over
from quadpi_core.models.fitted_ensemble import EnsembleAxis, FittedEnsembles
from quadpi_core.models.interval_rules import NormalRule, Rule
from quadpi_core.training.networks import Networks

if TYPE_CHECKING:
    from quadpi_core.training.train import Report, Training


@dataclass(frozen=True)
class BootstrapAxis(EnsembleAxis):
    """Members that predict the target, and one network that predicts the variance of the noise.

    centre = mean of the members, spread² = model_share · their variance (B − 1) + noise² (van Beers and de
    Visser, Eq. 18 to 20).

    Attributes:
        noise: one network; noise = softplus(output) + floor, as a share of the target's scale.
        model_share: 1 in the paper; more in the default, for there are few members (see `Bootstrap`).
    """

    noise: Annotated[Networks, ReadBy(Networks.stored)]
    model_share: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        members, noise = self.members, self.noise
        shapes = (members.output_biases.shape[1], noise.output_biases.shape, noise.hidden_weights.shape[2])
        if shapes != (1, (1, 1), members.hidden_weights.shape[2]):
            raise ValueError("members and noise network do not fit together")

    @property
    def deviation_weight(self) -> float:
        """Of the members' variance."""
        return self.model_share


class FittedBootstrap(FittedEnsembles):
    """Bootstrap ensembles of all axes."""

    method = "bootstrap"
    axis_type = BootstrapAxis


@dataclass(frozen=True)
class Bootstrap(Ensemble):
    """Members trained on different subsets, and a network for the variance of the noise.

    Intervals follow from the variance of the members and that of the noise. The paper's rules take all
    samples as independent. The defaults deviate:

    - a member leaves out whole flights instead of single samples, whose neighbours in time it would have
      seen; with too few flights, contiguous parts. It keeps the weights of its best epoch on them;
    - the variance network learns from errors on flights that members left out, by the likelihood of the whole
      variance, which Eq. 19 overestimates. The weights kept are those of the epoch that did best on flights
      that a whole ensemble left out. The noise is at least the typical offset of a whole flight;
    - the variance of a mean of few members counts more: by 1 + 1/B and by Student's quantile;
    - intervals are calibrated on flights left out in turn, with ensembles of their own.

    Attributes:
        noise_hidden: units of the variance network.
        noise: target of the variance network, "error" by the likelihood of the whole error e² or "excess",
            the paper's max(e² − model variance, 0).
        few_members: whether the members' variance counts more.
    """

    noise_hidden: int = 25
    noise: Literal["error", "excess"] = "error"
    few_members: bool = True

    name = FittedBootstrap.method
    label = "bootstrap ensemble"
    colour = "#56B4E9"  # as in the paper
    normal_errors = True
    fitted_type = FittedBootstrap
    PAPER: ClassVar[dict[str, Any]] = Ensemble.PAPER | {"noise": "excess", "few_members": False}

    def _uncalibrated(self, confidence: float) -> Rule:  # noqa: ARG002 - for bounds trained for one
        return NormalRule()

    @property
    def _model_share(self) -> float:
        if not self.few_members:
            return 1.0
        from scipy.special import ndtri, stdtrit

        quantiles = stdtrit(self.members - 1, 0.975) / ndtri(0.975)
        return float((1.0 + 1.0 / self.members) * quantiles**2)

    def _train(
        self,
        table: Table,
        plan: Plan,
        confidence: float,  # noqa: ARG002 - for bounds trained for one
        report: Report | None,
    ) -> Trained:
        from quadpi_core.training.losses import SquaredError
        from quadpi_core.training.train import train

        members = train(self._samples(table, plan), SquaredError(), self._schedule(), "members", report)
        centre, variance, errors = self._outcomes(members, table, plan)
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

    def _outcome(self, members: Training, table: Table, plan: Plan, ensemble: int) -> Sequence[Floats]:
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
        errors: Floats,
        variance: Floats,
        floors: Floats,
        report: Report | None,
    ) -> tuple[Training, Floats]:
        """The variance networks, one per ensemble, and the noise (E, A, N) that they give."""
        from quadpi_core.training.losses import GaussianNoise, Samples
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


KIND = Bootstrap()
