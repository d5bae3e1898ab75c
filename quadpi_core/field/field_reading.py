# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reading any log as a field log; what is no flight of a multirotor is refused in a sentence."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from logging.handlers import BufferingHandler
from pathlib import Path
from typing import Any

import numpy as np

from quadpi_core.errors import LogError
from quadpi_core.field import stacks
from quadpi_core.field.field_log import FieldLog, Series, Setting, Stack
from quadpi_core.field.other_logs import read_other
from quadpi_core.flight_files import flight_in
from quadpi_core.logs import identify_format, reading
from quadpi_core.plugins import Plugins
from quadpi_core.reading_options import ReadingOptions
from quadpi_core.records import (
    AIRSPEED_MAX_M_S,
    NORM_TOLERANCE,
    POSITION_MAX_M,
    RATE_MAX_RAD_S,
    SPECIFIC_FORCE_MAX_M_S2,
    Threshold,
)
from quadpi_core.vehicle import Vehicle

STACKS = Plugins("flight stack", stacks, "quadpi.flight_stacks", Stack, LogError)
PULSE_RPM = Threshold(
    "readings between which rotor speeds in rpm are pulse widths in µs",
    (800.0, 2300.0),
    "rpm",
    "pulses are 900 to 2100 µs and never 0; rotors of less than half a metre turn faster, and all read 0 at "
    "rest",
    "flights of ../shared/data: rotors in flight turn at 3 000 to 25 000 rpm",
)

# 6 000 m high in warm air, and at sea level in the Arctic, kg/m³, with a margin: what errs more is broken.
_DENSITIES = (0.3, 1.6)
_LIMITS = {
    "imu": np.repeat([RATE_MAX_RAD_S, SPECIFIC_FORCE_MAX_M_S2], 3),
    "velocity": AIRSPEED_MAX_M_S,
    "position": POSITION_MAX_M,
}


def read_field_log(path: Path, options: ReadingOptions, known: Vehicle | int | None = None) -> FieldLog:
    """Read a log of any known format as it is.

    Args:
        path: of the log, or `FILE#NUMBER`.
        options: topics of a bag, mapping of a table.
        known: see :func:`quadpi_core.field.other_logs.read_other`.

    Raises:
        LogError: naming the file, for what cannot be read or is no flight of a multirotor.
    """
    log_format = identify_format(path)
    file, number = flight_in(path)
    stack = next((one for one in STACKS.all() if one.log_format is log_format), None)
    with reading(path), _notes_taken() as notes:
        if stack is None:
            log = read_other(path, options, known)
        else:
            log = stack.read(file, number, known.pole_pairs if isinstance(known, Vehicle) else known)
    told = [" ".join(note.getMessage().split()).removeprefix(f"{log.source}: ") for note in notes]
    log = replace(log, notes=(*dict.fromkeys(told), *log.notes))
    if log.no_multirotor:
        raise LogError(f"{path}: {log.no_multirotor}; `quadpi report` is for multirotors")
    if not log.series():
        raise LogError(f"{path}: holds no samples of gyro, state, commands or battery")
    return _without_still_state(_without_pulses(_within_limits(log)))


@contextmanager
def _notes_taken() -> Iterator[list[logging.LogRecord]]:
    """What the readers say of a log within the block, instead of on the terminal."""
    logger, taking = logging.getLogger("quadpi_core.logs"), BufferingHandler(sys.maxsize)
    taking.setLevel(logging.WARNING)
    propagate = logger.propagate
    logger.addHandler(taking)
    logger.propagate = False
    try:
        yield taking.buffer
    finally:
        logger.removeHandler(taking)
        logger.propagate = propagate


def _within_limits(log: FieldLog) -> FieldLog:
    """The log without samples that no flight can have: a single one would outweigh all others."""
    kept: dict[str, Any] = {}
    notes = list(log.notes)
    for name, series in log.series().items():
        if name == "attitude":
            good = np.abs(np.linalg.norm(series.values, axis=1) - 1.0) <= NORM_TOLERANCE
        elif name == "density":
            good = np.all((series.values >= _DENSITIES[0]) & (series.values <= _DENSITIES[1]), axis=1)
        else:
            good = np.all(np.abs(series.values) <= _LIMITS.get(name, np.inf), axis=1)
        if not good.all():
            notes.append(
                f"{name}: {np.sum(~good)} of {len(good)} samples are left out, beyond what any flight has"
            )
            kept[name] = Series(series.time[good], series.values[good]) if good.sum() > 1 else None
    return replace(log, **kept, notes=tuple(notes))


def _without_still_state(log: FieldLog) -> FieldLog:
    """The log without a position or velocity that never changes: an estimator logs zeros until it runs."""
    names = ("position", "velocity")
    still = [
        name for name in names if (own := log.series().get(name)) and not np.ptp(own.values, axis=0).any()
    ]
    said = [f"{name} is left out: it never changes, the estimator did not run" for name in still]
    gone: dict[str, Any] = dict.fromkeys(still)
    return replace(log, **gone, notes=(*log.notes, *said)) if still else log


def _without_pulses(log: FieldLog) -> FieldLog:
    """The log without rotor speeds that are pulse widths."""
    if log.rotor_speeds is None:
        return log
    if (log.rotor_speeds.values < 0.0).any():
        sizes = Series(log.rotor_speeds.time, np.abs(log.rotor_speeds.values))
        said = "rotor speeds below 0 are of rotors that turn the other way: their size counts"
        log = replace(log, rotor_speeds=sizes, notes=(*log.notes, said))
    assert log.rotor_speeds is not None
    rpm = log.rotor_speeds.values * (60.0 / (2.0 * np.pi))
    low, high = PULSE_RPM.value
    if rpm.min() < low or rpm.max() > high:
        return log
    pulses = f"{rpm.min():.0f} to {rpm.max():.0f} rpm, never 0: pulse widths of commands in µs, left out"
    setting = Setting("rotor speeds", pulses, "the speed controllers' telemetry", "measured rotor speeds")
    return replace(log, rotor_speeds=None, settings=(*log.settings, setting))
