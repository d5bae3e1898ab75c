# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from math import comb
from pathlib import Path

import pytest

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.models.regressors import CandidatePool, Regressor, expand_family, load_pools


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
