# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the pairing, see core/include/quadpi/monitor/pairing.hpp: rings of samples by topic."""

from __future__ import annotations

from typing import Annotated, NamedTuple, TypeAlias

from quadpi_core.estimator.imu_rate import Meter
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX, Records, record_dtype
from quadpi_core.signals.chain import RATES

# The topics.
IMU, STATE, ROTORS, WIND_TOPIC, TOPICS = 0, 1, 2, 3, 4
# A state, the first signals of a sample, or many rotors have the most numbers.
_WIDEST = max(RATES.stop, ROTORS_MAX)
# How a stretch begins: where the previous one ended; with a stamp more than MAX_JUMP_BACK_NS before the
# newest; with one that far before the stamp of the previous sample, as the IMU's clock was set back.
CONTINUES, STEPS_BACK, SET_BACK = 0, 1, 2


# What a monitor says of samples: their number, the stamps of its predictions, and the number of rows of the
# alarm that were raised.
Said: TypeAlias = tuple[int, list[int], int]
# What one more sample has completed: that, where it was judged; else how many samples may be taken.
Completed: TypeAlias = Said | int
NOTHING = -1


class Arriving(NamedTuple):
    """Samples in the order in which they arrive.

    Attributes:
        kind: (E,) topic of each, :data:`IMU`, ….
        row: (E,) its row in the arrays of that topic.
        imu_ns, specific_force: (N,), (N, 3).
        state_ns, states: (S,), (S, 10) velocity, attitude and rates; see :meth:`.pairing.Pairing.add_state`.
        rotor_ns, rotor_speeds: (R,), (R, rotors).
        wind_ns, wind: (W,), (W, 3).
    """

    kind: Stamps
    row: Stamps
    imu_ns: Stamps
    specific_force: Array
    state_ns: Stamps
    states: Array
    rotor_ns: Stamps
    rotor_speeds: Array
    wind_ns: Stamps
    wind: Array


class Track:
    """Where the last samples of a topic are in its ring; their stamps strictly increase."""

    oldest: int
    count: int
    newest_ns: int  # NO_STAMP before the first


class Entry:
    """A sample of a topic: as many of the numbers as it has are used."""

    time_ns: int
    values: Annotated[Array, _WIDEST]


class PairingState:
    """What the pairing remembers beside the rings."""

    tracks: Annotated[Records, Track, TOPICS]
    meter: Meter
    rotors: int
    timeout_ns: int
    # Of the IMU: the newest stamp since one stepped back, and that of the last sample. Of replays only.
    newest_ns: int
    last_ns: int
    rate_changes: int  # `meter.changes` at the last `compiled.take_samples`
    noted: bool  # whether the stamp at which a stretch begins has been noted
    # See pairing.PairingCounts.
    paired: int
    early: int
    dropped: int
    disordered: int


PAIRING_STATE, ENTRY = record_dtype(PairingState), record_dtype(Entry)


class Arrays(NamedTuple):
    """The memory of a pairing, which compiled code holds.

    Attributes:
        state: (1,) a :class:`PairingState`.
        rings: (TOPICS, capacity) each an :class:`Entry`.
    """

    state: Records
    rings: Records
