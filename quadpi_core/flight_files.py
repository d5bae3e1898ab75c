# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Several files of flights at once: names that tell them apart, and one that is bad stops no other."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Generic, TypeVar

from quadpi_core import array_checks
from quadpi_core.errors import LogError, OutputError, QuadpiError
from quadpi_core.parallel import DEFAULT_WORKERS, Progress, Workers

Shared = TypeVar("Shared")
Result = TypeVar("Result")

# Starting processes takes about as long as reading this number of flights of half a minute.
MANY_FILES = 64


@dataclass(frozen=True)
class FlightFile:
    """A log or bag, and the name that its flight has in results, bags and groups."""

    path: Path
    name: str


@dataclass(frozen=True)
class FlightLeftOut:
    """A flight that was given and left out.

    Attributes:
        flight: its name.
        path: of its file.
        reason: in a sentence that names the file.
    """

    flight: str
    path: str
    reason: str


# Collects the flights that are left out; with None, the first of them is an error.
LeftOutFlights = list[FlightLeftOut] | None


def flight_in(path: Path | str) -> tuple[Path, int | None]:
    """A file and the number of one of the flights in it, as `FILE#NUMBER` says; None for a file by itself."""
    path = Path(path)
    file, _, number = path.name.rpartition("#")
    if file and number.isdecimal() and len(number) < 6 and not path.exists():
        return path.with_name(file), int(number)
    return path, None


def _stem(path: Path) -> str:
    """The name of a flight: NAME, of one among several in a file NAME_NUMBER."""
    file, number = flight_in(path)
    return file.stem if number is None else f"{file.stem}_{number}"


def named_files(paths: Path | str | Iterable[Path | str]) -> list[FlightFile]:
    """The files with names that differ: file stems, with the folders above where a stem repeats.

    `FILE#2`, the second flight of a file, is FILE_2.

    As many folders as tell all files of a stem apart stand before it, joined by `_`; files of one folder that
    differ in their ending alone keep it. The same file has the same name each time. One path alone is a list
    of one.

    Raises:
        ArgumentError: for what are no paths.
    """
    files = array_checks.paths("paths", paths)
    places = {path: path.absolute() for path in files}
    alike: dict[str, set[Path]] = defaultdict(set)
    for path in files:
        alike[_stem(places[path])].add(places[path])
    names: dict[Path, str] = {}
    for found in alike.values():
        endings = len({place.parent for place in found}) < len(found)
        depth = 0
        while len({_name(place, depth, endings=endings) for place in found}) < len(found):
            depth += 1
        names |= {place: _name(place, depth, endings=endings) for place in found}
    # A folder before a stem may give the name of another file.
    taken: set[str] = set()
    for place, name in sorted(names.items()):
        names[place] = next(own for n in count(1) if (own := name if n == 1 else f"{name}_{n}") not in taken)
        taken.add(names[place])
    return [FlightFile(path, names[places[path]]) for path in files]


def _name(place: Path, depth: int, *, endings: bool) -> str:
    folders = place.parent.parts[1:]
    return "_".join((*folders[max(len(folders) - depth, 0) :], place.name if endings else _stem(place)))


def bags_in(folder: Path, paths: Sequence[Path | str]) -> list[Path]:
    """The bags that flights get in a folder, by their names.

    Raises:
        LogError: for one in the place of a flight.
    """
    files = named_files(paths)
    places = {file.path.resolve(): file.path for file in files}
    bags = [folder / f"{file.name}.mcap" for file in files]
    for file, bag in zip(files, bags, strict=True):
        if (old := places.get(bag.resolve())) is not None:
            raise LogError(f"{file.path}: its bag would replace {old}; choose another folder")
    return bags


def for_each_flight(
    function: Callable[[Shared, FlightFile], Result],
    paths: Path | str | Iterable[Path | str],
    *,
    shared: Shared,
    task: str,
    workers: Workers = DEFAULT_WORKERS,
    left_out: LeftOutFlights = None,
) -> list[tuple[FlightFile, Result]]:
    """The files of flights with the results of `function(shared, file)`, each judged on its own.

    A file takes a fraction of a second: other processes are started only if it pays.

    Args:
        function: of a module, by whose name a worker finds it.
        paths: of the files; a scheduler's workers, whose working folder is another, are given absolute ones.
        shared: what all need.
        task: name of the work, for its progress.
        workers: that do it.
        left_out: the list to which flights that cannot be used are added; those in it are not read again.

    Raises:
        QuadpiError: of the first flight that cannot be used, without the list `left_out`; with it, if no
            flight is left.
        ParallelError: see :meth:`quadpi_core.parallel.Workers.map`.
    """
    given = named_files(paths)
    left = Counter(file.name for file in given)
    left.subtract(flight.flight for flight in left_out or ())
    once = once_each([(file, file.path.absolute()) for file in given], str, left_out)
    files = [file for file, _ in once if left[file.name] > 0]
    finished = 0

    def done(_index: int, _result: object) -> None:
        nonlocal finished
        finished += 1
        workers.progress(Progress(task, finished, len(files)))

    tasks, place = files, workers
    if workers.scheduler is not None:
        tasks = [replace(file, path=file.path.absolute()) for file in files]
    if workers.count is None and len(tasks) < MANY_FILES:
        place = replace(workers, count=1)
    results = place.map(_Refusing(function), tasks, shared=shared, done=done)
    kept: list[tuple[FlightFile, Result]] = []
    for file, result in zip(files, results, strict=True):
        if isinstance(result, QuadpiError):
            leave_out(file, result, left_out)
        else:
            kept.append((file, result))
    require_flights_left(len(kept), left_out)
    return kept


@dataclass(frozen=True)
class _Refusing(Generic[Shared, Result]):
    """A function that returns its refusal of a file, so that processes go on with the other files."""

    function: Callable[[Shared, FlightFile], Result]

    def __call__(self, shared: Shared, file: FlightFile) -> Result | QuadpiError:
        try:
            return self.function(shared, file)
        except OutputError:  # not the fault of this flight
            raise
        except QuadpiError as error:
            return error
        except (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError) as error:
            return LogError(f"{error.filename or file.path}: {error.strerror or error}")


def leave_out(file: FlightFile, error: QuadpiError, left_out: LeftOutFlights) -> None:
    """Add a flight to those left out.

    Raises:
        QuadpiError: the `error`, without a list.
    """
    if left_out is None:
        raise error
    if all(other.flight != file.name or other.reason != str(error) for other in left_out):
        left_out.append(FlightLeftOut(file.name, str(file.path), str(error)))


def once_each(
    flights: Sequence[tuple[FlightFile, Result]],
    key: Callable[[Result], Hashable],
    left_out: LeftOutFlights,
) -> list[tuple[FlightFile, Result]]:
    """Flights without those whose key, such as the hash of their samples, an earlier one has.

    Raises:
        LogError: naming both files, for the first of these, without the list `left_out`.
    """
    first: dict[Hashable, tuple[FlightFile, Result]] = {}
    for file, result in flights:
        if key(result) in first:
            same, _ = first[key(result)]
            leave_out(
                file,
                LogError(f"{file.path}: the same flight as {same.path}; give each flight once"),
                left_out,
            )
        else:
            first[key(result)] = file, result
    return list(first.values())


class NoFlightLeftError(LogError):
    """No flight of a batch can be used; the message has the reasons."""


def require_flights_left(count: int, left_out: LeftOutFlights) -> None:
    """Refuse a batch of which nothing is left with a NoFlightLeftError of the reasons, each once."""
    if count == 0 and left_out:
        reasons = "; ".join(dict.fromkeys(flight.reason for flight in left_out))
        raise NoFlightLeftError(
            reasons if len(left_out) == 1 else f"none of the flights can be used: {reasons}"
        )
