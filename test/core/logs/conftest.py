# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink packets and logs of every autopilot for tests: written here, of one flight whose truth is known."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from benchmarks.fuzzing.flight_logs import Flown, Sender, blackbox, dataflash, hover, tlog, ulog


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


@pytest.fixture(scope="session")
def flown() -> Flown:
    """A second of hovering, slowly turning and drifting."""
    return hover()


@pytest.fixture(scope="session")
def autopilot_logs(flown: Flown) -> dict[str, bytes]:
    """The flight as a log of every format, by its suffix."""
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    return {
        ".BIN": dataflash(flown),
        ".ulg": ulog(flown),
        ".tlog": tlog(flown),
        ".bbl": blackbox(flown),
    }
