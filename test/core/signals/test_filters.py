# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from quadpi_core.core import compiled
from quadpi_core.errors import SignalError
from quadpi_core.signals.chain import (
    DELAYS,
    SECTIONS,
    Filtered,
    design_low_pass,
    filter_settled,
    zero_phase,
)

RATE = 400.0
CUTOFF = 30.0


def random_walk(samples: int, channels: int = 3, seed: int = 1):
    return np.cumsum(np.random.default_rng(seed).normal(size=(samples, channels)), axis=0) + 5.0


def test_causal_filter_is_the_fourth_order_butterworth():
    samples = random_walk(500)
    sections = signal.butter(4, CUTOFF, fs=RATE, output="sos")
    start = signal.sosfilt_zi(sections)[:, :, None] * samples[0]
    expected, _ = signal.sosfilt(sections, samples, axis=0, zi=start)
    np.testing.assert_allclose(
        filter_settled(design_low_pass(CUTOFF, RATE), samples).value, expected, rtol=0, atol=1e-10
    )


def test_design_is_that_of_scipy():
    rng = np.random.default_rng(5)
    for cutoff, ratio in zip(rng.uniform(0.5, 120.0, 500), rng.uniform(2.02, 80.0, 500), strict=True):
        rate = cutoff * ratio
        design = design_low_pass(cutoff, rate)
        for name, row in zip(
            ("first", "second"), signal.butter(4, cutoff, fs=rate, output="sos"), strict=True
        ):
            np.testing.assert_allclose((*design[name]["a1"], *design[name]["a2"]), row[4:], atol=1e-15)


def test_zero_phase_is_the_forward_backward_butterworth():
    samples = random_walk(500)
    sections = signal.butter(4, CUTOFF, fs=RATE, output="sos")
    padding = int(np.ceil(6.0 * RATE / CUTOFF))
    expected = signal.sosfiltfilt(sections, samples, axis=0, padlen=padding)
    np.testing.assert_allclose(zero_phase(samples, CUTOFF, RATE).value, expected, rtol=0, atol=1e-10)


def test_blocks_of_any_length_give_the_same_bits():
    samples = random_walk(300)
    whole = filter_settled(design_low_pass(CUTOFF, RATE), samples)
    for blocks in ([1] * 300, [1, 7, 2, 90, 200]):
        design = design_low_pass(CUTOFF, RATE)
        state, parts = np.empty((SECTIONS, DELAYS, samples.shape[1])), []
        compiled.settle(design, state, samples[0])
        for part in np.split(samples, np.cumsum(blocks)[:-1]):
            parts.append(Filtered(np.empty_like(part), np.empty_like(part)))
            compiled.low_pass(design, state, part, *parts[-1])
        assert np.array_equal(np.concatenate([part.value for part in parts]), whole.value)
        assert np.array_equal(np.concatenate([part.derivative for part in parts]), whole.derivative)


def test_starts_settled():
    for level in (3.0, -40.0):
        filtered = filter_settled(design_low_pass(CUTOFF, RATE), np.full((50, 2), level))
        np.testing.assert_allclose(filtered.value, level, rtol=1e-12)
        np.testing.assert_allclose(filtered.derivative, 0.0, atol=1e-9)


def test_trapezoidal_integral_of_the_derivative_is_the_filtered_signal():
    samples = random_walk(400)
    causal = filter_settled(design_low_pass(CUTOFF, RATE), samples)
    for filtered in (causal, zero_phase(samples, CUTOFF, RATE)):
        steps = 0.5 * (filtered.derivative[1:] + filtered.derivative[:-1]) / RATE
        np.testing.assert_allclose(np.diff(filtered.value, axis=0), steps, rtol=0, atol=1e-5)


def test_zero_phase_derivative_of_a_slow_sine_is_its_cosine():
    time = np.arange(800) / RATE
    omega = 2.0 * np.pi * 2.0
    filtered = zero_phase(np.sin(omega * time)[:, None], CUTOFF, RATE)
    middle = slice(150, 650)
    np.testing.assert_allclose(
        filtered.derivative[middle, 0], omega * np.cos(omega * time[middle]), atol=0.01
    )
    np.testing.assert_allclose(filtered.value[middle, 0], np.sin(omega * time[middle]), atol=1e-4)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 200.0, 250.0, float("nan")])
def test_impossible_cutoff_is_refused(cutoff):
    with pytest.raises(SignalError, match="half the sample rate"):
        design_low_pass(cutoff, RATE)


def test_short_or_not_finite_signals_are_refused():
    with pytest.raises(SignalError, match="too few"):
        zero_phase(random_walk(80), CUTOFF, RATE)
    samples = random_walk(200)
    samples[17, 1] = np.nan
    with pytest.raises(SignalError, match="sample 17 "):
        zero_phase(samples, CUTOFF, RATE)
