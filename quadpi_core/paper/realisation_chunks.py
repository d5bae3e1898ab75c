# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Realisations in chunks: spread over workers, kept in files, so that a later run goes on where one ended."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np

from quadpi_core.paper.realisations import Tally, realise
from quadpi_core.paper.validation_case import ValidationCase
from quadpi_core.parallel import map_tasks
from quadpi_core.paths import whole_output

# Seconds of work, so that an interruption loses little and the last chunks keep all workers busy.
CHUNK = 5


def run_realisations(
    case: ValidationCase,
    count: int,
    *,
    folder: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> Tally:
    """Count the first `count` realisations of a case; the result is the same whatever does the work.

    Args:
        case: checked.
        count: of realisations, at least one.
        folder: where finished chunks are kept, and taken from when they are of the same case.
        workers: see :func:`quadpi_core.parallel.map_tasks`.
        scheduler: see there.
        progress: called with the number of realisations finished so far.

    Raises:
        ParallelError: see there.
        OutputError: if a chunk cannot be kept.
    """
    spans = [range(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]
    kept = [None if folder is None else _read(_path(folder, case, span), case, span) for span in spans]
    missing = [k for k, tally in enumerate(kept) if tally is None]
    finished = sum(len(spans[k]) for k in range(len(spans)) if k not in set(missing))
    progress(finished)

    def done(index: int, tally: Tally) -> None:
        nonlocal finished
        span = spans[missing[index]]
        if folder is not None:
            _write(_path(folder, case, span), tally)
        finished += len(span)
        progress(finished)

    counted = map_tasks(
        realise,
        [spans[k] for k in missing],
        shared=case,
        workers=workers,
        scheduler=scheduler,
        done=done,
    )
    for k, tally in zip(missing, counted, strict=True):
        kept[k] = tally
    return Tally.joined([tally for tally in kept if tally is not None])


def _path(folder: Path, case: ValidationCase, span: range) -> Path:
    return folder / case.fingerprint[:16] / f"{span.start:06d}-{span.stop:06d}.npz"


def _write(path: Path, tally: Tally) -> None:
    with whole_output(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **{column.name: getattr(tally, column.name) for column in fields(tally)})


def _read(path: Path, case: ValidationCase, span: range) -> Tally | None:
    """What a file keeps; None where there is none, or one that is damaged."""
    expected = Tally.empty(len(span), len(case.models), len(case.flights))
    try:
        with np.load(path, allow_pickle=False) as file:
            tally = Tally(**{column.name: file[column.name] for column in fields(Tally)})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    same = all(
        getattr(tally, column.name).shape == getattr(expected, column.name).shape for column in fields(Tally)
    )
    return tally if same else None
