# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Air of another density, and states that are not sure: what they do to predictions and intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from quadpi_core.errors import ArgumentError
from quadpi_core.flight import AXES
from quadpi_core.frames import from_rotation_vector, products
from quadpi_core.inputs import DERIVATIVES, aerodynamic_inputs
from quadpi_core.models.aerodynamic import unchecked_evaluation
from quadpi_core.models.model_kind import Fitted
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.preparation import STATE_ERRORS, Preparation, conditions
from test.core.models.physical_flights import fitted_physical

RATE_HZ = 500.0
SAMPLES = 400


def step(model, vehicle, samples, known=None, block=SAMPLES):
    """Predicted, lower, upper and relative width (K, 6) of the first samples."""
    monitor = Monitor(model, vehicle, RATE_HZ)
    parts = []
    for k in range(0, SAMPLES, block):
        part = slice(k, min(k + block, SAMPLES))
        own = None if known is None else known[part]
        said, _, _ = monitor.step(samples.time_ns[part], samples.values[part], own)
        parts.append((said.predicted, said.lower, said.upper, said.relative_width))
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]


def held(model):
    return np.isin(AXES, model.axes)


def test_nothing_known_changes_no_bit(each_model, vehicle, samples):
    plain = step(each_model, vehicle, samples)
    known = conditions(SAMPLES, vehicle.air_density_kg_m3, np.zeros((STATE_ERRORS, STATE_ERRORS)))
    for block in (1, 7, SAMPLES):
        np.testing.assert_array_equal(step(each_model, vehicle, samples, known, block), plain)


@pytest.mark.parametrize("ratio", [0.8, 1.2])
def test_the_wrench_goes_with_the_density(each_model, vehicle, samples, ratio):
    centre, lower, upper, width = step(each_model, vehicle, samples)
    known = conditions(SAMPLES, ratio * vehicle.air_density_kg_m3)
    said = step(each_model, vehicle, samples, known)
    np.testing.assert_array_equal(step(each_model, vehicle, samples, known, 1), said)
    if each_model.method == "physical":
        # Its terms say which of them are of the air; the next test is of them.
        assert np.all(np.abs(said[0] - centre)[:, held(each_model)] > 0.0)
        return
    wider = max(1.0, ratio)
    expected = (
        ratio * centre,
        ratio * centre + wider * (lower - centre),
        ratio * centre + wider * (upper - centre),
    )
    np.testing.assert_allclose(said[:3], expected, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(said[3], wider * width, rtol=1e-12)


@pytest.mark.parametrize(
    ("term", "is_of_the_air"),
    [
        ("thrust", True),
        ("drag_x", True),
        ("damping_q", True),
        ("incline_x", True),
        ("gravity_centre_y", True),
        ("rotor_inertia_gyro", False),
        ("rotor_inertia_spin", False),
        ("inertia_z", False),
        ("bias_x", False),
        ("bias_yaw", False),
        ("imu_x", False),
        ("imu_z", False),
    ],
)
def test_inertia_and_sensors_care_for_no_air(training_inputs, term, is_of_the_air):
    inputs, moving = training_inputs[:50], np.zeros(50, DERIVATIVES)
    moving["angular_acceleration"] = [1.0, -2.0, 3.0]
    moving["rotor_accelerations"] = [100.0, -200.0, 300.0, 500.0]

    def of_term():
        with_it, without = (
            fitted_physical(*AXES, **{term: value}).evaluate(inputs, np.zeros(len(AXES)), moving).predicted
            for value in (1.0, 0.0)
        )
        return with_it - without

    before = of_term()
    assert np.any(before)
    moving["density_excess"] = 0.25
    np.testing.assert_allclose(of_term(), (1.25 if is_of_the_air else 1.0) * before, rtol=1e-9, atol=1e-9)


class OfAnother(Fitted):
    """A model that Python evaluates."""

    method = "of another"

    def __init__(self, model):
        object.__setattr__(self, "axes", model.fitted.axes)
        object.__setattr__(self, "own", model.fitted)

    def evaluate(self, inputs, factors, derivatives=None):  # noqa: ARG002
        return self.own.evaluate(inputs, factors)


def test_a_model_in_python_is_told_too(model, vehicle, samples):
    other = replace(model, fitted=OfAnother(model))
    root = np.diag(np.r_[np.full(3, 0.1), np.full(3, 0.02), np.full(3, 0.05)])
    known = conditions(SAMPLES, 1.5, root @ root.T)
    np.testing.assert_allclose(
        step(other, vehicle, samples, known), step(model, vehicle, samples, known), rtol=1e-12, atol=1e-15
    )


@pytest.mark.parametrize("block", [1, SAMPLES])
def test_a_model_whose_flights_told_no_air_stays_in_it(each_model, vehicle, samples, block):
    untold = replace(each_model, flights=())
    known = conditions(SAMPLES, 0.8 * vehicle.air_density_kg_m3)
    for said, plain in zip(
        step(untold, vehicle, samples, known, block), step(untold, vehicle, samples), strict=True
    ):
        np.testing.assert_array_equal(said, plain)


def test_an_unsure_state_widens_intervals_by_what_it_does(each_model, vehicle):
    rng = np.random.default_rng(3)
    # A steady state passes the low-pass as it is.
    state = {
        "velocity": np.array([3.0, -1.0, 0.5]),
        "attitude": np.array([0.98, 0.1, -0.15, 0.07]),
        "rates": np.array([0.3, -0.2, 0.1]),
    }
    state["attitude"] /= np.linalg.norm(state["attitude"])
    speeds, wind = np.array([1100.0, 1150.0, 1080.0, 1120.0]), np.zeros(3)
    count = SAMPLES
    steady = PairedSamples.join(
        1_000_000_000 + np.arange(count) * 2_000_000,
        **{name: np.tile(values, (count, 1)) for name, values in state.items()},
        specific_force=np.tile([0.1, 0.2, -9.8], (count, 1)) + 1e-9 * rng.standard_normal((count, 3)),
        rotor_speeds=np.tile(speeds, (count, 1)),
        wind=np.tile(wind, (count, 1)),
    )
    root = 1e-4 * rng.standard_normal((STATE_ERRORS, STATE_ERRORS))
    covariance = root @ root.T

    def predicted(errors):
        turned = products(from_rotation_vector(errors[:, 3:6]), np.tile(state["attitude"], (len(errors), 1)))
        inputs = aerodynamic_inputs(
            state["velocity"] + errors[:, :3],
            turned,
            state["rates"] + errors[:, 6:],
            np.tile(speeds, (len(errors), 1)),
            vehicle,
        )
        still = np.zeros(len(inputs), DERIVATIVES)
        return unchecked_evaluation(each_model, inputs, None, still).predicted

    tiny = 1e-6 * np.eye(STATE_ERRORS)
    slopes = (predicted(tiny) - predicted(-tiny)).T / 2e-6
    by_state = np.einsum("ai,ij,aj->a", slopes, covariance, slopes)

    _, lower, upper, width = step(each_model, vehicle, steady)
    known = conditions(count, state_covariance=1e4 * covariance)
    centre, wide_lower, wide_upper, wide = step(each_model, vehicle, steady, known)
    axes = held(each_model)
    half, wide_half = 0.5 * (upper - lower)[-1, axes], 0.5 * (wide_upper - wide_lower)[-1, axes]
    added = norm.ppf(0.975) ** 2 * 1e4 * by_state[axes]
    assert np.all(added > 0.0)
    np.testing.assert_allclose(wide_half, np.sqrt(half**2 + added), rtol=2e-3)
    np.testing.assert_allclose(centre[-1, axes], 0.5 * (wide_lower + wide_upper)[-1, axes], rtol=1e-9)
    np.testing.assert_allclose(wide[-1, axes] / width[-1, axes], wide_half / half, rtol=1e-9)


def test_verdicts_know_which_speeds_are_commands(vehicle, samples):
    few = PairedSamples(samples.time_ns[:3], samples.values[:3])
    flags = np.array([[True, False, False, True], [False] * 4, [False, True, False, False]])
    preparation = Preparation(vehicle, RATE_HZ, 12.0)
    verdicts = preparation.step(*few, conditions(3, commanded=flags)).verdicts
    assert verdicts["commanded"].tolist() == [9, 0, 2]
    assert conditions(3, commanded=flags[0])["commanded"].tolist() == [9, 9, 9]
    assert preparation.step(*few).verdicts["commanded"].tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"air_density": 101325.0}, "air_density: sample 0 has 101325, no density of air in kg/m³"),
        ({"air_density": [1.2, 1.2, 0.1]}, "air_density: sample 2 has 0.1"),
        ({"air_density": [1.2, np.nan, 1.2]}, "air_density.*1"),
        ({"air_density": [1.2, 1.2]}, r"air_density: expected shape \(3,\)"),
        ({"air_density": "thin"}, "air_density: expected"),
        ({"state_covariance": np.eye(6)}, r"state_covariance: expected shape \(9, 9\)"),
        ({"state_covariance": np.zeros((2, 9, 9))}, r"state_covariance: expected shape \(3, 9, 9\)"),
        ({"commanded": [0, 1, 0, 1]}, "commanded: expected true or false for each rotor"),
        ({"commanded": np.zeros((2, 4), bool)}, "commanded: expected true or false"),
        ({"commanded": np.zeros((3, 13), bool)}, "commanded: expected true or false"),
        ({"state_covariance": -np.eye(9)}, "state_covariance: that of sample 0 is none"),
        (
            {"state_covariance": np.triu(np.ones((9, 9)))},
            "state_covariance: that of sample 0 is none: not symmetric",
        ),
        ({"state_covariance": np.full((9, 9), np.inf)}, "state_covariance.*finite"),
    ],
)
def test_refused(given, message):
    with pytest.raises(ArgumentError, match=message):
        conditions(3, **given)
