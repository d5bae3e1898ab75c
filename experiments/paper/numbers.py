# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of van Beers and de Visser, as they are published."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

# Winds in m/s; the models are identified on the first group.
GROUPS = {"identification": (0.0, 5.0, 10.0), "interpolation": (8.0,), "extrapolation": (14.0,)}

# Tables of the force and the moment models: PICP and MPIW over the range of the data, each on the training
# data, under model variation and under measurement variation, in percent.
_VALIDATION_TABLES = """
Fx bootstrap       96.36 100.00 97.24  3.26  6.97  6.09
Fx quality-driven  97.18 100.00 97.84  3.46  7.00  6.28
Fx polynomial      97.59 100.00 96.89  3.95  6.30  5.63
Fy bootstrap       95.78 100.00 96.76  3.15  6.16  5.95
Fy quality-driven  97.54 100.00 98.33  3.60  7.28  7.08
Fy polynomial      96.74 100.00 96.51  3.82  5.67  5.61
Fz bootstrap       97.52  99.99 98.90  5.37  7.62  6.12
Fz quality-driven  97.59 100.00 99.40  3.02  9.25  6.92
Fz polynomial      96.68 100.00 99.94  8.13 27.32 21.78
Mx bootstrap       96.05  98.63 97.67  2.40  3.83  3.84
Mx quality-driven  98.51  99.55 98.40  2.96  3.87  3.81
Mx polynomial      96.22  98.75 98.29  3.14  5.58  5.80
My bootstrap       96.84  98.26 97.89  2.76  5.76  6.39
My quality-driven  99.13  99.65 98.84  3.75  6.11  7.20
My polynomial      96.04  98.54 98.00  2.95  7.19  8.18
Mz bootstrap       98.05 100.00 98.85  6.36  8.77  8.41
Mz quality-driven  97.86 100.00 97.89  5.28  7.08  6.57
Mz polynomial      96.75 100.00 96.92  4.64  6.00  5.77
"""
# Table of the HDBeetle: PICP in percent, and MPIW in N or Nm, of each group.
_TUNNEL_TABLE = """
Fx bootstrap       98.26 97.35  97.15 0.89 0.77 1.26
Fx quality-driven  98.25 97.30  96.97 0.89 0.77 1.20
Fx polynomial      95.29 96.06  89.19 0.83 0.83 0.83
Fz bootstrap       98.04 97.79  39.21 0.73 0.69 1.06
Fz quality-driven  97.98 97.78  33.48 0.71 0.69 1.03
Fz polynomial      95.70 97.54  75.85 0.69 0.69 0.69
My bootstrap       99.95 99.97 100.00 0.06 0.04 0.08
My quality-driven  99.79 99.84  99.85 0.04 0.03 0.05
My polynomial      97.15 97.31  98.92 0.02 0.02 0.02
"""


def _rows(table: str) -> Iterator[tuple[str, str, list[float], list[float]]]:
    """Method, axis, three coverages as fractions and three widths of each line."""
    for line in table.split("\n")[1:-1]:
        axis, method, *cells = line.split()
        yield (
            method,
            axis,
            [_fraction(float(cell)) for cell in cells[:3]],
            [float(cell) for cell in cells[3:]],
        )


def _fraction(percent: float) -> float:
    """Rounded to the digits that the paper states."""
    return round(percent / 100.0, 4)


# In the order of the tables.
METHODS = tuple(dict.fromkeys(method for method, *_ in _rows(_TUNNEL_TABLE)))


@dataclass(frozen=True)
class CoverageAndWidth:
    """Coverage, and mean width over the range of the covered quantity, as fractions."""

    picp: float
    nmpiw: float


@dataclass(frozen=True)
class PublishedAxis:
    """Published numbers of one axis: on the training flights, and under each variation."""

    training: CoverageAndWidth
    model_variation: CoverageAndWidth
    measurement_variation: CoverageAndWidth


@dataclass(frozen=True)
class TunnelCoverage:
    """Coverage as a fraction, and mean width in N or Nm."""

    picp: float
    mpiw: float


def validation_numbers() -> dict[str, dict[str, PublishedAxis]]:
    """Coverage and width that the paper states under noise, by method and axis."""
    tables: dict[str, dict[str, PublishedAxis]] = {method: {} for method in METHODS}
    for method, axis, coverages, widths in _rows(_VALIDATION_TABLES):
        pairs = zip(coverages, widths, strict=True)
        tables[method][axis] = PublishedAxis(
            *(CoverageAndWidth(picp, _fraction(width)) for picp, width in pairs)
        )
    return tables


def tunnel_numbers() -> dict[str, dict[str, dict[str, TunnelCoverage]]]:
    """Coverage and width that the paper states in the wind tunnel, by method, axis and group.

    The text says that 0, 5 and 10 m/s are the identification data, the caption of the table 10 m/s alone.
    """
    table: dict[str, dict[str, dict[str, TunnelCoverage]]] = {method: {} for method in METHODS}
    for method, axis, coverages, widths in _rows(_TUNNEL_TABLE):
        cells = map(TunnelCoverage, coverages, widths)
        table[method][axis] = dict(zip(GROUPS, cells, strict=True))
    return table
