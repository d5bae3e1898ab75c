# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from dataclasses import fields, replace
from functools import reduce

import numpy as np
import pytest
import yaml

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.envelope import Envelope, PlacedErrors, SpreadShape, fit_shape, squared_speed

SAMPLES = 3000
U, COS_PHI = INPUT_INDEX["u"], INPUT_INDEX["cos_phi"]


@pytest.fixture
def training() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    leverage = np.zeros((SAMPLES, 6))
    leverage[:, 0] = rng.uniform(0.0, 0.01, SAMPLES)
    width = np.zeros((SAMPLES, 6))
    width[:, 0] = rng.uniform(0.9, 1.1, SAMPLES)
    return {
        "inputs": rng.uniform(-1.0, 1.0, (SAMPLES, len(INPUT_NAMES))),
        "groups": np.repeat([0, 1, 2], SAMPLES // 3),
        "leverage": leverage,
        "relative_width": width,
    }


def test_training_samples_lie_inside_the_margin(training):
    envelope = Envelope.fit(**training)
    excess = envelope.input_excess(training["inputs"])
    assert np.all(excess <= envelope.margin)
    assert np.all(training["leverage"] < envelope.leverage_limit)
    assert np.all(training["relative_width"] < envelope.width_limit)


def test_excess_counts_in_widths_of_the_range(training):
    envelope = Envelope.fit(**training)
    width = envelope.upper - envelope.lower
    above = envelope.upper + 0.5 * width
    below = envelope.lower - 2.0 * width
    excess = envelope.input_excess(np.stack((above, below)))[
        :, [not name.startswith("cos_") for name in INPUT_NAMES]
    ]
    np.testing.assert_allclose(excess[0], 0.5)
    np.testing.assert_allclose(excess[1], 2.0)


@pytest.mark.parametrize("times", [1.0, 1.2, 2.0])
def test_a_cosine_is_as_far_outside_as_its_angle(training, times):
    most = 0.3
    inputs = training["inputs"].copy()
    angles = np.linspace(-most, most, SAMPLES // 3)
    inputs[:, COS_PHI] = np.tile(np.cos(angles), 3)
    envelope = Envelope.fit(**training | {"inputs": inputs})
    sample = inputs[:1].copy()
    sample[0, COS_PHI] = np.cos(times * most)
    assert envelope.input_excess(sample)[0, COS_PHI] == pytest.approx(0.5 * (times - 1.0), abs=0.02)


def test_one_spike_does_not_widen_the_range_but_a_flight_does(training):
    spiked = training["inputs"].copy()
    spiked[10, U] = 50.0
    assert Envelope.fit(**training | {"inputs": spiked}).upper[U] < 1.5

    faster = training["inputs"].copy()
    faster[training["groups"] == 2, U] *= 3.0
    assert Envelope.fit(**training | {"inputs": faster}).upper[U] > 2.9


def test_axes_that_the_model_does_not_hold_never_count(training):
    envelope = Envelope.fit(**training)
    np.testing.assert_array_equal(envelope.leverage_limit[1:], 1.0)
    np.testing.assert_array_equal(envelope.width_limit[1:], 1.0)
    assert envelope.leverage_limit[0] == pytest.approx(2.0 * 0.01, rel=0.01)


def test_constant_input_is_measured_in_its_unit(training):
    inputs = training["inputs"].copy()
    inputs[:, U] = 7.0
    envelope = Envelope.fit(**training | {"inputs": inputs})
    sample = inputs[:1].copy()
    assert envelope.input_excess(sample)[0, U] == 0.0
    sample[0, U] = 7.3
    assert envelope.input_excess(sample)[0, U] == pytest.approx(0.3)


def test_the_warning_keeps_the_plain_limits_unless_others_are_nearer(training):
    plain = Envelope.fit(**training)
    peaks = plain.leverage_peak[0], plain.width_peak[0]
    for name in ("margin", "leverage_limit", "width_limit"):
        np.testing.assert_array_equal(getattr(plain.near, name), getattr(plain, name))

    def with_limits(times: float) -> Envelope:
        return replace(
            plain,
            margin=times * plain.margin,
            leverage_limit=times * plain.leverage_limit,
            width_limit=times * plain.width_limit,
        )

    for times, near in ((3.0, 1.0), (0.5, 0.5)):
        envelope = with_limits(times).near
        np.testing.assert_allclose(envelope.margin, near * 0.1)
        assert envelope.leverage_limit[0] == pytest.approx(near * 2.0 * peaks[0])
        assert envelope.width_limit[0] == pytest.approx(near * 1.25 * peaks[1])


def test_json_gives_the_same_envelope(training):
    envelope = Envelope.fit(**training)
    again = Envelope.from_json(json.loads(json.dumps(envelope.to_json())))
    for field in fields(Envelope):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(envelope, field.name))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ("axes.Fz.leverage_limit: high", "envelope: axes.Fz: `leverage_limit` must be a positive number"),
        ("inputs.u.upper: .inf", "envelope: inputs.u: `upper` must be a number, found inf"),
        ("inputs.u.lower: 99.0", "envelope: inputs.u: the lower bound 99 lies above its upper bound"),
        ("axes.Fx.width_limit: 0.0", "envelope: axes.Fx: `width_limit` must be a positive number, found 0.0"),
        ("axes.Fx.leverage_peak: -0.1", "envelope: axes.Fx: `leverage_peak` must be a number not below 0"),
        ("inputs.mu_x: null", "envelope: inputs: missing key `mu_x`"),
    ],
)
def test_damaged_json_is_refused(training, damage, message):
    data = Envelope.fit(**training).to_json()
    ((place, value),) = yaml.safe_load(damage).items()
    *above, key = place.split(".")
    entry = reduce(dict.__getitem__, above, data)
    entry[key] = value
    with pytest.raises(ModelError, match=message):
        Envelope.from_json(data)


def test_training_that_is_not_finite_or_does_not_fit_is_refused(training):
    inputs = training["inputs"].copy()
    inputs[17, 3] = np.nan
    with pytest.raises(ModelError, match="inputs of sample 17 is not finite"):
        Envelope.fit(**training | {"inputs": inputs})
    with pytest.raises(ModelError, match="flight labels"):
        Envelope.fit(**training | {"groups": training["groups"][:-1]})


def test_the_range_of_a_flight_leaves_out_a_thousandth_at_either_end():
    lower, upper = Envelope.flight_range(np.tile(np.arange(1001.0)[:, None], (1, 19)))
    assert (lower[0], upper[0]) == pytest.approx((1.0, 999.0))


def errors(error: Array, leverage: Array, speed_squared: Array) -> PlacedErrors:
    return PlacedErrors(error, leverage, speed_squared, np.ones(len(error), dtype=bool))


@pytest.mark.parametrize(("inflation", "growth"), [(1.0, 0.5), (10.0, 0.05), (200.0, 1e-4), (200.0, 0.2)])
def test_known_shape_is_found(inflation: float, growth: float) -> None:
    rng = np.random.default_rng(1)
    shape, flights = SpreadShape(inflation, growth), []
    for fastest in (4.0, 8.0, 12.0, 6.0, 10.0):
        leverage = rng.exponential(0.05, size=4000)
        speed_squared = np.square(rng.uniform(0.0, fastest, size=4000))
        error = 0.3 * shape.of(leverage, speed_squared) * rng.normal(size=4000)
        flights.append(errors(error, leverage, speed_squared))
    found = fit_shape(flights, most_inflation=20_000)
    assert found.inflation == pytest.approx(inflation, rel=0.2, abs=1.0)
    assert found.growth == pytest.approx(growth, rel=0.2, abs=0.003)


def test_shape_stays_within_its_bounds() -> None:
    rng = np.random.default_rng(2)
    leverages = [rng.exponential(0.01, size=500) for _ in range(3)]
    still = np.zeros(500)
    falling = [errors(rng.normal(size=500) / (1.0 + 100.0 * h), h, still) for h in leverages]
    rising = [errors(rng.normal(size=500) * h, h, still) for h in leverages]
    assert fit_shape(falling, most_inflation=1500).inflation == pytest.approx(1.0, abs=0.01)
    assert fit_shape(rising, most_inflation=50).inflation == pytest.approx(50.0, rel=0.01)
    speeds = [rng.uniform(0.0, 100.0, size=500) for _ in range(3)]
    flat = [errors(rng.normal(size=500), np.zeros(500), speed) for speed in speeds]
    assert fit_shape(flat, most_inflation=50).growth * 100.0 < 0.3


def test_standstill_throughout_gives_a_finite_shape() -> None:
    rng = np.random.default_rng(3)
    hover = [errors(rng.normal(size=500), rng.exponential(0.01, size=500), np.zeros(500)) for _ in range(2)]
    shape = fit_shape(hover, most_inflation=1000)
    assert np.isfinite(shape.inflation)
    assert np.isfinite(shape.growth)


def test_no_errors_at_all_give_the_plain_shape() -> None:
    exact = [errors(np.zeros(5), np.full(5, 0.1), np.arange(5.0))]
    assert fit_shape(exact, most_inflation=5) == SpreadShape(1.0, 0.0)


def test_squared_airspeed_is_that_of_the_input_vector() -> None:
    inputs = np.arange(38.0).reshape(2, 19)
    np.testing.assert_allclose(squared_speed(inputs), [0 + 1 + 4, 19**2 + 20**2 + 21**2])


def test_variance_grows_with_airspeed_by_a_millionth_to_a_hundred_times() -> None:
    """On average over the flights; flights that hardly move leave it where it doubles at 0.1 m/s."""
    rng = np.random.default_rng(4)
    noise, exact = rng.normal(size=500), np.zeros(500)
    speed_squared = np.square(rng.uniform(0.0, 9.0, size=500))
    size = speed_squared.mean()
    moving = [errors(noise * np.sqrt(speed_squared), exact, speed_squared)]
    assert fit_shape(moving, most_inflation=5).growth * size == pytest.approx(100.0, rel=0.01)
    still = [errors(noise / (0.1 + speed_squared / size), exact, speed_squared)]
    assert fit_shape(still, most_inflation=5).growth * size == pytest.approx(1e-6, rel=0.01)
    hover = 1e-8 * speed_squared
    hardly = [errors(noise * np.sqrt(hover), exact, hover)]
    assert fit_shape(hardly, most_inflation=5).growth * 0.1**2 == pytest.approx(1.0, rel=0.01)
