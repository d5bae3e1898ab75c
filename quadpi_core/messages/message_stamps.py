# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps as they stand in messages, as nanoseconds."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import SampleError
from quadpi_core.flight import Stamps
from quadpi_core.messages.cdr import Columns

_NANOSECONDS = 1_000_000_000
_MICROSECOND = 1_000
_LAST_US = np.iinfo(np.int64).max // _MICROSECOND


def header_stamps(columns: Columns, prefix: str = "header.stamp.") -> Stamps:
    """Stamps (N,) from the columns of a builtin_interfaces/Time.

    Raises:
        SampleError: naming the sample, for a stamp that is none.
    """
    nanoseconds = columns[f"{prefix}nanosec"]
    _check(nanoseconds < _NANOSECONDS, nanoseconds, "ns beyond its second")
    stamps: Stamps = columns[f"{prefix}sec"].astype(np.int64) * _NANOSECONDS + nanoseconds
    return stamps


def microsecond_stamps(microseconds: npt.NDArray[np.uint64]) -> Stamps:
    """Stamps (N,) of a clock that counts microseconds.

    Raises:
        SampleError: naming the sample, for a stamp that nanoseconds cannot hold.
    """
    _check(microseconds <= _LAST_US, microseconds, "µs")
    return microseconds.astype(np.int64) * _MICROSECOND


def _check(usable: npt.NDArray[np.bool_], value: npt.NDArray[np.unsignedinteger], unit: str) -> None:
    if not usable.all():
        sample = int(np.argmin(usable))
        raise SampleError(sample, f"the stamp has {value[sample]} {unit}")
