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

# Of a click context: the options of kinds that its command takes beside its own.
_OPTIONS = f"{__name__}.options"


class KindCommand(TyperCommand):
    """A command that also takes the options of the kind of model that its `--method` names.

    Its callback finds the kind, with these options set, in the `obj` of its context. Its help shows the
    options of the kind if `--method` is given: without it, it imports no kind and answers at once.
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
        from quadpi_core.models.kind_registry import KINDS

        default = next(param.default for param in self.params if param.name == "method")
        kind = KINDS.named(given.get("method", default))
        if kind is None:
            return super().parse_args(ctx, args)
        ctx.meta[_OPTIONS] = _options(kind)
        known = {name for param in self.get_params(ctx) for name in param.opts}
        unknown = {word.partition("=")[0] for word in args if word.startswith("--")} - known
        for other in KINDS.all() if unknown else ():
            if found := unknown & {name for option in _options(other) for name in option.opts}:
                raise ModelError(f"{found.pop()}: an option of --method {other.name}, not of {kind.name}")
        left = super().parse_args(ctx, args)
        ctx.obj = replace(kind, **{field.name: ctx.params.pop(field.name) for field in fields(kind)})
        return left


def _options(kind: Kind) -> list[Any]:
    """The options that the fields of a kind declare."""
    parameters = []
    for field in fields(kind):
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
