# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Axes of a message's values from its frame_id; one rule for live messages and bags.

A world whose name says `ned`, as a word of it (`map_ned`, `ned_world`, `odomNED`), is not the east-north-up
that these messages are read in: refused. An IMU in another frame than the body's is turned, and moved by its
lever arm, where static transforms lead from its frame to the body's. Without transforms, a frame whose name
ends in `frd` is rotated by half a turn about x, one that says `ned` is refused, and any other is taken as the
body's, with a warning; where `strict`, it is refused, and so is any `frd` but the body's own. An empty
frame_id is taken as the expected frame.
"""

from __future__ import annotations

import logging
import re
import struct
import time
from collections.abc import Callable, Iterator
from functools import cache
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from quadpi_core.core import matrix_times
from quadpi_core.errors import LogError, SampleError
from quadpi_core.flight import ImuStream
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.messages.cdr import ORIGIN
from quadpi_core.messages.definitions import ForeignCodec, standard_types
from quadpi_core.messages.mounting import Mounting
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.sensor_messages import BODY_FRAME, STAMP_END, without_namespace

_log = logging.getLogger(__name__)

TF_TYPE = "tf2_msgs/msg/TFMessage"
TF_TOPIC = "tf_static"
# Largest error of the norm of a quaternion in a transform.
_NORM_TOLERANCE = 0.01
_LENGTH = struct.Struct("<I")
# As a word of the last part of a name: `tuned` and `NedKelly1` are others.
_DOWN = re.compile(
    r"(?:(?<![A-Za-z])(?i:ned)|(?<=[a-z])(?:NED|Ned))(?![a-z])[^/]*$|(?i:north_?east_?down)[^/]*$"
)
_RIGHT_DOWN = re.compile(r"(?:^|[^a-z])frd$", re.I)
_WINDOW = 64
# Rotation between FRD and FLU in both directions: half a turn about x.
_HALF_TURN = np.diag([1.0, -1.0, -1.0])

_TRANSFORM = ("transform.translation", "transform.rotation")

Content = TypeVar("Content")
Judge = Callable[[tuple[str, ...]], Mounting | None]


class Transform(NamedTuple):
    """Transform between frames: rotation (3, 3) of vectors, position (3,) m of the source's origin."""

    rotation: Array
    translation: Array

    def then(self, other: Transform) -> Transform:
        """This transform followed by another."""
        return Transform(
            matrix_times(other.rotation, self.rotation),
            matrix_times(other.rotation, self.translation) + other.translation,
        )

    def inverse(self) -> Transform:
        """The inverse transform."""
        return Transform(self.rotation.T, -matrix_times(self.rotation.T, self.translation))


def plain_name(frame: str) -> str:
    """Name of a frame without the leading slash of early tf."""
    return frame.strip("/")


@cache
def _transforms() -> ForeignCodec:
    wanted = {"header.frame_id": 0, "child_frame_id": 0, _TRANSFORM[0]: 3, _TRANSFORM[1]: 4}
    return ForeignCodec(
        TF_TYPE, standard_types(), {f"transforms.{path}": width for path, width in wanted.items()}
    )


class StaticTransforms:
    """Tree of static transforms.

    Attributes:
        changes: number of messages added.
    """

    def __init__(self) -> None:
        self.changes = 0
        self._to: dict[str, dict[str, Transform]] = {}

    def take(self, message: bytes) -> None:
        """Add a serialized tf2_msgs/TFMessage; later transforms replace earlier ones between the same frames.

        Raises:
            LogError: for invalid bytes; for an invalid rotation, after the other transforms were added.
        """
        try:
            columns = _transforms().decode(message)[1]["transforms"].columns
        except SampleError as error:
            raise LogError(f"its {len(message)} bytes are no {TF_TYPE}") from error
        wrong = []
        for frame, child_frame, translation, x_y_z_w in zip(
            *(columns[path] for path in ("header.frame_id", "child_frame_id", *_TRANSFORM)), strict=True
        ):
            parent, child = (plain_name(name.decode()) for name in (frame, child_frame))
            quaternion = np.roll(x_y_z_w, 1)
            norm = float(np.sqrt(np.sum(np.square(quaternion))))
            if not (abs(norm - 1.0) <= _NORM_TOLERANCE and np.isfinite(translation).all()):
                wrong.append(
                    f"the transform from {parent} to {child} is none (quaternion of norm {norm:.3g})"
                )
                continue
            transform = Transform(rotation_matrix(quaternion / norm), translation)
            self._to.setdefault(child, {})[parent] = transform
            self._to.setdefault(parent, {})[child] = transform.inverse()
        self.changes += 1
        if wrong:
            raise LogError(wrong[0])

    def between(self, source: str, target: str) -> Transform | None:
        """Transform from one frame to another, through others if necessary; None without a path."""
        reached = {source: Transform(np.eye(3), np.zeros(3))}
        waiting = [source]
        while waiting and target not in reached:
            frame = waiting.pop(0)
            for following, transform in self._to.get(frame, {}).items():
                if following not in reached:
                    reached[following] = reached[frame].then(transform)
                    waiting.append(following)
        return reached.get(target)


class FrameRefusedError(Exception):
    """Why messages of a frame cannot be used."""


class BodyFrames:
    """Decides how frames relate to the body's, from their names and static transforms.

    Args:
        body_frame: frame_id of the body, forward-left-up; the last part of its name counts.
        strict: refuse an IMU in a frame without a known relation to the body's.
        patience_s: time to wait for transforms, from the first sample that needs one.
        hint: possible reason for missing transforms, for messages.
        warn: called once for each frame that is taken as the body's.

    Attributes:
        transforms: static transforms; more may be added at any time.
    """

    def __init__(
        self,
        body_frame: str = BODY_FRAME,
        *,
        strict: bool = False,
        patience_s: float = 0.0,
        hint: str = "",
        warn: Callable[[str], object] = _log.warning,
    ) -> None:
        self.transforms = StaticTransforms()
        self._body = plain_name(body_frame)
        self._strict = strict
        self._patience_s = patience_s
        self._hint = hint
        self._warn = warn
        self._warned: set[str] = set()
        self._since_s: float | None = None

    def imu(self, frames: tuple[str, ...]) -> Mounting | None:
        """Mounting of an IMU with these frames; None where they are the body's."""
        frame = plain_name(frames[0])
        if not frame or without_namespace(frame) == without_namespace(self._body):
            return None
        transform = self.transforms.between(frame, self._body)
        if transform is not None:
            return Mounting(_HALF_TURN @ transform.rotation @ _HALF_TURN, _HALF_TURN @ transform.translation)
        if _DOWN.search(frame):
            raise FrameRefusedError(
                f"the frame `{frame}` of an IMU says north-east-down: its axes are the body's"
            )
        named = f"the frame `{frame}` is not the body's, `{self._body}`"
        of_body = without_namespace(frame).lower() == f"{without_namespace(self._body)}_frd".lower()
        if of_body or (_RIGHT_DOWN.search(frame) and not self._strict):
            return Mounting(_HALF_TURN, np.zeros(3))
        if self._waits():
            raise FrameRefusedError(f"{named}: waiting for a static transform")
        alone = f"{named}, and no static transform leads there{self._hint}"
        if self._strict:
            raise FrameRefusedError(alone)
        if frame not in self._warned:
            self._warned.add(frame)
            self._warn(f"{alone}: taken as the body's")
        return None

    @staticmethod
    def world(frames: tuple[str, ...]) -> None:
        """Check the frame of a pose, a velocity or the wind, and the child frame where there is one."""
        if _DOWN.search(frames[0]):
            raise FrameRefusedError(
                f"the frame `{frames[0]}` says north-east-down: east-north-up is expected"
            )
        for frame in frames[1:]:
            if _DOWN.search(frame) or _RIGHT_DOWN.search(frame):
                raise FrameRefusedError(f"the child frame `{frame}` says z down: forward-left-up is expected")

    def _waits(self) -> bool:
        now_s = time.monotonic()
        if self._since_s is None:
            self._since_s = now_s
        return now_s - self._since_s < self._patience_s


def judged(
    judge: Judge | Callable[[tuple[str, ...]], None],
    frames: tuple[str, ...],
    sample: int,
    before: Mounting | None,
) -> Mounting | None:
    """The mounting that a judge gives of the frames of a sample; the one before where it is the same.

    Raises:
        SampleError: naming a frame that cannot be used, and why.
    """
    try:
        mounting = judge(frames)
    except FrameRefusedError as refused:
        raise SampleError(sample, str(refused)) from refused
    return mounting and mounting.or_same(before)


class Framed(Generic[Content]):
    """Unpacks the messages of a topic in their order, and applies their frames.

    The frames are judged where they change. See :class:`.one_by_one.IncomingMessage` for live messages.

    Args:
        unpack: of N messages.
        judge: such as :meth:`BodyFrames.imu`.
        texts: number of names behind the stamp: 2 with a child frame.
    """

    def __init__(
        self,
        unpack: Callable[[Payloads], Content],
        judge: Judge | Callable[[tuple[str, ...]], None],
        texts: int = 1,
    ) -> None:
        self._unpack = unpack
        self._judge = judge
        self._texts = texts
        self._mounting: Mounting | None = None

    def __call__(self, payloads: Payloads) -> Content:
        """The samples.

        Raises:
            SampleError: naming a frame that cannot be used, and why.
            LogError: as `unpack` does.
        """
        content = self._unpack(payloads)
        for run in self._runs(payloads):
            names, _ = names_of(payloads[run.start], self._texts)
            self._mounting = judged(self._judge, names, run.start, self._mounting)
            if self._mounting is not None:
                assert isinstance(content, ImuStream)
                rates, force = content.angular_velocity[run], content.specific_force[run]
                self._mounting.move(content.time_ns[run], rates, force)
        return content

    def _runs(self, payloads: Payloads) -> Iterator[slice]:
        """Runs of messages with the same frames, found in windows that grow with a run."""
        start = 0
        while start < len(payloads):
            end = names_of(payloads[start], self._texts)[1]
            head = np.frombuffer(payloads[start], dtype=np.uint8, count=end)[STAMP_END:]
            stop, window = start + 1, _WINDOW
            while stop < len(payloads):
                following = np.arange(stop, min(stop + window, len(payloads)))
                same = payloads.lengths[following] >= end
                same[same] = (payloads.rows(following[same], end)[:, STAMP_END:] == head).all(axis=1)
                if not same.all():
                    stop += int(np.argmin(same))
                    break
                stop, window = int(following[-1]) + 1, 2 * window
            yield slice(start, stop)
            start = stop


def names_of(message: bytes, count: int) -> tuple[tuple[str, ...], int]:
    """Strings behind the stamp of a message with a valid layout, and the position behind them."""
    names, place = [], STAMP_END
    for _ in range(count):
        place = ORIGIN - (ORIGIN - place) // _LENGTH.size * _LENGTH.size
        (length,) = _LENGTH.unpack_from(message, place)
        place += _LENGTH.size + length
        names.append(message[place - length : place].rstrip(b"\0").decode(errors="replace"))
    return tuple(names), place
