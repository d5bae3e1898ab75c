# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What flights do not tell of the physical model, and the manoeuvre that would.

A parameter is not identified where its standard error is nearly its prior spread. Either the flights hardly
excite it, or they excite it together with another parameter, so that only their sum is known: in hover, a
bias of the force x and an accelerometer that is inclined look the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.models.physical_terms import BY_SPEED, TERM_INDEX, TERM_NAMES, TERMS

# A parameter whose standard error is this share of its prior spread was not identified by the flights.
UNKNOWN = 0.9
# A parameter whose standard error were this share of its prior spread, if all others were known, is excited.
_EXCITED = 0.5
# Correlation beyond which a parameter is said to look like another.
_ALIKE = 0.5
# The delay of rotor speeds [s] that is used where flights do not tell it: none, as of a log whose stamps are
# those of the rotors. They do not where delays that differ by so much [s], this one among them, remain: the
# data sets of the tests have delays of 2.5 to 7.5 ms, told within 5 ms.
UNTOLD_DELAY_S, _UNTOLD_RANGE_S = 0.0, 0.01
# Least variance of a direction of parameters, in units of the prior: rounding may leave less than none.
_LEAST_VARIANCE = 1e-12


def unidentified(covariance: Array, spreads: Array) -> dict[str, str]:
    """By parameter about which flights say no more than the prior: a note with the manoeuvre that would tell.

    Args:
        covariance: (P, P) of the posterior; zero where a term was left out.
        spreads: (P,) of the prior.
    """
    fitted = np.flatnonzero(np.diag(covariance) > 0.0)
    if not len(fitted):
        return {}
    correlation = covariance[np.ix_(fitted, fitted)] / np.outer(spreads[fitted], spreads[fitted])
    share = np.sqrt(np.diag(correlation))
    # Standard error of each if all others were known: far smaller where flights excite it.
    values, vectors = np.linalg.eigh(correlation)
    alone = 1.0 / np.sqrt(np.square(vectors) @ (1.0 / np.maximum(values, _LEAST_VARIANCE)))
    alike = np.abs(correlation / np.outer(share, share)) - np.eye(len(fitted))
    notes = {}
    for k in np.flatnonzero(share > UNKNOWN):
        term, other = TERMS[fitted[k]], int(np.argmax(alike[k]))
        note = "not identified by these flights"
        excited = alone[k] <= _EXCITED
        if excited and alike[k, other] > _ALIKE:
            note += f", which hardly tell it from {TERM_NAMES[fitted[other]]}"
        speeds = " at several speeds" if excited and term.manoeuvre in BY_SPEED else ""
        notes[term.name] = f"{note}: fly {term.manoeuvre}{speeds}"
    return notes


def missing_flying(names: Iterable[str], count: int) -> str:
    """A sentence on what to fly for parameters that were not identified; empty where all were.

    Args:
        names: of these parameters.
        count: of the parameters in the model.
    """
    manoeuvres = Counter(TERMS[TERM_INDEX[name]].manoeuvre for name in names)
    if not manoeuvres:
        return ""
    words = ", ".join(f"{manoeuvre} ({number})" for manoeuvre, number in manoeuvres.most_common())
    return (
        f"{manoeuvres.total()} of {count} parameters are not identified by these flights; "
        f"what would tell them, and how many: {words}"
    )


def delay_untold(range_s: tuple[float, float]) -> bool:
    """Whether flights that leave a range of delays of the rotor speeds [s] do not tell the delay."""
    low, high = range_s
    return low <= UNTOLD_DELAY_S and high - low >= _UNTOLD_RANGE_S


def delay_words(delay_s: float, range_s: tuple[float, float] | None, longest_s: float) -> str:
    """What flights tell of the delay of the rotor speeds.

    Args:
        delay_s: that is used.
        range_s: delays that the flights do not rule out; None where it was not kept.
        longest_s: delay that was tried.
    """
    words = f"rotor speeds act {delay_s * 1e3:g} ms after they were measured"
    low, high = (bound * 1e3 for bound in range_s or (delay_s, delay_s))
    longer = ", or later: no longer delay is tried" if high >= longest_s * 1e3 else ""
    if range_s is not None and delay_untold(range_s):
        return (
            f"rotor speeds are taken to act {delay_s * 1e3:g} ms after they were measured, as these flights "
            f"do not tell delays of {low:g} to {high:g} ms apart: fly fast rolls and pitches"
        )
    return words + (f" ({low:g} to {high:g} ms{longer})" if high > low else longer)
