# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.regressors import CandidatePool, Regressor, RegressorProgram, load_pools
from quadpi_core.paths import config_directory

POOL_FILES = sorted(path.stem for path in (config_directory() / "candidates").glob("*.yaml"))


def every_regressor(pools: dict[str, CandidatePool]) -> list[Regressor]:
    return [regressor for pool in pools.values() for regressor in (*pool.fixed, *pool.candidates)]


def evaluated_as_text(text: str, inputs: Array) -> Array:
    """The value of a regressor's text, read by Python's own parser rather than ours."""
    expression = text.replace("^", "**")
    while "|" in expression:
        expression = expression.replace("|", "abs(", 1).replace("|", ")", 1)
    names = dict(zip(INPUT_NAMES, inputs.T, strict=True)) | {"bias": np.ones(len(inputs)), "abs": np.abs}
    value: Array = eval(expression, {"__builtins__": {}}, names)
    return value


@pytest.mark.parametrize("name", POOL_FILES)
def test_text_of_every_candidate_reads_back(name: str) -> None:
    for regressor in every_regressor(load_pools(name)):
        assert Regressor.parse(str(regressor)) == regressor


@pytest.mark.parametrize("name", POOL_FILES)
def test_program_evaluates_what_the_text_says(name: str) -> None:
    regressors = every_regressor(load_pools(name))
    inputs = np.random.default_rng(1).normal(size=(7, len(INPUT_NAMES)))
    values = RegressorProgram.compile(regressors).evaluate(inputs)
    expected = np.stack([evaluated_as_text(str(regressor), inputs) for regressor in regressors], axis=1)
    np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("|v|^2", "v^2"),
        ("|u|*|u|", "u^2"),
        ("|u|^3", "|u|*u^2"),
        ("|u|^4", "u^4"),
        ("u*|u|", "|u|*u"),
        ("w*u", "u*w"),
        ("w*|v|*w*u", "u*|v|*w^2"),
        ("u·w", "u*w"),
        ("1*u", "u"),
        ("u^0*w", "w"),
        ("u^0", "bias"),
        ("1", "bias"),
        (" mu_z  -  mu_v_in ", "mu_z - mu_v_in"),
    ],
)
def test_equal_monomials_compare_equal(text: str, same: str) -> None:
    assert Regressor.parse(text) == Regressor.parse(same)


@pytest.mark.parametrize(("text", "other"), [("|u|", "u"), ("u*|u|", "u^2"), ("|u|^3", "u^3"), ("-u", "u")])
def test_different_monomials_compare_different(text: str, other: str) -> None:
    assert Regressor.parse(text) != Regressor.parse(other)


@pytest.mark.parametrize(
    "text",
    [
        "mu_x^2 + mu_y^2",
        "mu_z - mu_v_in",
        "-u",
        "-u - v*|w|",
        "u - bias",
        "u^2*w + |q|*q - sin_phi*cos_theta^3",
    ],
)
def test_sums(text: str) -> None:
    inputs = np.random.default_rng(2).normal(size=(11, len(INPUT_NAMES)))
    regressor = Regressor.parse(text)
    assert str(regressor).replace(" ", "") == text.replace(" ", "")
    values = RegressorProgram.compile([regressor]).evaluate(inputs)[:, 0]
    np.testing.assert_allclose(values, evaluated_as_text(text, inputs), rtol=1e-14)


def test_shared_products_are_computed_once() -> None:
    pool = load_pools("hdbeetle")["Fx"]
    program = RegressorProgram.compile(pool.candidates)
    assert len(program.operations) < 1.1 * len(pool.candidates)


@pytest.mark.parametrize(
    "text",
    [
        "",
        " ",
        "-",
        "x",
        "u^",
        "u^-1",
        "u^1.5",
        "2*u",
        "u**2",
        "u*",
        "*u",
        "|u",
        "u|",
        "|u^2|",
        "u v",
        "u + ",
        "u ++ v",
    ],
)
def test_broken_text_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ModelError) as caught:
        Regressor.parse(text)
    assert "\n" not in str(caught.value)
    assert text.strip()[:1] in str(caught.value)


@pytest.mark.parametrize("shape", [(5, 18), (5, 20), (19,), (2, 5, 19)])
def test_inputs_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    program = RegressorProgram.compile([Regressor.parse("u*w")])
    with pytest.raises(ModelError, match="shape"):
        program.evaluate(np.zeros(shape))


@pytest.mark.parametrize(
    "text", ["u^101", "|u|^999999999", "u^60*v^60", "*".join(["w"] * 101), f"u^{'9' * 5000}"]
)
def test_a_degree_without_bound_is_refused(text):
    assert Regressor.parse("u^100").parts
    with pytest.raises(ModelError, match="its degree is beyond 100"):
        Regressor.parse(text)


@pytest.mark.parametrize(
    ("family", "message"),
    [
        ("P^99(u, v, w, p, q, r)", r"\d+ regressors; a family may have 20000|beyond"),
        ("P^20(u, v, w, p, q, r)", r"\d+ regressors; a family may have 20000"),
        ("P^50(u^3)", "the degree of a regressor is 150, beyond 100"),
    ],
)
def test_a_family_without_bound_is_refused(family, message):
    with pytest.raises(ModelError, match=message):
        CandidatePool.parse([], [family])
