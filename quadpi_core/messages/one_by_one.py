# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages one by one, as live nodes exchange them: each is read or written in the buffer of the one before.

A node takes and gives thousands of messages a second that differ only in their stamp and the float64 fields
that end them. Arrays of its own for each message cost four times as much.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic

import numpy as np

from quadpi_core.flight import ImuStream
from quadpi_core.frames import Array
from quadpi_core.messages.cdr import NANOSECONDS, ORIGIN, STAMP, Codec, no_stamp
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.frame_ids import BodyFrames, Judge, judged, names_of
from quadpi_core.messages.mounting import Mounting
from quadpi_core.messages.payloads import Bytes
from quadpi_core.messages.sensor_messages import STAMP_END, SampleKind, SomeStream, require_rotations

_DOUBLE_BYTES = 8


class IncomingMessage(Generic[SomeStream]):
    """Unpacks the messages of one topic and does what their frames ask for.

    Layout and frames are judged where they change; of most messages a few bytes are compared.

    Args:
        kind: of the messages.
        judge: such as :meth:`BodyFrames.imu`; none for messages whose frame does not matter.
        frames: that it belongs to.
    """

    def __init__(
        self,
        kind: SampleKind[SomeStream],
        judge: Judge | Callable[[tuple[str, ...]], None] = lambda _: None,
        frames: BodyFrames | None = None,
    ) -> None:
        self._kind = kind
        self._judge = judge
        self._transforms = (frames or BodyFrames()).transforms
        self._judged_at = -1
        self._size = self._end = 0
        self._known = self._count = b""
        self._counted = slice(0)
        self._mounting: Mounting | None = None

    def __call__(self, payload: bytes) -> SomeStream:
        """The sample in a message; the next message overwrites it.

        Raises:
            SampleError: for bytes that are no message of the type, another number of values than the kind's,
                a stamp or an orientation that is none, or saying which frame cannot be used, and why.
        """
        if (
            payload[STAMP_END : self._end] != self._known
            or len(payload) != self._size
            or payload[self._counted] != self._count
            or payload[:2] != b"\x00\x01"
            or self._judged_at != self._transforms.changes
        ):
            self._meet(payload)
        seconds, nanoseconds = STAMP.unpack_from(payload, ORIGIN)
        if nanoseconds >= NANOSECONDS:
            raise no_stamp(0, nanoseconds)
        self._memory[:] = payload
        stream = self._stream
        stream.time_ns[0] = seconds * NANOSECONDS + nanoseconds
        require_rotations(self._kind.fill(self._values, stream), self._values)
        if self._mounting is not None:
            assert isinstance(stream, ImuStream)
            self._mounting.move(stream.time_ns, stream.angular_velocity, stream.specific_force)
        return stream

    def _meet(self, payload: bytes) -> None:
        """Prepare for messages of this length and these frames."""
        self._judged_at = -1
        layout = codec(self._kind.type_name).layout_of(payload, 0)
        layout.require(self._kind.counts, 0)
        names, self._end = names_of(payload, self._kind.texts)
        self._mounting = judged(self._judge, names, 0, self._mounting)
        buffer, self._values = _buffer(len(payload), layout.doubles)
        self._memory = buffer.data
        self._stream = self._kind.room(np.zeros(1, dtype=np.int64), names)
        self._size = len(payload)
        # Without the padding behind the names, which writers leave as it happens to be.
        self._known = payload[STAMP_END : self._end]
        if layout.counts:
            # A sequence of numbers ends the message.
            self._counted, self._count = layout.last_length
        self._judged_at = self._transforms.changes


class OutgoingMessage:
    """A message that is written again and again.

    Args:
        codec: of the message, which has a header.
        constants: its fields that stay the same, with their values.

    Attributes:
        values: (1, K) the float64 fields that end the message, to be filled.
    """

    def __init__(self, codec: Codec, constants: tuple[tuple[str, str | float], ...]) -> None:
        layout, template = codec.template(constants)
        buffer, self.values = _buffer(template.size, layout.doubles)
        buffer[:] = template
        self._memory = buffer.data
        assert layout.dtype.fields
        self._stamp = layout.dtype.fields["header.stamp.sec"][1]

    def stamped(self, time_ns: int) -> bytes:
        """The message with its present values and a stamp."""
        STAMP.pack_into(self._memory, self._stamp, *divmod(time_ns, NANOSECONDS))
        return self._memory.tobytes()


def _buffer(size: int, doubles: slice) -> tuple[Bytes, Array]:
    """Room for a message, where its float64 fields are aligned, and a view (1, K) of these."""
    room = np.zeros(size + _DOUBLE_BYTES, dtype=np.uint8)
    start = -(room.ctypes.data + doubles.start) % _DOUBLE_BYTES
    buffer = room[start : start + size]
    return buffer, buffer[doubles].view(np.float64).reshape(1, -1)
