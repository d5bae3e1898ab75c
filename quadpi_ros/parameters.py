# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Declare the parameters of a node, check what they are set to, and follow changes in flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import Field, fields, replace
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from quadpi_core.errors import QuadpiError
from quadpi_ros.dds_profile import QOS_PREFIX
from quadpi_ros.node_parameters import ALL_NAMES, Declaration

# Declared by rclpy.
_RCLPY_PARAMETERS = {"use_sim_time", "start_type_description_service"}
_ROS_NAMES = {
    str: "string",
    float: "double",
    int: "integer",
    bool: "bool",
    tuple: "string or an array of strings",
}
Parameters = TypeVar("Parameters")


class ParameterError(QuadpiError):
    """A node parameter is unknown, missing, of the wrong type or out of range."""


class ParameterServer(Generic[Parameters]):
    """Declares every field of a dataclass as a parameter of a node, and holds the current values.

    An integer is accepted for a double, at the start and in flight. Parameters of quadpi's other nodes are
    ignored, as one file may hold the parameters of all nodes under `/**`.

    Args:
        node: created with `automatically_declare_parameters_from_overrides`.
        parameters: dataclass made of :func:`quadpi_ros.node_parameters.parameter` fields.
        changed: called after a change in flight.

    Raises:
        ParameterError: for an unknown name, a missing, mistyped or out-of-range value.
    """

    def __init__(
        self,
        node: Node,
        parameters: type[Parameters],
        changed: Callable[[], None] = lambda: None,
    ) -> None:
        self._fields: dict[str, Field[Any]] = {item.name: item for item in fields(parameters)}  # type: ignore[arg-type]
        self._where = f"node {node.get_name()}"
        self._changed = changed
        # rclpy annotates values, but returns parameters.
        overrides: Mapping[str, Any] = node.get_parameters_by_prefix("")
        given = {name: override.value for name, override in overrides.items()}
        for name in _RCLPY_PARAMETERS & given.keys():
            # rclpy would ignore a value of the wrong type.
            _coerced(f"{self._where}: parameter `{name}`", bool, given[name])
        self._pass_over(node, given.keys() - self._fields.keys() - _RCLPY_PARAMETERS)
        self.values = parameters(**{name: self._declare(node, name, given) for name in self._fields})
        node.add_pre_set_parameters_callback(self._coerce)
        node.add_post_set_parameters_callback(self._take)

    def _pass_over(self, node: Node, names: set[str]) -> None:
        """Refuse parameters that no node has, and undeclare those that only other nodes have."""
        for name in sorted(names):
            if name.startswith(QOS_PREFIX):
                kind = node.get_parameter(name).type_.value
                node.set_descriptor(name, ParameterDescriptor(type=kind, read_only=True))
            elif name in ALL_NAMES:
                node.undeclare_parameter(name)
            else:
                raise ParameterError(
                    f"{self._where}: unknown parameter `{name}`; known: {', '.join(sorted(self._fields))}"
                )

    def _declare(self, node: Node, name: str, given: dict[str, Any]) -> Any:
        declaration: Declaration = self._fields[name].metadata["declaration"]
        value = self._fields[name].default
        if name in given:
            value = self._checked(name, given[name])
            node.undeclare_parameter(name)
        if value == "" and declaration.empty_means is not None:
            value = declaration.empty_means(node)
        if value in ("", ()) and not declaration.optional:
            raise ParameterError(f"{self._where}: parameter `{name}` is required: {declaration.description}")
        ros_value = list(value) if isinstance(value, tuple) else value
        node.declare_parameter(name, ros_value, _descriptor(declaration, type(value)), ignore_override=True)
        return value

    def _checked(self, name: str, value: Any) -> Any:
        """The value in the type of the dataclass field.

        Raises:
            ParameterError: if it is of the wrong type or out of range.
        """
        declaration: Declaration = self._fields[name].metadata["declaration"]
        where = f"{self._where}: parameter `{name}`"
        value = _coerced(where, type(self._fields[name].default), value)
        if (allowed := declaration.allowed()) and value not in allowed:
            raise ParameterError(f"{where} must be one of {', '.join(allowed)}, found `{value}`")
        if declaration.limits is not None:
            low, high = declaration.limits
            if not low <= value <= high:
                raise ParameterError(f"{where} must lie between {low:g} and {high:g}, found {value:g}")
        return value

    def _coerce(self, given: list[Parameter]) -> list[Parameter]:
        doubles = {name for name, item in self._fields.items() if isinstance(item.default, float)}
        return [
            Parameter(item.name, value=float(item.value))
            if item.name in doubles and type(item.value) is int
            else item
            for item in given
        ]

    def _take(self, given: list[Parameter]) -> None:
        changes = {item.name: item.value for item in given if item.name in self._fields}
        if changes:
            self.values = replace(self.values, **changes)  # type: ignore[type-var]
            self._changed()


def read_parameters(node: Node, parameters: type[Parameters]) -> Parameters:
    """Declare the parameters of a node that cannot change in flight, and return their values.

    See :class:`ParameterServer`.
    """
    return ParameterServer(node, parameters).values


def _coerced(where: str, kind: type, value: Any) -> Any:
    if kind is float and type(value) is int:
        return float(value)
    if kind is int and type(value) is float and value.is_integer():
        return int(value)
    if kind is tuple and isinstance(value, str):
        return (value,) if value else ()
    if kind is tuple and isinstance(value, list | tuple) and all(isinstance(item, str) for item in value):
        return tuple(value)
    if kind is tuple or type(value) is not kind:
        raise ParameterError(f"{where} must be a {_ROS_NAMES[kind]}, found {value!r}")
    return value


def _descriptor(declaration: Declaration, kind: type) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=declaration.description, read_only=not declaration.in_flight)
    if allowed := declaration.allowed():
        descriptor.additional_constraints = f"one of {', '.join(allowed)}"
    if declaration.limits is not None and kind is int:
        low, high = declaration.limits
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    elif declaration.limits is not None:
        low, high = declaration.limits
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    return descriptor
