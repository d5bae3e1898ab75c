# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What rotor speeds from motor commands hide from a search, in words and numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from quadpi_core.discrepancy.closure import Found
from quadpi_core.discrepancy.commanded_speeds import (
    GAIN_LEAST,
    ROTORS_DIFFER,
    errors_of_speeds,
    scale_is_known,
)
from quadpi_core.discrepancy.effect_regression import Regression
from quadpi_core.discrepancy.whitening import Noise, Part, rows_of
from quadpi_core.records import CONVENTION, DEVELOPMENT, Threshold

GAIN_ALIKE = Threshold(
    "share of the squares of an effect that gains of rotor speeds explain, from which that is said",
    0.8,
    "of the squares",
    "what is left of the effect is then less than half of it",
    DEVELOPMENT,
)
HIDDEN = Threshold(
    "share of the evidence of an effect that errors of rotor speeds take, from which they hide it",
    0.9,
    "of the evidence",
    "the effect would have to be three times as large to be seen as by measured speeds",
    CONVENTION,
)


@dataclass(frozen=True)
class CommandedSpeeds:
    """That rotor speeds of a search are made of commands, how well they are known, and what that hides.

    Attributes:
        flights: names of the flights concerned.
        gain: standard deviation of a gain of all speeds, from flight to flight.
        rotors: standard deviation of a gain of each rotor beside, the largest.
        scale_known: whether other flights or tachometers tell the scale of the speeds.
        hidden: effects of which these speeds hide most of what measured ones would tell.
        alike: of each named effect that errors of speeds resemble, the gains (R) that would look the same.
    """

    flights: tuple[str, ...]
    gain: float
    rotors: float
    scale_known: bool
    hidden: tuple[str, ...] = ()
    alike: tuple[tuple[str, tuple[float, ...]], ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a reader has to know."""
        told = [
            f"Rotor speeds are made of motor commands: from flight to flight their gain scatters by "
            f"{_percent(self.gain)}, that of single rotors by {_percent(self.rotors)} (standard deviations)."
        ]
        if not self.scale_known:
            told.append(
                "Their scale is that of the thrust of these flights: a mass, a thrust coefficient and a gain "
                "of all speeds cannot be told apart, and none of them is found."
            )
        told += [
            f"{name.replace('_', ' ').capitalize()} looks as if the motors turned by "
            f"{', '.join(f'{100.0 * gain:+.1f}' for gain in gains)} % (rotor 1 to {len(gains)}) off what the "
            "commands tell, in all flights: only its size speaks for it."
            for name, gains in self.alike
        ]
        return tuple(told)

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {**asdict(self), "alike": dict(self.alike), "text": list(self.sentences)}


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def traces(regression: Regression, noise: Noise) -> dict[str, float]:
    """Evidence [nat] of each effect of the size that is looked for, of its best candidate, in some noise."""
    found: dict[str, float] = {}
    for candidate, block in zip(regression.candidates, regression.blocks, strict=True):
        squares = np.einsum("fkk->k", noise.gram(block.columns, block.columns))
        found[candidate.name] = max(
            found.get(candidate.name, 0.0), 0.5 * float(squares[: len(block.at)].sum())
        )
    return found


def hidden_effects(measured: Mapping[str, float], commanded: Mapping[str, float]) -> tuple[str, ...]:
    """Effects that lose most of their evidence [nat] as speeds are commanded ones."""
    return tuple(
        name for name, evidence in commanded.items() if evidence < (1.0 - HIDDEN.value) * measured[name]
    )


def resembles_gains(share: float) -> bool:
    """Whether gains of rotor speeds explain so much of an effect's squares that this is said."""
    return share >= GAIN_ALIKE.value


def commanded_speeds(found: Found) -> CommandedSpeeds | None:
    """What is to be said of rotor speeds from commands after a search; None where all are measured."""
    regression = found.regression
    by_commands = {own.flight.name: own.flight.motors for own in regression.flights if own.flight.motors}
    if not by_commands:
        return None
    vehicle, measured = regression.flights[0].simulation.vehicle, replace(regression.noise, own=())
    with_measured, with_these = traces(regression, measured), traces(regression, regression.noise)
    alike = []
    for index in found.chosen:
        share, gain = _as_gain(regression, regression.added((index,), found.fit))
        if resembles_gains(share):
            alike.append((regression.candidates[index].name, gain))
    return CommandedSpeeds(
        flights=tuple(by_commands),
        gain=max(GAIN_LEAST.value, *(own.gain for own in by_commands.values())),
        rotors=max(max(own.error, default=ROTORS_DIFFER.value) for own in by_commands.values()),
        scale_known=all(scale_is_known(own, vehicle) for own in by_commands.values()),
        hidden=hidden_effects(with_measured, with_these),
        alike=tuple(alike),
    )


def _as_gain(regression: Regression, added: Sequence[Part]) -> tuple[float, tuple[float, ...]]:
    """Share of the squares that an effect adds which gains of rotor speeds explain, and these (R)."""
    (speeds,) = errors_of_speeds(regression.flights)
    weights, rotors = 1.0 / np.sqrt(regression.noise.variance), slice(1, speeds.columns.width - 1)
    of_effect, told, gains = 0.0, 0.0, []
    for place, (rows, band) in enumerate(speeds.columns.spectra):
        weighed = weights[place][:, band]
        effect = (weighed * rows_of(added, place)).ravel()
        columns = (weighed[:, :, np.newaxis] * rows[:, :, rotors]).reshape(len(effect), -1)
        fitted = np.linalg.lstsq(columns, effect, rcond=None)[0]
        of_effect += float(effect @ effect)
        told += float(np.sum(np.square(columns @ fitted)))
        gains.append(fitted)
    return told / of_effect if of_effect else 0.0, tuple(np.mean(gains, axis=0).tolist())
