# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Node parameters as frozen dataclasses: each field is one parameter with its ROS descriptor."""

from __future__ import annotations

from dataclasses import Field, dataclass, field, fields
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from quadpi_core.errors import QuadpiError

# Declared by rclpy itself.
_RCLPY_PARAMETERS = {"use_sim_time", "start_type_description_service"}
_ROS_NAMES = {str: "string", float: "double", bool: "bool"}

Parameters = TypeVar("Parameters")


class ParameterError(QuadpiError):
    """A node parameter is unknown, missing, of the wrong type or out of range."""


@dataclass(frozen=True)
class _Declaration:
    description: str
    limits: tuple[float, float] | None
    choices: tuple[str, ...]


def parameter(
    default: str | float | bool,
    description: str,
    *,
    limits: tuple[float, float] | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """A field of a parameter dataclass.

    Args:
        default: also fixes the type; the empty string makes the parameter required.
        description: shown by `ros2 param describe`.
        limits: smallest and largest value of a double.
        choices: the strings allowed.
    """
    declaration = _Declaration(description, limits, choices)
    return field(default=default, metadata={"declaration": declaration})


def read_parameters(
    node: Node, parameters: type[Parameters], *, shared_with: tuple[type, ...] = ()
) -> Parameters:
    """Declare every field on the node, read-only, and return the values.

    An integer given for a double is taken as one.

    Args:
        node: created with `automatically_declare_parameters_from_overrides`.
        parameters: dataclass made of :func:`parameter` fields.
        shared_with: parameter dataclasses of other nodes in this process, whose names an override for all
            nodes may hold.

    Raises:
        ParameterError: for an unknown name, a missing, mistyped or out-of-range value.
    """
    own = {item.name: item for item in fields(parameters)}  # type: ignore[arg-type]
    others = {item.name for other in shared_with for item in fields(other)}
    given = {name: value.value for name, value in node.get_parameters_by_prefix("").items()}
    for name in given.keys() - own.keys() - others - _RCLPY_PARAMETERS:
        raise ParameterError(
            f"node {node.get_name()}: unknown parameter `{name}`; known: {', '.join(sorted(own))}"
        )
    return parameters(**{name: _declare(node, item, given) for name, item in own.items()})


def _declare(node: Node, item: Field[Any], given: dict[str, Any]) -> Any:
    declaration: _Declaration = item.metadata["declaration"]
    where = f"node {node.get_name()}: parameter `{item.name}`"
    value = item.default
    if item.name in given:
        value = _coerced(where, type(item.default), given[item.name])
        node.undeclare_parameter(item.name)
    if value == "":
        raise ParameterError(f"{where} is required: {declaration.description}")
    if declaration.choices and value not in declaration.choices:
        raise ParameterError(f"{where} must be one of {', '.join(declaration.choices)}, found `{value}`")
    if declaration.limits is not None:
        low, high = declaration.limits
        if not low <= value <= high:
            raise ParameterError(f"{where} must lie between {low:g} and {high:g}, found {value:g}")
    node.declare_parameter(item.name, value, _descriptor(declaration), ignore_override=True)
    return value


def _coerced(where: str, kind: type, value: Any) -> Any:
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is not kind:
        raise ParameterError(f"{where} must be a {_ROS_NAMES[kind]}, found {value!r}")
    return value


def _descriptor(declaration: _Declaration) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=declaration.description, read_only=True)
    if declaration.choices:
        descriptor.additional_constraints = f"one of {', '.join(declaration.choices)}"
    if declaration.limits is not None:
        low, high = declaration.limits
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    return descriptor
