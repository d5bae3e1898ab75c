# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flight logs: one file per format in `formats`, each giving a :class:`quadpi_core.flight.Recording`."""

from quadpi_core.logs.log_format import LogFormat
from quadpi_core.logs.readers import (
    blocks_of,
    decode_recording,
    identify_format,
    is_log_folder,
    open_in_blocks,
    read_recording,
    reading,
)

__all__ = [
    "LogFormat",
    "blocks_of",
    "decode_recording",
    "identify_format",
    "is_log_folder",
    "open_in_blocks",
    "read_recording",
    "reading",
]
