# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Smooth functions of time with exact derivatives, compiled.

A jet is a value with its first and second derivative by time. In compiled loops, unlike in array functions,
a sine gives the same bits on every machine.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array

Jet: TypeAlias = tuple[float, float, float]
# Start, duration and fade of a window.
Span: TypeAlias = tuple[float, float, float]


@njit(cache=True)
def wave_jets(
    time: Array, amplitude: float, frequencies: Array, phases: Array, sweep: float, window: Span
) -> Array:
    """Jets (N, 3) of a sum of sines whose frequencies (K,) Hz rise by `sweep` [Hz/s], faded in and out."""
    jets = np.zeros((len(time), 3))
    for i in range(len(time)):
        since = time[i] - window[0]
        size, size_rate, size_curve = _presence(since, window)
        for k in range(len(frequencies)):
            wave, wave_rate, wave_curve = _sine(
                2.0 * np.pi * (frequencies[k] + 0.5 * sweep * since) * since + phases[k],
                2.0 * np.pi * (frequencies[k] + sweep * since),
                2.0 * np.pi * sweep,
            )
            jets[i, 0] += amplitude * (size * wave)
            jets[i, 1] += amplitude * (size_rate * wave + size * wave_rate)
            jets[i, 2] += amplitude * (size_curve * wave + 2.0 * size_rate * wave_rate + size * wave_curve)
    return jets


@njit(cache=True)
def edge_jets(time: Array, instants: Array, heights: Array, rise: float) -> Array:
    """Jets (N, 3) of a sum of edges that begin at instants (E,) s and rise by heights (E,)."""
    jets = np.zeros((len(time), 3))
    for i in range(len(time)):
        for k in range(len(instants)):
            edge = _edge(time[i] - instants[k], rise)
            for order in range(3):
                jets[i, order] += heights[k] * edge[order]
    return jets


@njit(cache=True)
def orbit_jets(time: Array, radius: float, turn_rate: float, bearing: float, window: Span) -> Array:
    """Jets (3, N, 3) of north, east and angle on a circle from a bearing [rad], turning at a rate [rad/s]."""
    jets = np.empty((3, len(time), 3))
    for i in range(len(time)):
        since = time[i] - window[0]
        presence, presence_rate, _ = _presence(since, window)
        angle = turn_rate * (
            _edge_area(since, window[2]) - _edge_area(since - window[1] + window[2], window[2])
        )
        rate, curve = turn_rate * presence, turn_rate * presence_rate
        north = _sine(bearing + angle + 0.5 * np.pi, rate, curve)
        east = _sine(bearing + angle, rate, curve)
        yaw = (angle, rate, curve)
        for order in range(3):
            jets[0, i, order] = radius * north[order]
            jets[1, i, order] = radius * east[order]
            jets[2, i, order] = yaw[order]
    return jets


@njit(cache=True)
def _sine(angle: float, rate: float, curve: float) -> Jet:
    """Sine of a jet."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return sine, cosine * rate, cosine * curve - sine * rate * rate


@njit(cache=True)
def _presence(since: float, window: Span) -> Jet:
    """From 0 to 1 and back to 0 over a window (start, duration, fade)."""
    rise = _edge(since, window[2])
    fall = _edge(since - window[1] + window[2], window[2])
    return rise[0] - fall[0], rise[1] - fall[1], rise[2] - fall[2]


@njit(cache=True)
def _edge(since: float, duration: float) -> Jet:
    """From 0 to 1 by the polynomial of fifth degree that begins and ends without slope and curvature."""
    x = min(max(since / duration, 0.0), 1.0)
    rest = 1.0 - x
    return (
        x * x * x * (10.0 - x * (15.0 - 6.0 * x)),
        30.0 * x * x * rest * rest / duration,
        60.0 * x * rest * (rest - x) / (duration * duration),
    )


@njit(cache=True)
def _edge_area(since: float, duration: float) -> float:
    """Integral of the edge."""
    x = min(max(since / duration, 0.0), 1.0)
    area = x * x * x * x * (2.5 - x * (3.0 - x)) * duration
    return float(area + max(since - duration, 0.0))
