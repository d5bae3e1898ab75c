# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The sample rate of an IMU from the stamps of its samples in flight: measured in a second, then watched.

A rate is measured over the first second by :func:`quadpi_core.signals.resample.nominal_rate`, which jitter,
single lost samples and repeated stamps do not change. From then on every span of ten steps is compared with
it. Single spans are longer where samples were lost; the rate has changed when nearly all spans differ for
:data:`NOTICED_NS`. After a pause or a jump of the clock the rate is measured again: the driver may have
restarted.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.records import Records, record_dtype
from quadpi_core.signals.resample import RATE_SPAN

MEASURED_NS = compiled.MEASURED_NS
# Largest difference from a given rate, as a share of it: the cut-off of a low-pass designed for that rate,
# and the noise of the estimator, are off by as much.
RATE_TOLERANCE = 0.1
# Used until the rate is known; no sample is judged before.
RATE_BEFORE_HZ = 500.0
NOTICED_NS = compiled.NOTICED_NS


class ImuRate(NamedTuple):
    """What is known of the rate.

    Attributes:
        measured_hz: by the stamps; 0 while it is being measured.
        given_hz: by the user; 0 where the measured one counts.
        lost: whether it is being measured again, after a pause or a change.
    """

    measured_hz: float = 0.0
    given_hz: float = 0.0
    lost: bool = False

    @classmethod
    def from_meters(cls, meters: Records, given_hz: float) -> ImuRate:
        """The rate as a :class:`Meter` (1,) knows it now, beside the one given by the user."""
        span_ns = float(meters["span_ns"][0])
        return cls(1e9 * RATE_SPAN / span_ns if span_ns > 0.0 else 0.0, given_hz, bool(meters["lost"][0]))

    @property
    def differs(self) -> bool:
        """Whether the configured rate contradicts the measured one."""
        known = self.given_hz > 0.0 and self.measured_hz > 0.0
        return known and abs(self.measured_hz / self.given_hz - 1.0) > RATE_TOLERANCE

    @property
    def filter_hz(self) -> float:
        """The rate to design filters for; 0 where it is not known, or not the one that was given."""
        if self.measured_hz == 0.0 or self.differs:
            return 0.0
        return self.given_hz or self.measured_hz

    @property
    def begins(self) -> bool:
        """Whether the first second has not passed yet: nothing can be judged, and nothing is wrong."""
        return self.measured_hz == 0.0 and not self.lost

    def __str__(self) -> str:
        if self.differs:
            return f"stamps say {self.measured_hz:.0f} Hz, imu_rate_hz is {self.given_hz:g}"
        return f"{self.filter_hz:.4g} Hz" if self.filter_hz else "being measured"


class Meter:
    """What is remembered of the stamps."""

    span_ns: float  # usual time of ten steps; 0 while it is not known
    lost: bool  # whether the rate is being measured again, after a pause or a change
    changes: int  # how often `span_ns` or `lost` has changed
    count: int  # stamps since the measurement began
    newest_ns: int
    jumped_ns: int  # stamp of the previous sample, where that was far from all before it
    off_ns: int  # for how long nearly all spans have differed from the usual one
    stamps: Annotated[
        npt.NDArray[np.int64], compiled.METER_ROOM
    ]  # a ring of those since the measurement began


METER = record_dtype(Meter)
