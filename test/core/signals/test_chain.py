# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np

from quadpi_core.signals.chain import filter_zero_phase

RATE, CUTOFF = 500.0, 40.0


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


def test_attitude_of_either_sign_filters_to_the_same_rotation():
    signals = random_signals()
    filtered = filter_zero_phase(*signals, rate_hz=RATE, cutoff_hz=CUTOFF).attitude
    np.testing.assert_allclose(np.linalg.norm(filtered, axis=1), 1.0, rtol=1e-12)
    assert np.all(np.abs(np.sum(filtered * signals[1], axis=1)) > 1.0 - 1e-6)
