# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from math import comb
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.regressors import (
    CandidatePool,
    Regressor,
    RegressorProgram,
    expand_family,
    load_pools,
)
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


@pytest.mark.parametrize(("axis", "count"), [("Fx", 324), ("Fz", 590), ("My", 688)])
def test_pools_of_the_real_vehicle_have_the_papers_size(axis: str, count: int) -> None:
    assert len(load_pools("hdbeetle")[axis].candidates) == count


@pytest.mark.parametrize("name", ["bebop2_simulation", "quadrotor"])
def test_pools_hold_all_six_axes(name: str) -> None:
    assert set(load_pools(name)) == set(AXES)


@pytest.mark.parametrize("axis", ["Fx", "Fz", "My"])
def test_default_pools_are_the_papers_where_it_gives_them(axis: str) -> None:
    assert load_pools("quadrotor")[axis] == load_pools("hdbeetle")[axis]


@pytest.mark.parametrize(
    ("name", "axis", "count"),
    [("bebop2_simulation", axis, count) for axis, count in zip(AXES, (3, 3, 12, 5, 5, 10), strict=True)]
    + [("hdbeetle", "Fx", 14), ("hdbeetle", "Fz", 17), ("hdbeetle", "My", 15)],
)
def test_inputs_of_networks_are_as_many_as_in_the_papers_tables(name: str, axis: str, count: int) -> None:
    inputs = load_pools(name)[axis].inputs
    assert len(set(inputs)) == len(inputs) == count


def test_inputs_are_read_as_regressors() -> None:
    pool = CandidatePool.parse(["u"], ["P^1(v)"], ["u", "|v|", "u"])
    assert [str(regressor) for regressor in pool.inputs] == ["u", "|v|"]
    assert CandidatePool.parse(["u"], ["P^1(v)"]).inputs == ()


@pytest.mark.parametrize(("mirrored", "original"), [("Fy", "Fx"), ("Mx", "My")])
def test_lateral_pools_mirror_the_longitudinal_ones(mirrored: str, original: str) -> None:
    pools = load_pools("quadrotor")
    assert len(pools[mirrored].candidates) == len(pools[original].candidates)
    assert len(pools[mirrored].inputs) == len(pools[original].inputs)


@pytest.mark.parametrize("name", ["bebop2_simulation", "hdbeetle", "quadrotor"])
def test_every_candidate_is_listed_once_and_bias_is_fixed(name: str) -> None:
    for pool in load_pools(name).values():
        assert len(set(pool.candidates)) == len(pool.candidates)
        assert len(set(pool.fixed)) == len(pool.fixed)
        assert str(pool.fixed[0]) == "bias"


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("variables", ["u", "u, v", "u, v, w", "u, v, w, q"])
def test_family_holds_every_monomial_up_to_its_degree(variables: str, degree: int) -> None:
    family = expand_family(f"P^{degree}({variables})")
    count = len(variables.split(","))
    assert len(family) == comb(count + degree, degree) - 1
    assert len(set(family)) == len(family)


def test_family_times_factors() -> None:
    family = expand_family("P^2(u, |v|)·{1, omega_avg}")
    expected = ["u", "|v|", "u^2", "u*|v|", "v^2"]
    expected += [f"{text}*omega_avg" for text in expected]
    assert family == [Regressor.parse(text) for text in expected]


def test_duplicates_across_families_count_once() -> None:
    # u*q appears in the first family as u·{q} and in the second; |u|^2 is u^2.
    pool = CandidatePool.parse([], ["P^1(u)·{1, q}", "P^2(u, q)", "P^2(|u|)·{1}"])
    assert [str(regressor) for regressor in pool.candidates] == ["u", "u*q", "q", "u^2", "q^2", "|u|"]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("Fx:\n  fixed: [u]\n  candidates: ['P^3(u, x)']\n", ["Fx", "'P^3(u, x)'", "'x'"]),
        ("Fx:\n  fixed: [u, sin_psi]\n  candidates: []\n", ["Fx", "'sin_psi'"]),
        ("Fx:\n  candidates: ['P^3(u, v']\n", ["Fx", "'P^3(u, v'"]),
        ("Fx:\n  candidates: ['P^0(u)']\n", ["Fx", "'P^0(u)'"]),
        ("Fx:\n  candidates: ['P^2(u)·{1, zeta}']\n", ["Fx", "'zeta'"]),
        ("Fx:\n  candidates: P^2(u)\n", ["Fx", "candidates", "list"]),
        ("Fx:\n  candidate: [P^2(u)]\n", ["Fx", "candidates"]),
        ("Fx:\n  inputs: [u, x]\n", ["Fx", "'x'"]),
        ("Fx:\n  inputs: u, v\n", ["Fx", "inputs", "list"]),
        ("Fw:\n  candidates: [P^2(u)]\n", ["unknown key `Fw`", "Fx, Fy, Fz"]),
        ("Fx: [P^2(u)]\n", ["Fx", "expected keys and values"]),
        ("- Fx\n", ["expected keys and values"]),
        ("", ["expected keys and values"]),
        ("Fx: {fixed: [u\n", ["YAML"]),
    ],
)
def test_broken_file_is_refused_in_one_line(tmp_path: Path, content: str, words: list[str]) -> None:
    path = tmp_path / "pool.yaml"
    path.write_text(content)
    with pytest.raises(ModelError) as caught:
        load_pools(path)
    message = str(caught.value)
    assert "\n" not in message
    for word in [str(path), *words]:
        assert word in message


def test_unknown_pool_names_the_known_ones() -> None:
    with pytest.raises(ModelError, match=r"no such candidate file; known candidates: .*hdbeetle"):
        load_pools("hdbeatle")
