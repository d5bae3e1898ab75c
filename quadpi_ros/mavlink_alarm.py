# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a pilot is told of the alarm over MAVLink: reasons as text, a change of the vehicle as a number.

Source: mavlink.io, common message set: STATUSTEXT (253), NAMED_VALUE_FLOAT (251).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from quadpi_core.results import (
    CAUSES,
    CHANGED_CENTRE_FORWARD,
    CHANGED_CENTRE_RIGHT,
    CHANGED_FORCE_FORWARD,
    CHANGED_FORCE_RIGHT,
    CHANGED_MASS,
    CHANGED_ROTOR,
    LEVEL_ALARM,
    ReportedAlarms,
)

# Bytes of a STATUSTEXT, and severities of MAVLink: a failure that needs care, and what is normal but worth a
# word.
_TEXT_BYTES, _CRITICAL, _NOTICE = 50, 2, 5
# Reasons of an alarm that are told, the first ones.
_REASONS = 2
# A cause that comes again sooner [ns] is told after that long, if it stands then; a number at most so often.
_AGAIN_NS, _NUMBER_NS = 5_000_000_000, 1_000_000_000
# Names of at most ten letters, with the unit, and the factor to it.
_NUMBERS = {
    CHANGED_MASS: ("add_g", 1e3),
    CHANGED_FORCE_FORWARD: ("push_fwd_N", 1.0),
    CHANGED_FORCE_RIGHT: ("push_rgt_N", 1.0),
    CHANGED_CENTRE_FORWARD: ("cg_fwd_mm", 1e3),
    CHANGED_CENTRE_RIGHT: ("cg_rgt_mm", 1e3),
    CHANGED_ROTOR: ("rotor{}_pc", 1e2),
}


class Text(NamedTuple):
    """A piece of a STATUSTEXT."""

    severity: int
    text: bytes
    number: int  # of the text, the same for its pieces
    piece: int


class Number(NamedTuple):
    """A NAMED_VALUE_FLOAT."""

    name: bytes
    value: float


class AlarmTold:
    """Follows alarm messages, which repeat at a steady rate, and tells what is new."""

    def __init__(self) -> None:
        # What was told, and stands.
        self._standing: set[object] = set()
        self._told_ns: dict[object, int] = {}
        self._number_ns = 0
        self._texts = 0

    def take(self, alarms: ReportedAlarms, now_ns: int) -> Iterator[Text | Number]:
        """What is to be sent because of alarm messages."""
        for row in range(len(alarms)):
            raised: set[object] = {
                cause
                for cause, level in zip(CAUSES, alarms.cause_level[row], strict=True)
                if level == LEVEL_ALARM
            }
            kind, rotor = int(alarms.changed[row]), int(alarms.changed_rotor[row])
            if kind in _NUMBERS:
                # What has changed may be named anew while the alarm stands.
                raised.add(("change", kind, rotor))
            # In the future is what was told before the clock was set back.
            if any(
                one not in self._told_ns or not 0 <= now_ns - self._told_ns[one] < _AGAIN_NS
                for one in raised - self._standing
            ):
                self._standing = raised
                self._told_ns |= dict.fromkeys(raised, now_ns)
                yield from self._text(_CRITICAL, "ALARM: " + "; ".join(alarms.reasons[row][:_REASONS]))
            elif self._standing and not raised:
                yield from self._text(_NOTICE, "quadpi: the alarm is over")
            self._standing = self._standing & raised
            if kind in _NUMBERS and not 0 <= now_ns - self._number_ns < _NUMBER_NS:
                self._number_ns = now_ns
                name, factor = _NUMBERS[kind]
                yield Number(name.format(rotor).encode(), factor * float(alarms.change_size[row]))

    def _text(self, severity: int, words: str) -> Iterator[Text]:
        """A text in pieces, of which a zero ends the last; old ground stations know ASCII alone."""
        whole = words.replace("±", "+-").encode("ascii", "replace")
        self._texts = self._texts % 0xFFFF + 1
        for piece, start in enumerate(range(0, len(whole) + 1, _TEXT_BYTES)):
            yield Text(severity, whole[start : start + _TEXT_BYTES], self._texts, piece)
