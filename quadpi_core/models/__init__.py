# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Aerodynamic models with prediction intervals."""

from quadpi_core.models.aerodynamic import AerodynamicModel, TrainingFlight
from quadpi_core.models.evaluation import Evaluation
from quadpi_core.models.polynomial import FittedPolynomial, StepwisePolynomial
from quadpi_core.models.pool import CandidatePool, load_pools

__all__ = [
    "AerodynamicModel",
    "CandidatePool",
    "Evaluation",
    "FittedPolynomial",
    "StepwisePolynomial",
    "TrainingFlight",
    "load_pools",
]
