# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The command line `quadpi`: an error that the user can mend is one line, with exit status 2.

Each command imports what it needs when it runs, so that `--help` answers at once.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from quadpi_core.cli.flight_commands import import_logs, info, replay, report, view
from quadpi_core.cli.model_commands import evaluate, identify, rollout, validate
from quadpi_core.cli.options import KindCommand, several_topics
from quadpi_core.cli.simulation_commands import demo, discrepancy, export, simulate
from quadpi_core.errors import QuadpiError
from quadpi_core.paths import LIMIT_DEFAULT_MIB, LIMIT_VARIABLE
from quadpi_core.version import __version__

__all__ = ["app", "main"]


class Interruptible(TyperGroup):
    """Reports in one line that a command was interrupted, and takes several topics behind `--topics`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line; click knows no option with any number of values."""
        return super().parse_args(ctx, several_topics(args))

    def invoke(self, ctx: Any) -> Any:
        """Run the command; click would end an interrupted one in its own words."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interruption:
            print(f"quadpi: interrupted; {str(interruption) or 'nothing is half written'}", file=sys.stderr)
            # As a shell reports them: 128 and the number of the signal.
            raise typer.Exit(143 if isinstance(interruption, _Terminated) else 130) from None


class _Terminated(KeyboardInterrupt):
    """SIGTERM, which ends a command as Ctrl-C does, temporary files removed."""


def _terminate(*_: object) -> None:
    raise _Terminated


app = typer.Typer(
    cls=Interruptible,
    help="How far can an aerodynamic model of a quadrotor be trusted?",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("import")(import_logs)
# In the order in which `--help` lists them.
commands = (
    info,
    report,
    identify,
    evaluate,
    rollout,
    replay,
    view,
    simulate,
    validate,
    discrepancy,
    export,
    demo,
)
for command in commands:
    app.command(cls=KindCommand if command is identify else None)(command)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"quadpi {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[  # noqa: ARG001  # its callback prints it
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
    unpacked_mib: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Largest size in MiB that a log may unpack to, if that is over 100 times its own; "
            f"default: ${LIMIT_VARIABLE}, or {LIMIT_DEFAULT_MIB}.",
        ),
    ] = None,
) -> None:
    """How far can an aerodynamic model of a quadrotor be trusted?"""
    if unpacked_mib is not None:
        # Also for the processes that a command starts.
        os.environ[LIMIT_VARIABLE] = str(unpacked_mib)


def main() -> None:
    """Entry point of the command `quadpi`."""
    signal.signal(signal.SIGTERM, _terminate)
    # An interrupted Dask client does not retrieve the exceptions of its tasks, which asyncio would report.
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)
    try:
        app()
    except QuadpiError as error:
        print(f"quadpi: {error}", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        print(f"quadpi: {error.filename or 'a file'}: {error.strerror or error}", file=sys.stderr)
        sys.exit(2)
    except MemoryError:
        print("quadpi: not enough memory; nothing is half written", file=sys.stderr)
        sys.exit(2)
