# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Options of `quadpi identify` that the kinds of model declare, as fields of their dataclass."""

from __future__ import annotations

from dataclasses import fields, replace
from inspect import Parameter, Signature
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from quadpi_core.errors import ModelError

if TYPE_CHECKING:
    from quadpi_core.models.model_kind import Kind

# Of a click context: the options of kinds that its command takes beside its own; why it took a kind that is
# not the first default.
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
        """Read what is given, once it is known which kind's options that may be.

        Raises:
            ModelError: for an option of another kind.
        """
        parser: Any = self.make_parser(ctx)
        parser.ignore_unknown_options = True
        given, _, _ = parser.parse_args(args=list(args))
        if "help" in given and "method" not in given:
            return super().parse_args(ctx, args)
        from quadpi_core.models.kind_registry import KINDS, default_kind

        own = {name for param in self.get_params(ctx) for name in param.opts}
        asked = {word.partition("=")[0] for word in args if word.startswith("--")} - own
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
        left = super().parse_args(ctx, args)
        ctx.obj = replace(kind, **{own.name: ctx.params.pop(own.name) for own in ctx.meta[_OPTIONS]})
        return left


def choice_of_kind(context: typer.Context) -> str | None:
    """Why a command took another kind of model than the default; None where it did not, or one was named."""
    sentence: str | None = context.meta.get(_CHOICE)
    return sentence


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
