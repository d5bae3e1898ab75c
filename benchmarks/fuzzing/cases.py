# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One case of fuzzing: make it from format, seed and number, read it, and judge the outcome."""

from __future__ import annotations

import random
import resource
import traceback
from pathlib import Path
from typing import NamedTuple

from benchmarks.fuzzing.formats import FORMATS, Format
from benchmarks.fuzzing.mutation import Finding
from quadpi_core.errors import QuadpiError

# Processor time of a case, beyond which SIGPROF ends its process: a hang.
SECONDS_MAX = 5.0
# By how much a case, whose files are of a few kilobytes, may raise the peak memory of its process.
MEMORY_MAX = 512 * 2**20


class Outcome(NamedTuple):
    """Result of a case.

    Attributes:
        kind: "read", "refused", or what is wrong: "traceback", "unnamed" (a refusal without the file),
            "passed" (values or times that are none of a flight), "memory", "crash", "hang".
        detail: description of what is wrong.
    """

    kind: str
    detail: str = ""

    @property
    def is_finding(self) -> bool:
        """Whether the reader misbehaved."""
        return self.kind not in {"read", "refused"}


def make(form: Format, seed: int, number: int) -> bytes:
    """The damaged bytes of a case."""
    return form.make(random.Random(f"{form.name}:{seed}:{number}"))


def judge(form: Format, data: bytes, number: int, folder: Path) -> Outcome:
    """Read damaged bytes from a file in a folder and judge the outcome."""
    path = folder / f"case{form.suffix}"
    path.write_bytes(data)
    peak_before = peak_bytes()
    try:
        form.read(path, number)
    except QuadpiError as error:
        text = str(error)
        if isinstance(error.__cause__, MemoryError):
            return Outcome("memory", text)
        if "\n" in text or (form.names_file and path.name not in text):
            return Outcome("unnamed", text)
    except Finding as finding:
        return Outcome("passed", str(finding))
    except MemoryError as error:
        return Outcome("memory", _place(error))
    except Exception as error:  # any other exception is a finding
        return Outcome("traceback", _place(error))
    else:
        return _within_memory("read", peak_before)
    return _within_memory("refused", peak_before)


def peak_bytes() -> int:
    """Peak memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _within_memory(kind: str, peak_before: int) -> Outcome:
    grown = peak_bytes() - peak_before
    return Outcome("memory", f"{grown / 2**20:.0f} MiB") if grown > MEMORY_MAX else Outcome(kind)


def _place(error: BaseException) -> str:
    """The error and the innermost place in quadpi_core that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "quadpi_core" in frame.filename] or frames
    last = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
    return f"{type(error).__name__} {str(error)[:120]} at {last}"


def parse_case(text: str) -> tuple[Format, int, int]:
    """Format, seed and number of a case written as `mcap:0:1234`.

    Raises:
        ValueError: for a malformed case or an unknown format.
    """
    name, seed, number = text.split(":")
    if name not in FORMATS:
        raise ValueError(f"{name}: not one of {', '.join(FORMATS)}")
    return FORMATS[name], int(seed), int(number)
