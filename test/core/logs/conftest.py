# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink packets for tests, packed by pymavlink."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest


class Sender:
    """One system; numbers its packets, and signs them if there is a key."""

    def __init__(self, system: int = 1, component: int = 1, key: bytes | None = None) -> None:
        from quadpi_core.logs.mavlink_dialect import load_dialect

        self.dialect = load_dialect()
        self.mav = self.dialect.MAVLink(None, system, component)
        self.kinds = {kind.msgname: kind for kind in self.dialect.mavlink_map.values()}
        if key:
            self.mav.signing.secret_key = key
            self.mav.signing.sign_outgoing = True

    def packet(self, name: str, *values: Any, version: int = 2) -> bytes:
        """A packet of a message by its fields in the order of the XML; extensions may be left out."""
        packed = self.kinds[name](*values).pack(self.mav, force_mavlink1=version == 1)
        self.mav.seq = (self.mav.seq + 1) % 256
        return bytes(packed)

    def raw(self, kind: Any, payload: bytes) -> bytes:
        """A packet of a message with any payload."""
        head = bytes((0xFD, len(payload), 0, 0, 0, 1, 1)) + kind.id.to_bytes(3, "little")
        checksum = self.dialect.x25crc(head[1:] + payload + bytes((kind.crc_extra,))).crc
        return head + payload + checksum.to_bytes(2, "little")


@pytest.fixture(scope="session")
def mavlink_sender() -> type[Sender]:
    """A class whose instances pack messages."""
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    return Sender


@pytest.fixture(scope="session")
def mavlink_message(mavlink_sender: type[Sender]) -> Callable[..., Any]:
    """What the decoder makes of one message, by its name and fields."""

    def decoded(name: str, *values: Any) -> Any:
        from quadpi_core.logs.mavlink_frames import Framer, MessageDecoder

        (frame,) = Framer().feed(mavlink_sender().packet(name, *values), complete=True)
        return MessageDecoder().decode(frame)

    return decoded
