# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where the inputs of a node come from: standard topics, or messages of other packages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from quadpi_core.errors import QuadpiError
from quadpi_core.messages.adapters import ADAPTERS, AdapterSettings
from quadpi_core.vehicle import Vehicle
from quadpi_ros.foreign_messages import AdapterError, adapted
from quadpi_ros.parameters import ParameterError


class Source(NamedTuple):
    """A topic, and how its messages become streams of one sample; the first arguments of `listen`."""

    message_type: type
    topic: str
    unpack: Callable[[bytes], Any]


def adapters_of(kind: str) -> tuple[str, ...]:
    """Names of the adapters that give a kind of stream, as further choices of a parameter."""
    return tuple(name for name, adapter in ADAPTERS.items() if adapter.kind == kind)


class AdaptedSources:
    """Inputs that come as messages of other packages, read as a file says.

    Args:
        node: its name, for errors.
        file: parameter `adapters`: a name in config/adapters or a path; empty for none.
        vehicle: that flies.

    Raises:
        LogError: for a file that cannot be used.
    """

    def __init__(self, node: str, file: str, vehicle: Vehicle) -> None:
        self._node = node
        self._file = file
        self._vehicle = vehicle
        self._settings = AdapterSettings.load(file) if file else AdapterSettings()

    def named(self, name: str) -> Source:
        """The messages of the adapter of that name.

        Raises:
            ParameterError: if no file says how to read them.
            AdapterError: if the package that defines them is not installed, or the file does not fit.
        """
        if not self._file:
            raise ParameterError(
                f"node {self._node}: parameter `adapters` is required for `{name}`: "
                "the file that says how its messages are read"
            )
        try:
            subscription = adapted(name, self._settings, self._vehicle)
        except AdapterError:
            raise
        except QuadpiError as error:
            raise AdapterError(f"{self._file}: {error}") from error
        return Source(subscription.message_type, subscription.topic, subscription.unpack)

    def instead_of(self, standard: Source, kind: str) -> Source:
        """The messages of the only adapter of a kind if the file lists that kind, else the standard topic.

        Raises:
            AdapterError: see :meth:`named`.
        """
        if getattr(self._settings, kind) is None:
            return standard
        (name,) = adapters_of(kind)
        return self.named(name)
