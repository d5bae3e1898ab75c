# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What an adapter is: a message type of another package, and its conversion to a stream."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError
from quadpi_core.findings import LeftOut
from quadpi_core.flight import Stamps, Stream
from quadpi_core.frames import Array
from quadpi_core.messages.adapters.adapter_settings import EXAMPLES, AdapterSettings
from quadpi_core.messages.cdr import Columns
from quadpi_core.messages.definitions import ForeignCodec, Items, foreign_codec
from quadpi_core.messages.payloads import Payloads
from quadpi_core.vehicle import Vehicle


class Reading(NamedTuple):
    """Converts decoded messages to a stream, and counts dropped ones.

    Attributes:
        read: (columns, items of arrays) gives the samples of the next messages.
        dropped: gives how many messages held none, by reason.
        left_out: (topic, stamp that times count from) gives the same for a flight's `quality`, where a sample
            was to be expected of each message.
    """

    read: Callable[[Columns, dict[str, Items]], Stream]
    dropped: Callable[[], Counter[str]]
    left_out: Callable[[str, int], Iterator[LeftOut]] | None = None


@dataclass(frozen=True)
class Adapter:
    """A message type of another package.

    Attributes:
        name: as a node's parameter names it.
        type_name: such as `px4_msgs/msg/EscStatus`.
        topic: where its package publishes it by default.
        kind: the stream that it gives, and the field of AdapterSettings that configures it: "rotor_speeds",
            "mocap", "odometry", "imu", "motor_commands", "battery", "pressure" or "temperature".
        columns: that the messages must have, those of items of arrays included: how many numbers each has per
            row, 0 for text, `cdr.ANY` for a sequence of numbers.
        start: (settings of its kind, vehicle) begins to read the messages of one topic.
        common: whether messages of this type hold many other things too, so that the topic must be named.
        battery: of motor commands, the adapter of the voltage that belongs to them, and its topic.
        without_attitude: of a state, whether its attitude must be the orientation of the IMU's messages.
    """

    name: str
    type_name: str
    topic: str
    kind: str
    columns: dict[str, int]
    start: Callable[[Any, Vehicle | None], Reading]
    common: bool = False
    battery: tuple[str, str] | None = None
    without_attitude: bool = False

    def open(self, definition: str, settings: AdapterSettings, vehicle: Vehicle | None) -> Unpacker:
        """Unpacker of the messages of this type on one topic.

        Args:
            definition: of the type and all that it contains (`ros2msg`), in the version that was sent.
            settings: must have those of this kind.
            vehicle: needed for electrical rotor speeds.

        Raises:
            LogError: for settings that are missing, and a version of the type that lacks a field.
            VehicleError: if the pole pairs are needed and not known.
        """
        stream_settings = getattr(settings, self.kind)
        if stream_settings is None:
            how = f"--mapping must say how, as in `{EXAMPLES.get(self.kind, f'{self.kind}: {{}}')}`"
            raise LogError(f"{self.type_name} needs settings for `{self.kind}`: {how}")
        try:
            stream_settings.require()
        except ValueError as error:
            raise LogError(f"{self.type_name} needs settings for `{self.kind}`: {error}") from error
        codec = foreign_codec(self.type_name, definition, tuple(self.columns.items()))
        return Unpacker(codec, self.start(stream_settings, vehicle))


class Unpacker:
    """Unpacks the messages of one topic in their order: all at once or one by one.

    Attributes:
        left_out: see :class:`Reading`.
    """

    def __init__(self, codec: ForeignCodec, reading: Reading) -> None:
        self._codec = codec
        self._reading = reading
        self.left_out = reading.left_out

    @property
    def dropped(self) -> Counter[str]:
        """Number of dropped messages by reason."""
        return self._reading.dropped()

    def unpack(self, payloads: Payloads | bytes) -> Stream:
        """The samples in N messages or one; fewer than N where messages hold none that can be used.

        Raises:
            LogError: naming the sample, for bytes that are no message of this type, or values that
                contradict each other.
        """
        columns, items = self._codec.decode(payloads)
        return self._reading.read(columns, items)


# Columns of a `std_msgs/Header`.
STAMP = {"header.stamp.sec": 1, "header.stamp.nanosec": 1}


def of_items(array: str, **members: int) -> dict[str, int]:
    """Columns of the items of an array of messages."""
    return {f"{array}.{member}": width for member, width in members.items()}


def start_of_numbers(
    column: str,
    stamps: Callable[[Columns], Stamps],
    stream: Callable[[Stamps, Array], Stream],
    is_known: Callable[[Array], npt.NDArray[np.bool_]],
    reason: str,
) -> Callable[[object, Vehicle | None], Reading]:
    """`Adapter.start` of messages with one number in a column; what is not known is dropped, and counted."""

    def start(_settings: object, _vehicle: Vehicle | None) -> Reading:
        dropped: Counter[str] = Counter()

        def read(columns: Columns, _items: object) -> Stream:
            values = columns[column].astype(np.float64)
            known = is_known(values)
            if not known.all():
                dropped[reason] += int(np.sum(~known))
            return stream(stamps(columns)[known], values[known])

        return Reading(read, lambda: dropped)

    return start
