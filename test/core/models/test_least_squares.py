# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from scipy.linalg import solve_triangular

from benchmarks.stepwise import direct_stepwise, squared_error
from benchmarks.synthetic_inputs import planted_target, smooth_inputs
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.least_squares import (
    Gram,
    SelectionSettings,
    StopRule,
    fit_coefficients,
    flight_grams,
    huber,
    identifiable,
    select,
)
from quadpi_core.models.regressors import RegressorProgram, load_pools


@pytest.mark.parametrize("count", [7, 384, 2 * 2048 + 1])
def test_one_pass_equals_the_products_of_the_whole_matrix(count: int) -> None:
    pool = load_pools("hdbeetle")["Fx"]
    program = RegressorProgram.compile((*pool.fixed, *pool.candidates))
    inputs = smooth_inputs(count, seed=1)
    rng = np.random.default_rng(2)
    target = rng.normal(size=count)
    groups = rng.integers(0, 3, size=count)
    groups[:3] = 0, 1, 2
    grams = flight_grams(program, inputs, target, groups)
    assert len(grams) == 3
    Z = program.evaluate(inputs)
    for group, gram in enumerate(grams):
        own, own_target = Z[groups == group], target[groups == group]
        scale = np.sqrt(np.diag(own.T @ own))
        np.testing.assert_allclose(gram.matrix / np.outer(scale, scale), own.T @ own / np.outer(scale, scale))
        np.testing.assert_allclose(gram.moment / scale, own.T @ own_target / scale, rtol=1e-9, atol=1e-12)
        assert gram.square == pytest.approx(own_target @ own_target)
        assert gram.count == len(own_target)


def test_sums_differences_and_errors_of_foreign_coefficients() -> None:
    pool = load_pools("bebop2_simulation")["Mx"]
    program = RegressorProgram.compile(pool.candidates)
    inputs = smooth_inputs(600, seed=3, vehicle_name="bebop2")
    rng = np.random.default_rng(4)
    target = 3.0 + rng.normal(size=600)
    groups = np.arange(600) // 200
    first, second, third = flight_grams(program, inputs, target, groups)
    (whole,) = flight_grams(program, inputs, target, np.zeros(600, dtype=np.int64))
    scale = np.sqrt(np.outer(np.diag(whole.matrix), np.diag(whole.matrix)))
    np.testing.assert_allclose((first + second + third).matrix / scale, whole.matrix / scale, atol=1e-14)
    np.testing.assert_allclose((whole - third).matrix / scale, (first + second).matrix / scale, atol=1e-14)
    assert (whole - third).count == 400

    active = [0, 5, 2]
    coefficients = rng.normal(size=3)
    residual = target - program.evaluate(inputs)[:, active] @ coefficients
    assert whole.residual_square(active, coefficients) == pytest.approx(residual @ residual)


TRUE = np.array([2.0, -1.0, 0.5])
NOISE = 0.1


@pytest.fixture
def samples():
    rng = np.random.default_rng(0)
    Z = np.column_stack((np.ones(20_000), rng.normal(size=(20_000, 2))))
    return Z, Z @ TRUE + rng.normal(0.0, NOISE, len(Z))


def least_squares(Z, y):
    return fit_coefficients(Gram(Z.T @ Z, Z.T @ y, float(y @ y), len(y)), [0, 1, 2])


def test_without_wild_samples_it_is_least_squares_bit_for_bit(samples):
    Z, y = samples
    plain = least_squares(Z, y)
    for robust, least in zip(huber(Z, y, *plain), plain, strict=True):
        np.testing.assert_array_equal(robust, least)


@pytest.mark.parametrize("size", [1e2, 1e4])
def test_wild_samples_pull_no_more_than_the_bound(samples, size):
    """200 of 20 000 samples, all wild in one direction where the regressors are large."""
    Z, y = samples
    wild = np.argsort(Z[:, 1])[-200:]
    spoilt = y.copy()
    spoilt[wild] += size
    robust, _ = huber(Z, spoilt, *least_squares(Z, spoilt))
    plain, _ = least_squares(Z, spoilt)
    pull = np.linalg.norm(Z[wild], axis=1).sum() * 6.0 * NOISE / len(y)
    assert np.abs(robust - TRUE).max() < 1.5 * pull
    assert np.abs(plain - TRUE).max() > 10.0 * pull


def test_terms_that_only_wild_samples_tell_apart_are_refused(samples):
    Z, y = samples
    alike, spoilt = Z[:, [0, 1, 1]].copy(), y.copy()
    alike[:2, 2] += 1e-3
    spoilt[:2] += (1e12, -1e12)
    with pytest.raises(ModelError, match=r"differ in wild samples alone, with residuals up to 1e\+12"):
        huber(alike, spoilt, np.zeros(3), np.eye(3))


def test_the_bound_is_six_deviations_by_the_median():
    """Of a mean of ±1, and of one wild sample, which pulls as if it were 6 · 1.4826 away."""
    y = np.append(np.tile([-1.0, 1.0], 500), 1e6)
    Z = np.ones((len(y), 1))
    plain = fit_coefficients(Gram(Z.T @ Z, Z.T @ y, float(y @ y), len(y)), [0])
    robust, _ = huber(Z, y, *plain)
    assert robust[0] == pytest.approx(6.0 * 1.4826 / 1000.0, rel=0.02)


def test_a_fit_without_a_solution_says_what_cannot_be_identified():
    refusal = r"^Fx cannot be identified .*\(Singular matrix\): `quadpi info`"
    with pytest.raises(ModelError, match=refusal), identifiable("Fx"):
        np.linalg.inv(np.zeros((2, 2)))


def gram_of(Z: Array, y: Array) -> Gram:
    return Gram(Z.T @ Z, Z.T @ y, float(y @ y), len(y))


def select_from(
    Z: Array, y: Array, settings: SelectionSettings, flights: int = 1, n_fixed: int = 1
) -> list[int]:
    """Columns that `select` chooses, the samples cut into `flights` contiguous parts."""
    grams = [
        gram_of(*part) for part in zip(np.array_split(Z, flights), np.array_split(y, flights), strict=True)
    ]
    return select(grams, n_fixed, settings, [f"z{k}" for k in range(Z.shape[1])])[0]


def with_bias(columns: Array) -> Array:
    return np.column_stack((np.ones(len(columns)), columns))


@pytest.mark.parametrize("seed", [1, 2])
def test_same_terms_as_direct_least_squares(seed: int) -> None:
    pool = load_pools("hdbeetle")["Fx"]
    regressors = list(dict.fromkeys(pool.fixed + pool.candidates))
    Z = RegressorProgram.compile(regressors).evaluate(smooth_inputs(5000, seed))
    y = planted_target(Z, len(pool.fixed), terms=6, seed=seed)
    expected = direct_stepwise(Z, y, n_fixed=len(pool.fixed), max_terms=8)
    assert len(expected) > len(pool.fixed) + 3
    chosen = select_from(Z, y, SelectionSettings(stop="pse", max_terms=8), n_fixed=len(pool.fixed))
    assert chosen == expected


def overtaken_term() -> tuple[Array, Array]:
    """Column 1 correlates best with y, until columns 2 and 3 are in and leave it nothing to explain."""
    rng = np.random.default_rng(11)
    a, b, c = rng.normal(size=(3, 2000))
    proxy = a + b + 0.4 * c
    y = a + b + 0.01 * rng.normal(size=2000)
    return with_bias(np.column_stack((proxy, a, b))), y


def test_backward_elimination_takes_an_overtaken_term_out() -> None:
    Z, y = overtaken_term()
    settings = SelectionSettings(stop="pse")
    active, steps = select([gram_of(Z, y)], 1, settings, ["bias", "proxy", "a", "b"])
    assert [step.added for step in steps] == [None, 1, 3, 2]
    assert [step.removed for step in steps] == [(), (), (), (1,)]
    assert active == [0, 3, 2] == direct_stepwise(Z, y, n_fixed=1, max_terms=10)


def test_error_and_r2_after_an_elimination_are_those_of_a_refit() -> None:
    Z, y = overtaken_term()
    _, steps = select([gram_of(Z, y)], 1, SelectionSettings(stop="pse"), ["bias", "proxy", "a", "b"])
    for step in steps:
        sse = squared_error(Z[:, list(step.active)], y)
        assert step.sse == pytest.approx(sse, rel=1e-7)
        assert step.r2 == pytest.approx(1.0 - sse / (len(y) * np.var(y)), abs=1e-10)


def test_selection_stops_at_the_most_terms_allowed() -> None:
    rng = np.random.default_rng(12)
    Z = with_bias(rng.normal(size=(500, 12)))
    y = Z @ np.ones(13) + 0.01 * rng.normal(size=500)
    assert len(select_from(Z, y, SelectionSettings(stop="pse", max_terms=4))) == 5


def test_f_to_enter_keeps_noise_out() -> None:
    rng = np.random.default_rng(13)
    Z, y = with_bias(rng.normal(size=(500, 20))), rng.normal(size=500)
    assert select_from(Z, y, SelectionSettings(stop="pse", f_enter=1e4)) == [0]


@pytest.mark.parametrize("noise", [0.0, 1e-7])
def test_collinear_candidate_is_never_admitted(noise: float) -> None:
    """A duplicate, a combination of chosen columns and a constant: nothing new in any of them."""
    rng = np.random.default_rng(14)
    a, b, c = rng.normal(size=(3, 1000))
    combination = 2.0 * a - 3.0 * b + 1.0 + noise * rng.normal(size=1000)
    Z = with_bias(np.column_stack((a, b, 5.0 * a, combination, np.full(1000, 7.0), np.zeros(1000), c)))
    y = a + 2.0 * b + 0.1 * c + 1e-6 * combination + 0.001 * rng.normal(size=1000)
    chosen = select_from(Z, y, SelectionSettings(stop="r2", f_enter=0.0, f_remove=0.0))
    assert np.linalg.matrix_rank(Z[:, chosen], tol=1e-3) == len(chosen)
    assert not {5, 6} & set(chosen)


@pytest.mark.parametrize("stop", get_args(StopRule))
@pytest.mark.parametrize("seed", [1, 2])
def test_every_rule_finds_a_planted_sparse_truth(stop: StopRule, seed: int) -> None:
    rng = np.random.default_rng(seed)
    Z = with_bias(rng.normal(size=(4000, 60)))
    planted = [3, 17, 29, 44]
    y = 2.0 + Z[:, planted] @ np.array([1.0, -0.8, 0.6, 0.4]) + 0.5 * rng.normal(size=4000)
    chosen = select_from(Z, y, SelectionSettings(stop=stop), flights=5)
    assert chosen == [0, *planted]


def test_held_out_score_is_that_of_explicit_refits() -> None:
    rng = np.random.default_rng(15)
    Z = with_bias(rng.normal(size=(600, 6)))
    y = Z[:, [1, 4]] @ np.array([1.0, 0.5]) + 0.3 * rng.normal(size=600)
    parts = [slice(0, 100), slice(100, 350), slice(350, 600)]
    grams = [gram_of(Z[part], y[part]) for part in parts]
    _, steps = select(grams, 1, SelectionSettings(stop="leave-one-flight-out"), list("0123456"))
    assert len(steps) > 2
    for step in steps:
        errors = []
        for part in parts:
            rest = np.ones(600, dtype=bool)
            rest[part] = False
            columns = list(step.active)
            coefficients = np.linalg.lstsq(Z[rest][:, columns], y[rest], rcond=None)[0]
            errors.append(np.mean((y[part] - Z[part][:, columns] @ coefficients) ** 2))
        floored = np.array(errors) + 0.01 * np.var(y)
        assert step.score == pytest.approx(np.mean(np.log(floored)), abs=1e-9)


def test_leave_one_flight_out_refuses_a_term_that_only_one_flight_supports() -> None:
    rng = np.random.default_rng(16)
    flights = [rng.normal(size=(500, 3)) for _ in range(4)]
    targets = [f[:, 0] + 0.5 * rng.normal(size=500) for f in flights]
    targets[2] = targets[2] + 3.0 * flights[2][:, 1]  # a fault of the third flight alone
    Z, y = with_bias(np.concatenate(flights)), np.concatenate(targets)
    assert select_from(Z, y, SelectionSettings(stop="pse"), flights=4)[:3] == [0, 1, 2]
    assert 2 not in select_from(Z, y, SelectionSettings(stop="leave-one-flight-out"), flights=4)


def test_a_term_that_one_flight_alone_excites_is_left_out() -> None:
    """The others cannot fit it: its regressor is zero on all of their samples."""
    rng = np.random.default_rng(19)
    flights = [rng.normal(size=(500, 2)) for _ in range(2)]
    flights[1][:, 1] = 0.0
    Z = with_bias(np.concatenate(flights))
    y = Z @ np.array([0.0, 1.0, 2.0]) + 0.1 * rng.normal(size=1000)
    assert 2 not in select_from(Z, y, SelectionSettings(stop="leave-one-flight-out"), flights=2)


def test_flights_that_do_not_excite_the_target_do_not_stop_selection() -> None:
    """There a true term brings nothing but the noise of its input."""
    rng = np.random.default_rng(18)
    truths = [size * rng.normal(size=(500, 2)) for size in (1.0, 1.0, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3)]
    targets = [f @ np.array([1.0, 0.7]) + 1e-3 * rng.normal(size=500) for f in truths]
    noisy = [f + np.array([1e-3, 2e-2]) * rng.normal(size=(500, 2)) for f in truths]
    Z, y = with_bias(np.concatenate(noisy)), np.concatenate(targets)
    settings = SelectionSettings(stop="leave-one-flight-out")
    assert select_from(Z, y, settings, flights=8, n_fixed=2) == [0, 1, 2]


def test_predicted_square_error_and_bic_as_written() -> None:
    rng = np.random.default_rng(17)
    Z = with_bias(rng.normal(size=(300, 5)))
    y = Z[:, 2] + rng.normal(size=300)
    count, names = 300, list("012345")
    _, steps = select([gram_of(Z, y)], 1, SelectionSettings(stop="pse"), names)
    for step in steps:
        expected = step.sse / count + np.var(y) * len(step.active) / count
        assert step.score == pytest.approx(expected, rel=1e-12)
    _, steps = select([gram_of(Z, y)], 1, SelectionSettings(stop="bic"), names)
    for step in steps:
        expected = count * np.log(step.sse / count) + len(step.active) * np.log(count)
        assert step.score == pytest.approx(expected, rel=1e-12)


def test_exact_target_ends_the_selection() -> None:
    rng = np.random.default_rng(18)
    Z = with_bias(rng.normal(size=(200, 30)))
    y = 1.0 + 2.0 * Z[:, 7] - Z[:, 11]
    for stop in get_args(StopRule):
        chosen = select_from(Z, y, SelectionSettings(stop=stop), flights=4)
        assert set(chosen[:3]) == {0, 7, 11}


def test_coefficients_and_whitening_are_those_of_qr() -> None:
    rng = np.random.default_rng(19)
    # Columns of very different scale, as 1, rad/s and (rad/s)^3 are.
    Z = with_bias(rng.normal(size=(400, 3)) * [1e-3, 1.0, 1e8])
    y = rng.normal(size=400)
    coefficients, whitening = fit_coefficients(gram_of(Z, y), [0, 1, 2, 3])
    Q, R = np.linalg.qr(Z)
    np.testing.assert_allclose(coefficients, solve_triangular(R, Q.T @ y), rtol=1e-10)
    hat_diagonal = np.square(Q).sum(axis=1)
    np.testing.assert_allclose(np.square(Z @ whitening.T).sum(axis=1), hat_diagonal, rtol=1e-10)
    assert np.all(np.triu(whitening, 1) == 0.0)


@pytest.mark.parametrize("broken", ["zero", "duplicate", "constant"])
def test_fixed_regressor_without_excitation_is_named(broken: str) -> None:
    rng = np.random.default_rng(20)
    a = rng.normal(size=300)
    column = {"zero": np.zeros(300), "duplicate": -2.0 * a, "constant": np.full(300, 3.0)}[broken]
    Z = with_bias(np.column_stack((a, column, rng.normal(size=300))))
    with pytest.raises(ModelError, match=r"`sin_theta`") as caught:
        select([gram_of(Z, a)], 3, SelectionSettings(stop="pse"), ["bias", "u", "sin_theta", "w"])
    assert "\n" not in str(caught.value)


def chosen_of_two(first: float, second: float, rest: float, stop: StopRule) -> int:
    """Number of terms chosen of two that add so much to the mean square of y, in two flights alike."""
    rng = np.random.default_rng(0)
    columns = np.linalg.qr(np.column_stack((np.ones(1000), rng.normal(size=(1000, 3)))))[0] * np.sqrt(1000)
    y = columns[:, 1:] @ np.sqrt([first, second, rest])
    flights = 2 if stop == "leave-one-flight-out" else 1
    Z = with_bias(np.tile(columns[:, 1:3], (flights, 1)))
    return len(select_from(Z, np.tile(y, flights), SelectionSettings(stop=stop), flights)) - 1


@pytest.mark.parametrize(("growth", "chosen"), [(0.0045, 1), (0.0055, 2)])
def test_a_term_must_raise_r2_by_half_a_percent(growth: float, chosen: int) -> None:
    assert chosen_of_two(0.9 - growth, growth, 0.1, "r2") == chosen


@pytest.mark.parametrize(("fall", "chosen"), [(0.009, 1), (0.011, 2)])
def test_a_term_must_lower_the_held_out_error_by_a_hundredth(fall: float, chosen: int) -> None:
    # With an error of 0.04 and a floor of 0.01 beside it.
    second = 0.05 * np.expm1(fall)
    assert chosen_of_two(0.96 - second, second, 0.04, "leave-one-flight-out") == chosen


@pytest.mark.parametrize(("second", "chosen"), [(0.9e-4, 1), (1.1e-4, 2)])
def test_held_out_errors_below_a_hundredth_of_the_variance_are_equal(second: float, chosen: int) -> None:
    assert chosen_of_two(1.0 - second, second, 1e-9, "leave-one-flight-out") == chosen
