# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of quadpi as earlier versions defined them, rewritten as they are defined now.

Rotor speeds were four numbers, and now are as many as the vehicle has rotors. A WrenchPrediction had the same
numbers in the same order under other names, so that its bytes are those of today.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np

from quadpi_core.errors import LogError, SampleError
from quadpi_core.messages.cdr import Codec, Field
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.sensor_messages import ERPM, ROTOR_SPEEDS

# The field that was an array of four, by type.
_WERE_FOUR = {ROTOR_SPEEDS: "rotor_speeds", ERPM: "erpm"}
_FOUR = 4
_FIXED = re.compile(rf"^\s*float64\[{_FOUR}\]\s", re.MULTILINE)


def is_earlier(type_name: str, definition: str) -> bool:
    """Whether messages of a type, with the definition that their bag embeds, must be rewritten."""
    return type_name in _WERE_FOUR and _FIXED.search(definition) is not None


def rewritten(topic: Topic, before: int = 0) -> Topic:
    """A topic of an earlier definition, for which :func:`is_earlier` holds, as it is defined now.

    Args:
        topic: its messages, or some of them.
        before: how many messages of the topic came before these.

    Raises:
        LogError: naming topic and sample, for bytes that are no message of the earlier definition.
    """
    try:
        columns = _earlier_codec(topic.type_name).decode(topic.payloads)
    except SampleError as error:
        raise LogError(f"topic {topic.name}: {error.after(before)}") from error
    frames = columns.pop("header.frame_id")
    parts, orders = [Payloads.join([])], [np.empty(0, dtype=np.int64)]
    for frame in np.unique(frames):
        rows = np.flatnonzero(frames == frame)
        of_frame = {name: column[rows] for name, column in columns.items()}
        of_frame["header.frame_id"] = frame.decode(errors="replace")
        parts.append(codec(topic.type_name).encode(len(rows), of_frame))
        orders.append(rows)
    payloads = Payloads.concatenate(parts).take(np.argsort(np.concatenate(orders)))
    return replace(topic, payloads=payloads)


@cache
def _earlier_codec(type_name: str) -> Codec:
    header = (
        Field("header.stamp.sec", "<i4"),
        Field("header.stamp.nanosec", "<u4"),
        Field("header.frame_id", "string"),
    )
    return Codec(type_name, (*header, Field(_WERE_FOUR[type_name], "<f8", _FOUR)))
