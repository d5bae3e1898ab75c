# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How far a long computation has come, as a bar that is gone when it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:
    from quadpi_core.identification.identify import Step


@contextmanager
def flying(console: Console, durations: Mapping[str, float]) -> Iterator[Callable[[str, float], None]]:
    """A bar over the simulated seconds of all flights; give it the name of a flight and its seconds flown.

    Args:
        console: to draw on; where it is no terminal nothing is drawn.
        durations: seconds of each flight by name.
    """
    flown = dict.fromkeys(durations, 0.0)
    columns = (
        TextColumn("Flying"),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        TextColumn("· {task.fields[done]} of {task.fields[flights]} flights"),
        TimeRemainingColumn(),
    )
    with _bar(console, *columns) as bar:
        task = bar.add_task("", total=sum(durations.values()), done=0, flights=len(durations))

        def report(flight: str, seconds: float) -> None:
            flown[flight] = min(seconds, durations[flight])
            done = sum(flown[name] >= duration for name, duration in durations.items())
            bar.update(task, completed=sum(flown.values()), done=done)

        yield report


@contextmanager
def counting(console: Console, what: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar over so many things; give it how many are finished.

    Args:
        console: to draw on; where it is no terminal nothing is drawn.
        what: the things are.
        total: of them.
    """
    columns = (
        TextColumn(what, markup=False),
        BarColumn(),
        TextColumn("{task.completed} of {task.total}"),
        TimeRemainingColumn(),
    )
    with _bar(console, *columns) as bar:
        task = bar.add_task("", total=total)
        yield lambda finished: bar.update(task, completed=finished)


@contextmanager
def identifying(console: Console) -> Iterator[Callable[[Step], None]]:
    """A bar over the axes or epochs of an identification; give it each step.

    Args:
        console: to draw on; where it is no terminal nothing is drawn.
    """
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=None),
        TextColumn("{task.fields[state]}", markup=False),
        TimeRemainingColumn(),
    )
    with _bar(console, *columns) as bar:
        task = bar.add_task("Identifying", total=None, state="")

        def report(step: Step) -> None:
            state = f"{step.done} of {step.total}"
            if step.loss is not None:
                state = f"epoch {state} · loss {step.loss:.3g}"
            if step.coverage is not None:
                state += f" · coverage {step.coverage:.1%}"
            if step.task == bar.tasks[0].description:
                bar.update(task, completed=step.done, state=state)
            else:
                bar.reset(task, completed=step.done, total=step.total, description=step.task, state=state)

        yield report


def _bar(console: Console, *columns: ProgressColumn) -> Progress:
    """A bar, drawn on a terminal only: colours may be forced on a pipe, lines that replace lines may not."""
    drawn = console.is_interactive and console.file.isatty()
    return Progress(*columns, console=console, transient=True, disable=not drawn)
