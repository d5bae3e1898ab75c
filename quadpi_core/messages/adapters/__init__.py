# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of other packages (mavros, PX4, motion capture) as the streams of the core.

None needs the package that defines the message: the layout comes from the definition that a bag embeds, or
that an installed package gives (:mod:`quadpi_ros.input_sources`).
"""

from quadpi_core.messages.adapters.adapter_definition import Adapter, Unpacker
from quadpi_core.messages.adapters.adapter_registry import known_adapters
from quadpi_core.messages.adapters.adapter_settings import AdapterSettings

__all__ = ["Adapter", "AdapterSettings", "Unpacker", "known_adapters"]
