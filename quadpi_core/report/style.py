# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Colours of figures, from the colour-blind safe set of Okabe and Ito, and texts of numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import cycle
from typing import Any

from quadpi_core.models.kind_registry import KINDS

MEASURED = "#7a7f87"
GROUPS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
LEVELS = {"ok": "#009E73", "warning": "#E69F00", "alarm": "#D55E00"}
PREDICTED = "#CC79A7"
INK = "#1f2933"
RULE = "#e4e7eb"
TRAINING = "#e9edf2"

INPUT_LABELS = {
    "u": "u [m/s]",
    "v": "v [m/s]",
    "w": "w [m/s]",
    "v_in": "v<sub>in</sub> [m/s]",
    "p": "p [rad/s]",
    "q": "q [rad/s]",
    "r": "r [rad/s]",
    "omega_avg": "ω<sub>avg</sub> [rad/s]",
    "sin_phi": "sin φ",
    "cos_phi": "cos φ",
    "sin_theta": "sin θ",
    "cos_theta": "cos θ",
    "U_p": "U<sub>p</sub> [rad/s]",
    "U_q": "U<sub>q</sub> [rad/s]",
    "U_r": "U<sub>r</sub> [rad/s]",
    "mu_x": "μ<sub>x</sub>",
    "mu_y": "μ<sub>y</sub>",
    "mu_z": "μ<sub>z</sub>",
    "mu_v_in": "μ<sub>v,in</sub>",
    "speed": "airspeed [m/s]",
}


def group_colours(groups: Iterable[str]) -> dict[str, str]:
    """A colour for each group in order; they repeat after the last."""
    return {name: GROUPS[i % len(GROUPS)] for i, name in enumerate(groups)}


def method_colours(names: Iterable[str]) -> dict[str, str]:
    """A colour per model, that of its kind where it is named after one; the others share what is left."""
    distinct = dict.fromkeys(names)
    own = {name: kind.colour for name in distinct if (kind := KINDS.named(name))}
    taken = {PREDICTED, *own.values()}
    left = cycle(colour for colour in GROUPS if colour not in taken)
    return {name: own.get(name) or next(left) for name in distinct}


def translucent(colour: str, opacity: float) -> str:
    """A colour #rrggbb as rgba()."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {opacity})"


def error_bar(values: Any, intervals: Any, thickness: float) -> dict[str, Any]:
    """Error bars of plotly from values (N,) to the ends of their intervals (N, 2)."""
    return {
        "type": "data",
        "symmetric": False,
        "thickness": thickness,
        "width": 0,
        "array": intervals[:, 1] - values,
        "arrayminus": values - intervals[:, 0],
    }


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
