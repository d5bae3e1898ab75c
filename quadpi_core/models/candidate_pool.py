# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Candidate pools: which regressors a stepwise selection may choose from, per axis.

A pool file under config/candidates is YAML; under each axis, `fixed` lists regressors that are always in
the model (the bias is too) and `candidates` lists families in the paper's notation, for example
``P^3(u, |v|, w)·{1, omega_avg}``: every monomial of degree 1 to 3 in the three variables, times each factor.
`inputs` lists the regressors that neural networks take instead, for example ``|v|``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from quadpi_core.config_schema import OneOf, ReadBy, Section, load_config
from quadpi_core.errors import ModelError, named_in
from quadpi_core.flight import AXES
from quadpi_core.models.regressors import (
    CONSTANT,
    DEGREE_MAX,
    Regressor,
    monomial_degree,
    monomial_product,
    parse_monomial,
)
from quadpi_core.records import brief_repr

# The largest family that comes with quadpi has a few hundred; of more than samples none can be identified.
_FAMILY_MAX = 20_000
_FAMILY = re.compile(
    r"P\^(?P<degree>[1-9]\d?)\((?P<variables>[^()]+)\)\s*(?:[·*]\s*\{(?P<factors>[^{}]+)\})?"
)


@dataclass(frozen=True)
class CandidatePool:
    """The fixed regressors (bias first) and the candidates of one axis, each once, in file order.

    A candidate that is also fixed stays listed, as the paper counts it; the selection never adds it.

    Attributes:
        inputs: of neural networks; empty where the pool is for polynomials alone.
    """

    __repr__ = brief_repr

    fixed: tuple[Regressor, ...]
    candidates: tuple[Regressor, ...]
    inputs: tuple[Regressor, ...] = ()

    @classmethod
    def parse(cls, fixed: list[str], families: list[str], inputs: Sequence[str] = ()) -> CandidatePool:
        """Read a pool from its notation.

        Raises:
            ModelError: naming the entry with unknown inputs or broken syntax.
        """
        bias = Regressor(((1.0, CONSTANT),))
        candidates = [regressor for family in families for regressor in expand_family(family)]
        lists = ([bias, *map(Regressor.parse, fixed)], candidates, map(Regressor.parse, inputs))
        return cls(*(tuple(dict.fromkeys(regressors)) for regressors in lists))


def expand_family(text: str) -> list[Regressor]:
    """All regressors of one family such as ``P^3(u, |v|, w)·{1, omega_avg}``.

    P^d holds the monomials of total degree 1 to d: models identified in the paper contain lower degrees
    than d, although its text names degree d only.

    Raises:
        ModelError: naming the text, for broken syntax or an unknown input.
    """
    match = _FAMILY.fullmatch(text.strip())
    if match is None:
        raise ModelError(f"candidates {text!r}: expected the form P^3(u, |v|, w)·{{1, omega_avg}}")
    with named_in(f"candidates {text!r}"):
        variables = [parse_monomial(v) for v in match["variables"].split(",")]
        factors = [parse_monomial(f) for f in (match["factors"] or "1").split(",")]
    degree = int(match["degree"])
    count = len(factors) * (math.comb(len(variables) + degree, degree) - 1)
    highest = degree * max(map(monomial_degree, variables)) + max(map(monomial_degree, factors))
    if highest > DEGREE_MAX:
        raise ModelError(f"candidates {text!r}: the degree of a regressor is {highest}, beyond {DEGREE_MAX}")
    if count > _FAMILY_MAX:
        raise ModelError(f"candidates {text!r}: {count} regressors; a family may have {_FAMILY_MAX}")
    return [
        Regressor(((1.0, monomial_product(factor, *chosen)),))
        for factor in factors
        for order in range(1, degree + 1)
        for chosen in combinations_with_replacement(variables, order)
    ]


def load_pools(name_or_path: str | Path) -> dict[str, CandidatePool]:
    """Read the pools of all axes by the name of a file in config/candidates, or by path.

    Raises:
        ModelError: naming the file, the axis and the entry that cannot be read.
    """
    path, content = load_config("candidate", name_or_path, dict[Axis, _AxisLists], ModelError)
    if not content:
        raise ModelError(f"{path}: expected axes, each with `fixed`, `candidates` and `inputs`")
    pools = {}
    for axis, lists in content.items():
        with named_in(f"{path}: {axis}"):
            pools[axis] = CandidatePool.parse(lists.fixed, lists.candidates, lists.inputs)
    return pools


def _texts(data: Any) -> list[str]:
    if not isinstance(data, list):
        raise ValueError(f"must be a list, found {data!r}")
    return [str(text) for text in data]


Texts: TypeAlias = Annotated[list[str], ReadBy(_texts)]


@dataclass(frozen=True, kw_only=True)
class _AxisLists(Section):
    """The keys of an axis in a pool file."""

    fixed: Texts = field(default_factory=list)
    candidates: Texts = field(default_factory=list)
    inputs: Texts = field(default_factory=list)


Axis: TypeAlias = Annotated[str, OneOf(*AXES)]


def select_axes(pools: dict[str, CandidatePool], names: str | None) -> dict[str, CandidatePool]:
    """The pools of the axes in a text such as ``Fx,Fz,My``; all of them for None.

    Raises:
        ModelError: for an axis without a pool.
    """
    if names is None:
        return pools
    wanted = [name.strip() for name in names.split(",")]
    for name in wanted:
        if name not in pools:
            raise ModelError(f"no candidates for axis {name!r}; there are pools for {', '.join(pools)}")
    return {name: pools[name] for name in wanted}
