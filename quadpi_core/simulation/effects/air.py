# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of the air: wind that is not measured."""

from __future__ import annotations

import numpy as np

from quadpi_core.elementary import exponential
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import Parameter, effect


@effect(
    "wind",
    "Fx Fy Fz Mx My Mz",
    Parameter("north_m_s", "m/s", 2.0, -30.0, 30.0),
    Parameter("east_m_s", "m/s", 0.0, -30.0, 30.0),
    Parameter("down_m_s", "m/s", 0.0, -10.0, 10.0),
    shown_by="turns of the heading in hover and in translation",
    formula=r"V = V_g - R_{BE}\,(w_N,\ w_E,\ w_D)",
    symbols="w_N w_E w_D",
)
def wind(time: Array, p: Array, rng: np.random.Generator) -> Array:  # noqa: ARG001
    """Steady wind, blowing towards north, east and down.

    Size: 2 m/s, 0.46 N on 0.5 kg.
    """
    return np.tile(p, (len(time), 1))


@effect(
    "wind",
    "Fx Fy Fz Mx My Mz",
    Parameter("intensity_m_s", "m/s", 1.2, 0.0, 10.0),
    Parameter("time_s", "s", 1.0, 0.01, 100.0),
    formula=r"S_w(\omega) \propto \frac{\sigma^2\,\tau}{1 + (\omega\tau)^2}",
    symbols=r"\sigma \tau",
)
def gust(time: Array, p: Array, rng: np.random.Generator) -> Array:
    """Gusts: coloured noise of the wind in all three directions.

    Each is an Ornstein–Uhlenbeck process, exact on any time grid and stationary from its first sample, with
    standard deviation `intensity_m_s` and autocorrelation e^(−|Δt|/time_s): the longitudinal spectrum of
    Dryden (MIL-F-8785C) at a fixed airspeed. Size: 0.27 N on 0.5 kg.
    """
    return _ornstein_uhlenbeck(time, p[0], p[1], rng.standard_normal((len(time), 3)))


def _ornstein_uhlenbeck(time: Array, deviation: float, time_constant: float, noise: Array) -> Array:
    persistence = exponential(-np.diff(time) / time_constant)
    added = deviation * np.sqrt(1.0 - persistence * persistence)[:, None] * noise[1:]
    x, y, z = (deviation * noise[0]).tolist()
    process = [(x, y, z)]
    for keep, (dx, dy, dz) in zip(persistence.tolist(), added.tolist(), strict=True):
        x, y, z = keep * x + dx, keep * y + dy, keep * z + dz
        process.append((x, y, z))
    return np.array(process)
