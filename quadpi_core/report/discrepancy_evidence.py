# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence for and against each effect in plain words, and what would change the verdict."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NamedTuple

import numpy as np

from quadpi_core.core import IN_NUMPY
from quadpi_core.discrepancy.by_condition import MOST_BINS, VARIABLES, Profile, Residual
from quadpi_core.discrepancy.closure import Gap
from quadpi_core.discrepancy.discrepancy_result import Discovery, FoundEffect, RankedCandidate, Study
from quadpi_core.evaluation.metrics import round_edges
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.report.evaluation_figures import listing
from quadpi_core.report.page import Boxes, Cells, Figure, Layer, Line, Panel, Points, Scale
from quadpi_core.report.table import GROUPS, INK, MEASURED, Cell, Mark, Row, Table, text_columns, unit
from quadpi_core.simulation.applied_effects import EFFECTS
from quadpi_core.simulation.effect_definition import SHAPE, shaped

# Candidates that a table shows at once.
MOST_CANDIDATES = 8
# Share of the needed evidence from which a refused candidate is worth further flights; so many are named.
_NEAR, _MOST_NEAR = 0.3, 3
# Share of the gap of an axis that is worth a word.
_LEAST_SHARE = 0.01

# Why a candidate was refused, before the sentence of the test that it failed.
_REFUSED = {
    "bounds": "does not act like this",
    "bounds, refined": "does not act like this",
    "bounds, reweighted": "does not act like this",
    "size": "too small to matter",
    "size, refined": "too small to matter",
    "size by its law": "too small to matter",
    "ordinary size": "larger than is ordinary, and another does as well",
    "not dropped": "no longer needed",
    "evidence": "too little evidence",
    "precedence": "behind a better one",
    "loudness": "quieter than the noise",
    "flights left out": "makes flights left out worse",
    "differs from zero": "may be zero",
    "barred": "barred by another search",
}
# What removes the doubt of a failed test of the whole result.
_REMEDIES = {
    "unexplained": "Look at what the rest varies with (section What is left) and where it is largest. "
    "Leave out flights in which something else acted, or add an effect of that form to the library "
    "(docs/effects.md).",
    "coefficients": "Measure that coefficient again. If it is right, something without a name acts in its "
    "place; if it is hardly known, state a wider tolerance in the vehicle file.",
    "coefficients together": "Measure the coefficients again. If they are right, something without a name "
    "acts in their place; if they are hardly known, state wider tolerances in the vehicle file.",
    "colour": "Fly in still air, and look at the sensors with `quadpi info`: gusts, or a sensor that drifts, "
    "cannot be told from a missing effect.",
    "closed": "Look for what else is missing in the conditions where the error stays large; more flights of "
    "those conditions help.",
    "intervals": "Look at what these flights have of their own (place, payload, air), and at their sensors "
    "with `quadpi info`: an effect that the library lacks breaks intervals, and one too weak to be told.",
    "not zero": "Fly more of what shows the effect, until an interval of its parameters excludes zero.",
    "agreement": "Compare what the flights that differ have of their own (payload, place, wind). If they are "
    "alike, something without a name acts, which this effect imitates on each flight in another way.",
    "disputed": "Fly what shows the one effect and not the other.",
    "closes": "Fly more of what shows the effect: where it is there, flights left out are closer with it.",
    "roll-outs": "Check the coefficients that moved with the effect, and the delays of the sensors: what "
    "fits a step ahead but not half a second is not the physics.",
    "diverged roll-outs": "Check the coefficients that moved with the effect: with it the vehicle does not "
    "fly.",
    "coverage": "Look at that axis in section What is left: the effect takes the place of something else "
    "there.",
}
# What removes the reason why a candidate with enough evidence was refused.
_REMEDIES_OF_CANDIDATES = {
    "flights left out": "Fly more flights of the same kind: if it is there, all of them must show it alike. "
    "An axis that grows may hold a second missing effect.",
    "loudness": "Fly harder: faster, or with larger steps, so that it exceeds the noise.",
    "differs from zero": "Fly more of what shows it, until an interval of its parameters excludes zero.",
    "precedence": "Remove what rejects the better one first.",
    "barred": "Fly more of what shows it: where it is there, flights left out are closer with it.",
}


class Change(NamedTuple):
    """What speaks against the verdict being another one, and what would remove it."""

    now: str
    then: str


def words(name: str) -> str:
    """Name of an effect or candidate as a text shows it."""
    return name.replace("_", " ")


def evidence_table(candidates: Sequence[RankedCandidate], verdict: str) -> Table:
    """Candidates with what speaks for and against them, in plain words; `verdict` is that of the search."""
    best = Cell("named", Mark.GOOD) if verdict == "effects" else Cell("comes closest", Mark.WARNING)
    headings = ("effect", "", "evidence", "of the gap it closes", "could as well be")
    rows: list[Row] = [
        [
            Cell(
                words(own.label),
                detail=f"beside {listing(list(map(words, own.beside)))}" if own.beside else "",
            ),
            best if own.named else Cell("refused", detail=refusal(own)),
            Cell(amount(own), detail="" if own.gain is None else f"{own.gain:.0f} of {own.needed:.0f} nat"),
            closes(own),
            "; ".join(f"{words(rival)}, {_odds(odds)}" for rival, odds in own.rivals.items()),
        ]
        for own in candidates
    ]
    return Table(text_columns(*headings, wraps=True), rows)


def refusal(candidate: RankedCandidate) -> str:
    """Why a candidate is not named."""
    gain = candidate.gain
    if candidate.test == "evidence" and gain is not None and gain >= (candidate.needed or 0):
        return "replaced by a better one"
    kind = _REFUSED.get(candidate.test, "")
    if candidate.test in ("bounds", "bounds, refined", "bounds, reweighted", "evidence"):
        return kind
    return f"{kind}: {words(candidate.reason)}" if kind else words(candidate.reason)


def amount(candidate: RankedCandidate) -> str:
    """Evidence of a candidate beside what it needs to be named."""
    if candidate.gain is None or not candidate.needed:
        return "not weighed"
    ratio = candidate.gain / candidate.needed
    if ratio >= 1.0:
        return f"{ratio:.0f} times what is needed" if ratio >= 9.5 else f"{ratio:.1f} times what is needed"
    return f"{100.0 * ratio:.0f} % of what is needed" if ratio > 0.0 else "none"


def closes(candidate: RankedCandidate) -> str:
    """Share of the gap of each axis that goes with a candidate, and of those that it makes worse."""
    better = {axis: share for axis, share in candidate.closes.items() if share >= _LEAST_SHARE}
    worse = {axis: -share for axis, share in candidate.closes.items() if share <= -_LEAST_SHARE}
    cancels = [axis for axis in candidate.cancels if axis in worse]
    worse = {axis: share for axis, share in worse.items() if axis not in cancels}
    parts = [", ".join(f"{axis} {100.0 * share:.0f} %" for axis, share in better.items())] if better else []
    if cancels:
        parts.append(f"nothing of {listing(cancels)} but with coefficients that move against it")
    if worse:
        grown = ", ".join(f"{axis} by {100.0 * share:.0f} %" for axis, share in worse.items())
        parts.append(f"makes {grown} worse")
    return "; ".join(parts) or ("nothing" if candidate.closes else "")


def _odds(odds: float) -> str:
    """Odds of a rival against the named effect."""
    if odds >= 1.0:
        return f"{odds:.3g} times as likely"
    return f"1/{1.0 / odds:.3g} as likely" if odds > 1e-3 else "hardly likely"


def changes_table(changes: Sequence[Change]) -> Table:
    """What would change the verdict."""
    return Table(
        text_columns("now", "what would change it", wraps=True), [list(change) for change in changes]
    )


def verdict_changes(study: Study) -> list[Change]:
    """What would change the verdict: doubts, rivals, refused effects, and what was not flown."""
    discovery = study.discovery
    failed = [check for check in discovery.checks if not check.passed]
    usual = "Fly more flights: what is there shows in all of them."
    changes = [
        Change(f"{check.sentence[:1].upper()}{check.sentence[1:]}.", _REMEDIES.get(check.test, usual))
        for check in failed
    ]
    changes += [_between_rivals(effect) for effect in discovery.effects if effect.rivals]
    changes += _refused(discovery)
    if (commanded := discovery.commanded) is not None:
        names = ", ".join(map(words, commanded.hidden))
        hidden = f" They hide most of what would show {names}." if names else ""
        changes.append(
            Change(" ".join(commanded.sentences) + hidden, "Log rotor speeds: flights with them tell more.")
        )
    if discovery.without_trace:
        changes.append(
            Change(
                f"Cannot be found by comparing these flights with this simulation: "
                f"{', '.join(map(words, discovery.without_trace))}.",
                "Fly what shows them. Wind, delays and rotor speeds need a simulation that computes its "
                "wrench from the flight: a vehicle file, a model or a function.",
            )
        )
    if discovery.within_intervals:
        changes.append(
            Change(
                "Not named, as the model's intervals hold the axes they act on: "
                f"{', '.join(map(words, discovery.within_intervals))}.",
                "A model with narrower intervals: identify it on more flights of the vehicle as it was.",
            )
        )
    if study.not_flown:
        changes.append(
            Change(
                f"Not flown: {', '.join(study.not_flown)}.",
                "Fly these: an effect that shows only there is neither found nor excluded.",
            )
        )
    return changes


def passed_checks(discovery: Discovery) -> str:
    """How far the result is from the limits of the tests that it passes; empty where nothing was named."""
    passed = [check.sentence for check in discovery.checks if check.passed]
    return f"Tests of the whole result that hold: {words('; '.join(passed))}." if passed else ""


def _between_rivals(effect: FoundEffect) -> Change:
    return Change(
        f"{words(effect.name).capitalize()} explains these flights as well as "
        f"{listing(list(map(words, effect.rivals)), 'or')} would.",
        f"To tell them apart, fly {listing(effect.shown_by)}.",
    )


def _refused(discovery: Discovery) -> list[Change]:
    """Refused candidates with enough evidence, then those with nearly enough."""
    rivals = {rival for effect in discovery.effects for rival in effect.rivals}
    refused = [own for own in discovery.candidates if not own.named and own.name not in rivals]
    enough, near = [], []
    for own in refused:
        if own.gain is None or not own.needed:
            continue
        ratio = own.gain / own.needed
        if own.test != "evidence" and ratio >= 1.0:
            remedy = _REMEDIES_OF_CANDIDATES.get(own.test, f"Fly {EFFECTS[own.name].shown_by}.")
            now = f"{words(own.label).capitalize()} has {amount(own)}, but is refused: {refusal(own)}."
            enough.append(Change(now, remedy))
        elif own.test == "evidence" and _NEAR <= ratio < 1.0:
            then = f"{_more_flights(own, ratio)}; best {EFFECTS[own.name].shown_by}."
            near.append(Change(f"{words(own.label).capitalize()} has {amount(own)}.", then))
    return [*enough[:_MOST_NEAR], *near[:_MOST_NEAR]]


def _more_flights(candidate: RankedCandidate, share: float) -> str:
    """Whether more flights would give all of the needed evidence: evidence grows with their number."""
    if candidate.beside:
        # So does what is needed beside other effects, see `acceptance.FURTHER_SHARE`.
        others = listing(list(map(words, candidate.beside)))
        return f"More such flights may not do: what it needs grows with the evidence of {others}"
    more = 1.0 / share - 1.0
    return f"About {10 * math.ceil(10.0 * more)} % more such flights should do if it is there"


BEFORE, AFTER = GROUPS[1], GROUPS[0]
MAPS = (("u", "v"), ("speed", "height"), ("w", "rotor_speed"))
# Samples that a cell of a map needs to be drawn.
_FEWEST_IN_CELL = 20
_COLUMNS = 3


def profile_figure(profiles: Sequence[Profile]) -> Figure:
    """Root mean square of the residual of each axis over the variable that explains most of it."""
    panels = []
    for profile in profiles:
        lines = (
            ("allowed by noise and tolerances", profile.allowed, MEASURED, "dotted"),
            ("with what was found", profile.after, AFTER, "dashed"),
            ("as it is", profile.beyond, BEFORE, ""),
        )
        layers = [
            Line(name, colour, profile.edges, np.append(values, values[-1]), None, 2.0, dash, True)
            for name, values, colour, dash in lines
        ]
        y = Scale(f"{profile.axis} [{unit(profile.axis)}]", low=0.0)
        panels.append(Panel(layers, Scale(_label(profile.variable)), y, 190.0))
    return Figure("Residual by condition", panels, _COLUMNS)


def map_figure(flights: Sequence[Residual], axes: Sequence[str]) -> Figure:
    """Mean residual over pairs of variables (rows) for each axis (columns)."""
    tables = {axis: [mean_map(flights, AXES.index(axis), *pair) for pair in MAPS] for axis in axes}
    largest = {
        axis: max(float(np.nanmax(np.abs(values))) for *_, values in own) for axis, own in tables.items()
    }
    panels = []
    for row, pair in enumerate(MAPS):
        for axis in axes:
            x, y, values = tables[axis][row]
            cells = Cells("", INK, x, y, values.ravel(), largest[axis])
            title = "" if row else f"{axis} [{unit(axis)}]"
            notes = [] if row else [f"full colour: ± {largest[axis]:.2g}"]
            x_scale = Scale(_label(pair[0]), float(x[0]), float(x[-1]))
            y_scale = Scale(_label(pair[1]), float(y[0]), float(y[-1]))
            panels.append(Panel([cells], x_scale, y_scale, 190.0, title, notes))
    return Figure("Maps of the mean residual", panels, len(axes), shared=True)


def mean_map(flights: Sequence[Residual], axis: int, x: str, y: str) -> tuple[Array, Array, Array]:
    """Edges of the bins of two variables, and the mean residual in each cell (Y, X); NaN for few samples."""
    first, second = (np.concatenate([own.variables[name] for own in flights]) for name in (x, y))
    values = np.concatenate([own.beyond[:, axis] for own in flights])
    edges = round_edges(first, MOST_BINS), round_edges(second, MOST_BINS)
    count, *_ = np.histogram2d(second, first, bins=(edges[1], edges[0]))
    total, *_ = np.histogram2d(second, first, bins=(edges[1], edges[0]), weights=values)
    enough = count >= _FEWEST_IN_CELL
    return *edges, np.where(enough, total / np.maximum(count, 1.0), np.nan)


def gap_figure(gap: Gap) -> Figure:
    """Root mean square error of each axis before and after, and the floor."""
    panels = []
    for own in (slice(0, 3), slice(3, 6)):
        axes, places = AXES[own], np.arange(3.0)
        layers: list[Layer] = []
        for name, values, colour, left in (
            ("before", gap.before, BEFORE, -0.32),
            ("after", gap.after, AFTER, 0.02),
        ):
            bottom = np.zeros(3)
            layers.append(Boxes(name, colour, places + left, places + left + 0.3, bottom, values[own]))
        layers.append(Points("floor", MEASURED, places, gap.floor[own], symbol=4))
        x = Scale("", -0.5, 2.5, ticks=[(float(k), axis) for k, axis in enumerate(axes)])
        panels.append(Panel(layers, x, Scale(f"RMSE [{unit(axes[0])}]", low=0.0), 230.0))
    return Figure("Error of each axis before and after", panels, 2)


def residual_figure(flight: Residual, floor: Array) -> Figure:
    """Measured − simulated wrench of one flight over time, before and after.

    Args:
        flight: its residuals.
        floor: (6,) root mean square, see `Gap`; twice the floor is drawn as a band.
    """
    panels = []
    whole = np.array([np.nan])
    for k, axis in enumerate(AXES):
        band = np.array([2.0 * float(floor[k])])
        layers = [
            Boxes("twice the floor", MEASURED, whole, whole, -band, band, 0.18),
            Line("before", BEFORE, flight.time, flight.before[:, k], width=1.2),
            Line("after", AFTER, flight.time, flight.after[:, k], width=1.2, dash="dashed"),
        ]
        panels.append(Panel(layers, Scale("time [s]"), Scale(f"{axis} [{unit(axis)}]"), 100.0))
    return Figure("Residuals over time", panels, over_time=True)


def _label(variable: str) -> str:
    words, of, _ = VARIABLES[variable]
    return f"{words} [{of}]"


# The Python is the source of each effect with all that it calls, elementary functions by numpy, so it
# computes the same to the last digits.

_SYMBOLS = r"""## Symbols

| symbol | |
| --- | --- |
| $u, v, w$; $V$ | velocity relative to the air, body axes forward-right-down |
| $u_i, v_i, w_i$; $V_i$ | that of the hub of rotor i |
| $p, q, r$; $\Omega$ | body rates |
| $\omega_i$, $s_i$, $T_i$, $Q_i$ | speed, direction (clockwise +1), thrust and torque of rotor i |
| $r_i = (x_i, y_i, z_i)$ | place of rotor i |
| $\omega_h$, $v_h$, $R$ | rotor speed and induced velocity of hover, rotor radius |
| $h_i$ | height of rotor i over ground |
| $F$, $M$ | force and moment in body axes |
| $F_i$, $\Delta T_i$ | forces at rotor i, the second along $-z$; each gives its moment $r_i \times F_i$ too |
"""
_SHAPED = r"""
These flights shape the law: what it adds in an axis $a$ is multiplied by
$1 + s_a + s_V V/v_h + s_u u/v_h + s_v v/v_h + s_w w/v_h + s_{ww} w^2/v_h^2
+ s_l \sum_i \omega_i^2/(4 \omega_h^2) + s_\Omega R |\Omega|/v_h + s_g R/\max(h, R)$,
from 0 to 3, of the height $h$ of the vehicle and
"""
# Of `SHAPE`, in its order.
_SHAPE_SYMBOLS = [*(f"{{{axis}}}" for axis in AXES), "V", "u", "v", "w", "l", r"\Omega", "g", "{ww}"]
_HEAD = '''"""Effects that quadpi found in flights, as functions of numpy alone.

{names}

Each takes what its first line says; `NAME_PARAMETERS` are the values that were found. Units are SI, body axes
forward-right-down, world north-east-down, quaternions (w, x, y, z) from body to world.
"""

from __future__ import annotations

'''
_WRENCH = f'''
def wrench_of(effect, p, states, vehicle, shape=np.zeros({len(SHAPE)})):
    """Wrench (N, 6) [N, Nm] that an effect adds at N instants.

    shape: `NAME_SHAPE` of an effect that has one.
    states: arrays (N, ...) by name: position, attitude, velocity_air, rates, rotor_speeds,
        rotor_accelerations,
        hub_velocity (N, 4, 3), thrusts (N, 4) along -z, torques (N, 4), wrench (N, 6) of all other forces.
    vehicle: by name: mass, rotor_positions (4, 3), rotor_spins (4,), rotor_radius, hover_induced_velocity,
        hover_rotor_speed.
    """
    state, vehicle = SimpleNamespace(**states), SimpleNamespace(**vehicle)
    wrench = shaped(effect(state, vehicle, p), state, vehicle, shape)
    return np.stack(np.broadcast_arrays(*wrench, state.wrench[:, 0])[:6], axis=1)
'''


def write_formulas(effects: Sequence[FoundEffect], folder: Path) -> list[Path]:
    """Write `effects.md` and `effects.py` into a folder that exists."""
    parts, values = ["# What the simulation lacked"], {}
    for found in effects:
        effect, shape = EFFECTS[found.name], found.shape
        values[found.name] = {**{p.name: p.value for p in found.parameters}, **shape}
        rows = ["| | parameter | value | 95 % | |", "| --- | --- | --- | --- | --- |"]
        for symbol, p in zip(effect.symbols, found.parameters, strict=True):
            rows.append(
                f"| ${symbol}$ | {p.name} | {p.value:.4g} | {p.lower:.4g} … {p.upper:.4g} | {p.unit} |"
            )
        law = inspect.cleandoc(effect.function.__doc__)
        parts += [f"## {effect.name}\n\n{law}\n\n$$ {effect.formula} $$", "\n".join(rows)]
        if shape:
            pairs = zip(SHAPE, _SHAPE_SYMBOLS, strict=True)
            stated = [f"$s_{symbol} = {shape[p.name]:.3g}$" for p, symbol in pairs if p.name in shape]
            parts.append(_SHAPED + "\n" + ", ".join(stated) + ".")
    text, code = folder / "effects.md", folder / "effects.py"
    text.write_text("\n\n".join([*parts, _SYMBOLS]))
    code.write_text(python_source(values))
    return [text, code]


def python_source(effects: Mapping[str, Mapping[str, float]]) -> str:
    """A Python file with a function for each effect that needs numpy and the standard library alone.

    Args:
        effects: by name the values of their parameters and of those that shape their laws.
    """
    imports, definitions, values = {"import numpy as np"}, dict[str, tuple[Any, str]](), list[str]()
    for name, found in effects.items():
        effect = EFFECTS[name]
        _add(name, effect.function, imports, definitions)
        numbers = [found[p.name] for p in effect.parameters]
        described = ", ".join(f"{p.name} [{p.unit or '-'}]" for p in effect.parameters)
        values.append(f"{name.upper()}_PARAMETERS = np.array({numbers!r})  # {described}")
        if any(p.name in found for p in effect.shape):
            shape = [found.get(p.name, p.default) for p in SHAPE]
            values.append(f"{name.upper()}_SHAPE = np.array({shape!r})  # {', '.join(p.name for p in SHAPE)}")
    driver = ""
    if any(EFFECTS[name].kind == "wrench" for name in effects):
        _add(shaped.__name__, shaped, imports, definitions)
        driver = _WRENCH
        imports.add("from types import SimpleNamespace")
    names = "\n".join(f"{name}: {EFFECTS[name].summary}." for name in effects)
    head = _HEAD.format(names=names) + "\n".join(sorted(imports))
    sources = [source for _, source in definitions.values()]
    return "\n\n\n".join([head, *sources, "\n".join(values)]) + "\n" + driver


def _add(name: str, value: Any, imports: set[str], definitions: dict[str, tuple[Any, str]]) -> None:
    """Add what a name stands for and, before it, all of quadpi that it uses, or the import of it.

    Raises:
        ValueError: for a name with different meanings in two files of effects.
    """
    if isinstance(value, ModuleType):
        imports.add(f"import {value.__name__} as {name}")
    elif inspect.isfunction(value) and not value.__module__.startswith("quadpi_core"):
        imports.add(f"from {value.__module__} import {value.__name__} as {name}")
    elif name in definitions:
        if definitions[name][0] is not value:
            raise ValueError(f"two files of effects define `{name}`: an exported file holds one of them")
    elif inspect.isfunction(value) and value in IN_NUMPY:
        definitions[name] = value, f"{name} = {IN_NUMPY[value]}"
    elif inspect.isfunction(value):
        for used in sorted(_names(value.__code__) & value.__globals__.keys() - {name}):
            _add(used, value.__globals__[used], imports, definitions)
        # Without decorators, and without remarks for linters and type checkers.
        source = "def " + f"\n{inspect.getsource(value)}".partition("\ndef ")[2]
        definitions[name] = value, re.sub(r"(?m)  # (?:noqa|type:).*$", "", source).rstrip()
    elif isinstance(value, type) and issubclass(value, Exception):
        text = (value.__doc__ or name).strip()
        definitions[name] = value, f'class {name}(Exception):\n    """{text}"""'
    else:
        definitions[name] = value, f"{name} = {value!r}"


def _names(code: CodeType) -> set[str]:
    """Global names that code refers to, those of its inner functions included."""
    inner = (value for value in code.co_consts if isinstance(value, CodeType))
    return set(code.co_names).union(*map(_names, inner))
