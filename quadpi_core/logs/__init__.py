# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flight logs: one reader per format, each giving a :class:`quadpi_core.flight.Recording`."""

from quadpi_core.logs.readers import (
    FORMATS,
    LogFormat,
    blocks_of,
    decode_recording,
    identify_format,
    read_recording,
    reading,
)

__all__ = [
    "FORMATS",
    "LogFormat",
    "blocks_of",
    "decode_recording",
    "identify_format",
    "read_recording",
    "reading",
]
