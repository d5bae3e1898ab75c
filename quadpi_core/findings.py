# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Problems found in the data of a flight: samples that were left out, and likely mistakes.

It goes along with the flight.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class LeftOut:
    """Samples of one topic that were left out, because no flight can have them.

    Attributes:
        topic: that they came on.
        limit: that they are beyond, in words.
        samples: how many were left out.
        of: how many the topic had.
        first: index of the first of them.
        first_s: its stamp, in seconds since the first IMU sample.
    """

    topic: str
    limit: str
    samples: int
    of: int
    first: int
    first_s: float

    def __str__(self) -> str:
        return (
            f"topic {self.topic}: left out {self.samples} of {self.of} samples {self.limit}; the first is "
            f"sample {self.first}, at {self.first_s:.3f} s"
        )


@dataclass(frozen=True)
class Finding:
    """A contradiction within a recording, or between it and its vehicle.

    Attributes:
        mistake: that explains it best, by its name in docs/mistakes.md.
        topic: that it shows in.
        text: what it looks like and the remedy, with numbers.
        certain: whether nothing else can explain it.
        leave_out: whether no model should learn from a flight that has it.
    """

    mistake: str
    topic: str
    text: str
    certain: bool = False
    leave_out: bool = False

    def __str__(self) -> str:
        return f"topic {self.topic}: {self.text}"


@dataclass(frozen=True)
class DataQuality:
    """Problems found in the data of one flight."""

    left_out: tuple[LeftOut, ...] = ()
    findings: tuple[Finding, ...] = ()

    def sentences(self) -> Iterator[str]:
        """In plain words, the topic first."""
        yield from map(str, (*self.left_out, *self.findings))

    @property
    def flaw(self) -> Finding | None:
        """The first finding for which a model should not learn from the flight; None without any."""
        return next((finding for finding in self.findings if finding.leave_out), None)

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {
            "left_out": [asdict(samples) for samples in self.left_out],
            "findings": [asdict(finding) for finding in self.findings],
        }


NOTHING_TO_SAY = DataQuality()
