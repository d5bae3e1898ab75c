# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from quadpi_core.core import compiled
from quadpi_core.errors import SignalError
from quadpi_core.frames import from_rotation_vector
from quadpi_core.signals.chain import (
    DELAYS,
    SECTIONS,
    Filtered,
    design_low_pass,
    filter_settled,
    first_gap,
    interpolate,
    interpolate_attitude,
    nominal_rate,
    uniform_stamps,
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


STAMPS = np.array([100, 200, 300, 700, 800], dtype=np.int64)


def test_linear_between_samples_and_never_beyond_them_or_across_a_gap():
    at = np.array([50, 100, 250, 300, 500, 700, 750, 800, 801], dtype=np.int64)
    values, valid = interpolate(STAMPS, STAMPS[:, None] * 2.0, at, max_gap_ns=100)
    assert valid.tolist() == [False, True, True, True, False, True, True, True, False]
    np.testing.assert_allclose(values[valid, 0], 2.0 * at[valid])
    assert np.all(np.isfinite(values))
    assert values[0, 0] == 200.0
    assert values[-1, 0] == 1600.0


def test_one_sample_serves_only_its_own_stamp():
    values, valid = interpolate(STAMPS[:1], np.array([[3.0]]), np.array([99, 100, 101]), max_gap_ns=1000)
    assert valid.tolist() == [False, True, False]
    assert values.tolist() == [[3.0]] * 3


def test_large_stamps_lose_no_precision():
    epoch = 1_700_000_000_000_000_000
    at = epoch + np.array([101, 102], dtype=np.int64)
    values, _ = interpolate(epoch + STAMPS, STAMPS[:, None].astype(float), at, max_gap_ns=1000)
    np.testing.assert_allclose(values[:, 0], [101.0, 102.0], rtol=1e-12)


def test_attitudes_of_any_sign_turn_the_short_way():
    axis = np.array([0.0, 0.6, 0.8])
    attitude = np.array([from_rotation_vector(axis * angle) for angle in (0.0, 0.1, 0.2)])
    attitude[1] *= -1.0
    time_ns = np.array([0, 100, 200], dtype=np.int64)
    values, valid = interpolate_attitude(time_ns, attitude, np.array([50, 125]), max_gap_ns=100)
    assert valid.all()
    expected = np.array([from_rotation_vector(axis * angle) for angle in (0.05, 0.125)])
    np.testing.assert_allclose(np.abs(np.sum(values * expected, axis=1)), 1.0, atol=1e-10)


def test_attitude_interpolation_error_is_what_the_docstring_says():
    angle = 0.1
    ends = np.array([from_rotation_vector(np.array([0.0, 0.0, a])) for a in (0.0, angle)])
    at = np.arange(0, 1001, dtype=np.int64)
    values, _ = interpolate_attitude(np.array([0, 1000], dtype=np.int64), ends, at, max_gap_ns=1000)
    turned = 2.0 * np.arctan2(values[:, 3], values[:, 0])
    assert np.max(np.abs(turned - angle * at / 1000.0)) < angle**3 / 200.0


@pytest.mark.parametrize("rate", [500.0, 506.4, 300.0])
def test_nominal_rate_survives_jitter_rounding_and_lost_samples(rate):
    rng = np.random.default_rng(7)
    time = np.arange(2000) / rate + rng.uniform(-1e-4, 1e-4, 2000)
    stamps = np.rint(time[rng.random(2000) > 0.01] * 1e6).astype(np.int64) * 1000
    assert nominal_rate(stamps) == pytest.approx(rate, rel=1e-3)


def test_uniform_grid_of_a_uniform_sensor_is_its_own_stamps():
    stamps = 5_000 + np.rint(np.arange(1000) * 1e9 / 300.0).astype(np.int64)
    assert np.max(np.abs(uniform_stamps(stamps) - stamps)) < 1_000
    assert len(uniform_stamps(stamps)) == 1000


def test_first_gap_names_the_sample_after_it():
    assert first_gap(STAMPS, 100) == 3
    assert first_gap(STAMPS, 400) is None
