# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A progress bar on the terminal, which disappears at the end of the computation."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from quadpi_core.parallel import Progress, ReportProgress


@contextmanager
def progress_bar(console: Console) -> Iterator[ReportProgress]:
    """Show a bar, and yield the function that progress is reported to.

    Args:
        console: to draw on; nothing is drawn unless it is a terminal, even if colours are forced on a pipe.
    """
    bar = Bar(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=None),
        TextColumn("{task.fields[state]}", markup=False),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not (console.is_interactive and console.file.isatty()),
    )
    with bar:
        task = bar.add_task("", total=None, state="", visible=False)

        def report(progress: Progress) -> None:
            if progress.task != bar.tasks[0].description:
                bar.reset(task, total=progress.total, description=progress.task, visible=True)
            bar.update(task, completed=progress.done, total=progress.total, state=_state(progress))

        yield report


def _state(progress: Progress) -> str:
    parts = []
    if progress.total is not None:
        parts.append(f"{progress.done:.0f} of {progress.total:.0f} {progress.unit}".rstrip())
    if progress.note:
        parts.append(progress.note)
    return " · ".join(parts)
