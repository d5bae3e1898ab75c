# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM: one line, and the status that a shell gives for them."""

from __future__ import annotations

import logging
import signal
import sys
from typing import Any

import typer
from typer.core import TyperGroup


class Interruptible(TyperGroup):
    """Says in one line that a command was interrupted, before click makes something of it."""

    def invoke(self, ctx: Any) -> Any:
        """See click.Group."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interruption:
            print(f"quadpi: interrupted; {str(interruption) or 'nothing is half written'}", file=sys.stderr)
            # What a shell gives for SIGTERM and SIGINT.
            raise typer.Exit(143 if isinstance(interruption, _Terminated) else 130) from None


class _Terminated(KeyboardInterrupt):
    """SIGTERM: what is half done is cleared away as on Ctrl-C."""


def interrupt_on_sigterm() -> None:
    """Let SIGTERM end a command as Ctrl-C does."""
    signal.signal(signal.SIGTERM, _terminate)
    # Where Dask is interrupted, it does not fetch what its tasks raise for that reason.
    logging.getLogger("asyncio").setLevel(logging.CRITICAL)


def _terminate(*_: object) -> None:
    raise _Terminated
