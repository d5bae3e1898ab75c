# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A small flight as sensor samples, and a model identified on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.random_ensembles import random_ensembles, simulation_inputs
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import DERIVATIVES, INPUT_NAMES, MEASURED
from quadpi_core.models.aerodynamic import AerodynamicModel, TrainingFlight
from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.fitted_polynomial import FittedPolynomials, PolynomialAxis
from quadpi_core.models.interval_rules import MovedAxis, MovingCentre, ResidualRule
from quadpi_core.models.model_kind import Fitted
from quadpi_core.models.regressors import Regressor, RegressorProgram
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.preparation import Preparation
from quadpi_core.vehicle import Vehicle
from test.core.models.physical_flights import fitted_physical

RATE_HZ = 500.0
CUTOFF_HZ = 12.0


def fly(seconds: float, vehicle: Vehicle, seed: int = 0) -> PairedSamples:
    """Gentle swings about hover, forward-right-down, with sensor noise."""
    rng = np.random.default_rng(seed)
    count = round(seconds * RATE_HZ)
    time = np.arange(count) / RATE_HZ
    roll, pitch = 0.2 * np.sin(2.1 * time), 0.25 * np.sin(1.7 * time)
    half_roll, half_pitch = roll / 2, pitch / 2
    attitude = np.stack(
        (
            np.cos(half_roll) * np.cos(half_pitch),
            np.sin(half_roll) * np.cos(half_pitch),
            np.cos(half_roll) * np.sin(half_pitch),
            -np.sin(half_roll) * np.sin(half_pitch),
        ),
        axis=1,
    )
    velocity = np.stack((3 * np.sin(1.3 * time), 2 * np.sin(0.9 * time), 0.5 * np.sin(2.3 * time)), axis=1)
    rates = np.stack((0.42 * np.cos(2.1 * time), 0.425 * np.cos(1.7 * time), 0 * time), axis=1)
    specific_force = np.array([0.0, 0.0, -vehicle.gravity_m_s2]) - 0.3 * velocity
    swing = np.stack([np.sin(3.1 * time + phase) for phase in range(4)], axis=1)
    return PairedSamples.join(
        1_700_000_000_000_000_000 + np.round(time * 1e9).astype(np.int64),
        velocity=velocity + 0.01 * rng.standard_normal(velocity.shape),
        attitude=attitude,
        rates=rates + 0.02 * rng.standard_normal(rates.shape),
        specific_force=specific_force + 0.3 * rng.standard_normal(specific_force.shape),
        rotor_speeds=1100.0 + 80.0 * swing + 5.0 * rng.standard_normal(swing.shape),
        wind=np.zeros((count, 3)),
    )


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return Vehicle.load("neurobem")


@pytest.fixture(scope="session")
def samples(vehicle) -> PairedSamples:
    return fly(10.0, vehicle)


@pytest.fixture(scope="session")
def training_inputs(vehicle) -> Array:
    """Input vectors of a minute of `fly`."""
    return Preparation(vehicle, RATE_HZ, CUTOFF_HZ).step(*fly(60.0, vehicle, seed=1)).inputs


@pytest.fixture(scope="session")
def model(vehicle, training_inputs) -> AerodynamicModel:
    """Fx and My linear in a few inputs, as least squares on `fly` would give them."""
    polynomials = {}
    for axis, terms in (("Fx", ("1", "mu_x")), ("My", ("1", "U_q", "q^2"))):
        regressors = tuple(Regressor.parse(term) for term in terms)
        z = RegressorProgram.compile(regressors).evaluate(training_inputs)
        whitening = np.linalg.inv(np.linalg.cholesky(z.T @ z))
        polynomials[axis] = PolynomialAxis(
            regressors,
            np.linspace(0.1, 0.01, len(terms)),
            whitening,
            1.0,
            0.0,
            ResidualRule(0.2, 1000.0),
            1.0,
        )
    return model_of(FittedPolynomials(polynomials), vehicle, training_inputs)


@pytest.fixture(scope="session", params=["polynomial", "physical", "bootstrap", "quality-driven"])
def each_model(request, model, vehicle, training_inputs) -> AerodynamicModel:
    """`model`, such of known physics, and of ensembles with random weights."""
    if request.param == model.method:
        return model
    if request.param == "physical":
        physical = fitted_physical(*model.axes, delay_s=0.005, rotor_inertia_spin=1e-6)
        return model_of(physical, vehicle, training_inputs)
    inputs = {axis: axis_inputs for axis, axis_inputs in simulation_inputs().items() if axis in model.axes}
    return model_of(random_ensembles(request.param, training_inputs, inputs), vehicle, training_inputs)


def model_of(fitted: Fitted, vehicle: Vehicle, inputs: Array) -> AerodynamicModel:
    evidence = fitted.evaluate(inputs, np.ones(len(AXES)), np.zeros(len(inputs), DERIVATIVES))
    return AerodynamicModel(
        name="swings",
        vehicle=vehicle.name,
        vehicle_fingerprint=vehicle.fingerprint,
        settings="default",
        cutoff_hz=CUTOFF_HZ,
        confidence=0.95,
        fitted=fitted,
        envelope=Envelope.fit(inputs, np.zeros(len(inputs)), evidence.leverage, evidence.relative_width),
        training_range=dict.fromkeys(fitted.axes, 1.0),
        flights=(TrainingFlight("told its air", "", 1, MEASURED),),
        selection={axis: [] for axis in fitted.axes},
        held_out_coverage={axis: [] for axis in fitted.axes},
        moving_centre=MovingCentre({axis: MovedAxis(np.linspace(0.1, 0.02, 8), 1.0) for axis in fitted.axes}),
        identity="swings@000000000000",
        # The coefficients mean nothing, so that the measured wrench is far off: no miss counts.
        alarm_limits=AlarmLimits(miscoverage_s=np.full(len(AXES), 1e9)),
    )


@pytest.fixture
def envelope() -> Envelope:
    """Every input within ±1, margins and limits round numbers."""
    inputs = len(INPUT_NAMES)
    return Envelope(
        lower=np.full(inputs, -1.0),
        upper=np.full(inputs, 1.0),
        margin=np.full(inputs, 0.1),
        leverage_peak=np.full(6, 0.01),
        width_peak=np.full(6, 1.2),
        leverage_limit=np.full(6, 0.02),
        width_limit=np.full(6, 1.5),
    )


@pytest.fixture
def calibrated(envelope: Envelope) -> Envelope:
    """Limits of the alarm at twice the range, 8 times the leverage and 2 times the width of training."""
    return replace(
        envelope,
        margin=np.full(len(INPUT_NAMES), 0.5),
        leverage_limit=8.0 * envelope.leverage_peak,
        width_limit=2.0 * envelope.width_peak,
    )
