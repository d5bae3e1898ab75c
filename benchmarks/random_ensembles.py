# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles of the paper's size with random weights: as heavy to evaluate as trained ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.models.fitted_ensemble import EnsembleAxis, FittedEnsembles, Scaling
from quadpi_core.models.interval_rules import NormalRule, Rule
from quadpi_core.models.kinds.bootstrap import BootstrapAxis, FittedBootstrap
from quadpi_core.models.kinds.quality_driven import FittedQualityDriven, QualityDrivenAxis
from quadpi_core.models.regressors import Regressor, RegressorProgram, load_pools
from quadpi_core.training.networks import Networks

NOISE_UNITS = 25


FITTED = {own.method: own for own in (FittedBootstrap, FittedQualityDriven)}


def random_ensembles(method: str, X: Array, inputs: Mapping[str, Sequence[Regressor]]) -> FittedEnsembles:
    """Ten networks of 20 units for each axis, over input vectors X (N, 19)."""
    return FITTED[method](
        {axis: random_ensemble(method, X, own, seed=k) for k, (axis, own) in enumerate(inputs.items())}
    )


def simulation_inputs() -> dict[str, tuple[Regressor, ...]]:
    """What the networks of the paper's simulation take, by axis: 3, 3, 12, 5, 5 and 10 inputs."""
    return {axis: pool.inputs for axis, pool in load_pools("bebop2_simulation").items()}


def random_ensemble(
    method: str,
    X: Array,
    inputs: Sequence[Regressor],
    *,
    members: int = 10,
    units: int = 20,
    rule: Rule | None = None,
    seed: int = 0,
) -> EnsembleAxis:
    """One axis of about 1 ± 0.3 N or Nm."""
    rng = np.random.default_rng(seed)
    features = RegressorProgram.compile(inputs).evaluate(X)
    scaling = Scaling(features.mean(axis=0), features.std(axis=0), target_mean=1.0, target_scale=0.3)
    rule = NormalRule() if rule is None else rule
    fitted: EnsembleAxis
    if method == FittedBootstrap.method:
        networks = _random_networks(rng, members, len(inputs), units, outputs=1)
        noise = _random_networks(rng, 1, len(inputs), NOISE_UNITS, outputs=1)
        fitted = BootstrapAxis(tuple(inputs), scaling, networks, rule, 1.0, noise, 1.0 + 1.0 / members)
    else:
        networks = _random_networks(rng, members, len(inputs), units, outputs=2)
        networks = replace(networks, output_biases=networks.output_biases + np.array([-1.0, 1.0]))
        fitted = QualityDrivenAxis(tuple(inputs), scaling, networks, rule, 1.0, outward=1.96)
    evaluation = FITTED[method]({"Fx": fitted}).evaluate(X, np.ones(6))
    spread = evaluation.upper[:, 0] - evaluation.predicted[:, 0]
    return replace(fitted, rms_spread=float(np.sqrt(np.mean(spread**2))))


def _random_networks(
    rng: np.random.Generator, members: int, inputs: int, units: int, outputs: int
) -> Networks:
    return Networks(
        rng.normal(scale=1.0 / np.sqrt(inputs), size=(members, units, inputs)),
        rng.normal(scale=0.5, size=(members, units)),
        rng.normal(scale=1.0 / np.sqrt(units), size=(members, outputs, units)),
        rng.normal(scale=0.1, size=(members, outputs)),
    )
