# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Blackbox logs of any frames, as Betaflight's documentation lays them out."""

from __future__ import annotations

END = b"E\xffEnd of log\x00"


# Nothing but what any flight has.
PLAIN = {"loopIteration": (0, 1, 6, 9), "time": (0, 1, 2, 0)}


def log(fields, frames, *, more=(), end=END):
    """A flight of fields name: (predictor, encoding of I; of P), and the bytes of its frames."""
    names, columns = list(fields), list(zip(*fields.values(), strict=True))
    lines = ["Product:Blackbox flight data recorder by Nicholas Sherlock", "Data version:2"]
    lines.append(f"Field I name:{','.join(names)}")
    # All are signed but the first two.
    lines.append(f"Field I signed:{','.join(str(int(k > 1)) for k in range(len(names)))}")
    kinds = ("I predictor", "I encoding", "P predictor", "P encoding")
    for kind, numbers in zip(kinds, columns, strict=True):
        lines.append(f"Field {kind}:{','.join(map(str, numbers))}")
    lines += more
    return "".join(f"H {line}\n" for line in lines).encode() + b"".join(frames) + end


def unsigned(value):
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def signed(value):
    return unsigned((value << 1 ^ value >> 31) & 0xFFFFFFFF)


def intra(iteration, time, rest=b""):
    return b"I" + unsigned(iteration) + unsigned(time) + rest


def inter(jerk=0, rest=b""):
    """`jerk`: how far the time is off a straight line."""
    return b"P" + signed(jerk) + rest
