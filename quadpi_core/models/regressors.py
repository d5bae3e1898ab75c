# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Polynomial regressors as text, as values and as a compiled program.

A regressor is a sum of monomials in the inputs X and their absolute values, written as in
``omega_avg*mu_z^2``, ``|u|*w^2`` or ``mu_x^2 + mu_y^2``. A :class:`RegressorProgram` evaluates many of them
with one multiplication each, since all but the shortest extend another by one factor.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import OneOf, ReadBy, Section, load_config
from quadpi_core.core import compiled
from quadpi_core.errors import ModelError, named_in
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.records import Records, brief_repr

# Powers by input, in the order of INPUT_NAMES: (input, power of it, power 0 or 1 of its absolute value).
Monomial: TypeAlias = tuple[tuple[str, int, int], ...]

CONSTANT: Monomial = ()
BASE_ROWS = compiled.BASE_ROWS
# Samples evaluated at a time, so that the rows in between stay in the cache.
_BLOCK = 1024
# Far above any useful degree; refuses powers that overflow.
DEGREE_MAX = 100
_FACTOR = re.compile(
    r"\|(?P<absolute>\w+)\|(?:\^(?P<absolute_power>\d+))?|(?P<plain>\w+)(?:\^(?P<power>\d+))?"
)
_SIGNED_MONOMIAL = re.compile(r"([+-]?)([^+-]+)")
_SUM = re.compile(r"[+-]?[^+-]+([+-][^+-]+)*")


@dataclass(frozen=True)
class Regressor:
    """A sum of monomials: `parts` holds (coefficient, monomial)."""

    parts: tuple[tuple[float, Monomial], ...]

    @classmethod
    def parse(cls, text: str) -> Regressor:
        """Read a regressor from text; `bias` is the constant 1.

        Raises:
            ModelError: naming the text, for an unknown input or broken syntax.
        """
        text = text.strip()
        if not _SUM.fullmatch(text):
            raise ModelError(f"regressor {text!r}: expected a sum of products such as mu_x^2 + mu_y^2")
        signed = _SIGNED_MONOMIAL.findall(text)
        return cls(tuple((-1.0 if sign == "-" else 1.0, parse_monomial(part)) for sign, part in signed))

    def __str__(self) -> str:
        texts = [("-" if c < 0 else "+") + " " + format_monomial(m) for c, m in self.parts]
        return " ".join(texts).removeprefix("+ ")


def monomial_product(*factors: Monomial) -> Monomial:
    """The product in canonical form, in which |x|² is x², so that equal monomials compare equal."""
    plain: dict[str, int] = {}
    absolute: dict[str, int] = {}
    for factor in factors:
        for name, power, absolute_power in factor:
            plain[name] = plain.get(name, 0) + power
            absolute[name] = absolute.get(name, 0) + absolute_power
    canonical = []
    for name in sorted(plain, key=INPUT_INDEX.__getitem__):
        pairs, odd = divmod(absolute[name], 2)
        if plain[name] or absolute[name]:
            canonical.append((name, plain[name] + 2 * pairs, odd))
    return tuple(canonical)


def parse_monomial(text: str) -> Monomial:
    """Read a product such as ``omega_avg*|u|*w^2``; ``bias`` and ``1`` are the constant.

    Raises:
        ModelError: naming the text, for an unknown input or broken syntax.
    """
    factors: list[Monomial] = []
    degree = 0
    for part in map(str.strip, re.split(r"[*·]", text)):
        if part in {"1", "bias"}:
            continue
        match = _FACTOR.fullmatch(part)
        name = match and (match["absolute"] or match["plain"])
        if match is None or name not in INPUT_INDEX:
            raise ModelError(
                f"regressor {text.strip()!r}: unknown factor {part!r}; inputs: {', '.join(INPUT_NAMES)}"
            )
        digits = match["absolute_power"] or match["power"] or "1"
        power = int(digits) if len(digits) <= len(str(DEGREE_MAX)) else DEGREE_MAX + 1
        degree += power
        if degree > DEGREE_MAX:
            raise ModelError(f"regressor {text.strip()!r}: its degree is beyond {DEGREE_MAX}")
        absolute = bool(match["absolute"])
        factors.append(monomial_product(*[((name, 0, 1),)] * power) if absolute else ((name, power, 0),))
    return monomial_product(*factors)


def monomial_degree(monomial: Monomial) -> int:
    """How many factors it has."""
    return sum(power + absolute for _, power, absolute in monomial)


def format_monomial(monomial: Monomial) -> str:
    """Text of a monomial, in the form that :func:`parse_monomial` reads."""
    texts = []
    for name, power, absolute in monomial:
        if absolute and power % 2 == 0:
            texts.append(f"|{name}|" + (f"^{power + 1}" if power else ""))
        else:
            texts += [f"|{name}|"] * absolute
            texts += [name + (f"^{power}" if power > 1 else "")]
    return "*".join(texts) or "bias"


def _first_factor(monomial: Monomial) -> tuple[int, Monomial]:
    """Split one factor off: its row among the base rows, and the monomial that remains."""
    name, power, absolute = monomial[-1]
    if absolute:
        row = 1 + len(INPUT_NAMES) + INPUT_INDEX[name]
        remaining = (name, power, 0)
    else:
        row = 1 + INPUT_INDEX[name]
        remaining = (name, power - 1, 0)
    tail = (remaining,) if remaining[1] or remaining[2] else ()
    return row, monomial[:-1] + tail


# One row of a program: the product of rows `first` and `second`, or their weighted sum where a weight is set.
OPERATION = np.dtype(
    [("first", np.int64), ("second", np.int64), ("first_weight", np.float64), ("second_weight", np.float64)],
    align=True,
)


@dataclass(frozen=True)
class RegressorProgram:
    """Evaluates regressors row by row: a row is the product or the weighted sum of two earlier rows.

    Attributes:
        operations: (n,) of :data:`OPERATION`. Rows begin with the constant 1, the inputs and their absolute
            values; operation k gives row BASE_ROWS + k.
        outputs: (p,) rows of the regressors.
    """

    operations: Records
    outputs: npt.NDArray[np.int64]

    @classmethod
    def compile(cls, regressors: Iterable[Regressor]) -> RegressorProgram:
        """Lay out the rows for `regressors`, sharing every common product."""
        rows: dict[Monomial, int] = {CONSTANT: 0}
        operations: list[tuple[int, int, float, float]] = []

        def add(first: int, second: int, first_weight: float = 0.0, second_weight: float = 0.0) -> int:
            operations.append((first, second, first_weight, second_weight))
            return BASE_ROWS + len(operations) - 1

        def row_of(monomial: Monomial) -> int:
            if monomial not in rows:
                factor_row, rest = _first_factor(monomial)
                rows[monomial] = factor_row if rest == CONSTANT else add(row_of(rest), factor_row)
            return rows[monomial]

        def output_of(regressor: Regressor) -> int:
            (weight, monomial), *others = regressor.parts
            row = row_of(monomial)
            if not others and weight != 1.0:
                return add(row, 0, weight, 0.0)
            for other_weight, other in others:
                row = add(row, row_of(other), weight, other_weight)
                weight = 1.0
            return row

        outputs = [output_of(regressor) for regressor in regressors]
        return cls(np.array(operations, dtype=OPERATION), np.array(outputs, dtype=np.int64))

    def evaluate(self, inputs: Array) -> Array:
        """Regressors (N, p) of input vectors (N, 19); memory N × p, so meant for selected terms."""
        check_inputs(inputs)
        values = np.empty((len(inputs), len(self.outputs)))
        rows = np.empty((BASE_ROWS + len(self.operations), _BLOCK))
        compiled.evaluate_regressors(
            np.ascontiguousarray(inputs), self.operations, self.outputs, rows, values
        )
        return values


def check_inputs(inputs: Array) -> None:
    """Refuse what the compiled code would read past the end of.

    Raises:
        ModelError: if `inputs` are not (N, 19).
    """
    if inputs.ndim != 2 or inputs.shape[1] != len(INPUT_NAMES):
        raise ModelError(f"inputs have shape {inputs.shape}, expected (N, {len(INPUT_NAMES)})")


# A pool file under config/candidates is YAML; under each axis, `fixed` lists regressors that are always in
# the model (the bias is too) and `candidates` lists families in the paper's notation, for example ``P^3(u,
# |v|, w)·{1, omega_avg}``: every monomial of degree 1 to 3 in the three variables, times each factor.
# `inputs` lists the regressors that neural networks take instead, for example ``|v|``.

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
