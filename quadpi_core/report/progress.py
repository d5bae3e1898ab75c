# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How far a long computation has come, as a bar that is gone when it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


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
    shown = console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not shown) as bar:
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
        TextColumn(what),
        BarColumn(),
        TextColumn("{task.completed} of {task.total}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        yield lambda finished: bar.update(task, completed=finished)
