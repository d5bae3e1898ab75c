# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.records import Records, record_dtype
from quadpi_core.signals.chain import (
    ATTITUDE,
    RATES,
    ROTOR_SPEEDS,
    SPECIFIC_FORCE,
    VELOCITY,
    WIND,
    ChainMemory,
    design_low_pass,
    filter_settled,
    filter_zero_phase,
    make_continuous,
)

RATE, CUTOFF = 500.0, 40.0


def empty_memory() -> Records:
    return np.zeros(1, record_dtype(ChainMemory))


def random_signals(samples: int = 300, seed: int = 2):
    """Velocity, attitude with random signs, rates, specific force, rotor speeds, wind."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0.0, 8.0, samples)
    zero = np.zeros(samples)
    attitude = np.stack((np.cos(0.5 * angle), zero, zero, np.sin(0.5 * angle)), axis=1)
    attitude *= rng.choice([-1.0, 1.0], size=(samples, 1))
    return [
        rng.normal(size=(samples, 3)),
        attitude,
        rng.normal(size=(samples, 3)),
        rng.normal(size=(samples, 3)),
        rng.normal(800.0, 10.0, size=(samples, 4)),
        np.zeros((samples, 3)),
    ]


def filtered_one_by_one(signals, memory):
    """Values and slopes (N, 20) of the causal chain, and curvatures (N, 4) of the rotor speeds."""
    design = design_low_pass(CUTOFF, RATE)
    samples = np.concatenate(signals, axis=1)
    value, slope, curvature = np.empty_like(samples), np.empty_like(samples), np.empty((len(samples), 4))
    for row in range(len(samples)):
        compiled.filter_sample(design, memory, samples[row], value[row], slope[row], curvature[row])
    return value, slope, curvature


def test_the_causal_chain_is_the_low_pass_of_a_continuous_attitude():
    signals = random_signals()
    value, slope, _ = filtered_one_by_one(signals, empty_memory())
    samples = np.concatenate(signals, axis=1)
    samples[:, ATTITUDE] = make_continuous(samples[:, ATTITUDE])
    expected = filter_settled(design_low_pass(CUTOFF, RATE), samples)
    norm = np.linalg.norm(expected.value[:, ATTITUDE], axis=1, keepdims=True)
    np.testing.assert_allclose(value[:, ATTITUDE], expected.value[:, ATTITUDE] / norm, rtol=1e-12)
    for others in (VELOCITY, RATES, SPECIFIC_FORCE, ROTOR_SPEEDS, WIND):
        np.testing.assert_array_equal(value[:, others], expected.value[:, others])
    np.testing.assert_array_equal(slope, expected.derivative)


def test_attitude_of_either_sign_filters_to_the_same_rotation():
    signals = random_signals()
    zero_phase = filter_zero_phase(*signals, rate_hz=RATE, cutoff_hz=CUTOFF).attitude
    causal = filtered_one_by_one(signals, empty_memory())[0][:, ATTITUDE]
    for filtered, lag in ((zero_phase, 1e-6), (causal, 3e-3)):
        np.testing.assert_allclose(np.linalg.norm(filtered, axis=1), 1.0, rtol=1e-12)
        assert np.all(np.abs(np.sum(filtered * signals[1], axis=1)) > 1.0 - lag)


def test_a_chain_that_forgets_starts_anew():
    memory = empty_memory()
    first = filtered_one_by_one(random_signals(), memory)
    filtered_one_by_one(random_signals(seed=3), memory)
    compiled.forget_samples(memory)
    again = filtered_one_by_one(random_signals(), memory)
    for before, after in zip(first, again, strict=True):
        assert np.array_equal(before, after)


def test_the_curvature_of_rotor_speeds_sums_up_to_their_slope():
    _, slope, curvature = filtered_one_by_one(random_signals(), empty_memory())
    steps = 0.5 * (curvature[1:] + curvature[:-1]) / RATE
    np.testing.assert_allclose(
        slope[1:, ROTOR_SPEEDS] - slope[0, ROTOR_SPEEDS], np.cumsum(steps, axis=0), atol=1e-8
    )
