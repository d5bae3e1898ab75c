# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The errors that quadpi reports to its user in one line, and what makes them of other errors."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# A terminal's worth: a damaged file may hold a name of megabytes.
_LONGEST = 1600


class QuadpiError(Exception):
    """A problem with what the user gave: the message says which file, topic and sample, and what to do.

    The command line prints the message alone and exits with status 2. Each package derives its own
    class, so that callers can tell a bad log from a bad model.
    """

    def __str__(self) -> str:
        """The message in one printable line of bounded length."""
        line = " ".join(super().__str__().splitlines())
        if not line.isprintable():
            line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
        if len(line) > _LONGEST:
            line = f"{line[: _LONGEST // 2]} … {line[-_LONGEST // 2 :]}"
        return line


class ArgumentError(QuadpiError):
    """A function of the library was called with what it does not take; see `quadpi_core.array_checks`."""


class VehicleError(QuadpiError):
    """A vehicle file is missing, incomplete or physically impossible."""


class LogError(QuadpiError):
    """A log or bag cannot be read, or what it holds cannot be used."""


class SampleError(LogError):
    """One sample among those decoded together cannot be used.

    Attributes:
        sample: its place among them, from 0.
        reason: what is wrong with it.
    """

    def __init__(self, sample: int, reason: str) -> None:
        super().__init__(f"sample {sample}: {reason}")
        self.sample = sample
        self.reason = reason

    def __reduce__(self) -> tuple[type[SampleError], tuple[int, str]]:
        """How processes hand it to each other."""
        return type(self), (self.sample, self.reason)

    def after(self, count: int) -> SampleError:
        """The same where `count` samples were decoded before."""
        return SampleError(count + self.sample, self.reason)


class SignalError(QuadpiError):
    """Signals cannot be aligned, filtered or fused."""


class ModelError(QuadpiError):
    """A model cannot be identified, loaded or applied."""


class SimulationError(QuadpiError):
    """A scenario, effect or sensor suite is impossible, or a simulated vehicle cannot fly it."""


class DiscrepancyError(QuadpiError):
    """A simulation and flights cannot be compared, or no effect can be looked for in them."""


class OutputError(QuadpiError):
    """A result cannot be written where it was asked for."""


@contextmanager
def named_in(where: str) -> Iterator[None]:
    """Put the file and key that refer to another file before an error in that other file."""
    try:
        yield
    except QuadpiError as error:
        error.args = (f"{where}: {error}",)
        raise


def one_line(error: BaseException) -> str:
    """The message of another library's error in one line, as part of ours."""
    return " ".join(str(error).split())


def require_library(module: str, extra: str) -> Any:
    """Import the module of a library that only some log formats, options or nodes need.

    Raises:
        LogError: naming the extra that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise LogError(
            f"this needs {library}, which the extra `{extra}` brings: pip install quadpi-monitor[{extra}] "
            f"({one_line(error)})"
        ) from error
