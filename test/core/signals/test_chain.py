# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import SignalError
from quadpi_core.signals.chain import SignalChain, filter_zero_phase

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


def test_one_by_one_equals_the_block_bit_for_bit():
    signals = random_signals()
    whole = SignalChain(RATE, CUTOFF).step(*signals)
    live = SignalChain(RATE, CUTOFF)
    rows = [live.step(*(column[i : i + 1] for column in signals)) for i in range(len(signals[0]))]
    for name in whole._fields:
        assert np.array_equal(np.concatenate([getattr(row, name) for row in rows]), getattr(whole, name)), (
            name
        )


def test_attitude_of_either_sign_filters_to_the_same_rotation():
    signals = random_signals()
    filtered = filter_zero_phase(*signals, rate_hz=RATE, cutoff_hz=CUTOFF).attitude
    np.testing.assert_allclose(np.linalg.norm(filtered, axis=1), 1.0, rtol=1e-12)
    assert np.all(np.abs(np.sum(filtered * signals[1], axis=1)) > 1.0 - 1e-6)


def test_inputs_are_left_alone_and_bad_samples_refused():
    signals = random_signals()
    before = [column.copy() for column in signals]
    chain = SignalChain(RATE, CUTOFF)
    chain.step(*signals)
    assert all(np.array_equal(a, b) for a, b in zip(signals, before, strict=True))
    signals[4][5, 2] = np.nan
    with pytest.raises(SignalError, match="sample 5 "):
        chain.step(*signals)


def test_reset_forgets_the_past():
    signals = random_signals()
    chain = SignalChain(RATE, CUTOFF)
    first = chain.step(*signals)
    chain.reset()
    again = chain.step(*signals)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
