# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Functions of a flight, and which of them a wrench with noise of its own is a sum of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.instruments import Instruments, learned_weights
from quadpi_core.discrepancy.own_state import INDEPENDENT_HZ
from quadpi_core.discrepancy.uncertain_parts import EVEN, LINEAR, SQUARED

# Every sample is independent.
RATE_HZ = INDEPENDENT_HZ.value


def functions_of(flight, simulation):
    return Instruments.of(flight, simulation.vehicle, simulation.hover_rotor_speed)


def moving(flight, airspeed, rates):
    """The flight with a share of its airspeed and of its rates."""
    return replace(
        flight, velocity=airspeed * flight.velocity, wind=airspeed * flight.wind, rates=rates * flight.rates
    )


def part(found, name):
    return found.values[:, next(own for part, _, own in found.parts if part == name)]


# --- The functions


def test_parts_divide_the_functions(flights, simulation):
    found = functions_of(flights[0], simulation)
    ranges = [range(*own.indices(found.values.shape[1])) for *_, own in found.parts]
    assert [index for own in ranges for index in own] == list(range(found.values.shape[1]))
    assert [part[:2] for part in found.parts] == [
        ("rates", LINEAR),
        ("airspeed", LINEAR),
        (EVEN, EVEN),
        (SQUARED, SQUARED),
    ]
    assert np.all(np.isfinite(found.values))
    assert np.quantile(np.abs(found.values), 0.99) < 100.0


def test_functions_of_a_part_are_of_its_parity_and_order(flights, simulation):
    """As the airspeed is reversed and halved, with the rates."""
    whole, back = (functions_of(moving(flights[0], sign, sign), simulation) for sign in (1.0, -1.0))
    half, still = (functions_of(moving(flights[0], share, 1.0), simulation) for share in (0.5, 0.0))
    np.testing.assert_allclose(part(back, "airspeed"), -part(whole, "airspeed"))
    np.testing.assert_allclose(part(back, EVEN), part(whole, EVEN))
    np.testing.assert_allclose(part(back, SQUARED), -part(whole, SQUARED))
    np.testing.assert_allclose(part(half, "airspeed"), 0.5 * part(whole, "airspeed"))
    np.testing.assert_allclose(part(half, SQUARED)[:, :3], 0.25 * part(whole, SQUARED)[:, :3])
    for name in ("airspeed", EVEN, SQUARED):
        assert not part(still, name).any()


def test_no_function_uses_the_specific_force(flights, simulation):
    pushed = replace(flights[0], specific_force=flights[0].specific_force + 1.0)
    values = functions_of(flights[0], simulation).values
    assert np.array_equal(functions_of(pushed, simulation).values, values)


# --- The weights


def drawn(rng, flights, samples, functions):
    """Functions of the order of 1 of each flight."""
    return [rng.standard_normal((samples, functions)) for _ in range(flights)]


def test_a_sum_of_a_few_functions_is_recovered_and_hardly_any_other_is_taken():
    """Schwarz's criterion takes a function of noise alone in one of 400 cases, with so many samples."""
    rng = np.random.default_rng(0)
    functions, true = drawn(rng, 5, 2000, 30), np.zeros((30, 6))
    for axis, chosen in enumerate(([1, 7], [0], [3, 4, 29], [2, 5], [12], [9, 20])):
        true[chosen, axis] = rng.uniform(0.5, 2.0, len(chosen)) * rng.choice([-1.0, 1.0], len(chosen))
    wrenches = [own @ true + 0.5 * rng.standard_normal((2000, 6)) for own in functions]
    for weights in learned_weights(wrenches, functions, RATE_HZ):
        assert np.all(weights[true != 0.0] != 0.0)
        assert np.sum(weights[true == 0.0] != 0.0) <= 2
        np.testing.assert_allclose(weights, true, atol=0.03)


def test_noise_alone_is_explained_by_nothing():
    rng = np.random.default_rng(1)
    functions = drawn(rng, 5, 4000, 20)
    noise = [rng.standard_normal((4000, 6)) for _ in functions]
    taken = np.mean([np.any(own != 0.0, axis=0) for own in learned_weights(noise, functions, RATE_HZ)])
    assert taken <= 1.0 / 6.0


def test_samples_that_are_not_independent_are_no_more_evidence():
    """The same values, each for ten samples, are taken or not as they are once."""
    rng = np.random.default_rng(2)
    functions = drawn(rng, 5, 100, 10)
    wrenches = [0.15 * own[:, :6] + rng.standard_normal((100, 6)) for own in functions]
    once = learned_weights(wrenches, functions, RATE_HZ)
    repeated = [[np.repeat(own, 10, axis=0) for own in values] for values in (wrenches, functions)]
    often = learned_weights(*repeated, 10.0 * RATE_HZ)
    np.testing.assert_allclose(often, once, atol=1e-9)
    assert not np.array_equal(np.array(learned_weights(*repeated, RATE_HZ)) != 0.0, np.array(once) != 0.0)


def share_of_own_noise(flights, functions, seed):
    """Share of the noise of flights that is in what their weights explain, of 20 functions that are there."""
    rng = np.random.default_rng(seed)
    known = drawn(rng, flights, 40, functions)
    noise = [0.3 * rng.standard_normal((40, 6)) for _ in known]
    true = rng.choice([-1.0, 1.0], (functions, 6))
    wrenches = [own @ true + more for own, more in zip(known, noise, strict=True)]
    weights = learned_weights(wrenches, known, RATE_HZ)
    errors = [own @ (found - true) for own, found in zip(known, weights, strict=True)]
    held = sum(np.sum(error * more) for error, more in zip(errors, noise, strict=True))
    fitted = np.linalg.lstsq(np.vstack(known), np.vstack(wrenches), rcond=None)[0]
    all_together = np.sum(np.vstack(known) @ (fitted - true) * np.vstack(noise))
    squares = np.sum(np.square(noise))
    return held / squares, all_together / squares


def test_a_flight_has_no_noise_of_its_own_in_what_is_explained():
    """Weights from all flights would hold a share of functions over samples, 20 of 200."""
    own, together = np.mean([share_of_own_noise(5, 20, seed) for seed in range(6)], axis=0)
    assert together == pytest.approx(0.1, abs=0.02)
    assert own == pytest.approx(0.0, abs=0.02)


def test_few_flights_are_explained_by_all_of_them():
    """Three flights each contain other manoeuvres: the weights of all are those of each."""
    own, together = share_of_own_noise(3, 20, 0)
    assert own == pytest.approx(together, rel=0.02)
    rng = np.random.default_rng(3)
    functions = drawn(rng, 3, 100, 5)
    first, second, third = learned_weights(
        [own[:, :1] @ np.ones((1, 6)) for own in functions], functions, 1.0
    )
    assert np.array_equal(first, second)
    assert np.array_equal(first, third)


def test_an_axis_without_any_wrench_has_no_weights():
    rng = np.random.default_rng(4)
    functions = drawn(rng, 4, 100, 5)
    wrenches = [own[:, :1] * [1.0, 0.0, 0.0, 0.0, 0.0, 1.0] for own in functions]
    weights = np.array(learned_weights(wrenches, functions, RATE_HZ))
    assert not weights[:, :, 1:5].any()
    np.testing.assert_allclose(weights[:, 0, [0, 5]], 1.0, rtol=1e-3)
    nothing = learned_weights([np.zeros((100, 6)) for _ in functions], functions, RATE_HZ)
    assert not np.any(nothing)


def test_a_wrench_without_noise_is_explained_whole():
    """What is left of it is zero, whose logarithm no criterion asks for."""
    functions = [np.eye(8)[:, :2], np.eye(8)[:, :2]]
    with np.errstate(all="raise"):
        weights = learned_weights([own @ np.full((2, 6), 2.0) for own in functions], functions, RATE_HZ)
    np.testing.assert_allclose(weights, 2.0, rtol=1e-3)


def test_a_function_that_one_flight_lacks_is_known_from_the_others():
    """And one that no other flight has is not known of that flight."""
    rng = np.random.default_rng(5)
    functions = drawn(rng, 4, 200, 4)
    functions[0][:, 1] = 0.0
    for own in functions[1:]:
        own[:, 2] = 0.0
    wrenches = [own[:, 1:3].sum(axis=1)[:, None] * np.ones(6) for own in functions]
    weights = np.array(learned_weights(wrenches, functions, RATE_HZ))
    assert np.all(np.isfinite(weights))
    np.testing.assert_allclose(weights[:, 1], 1.0, rtol=1e-3)
    assert not weights[0, 2].any()
    np.testing.assert_allclose(weights[1:, 2], 1.0, rtol=1e-3)
