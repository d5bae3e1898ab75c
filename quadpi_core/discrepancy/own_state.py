# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The state that an effect has of its own along a recorded flight, such as the swing of a slung load.

A recording begins in mid-air, and nothing measures that state. Its value at the start is the most probable
one given the residual of the first seconds: least squares with a normal prior, by Gauss-Newton. The strength
of the effect, its first parameter, is free meanwhile, as the state does not depend on it: so the contribution
of the effect stays in proportion to it.

A swing has many optima, the more the longer it is seen, as a start that is off by little is off by turns of
phase later. So the first seconds are explained first, from several states, then each longer stretch from
there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array
from quadpi_core.simulation.applied_effects import remembered_wrenches
from quadpi_core.simulation.effect_definition import Effect
from quadpi_core.simulation.state_records import MEMORY
from quadpi_core.thresholds import CONVENTION, Threshold

SEEN_S = Threshold(
    "seconds of a flight from which the state at its start is estimated",
    20.0,
    "s",
    "several swings of any cable up to 5 m; a longer stretch would need the exact length of the cable",
    CONVENTION,
)
INDEPENDENT_HZ = Threshold(
    "independent samples of the residual while a start is estimated",
    5.0,
    "Hz",
    "what aerodynamics leave is correlated over some tenths of a second",
    CONVENTION,
)
STRETCHES_S = Threshold(
    "stretches of a flight from which the state at its start is estimated, one after the other",
    (2.5, 5.0, 10.0, SEEN_S.value),
    "s",
    "a swing or two of any cable up to 1.5 m; each is twice the one before, over which the phase is known",
    CONVENTION,
)
# States from which the first stretch is explained, rest and others, in prior deviations from it.
_FIRST_STATES = np.vstack((np.zeros(MEMORY), np.random.default_rng(0).standard_normal((4, MEMORY))))
# Rate [Hz] at which the state is followed while its start is sought, several tens of samples in a swing.
_RATE_HZ = 62.5
_ITERATIONS, _HALVINGS = 15, 5
# Instead of a division by zero.
_TINY = 1e-30
# Iterations end when the state moves by less than this share of its prior deviation.
_SMALL = 1e-5
# Of the state, in prior deviations: a step for derivatives, and the longest of an iteration.
_STEP, _LONGEST = 1e-4, 1.0
# Least and first size of the contribution while the state is sought, in sizes of the residual: without a
# contribution nothing tells of the state.
_WEAKEST, _FIRST = 0.05, 0.5


class OwnStates(NamedTuple):
    """States (N, 6) of an effect at times (N,) [s] of a flight."""

    time: Array
    memory: Array


class Started(NamedTuple):
    """The state of an effect at the start of a flight.

    Attributes:
        memory: (6,) the state.
        strength: value of the effect's first parameter that fits this flight, not negative.
        explained: share of the squares of the residual, mean removed, that the effect explains.
        cost: evidence [nat] that the freedom of the start takes from the effect.
    """

    memory: Array
    strength: float
    explained: float
    cost: float


def started(
    effect: Effect,
    values: Array,
    states: npt.NDArray[np.void],
    vehicle: npt.NDArray[np.void],
    residual: Array,
    step_s: float,
    near: Array | None = None,
) -> Started:
    """Estimate the state of an effect at the start of a flight.

    Args:
        effect: one with a state of its own.
        values: (P,) its parameters; the first is not used.
        states: (N,) of `state_records.STATE`, with the measured force.
        vehicle: (1,) of `state_records.VEHICLE`.
        residual: (N, 6) measured less simulated wrench, without the effect.
        step_s: seconds between the states.
        near: (6,) the state for all but the same parameters, from which it is found at once.
    """
    stride = max(1, round(1.0 / (_RATE_HZ * step_s)))
    stretches = []
    for seconds in STRETCHES_S.value if near is None else (SEEN_S.value,):
        shown = slice(0, max(round(seconds / step_s), 2 * stride), stride)
        seen = _Seen(effect, values, states[shown].copy(), vehicle, stride * step_s)
        stretches.append((seen, _forces(residual[shown, :, np.newaxis])[:, 0]))
        if shown.stop >= len(states):
            break
    rest, spread = np.asarray(effect.at_rest, dtype=float), np.asarray(effect.start_spread)
    seen, target = stretches[0]
    firsts = rest + _FIRST_STATES * spread if near is None else near[np.newaxis]
    tried = [seen.found_from(first, target) for first in firsts]
    at = max(tried, key=lambda one: _judged(one, target, seen.step_s).explained)
    for seen, target in stretches[1:]:
        at = seen.found_from(at.memory, target)
    return _judged(at, target, seen.step_s)


def _judged(at: _Start, target: Array, step_s: float) -> Started:
    """A state at the start with its strength, and what it explains of forces as :func:`_forces`."""
    strength = max(float(at.shape @ target) / max(float(at.shape @ at.shape), _TINY), 0.0)
    left = target - strength * at.shape
    total = max(float(target @ target), _TINY)
    variance = max(float(left @ left) / len(left), _TINY)
    information = INDEPENDENT_HZ.value * step_s * strength**2 / variance * at.slopes.T @ at.slopes
    cost = 0.5 * float(np.linalg.slogdet(np.eye(MEMORY) + information)[1])
    return Started(at.memory, strength, 1.0 - float(left @ left) / total, cost)


class _Start(NamedTuple):
    """A state at the start, with what follows from it.

    Attributes:
        memory: (6,) the state.
        shape: contribution of unit strength, as :func:`_forces`.
        slopes: (·, 6) its derivatives, per prior deviation of the state.
    """

    memory: Array
    shape: Array
    slopes: Array


class _Seen(NamedTuple):
    """The beginning of a flight, and the parameters that a start is sought for."""

    effect: Effect
    values: Array
    states: npt.NDArray[np.void]
    vehicle: npt.NDArray[np.void]
    step_s: float

    def found_from(self, first: Array, target: Array) -> _Start:
        """The most probable state near a first one (6,), given forces to explain as :func:`_forces`."""
        rest, spread = np.asarray(self.effect.at_rest, dtype=float), np.asarray(self.effect.start_spread)
        independent = INDEPENDENT_HZ.value * self.step_s
        variance = max(float(target @ target) / len(target), _TINY)
        at = self._from(first, self._shapes(first[np.newaxis])[:, 0], spread)
        strength = _FIRST * _ratio(target, at.shape)

        def cost(strength: float, memory: Array, shape: Array) -> float:
            left, moved = target - strength * shape, (memory - rest) / spread
            return independent * float(left @ left) / variance + float(moved @ moved)

        for _ in range(_ITERATIONS):
            # Strength and moved state are linear together: a c + J (a δ).
            columns = np.column_stack((at.shape, at.slopes))
            precision = np.full(MEMORY, variance / max(strength, _TINY) ** 2)
            prior = strength * precision * (rest - at.memory) / spread
            solved = np.linalg.solve(
                independent * columns.T @ columns + np.diag([0.0, *precision]),
                independent * columns.T @ target + np.array([0.0, *prior]),
            )
            before = cost(strength, at.memory, at.shape)
            strength = max(float(solved[0]), _WEAKEST * _ratio(target, at.shape))
            step = np.clip(solved[1:] / max(strength, _TINY), -_LONGEST, _LONGEST)
            for _ in range(_HALVINGS):
                memory = at.memory + step * spread
                shape = self._shapes(memory[np.newaxis])[:, 0]
                if cost(strength, memory, shape) <= before:
                    break
                step = 0.5 * step
            else:
                break
            at = self._from(memory, shape, spread)
            if np.abs(step).max() < _SMALL:
                break
        return at

    def _from(self, memory: Array, shape: Array, spread: Array) -> _Start:
        moved = self._shapes(memory + np.diag(_STEP * spread))
        return _Start(memory, shape, (moved - shape[:, np.newaxis]) / _STEP)

    def _shapes(self, starts: Array) -> Array:
        """Contributions (·, K) of unit strength from states (K, 6) on, as :func:`_forces`."""
        parameters = {p.name: float(v) for p, v in zip(self.effect.parameters, self.values, strict=True)}
        parameters[self.effect.parameters[0].name] = 1.0
        flown = self.effect.name, parameters, self.states, self.vehicle
        return _forces(remembered_wrenches(*flown, starts, self.step_s))


def _forces(wrenches: Array) -> Array:
    """Forces (·, K) of wrenches (N, 6, K) without their means, which a coefficient explains as well."""
    forces = wrenches[:, :3]
    varying: Array = (forces - forces.mean(axis=0)).reshape(-1, wrenches.shape[2])
    return varying


def _ratio(numerator: Array, denominator: Array) -> float:
    return float(np.linalg.norm(numerator)) / max(float(np.linalg.norm(denominator)), _TINY)
