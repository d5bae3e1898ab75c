# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Arguments and options that several commands share, and what they do with their output."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from inspect import Parameter, Signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from quadpi_core.errors import ModelError, QuadpiError
from quadpi_core.paths import require_file, require_folder, write_json

if TYPE_CHECKING:
    from rich.console import Console

    from quadpi_core.findings import DataQuality
    from quadpi_core.flight_files import FlightLeftOut
    from quadpi_core.models.model_kind import Kind
    from quadpi_core.parallel import Workers
    from quadpi_core.reading_options import ReadingOptions, TimeRange

_NAMED_TOPIC = re.compile(r"[a-z][a-z_/]*=\S")
# Exit status of a command that did its work for some of the flights given.
SOME_LEFT_OUT = 3

Bags = Annotated[list[Path], typer.Argument(help="Flights: MCAP bags, or any log that `import` reads.")]
ModelFolder = Annotated[Path, typer.Argument(help="Model folder, as written by `identify`.")]
VehicleName = Annotated[str, typer.Option("--vehicle", help="Vehicle in config/vehicles, or a YAML file.")]
OptionalVehicle = Annotated[
    str | None,
    typer.Option("--vehicle", help="Vehicle; default: the one that the model holds, or that the bag names."),
]
Mapping = Annotated[
    str | None,
    typer.Option(
        help="Meaning of columns of a table or messages of other packages, or an autopilot's rotor order: a "
        "name in config/mappings (tables, autopilots) or config/adapters (bags), or a file."
    ),
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=TOPIC ...",
        help="Topics of a bag to read, such as imu=/uav1/imu mocap/pose=/vrpn/uav1/pose, by the names of the "
        "launch arguments; of tf, mocap/transform=/tf:CHILD_FRAME. Default: by name, else by type.",
    ),
]
Namespace = Annotated[
    str, typer.Option(metavar="/NAME", help="Look only for topics of a bag with this in their names.")
]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Also write the result as JSON.")]
HtmlFile = Annotated[Path | None, typer.Option("--html", help="Also write a self-contained page.")]
Adaptive = Annotated[
    bool, typer.Option("--adaptive", help="Adapt the intervals to the measured wrench during the flight.")
]
Change = Annotated[
    bool, typer.Option("--change/--no-change", help="Judge CHANGE: whether the vehicle has changed.")
]
Confidence = Annotated[float | None, typer.Option(help="Coverage of the intervals; default: the model's.")]
ProcessCount = Annotated[int | None, typer.Option(min=1, help="Processes to use; default: one per core.")]
FileProcessCount = Annotated[
    int | None,
    typer.Option(min=1, help="Processes to use; default: this one, from 64 flights on one per core."),
]
FromS = Annotated[
    float | None,
    typer.Option("--from", metavar="SECONDS", help="Use flights from then on, since the first IMU sample."),
]
ToS = Annotated[
    float | None,
    typer.Option("--to", metavar="SECONDS", help="Use flights until then, since the first IMU sample."),
]
AllParts = Annotated[
    bool,
    typer.Option(
        "--all-parts",
        help="Of a flight with pauses use every part that is long enough, as a flight of its own; default: "
        "the longest part.",
    ),
]
FromCommands = Annotated[
    bool,
    typer.Option(
        "--from-commands",
        help="Make rotor speeds of motor commands even if all flights have them measured; without it, "
        "only where a flight has none.",
    ),
]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler whose workers to use instead.")
]


def time_range(from_s: float | None, to_s: float | None) -> TimeRange:
    """The part of each flight that `--from` and `--to` ask for.

    Raises:
        QuadpiError: for one that is empty or inverted.
    """
    from quadpi_core.reading_options import TimeRange

    return TimeRange(0.0 if from_s is None else from_s, math.inf if to_s is None else to_s)


def reading_options(
    topics: list[str] | None,
    namespace: str,
    mapping: str | None = None,
    *,
    part: TimeRange | None = None,
    all_parts: bool = False,
) -> ReadingOptions:
    """How logs are to be read.

    Raises:
        QuadpiError: for a topic that is not named as NAME=TOPIC, or by no standard name, or twice.
    """
    from quadpi_core.config_schema import nearest
    from quadpi_core.messages.topics import SENSOR_KINDS
    from quadpi_core.reading_options import WHOLE, ReadingOptions

    chosen: dict[str, str] = {}
    for text in topics or ():
        name, _, topic = text.partition("=")
        if not (name and topic.strip("/")):
            raise QuadpiError(f"--topics {text}: expected NAME=TOPIC, such as imu=/uav1/imu")
        if name not in SENSOR_KINDS:
            # `imu_topic:=` is what the launch files take.
            by_argument = {f"{word.replace('/', '_')}_topic": word for word in SENSOR_KINDS}
            bare = name.removesuffix(":").removeprefix("/")
            raise QuadpiError(
                f"--topics {text}: unknown name {name}; known: {', '.join(SENSOR_KINDS)}"
                f"{nearest(by_argument.get(bare, bare), SENSOR_KINDS)}"
            )
        if name in chosen:
            raise QuadpiError(f"--topics {text}: {name} is named twice, before as {chosen[name]}")
        chosen[name] = topic
    return ReadingOptions(mapping, chosen, namespace, part or WHOLE, all_parts)


def several_topics(arguments: Sequence[str]) -> list[str]:
    """A command line in which `--topics A=B C=D` is written as `--topics A=B --topics C=D`."""
    written: list[str] = []
    follows = False
    for argument in arguments:
        if follows and _NAMED_TOPIC.match(argument) and written[-1] != "--topics":
            written.append("--topics")
        follows = argument == "--topics" or (follows and bool(_NAMED_TOPIC.match(argument)))
        written.append(argument)
    return written


def check_outputs(inputs: Sequence[Path], *files: Path | None, folders: Sequence[Path | None] = ()) -> None:
    """Refuse outputs that cannot be written, or that are in the place of an input or another output.

    Raises:
        QuadpiError: naming the output. A path within an input or another output is refused as well.
    """
    taken = [path.resolve() for path in inputs]
    for output in filter(None, (*folders, *files)):
        place = output.resolve()
        if any(place.is_relative_to(path) for path in taken):
            raise QuadpiError(f"{output}: would replace or alter an input or another output; choose another")
        taken.append(place)
    for folder in filter(None, folders):
        require_folder(folder)
    for file in filter(None, files):
        require_file(file)


@contextmanager
def shown_work(console: Console, workers: int | None, scheduler: str | None) -> Iterator[Workers]:
    """Where `--workers` and `--scheduler` have tasks run; a bar on the terminal shows how far they are."""
    from quadpi_core.parallel import Workers
    from quadpi_core.report.table import progress_bar

    with progress_bar(console) as progress:
        yield Workers(workers, scheduler, progress)


@contextmanager
def batch_of_flights() -> Iterator[list[FlightLeftOut]]:
    """A list for the flights that are left out; at the end they are named, and the command ends with 3.

    Raises:
        typer.Exit: with status 3, if any was left out of a batch that was finished.
    """
    from quadpi_core.flight_files import NoFlightLeftError

    left_out: list[FlightLeftOut] = []
    try:
        yield left_out
    except QuadpiError as error:
        if not isinstance(error, NoFlightLeftError):
            print_left_out(left_out)
        raise
    if left_out:
        print_left_out(left_out)
        raise typer.Exit(SOME_LEFT_OUT)


def print_left_out(left_out: Iterable[FlightLeftOut]) -> None:
    """Name the flights that were left out, on the error stream."""
    for flight in left_out:
        print(f"quadpi: left out {flight.flight}: {flight.reason}", file=sys.stderr)


def write_result(json_file: Path | None, data: dict[str, Any]) -> None:
    """Write the result of a command if `--json` names a file."""
    if json_file is not None:
        write_json(json_file, data)


def print_quality(console: Console, flights: Iterable[tuple[Path | str, DataQuality]]) -> None:
    """Print the remarks on the data of each flight, which is given by name or file."""
    from rich.text import Text

    for flight, quality in flights:
        for sentence in quality.sentences():
            console.print(Text(f"{flight}: {sentence}", style="yellow"), soft_wrap=True)


def open_console() -> Console:
    """The terminal, without markup: names such as [red] and :smile: are printed as they are."""
    from rich.console import Console

    return Console(markup=False, emoji=False)


# Keys of click's `meta`: options of the kind of model that a command was given; why it took a kind other than
# the first default.
_OPTIONS, _CHOICE = f"{__name__}.options", f"{__name__}.choice"
# Options of the command that not every kind has a use for.
_CANDIDATES, _PAPER = "--candidates", "--settings paper"


class KindCommand(TyperCommand):
    """A command that also takes the options of the kind of model that its `--method` names.

    Without `--method` it takes the first default kind that has all the options given. Its callback finds the
    kind, with these options set, in the `obj` of its context. Its help shows the options of the kind if
    `--method` is given: without it, it imports no kind and answers at once.
    """

    def get_params(self, ctx: Any) -> list[Any]:
        """The command's own options and those of the kind."""
        return [*super().get_params(ctx), *ctx.meta.get(_OPTIONS, ())]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments, with the options of the kind of model that they name or imply.

        Raises:
            ModelError: for an option of another kind.
        """
        parser: Any = self.make_parser(ctx)
        parser.ignore_unknown_options = True
        given, _, _ = parser.parse_args(args=list(args))
        if "help" in given and "method" not in given:
            return super().parse_args(ctx, args)
        from quadpi_core.models.kind_registry import KINDS, default_kind

        common = {name for param in self.get_params(ctx) for name in param.opts}
        asked = {word.partition("=")[0] for word in args if word.startswith("--")} - common
        asked |= {_CANDIDATES} if "candidates" in given else set()
        asked |= {_PAPER} if given.get("settings") == "paper" else set()
        known = {kind.name: _takes(kind) for kind in KINDS.all()} if asked else {}
        asked &= set().union(*known.values())
        default = default_kind(lambda kind: asked <= _takes(kind))
        kind = KINDS.named(given["method"]) if "method" in given else default
        if kind is None:
            return super().parse_args(ctx, args)
        if lacking := sorted(asked - _takes(kind) - {_PAPER}):
            having = " or ".join(name for name, takes in known.items() if lacking[0] in takes)
            raise ModelError(f"{lacking[0]}: an option of --method {having}, not of {kind.name}")
        first = default_kind(lambda _: True)
        if "method" not in given and kind is not first:
            others = ", ".join(sorted(asked - _takes(first)))
            ctx.meta[_CHOICE] = f"--method {kind.name}: {first.name}, the default, takes no {others}"
        ctx.meta[_OPTIONS] = _options(kind)
        unparsed = super().parse_args(ctx, args)
        ctx.obj = replace(kind, **{common.name: ctx.params.pop(common.name) for common in ctx.meta[_OPTIONS]})
        return unparsed


def choice_of_kind(context: typer.Context) -> str | None:
    """Why a command took another kind of model than the default; None where it did not, or one was named."""
    return context.meta.get(_CHOICE)


def _takes(kind: Kind) -> set[str]:
    """The options that a kind has beside those that all have."""
    takes = {name for option in _options(kind) for name in option.opts}
    takes |= {_CANDIDATES} if kind.chooses_candidates else set()
    return takes | ({_PAPER} if kind.has_paper_settings else set())


def _options(kind: Kind) -> list[Any]:
    """The options that the fields of a kind declare."""
    parameters = []
    for field in (field for field in fields(kind) if "help" in field.metadata):
        panel = f"Options of --method {kind.name}"
        declared = typer.Option(help=field.metadata["help"], rich_help_panel=panel)
        hint = Annotated[get_type_hints(type(kind))[field.name], declared]  # type: ignore[valid-type]
        parameters.append(
            Parameter(field.name, Parameter.KEYWORD_ONLY, default=field.default, annotation=hint)
        )

    def takes_them() -> None: ...

    # typer makes options of the signature of a function, and of nothing else.
    takes_them.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    takes_them.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    carrier = typer.Typer(add_completion=False)
    carrier.command()(takes_them)
    return list(typer.main.get_command(carrier).params)
