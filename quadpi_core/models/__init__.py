# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Aerodynamic models with prediction intervals."""

from quadpi_core.models.aerodynamic import AerodynamicModel, TrainingFlight
from quadpi_core.models.candidate_pool import CandidatePool, load_pools
from quadpi_core.models.methods import Evaluation
from quadpi_core.models.polynomial import FittedPolynomial, StepwisePolynomial

__all__ = [
    "AerodynamicModel",
    "CandidatePool",
    "Evaluation",
    "FittedPolynomial",
    "StepwisePolynomial",
    "TrainingFlight",
    "load_pools",
]
