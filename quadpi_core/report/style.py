# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Colours of figures, from a set that the colour-blind tell apart, and texts of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import cycle

from quadpi_core.models.kind_registry import KINDS

# Names of colours in assets/look.css.
MEASURED, INK, RULE, TRAINING, PREDICTED = "measured", "ink", "rule", "training", "predicted"
GROUPS = ("model-1", "model-2", "model-3", "model-4", "model-5", "model-6")
LEVELS = {"ok": "trusted-line", "warning": "warning-line", "alarm": "alarm-line"}
# The set of Okabe and Ito, and the indigo of Tol: the style sheet has a form of each for every ground.
_NAMES = dict(
    zip(
        ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#332288"),
        (*GROUPS, "model-7"),
        strict=True,
    )
)

INPUT_LABELS = {
    "u": "u [m/s]",
    "v": "v [m/s]",
    "w": "w [m/s]",
    "v_in": "v_in [m/s]",
    "p": "p [rad/s]",
    "q": "q [rad/s]",
    "r": "r [rad/s]",
    "omega_avg": "ω_avg [rad/s]",
    "sin_phi": "sin φ",
    "cos_phi": "cos φ",
    "sin_theta": "sin θ",
    "cos_theta": "cos θ",
    "U_p": "U_p [rad/s]",
    "U_q": "U_q [rad/s]",
    "U_r": "U_r [rad/s]",
    "mu_x": "μ_x",
    "mu_y": "μ_y",
    "mu_z": "μ_z",
    "mu_v_in": "μ_v,in",
    "speed": "airspeed [m/s]",
}


def group_colours(groups: Iterable[str]) -> dict[str, str]:
    """A colour for each group in order; they repeat after the last."""
    return {name: GROUPS[i % len(GROUPS)] for i, name in enumerate(groups)}


def method_colours(names: Iterable[str]) -> dict[str, str]:
    """A colour per model, that of its kind where it is named after one; the others share what is left."""
    distinct = dict.fromkeys(names)
    colours = {name: _NAMES.get(kind.colour, kind.colour) for name in distinct if (kind := KINDS.named(name))}
    taken = {*colours.values(), GROUPS[3]}
    spare = cycle(colour for colour in GROUPS if colour not in taken)
    return {name: colours.get(name) or next(spare) for name in distinct}


def css_colour(colour: str) -> str:
    """A colour for a style sheet: #rrggbb as it is, a name as the variable."""
    return colour if colour.startswith("#") else f"var(--{colour})"


def unit(axis: str) -> str:
    """Unit of an axis of the wrench."""
    return "N" if axis.startswith("F") else "Nm"


def nominal(confidence: float) -> str:
    """The nominal coverage of intervals, in percent."""
    return f"{100.0 * confidence:g}\u00a0%"


def count(value: float) -> str:
    """A whole number with thin spaces between thousands."""
    return f"{value:,.0f}".replace(",", "\u202f")


def percent(fraction: float) -> str:
    """A fraction in percent with one decimal; only 1 and 0 are shown as 100 and 0."""
    return f"{_in_percent(fraction, 1)} %"


def hundredths(fraction: float) -> str:
    """A fraction in percent with two decimals, as in the paper; only 1 and 0 are shown as 100 and 0."""
    return _in_percent(fraction, 2)


def _in_percent(fraction: float, decimals: int) -> str:
    least = 10.0**-decimals
    if 1.0 - 0.005 * least <= fraction < 1.0:
        return f"> {100.0 - least:.{decimals}f}"
    if 0.0 < fraction < 0.005 * least:
        return f"< {least:.{decimals}f}"
    return f"{100.0 * fraction:.{decimals}f}"


def percent_range(interval: Sequence[float]) -> str:
    """A confidence interval of a fraction in percent."""
    low, high = interval
    return f"{100.0 * low:.1f}–{100.0 * high:.1f} %"


def number(value: float) -> str:
    """A number with three significant digits."""
    if value != 0.0 and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.2e}"
    return f"{value:#.3g}".rstrip(".") if abs(value) < 999.5 else f"{value:.0f}"
