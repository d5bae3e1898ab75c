# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The services that rclpy gives every node, called as clients call them and with what none should send."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future
from type_description_interfaces.srv import GetTypeDescription

from quadpi_ros.live_session import Child

from .rig import assert_alive, known_client, wait_until

NODES = ("estimator", "monitor", "mavlink_bridge")
NO_TYPE = 99


@pytest.fixture(scope="module")
def children(
    ros_domain: int, folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[list[Child]]:
    del ros_domain
    errors = tmp_path_factory.mktemp("err")
    common = ("--ros-args", "-p", "vehicle:=neurobem")
    live = ("-p", "autostart:=false", "-p", f"monitor:model:={folder / 'model'}")
    with (
        Child("quadpi_ros.live_process", (*common, *live), errors) as nodes,
        Child(
            "quadpi_ros.mavlink_bridge", (*common, "-p", "connection:=udp:127.0.0.1:5999"), errors
        ) as bridge,
    ):
        yield [nodes, bridge]


Call = Callable[..., Any]


@pytest.fixture(scope="module")
def call(children: list[Child]) -> Iterator[Call]:
    """Calls a service and waits for its answer; whatever is called, no process ends."""
    context = Context()
    context.init()
    node = Node("client", context=context)
    executor = EventsExecutor(context=context)
    executor.add_node(node)

    clients: dict[str, Any] = {}

    def until(condition: Callable[[], bool]) -> None:
        def turn() -> None:
            for child in children:
                assert_alive(child)
            executor.spin_until_future_complete(Future(), timeout_sec=0.02)

        wait_until(condition, turn)

    def call(kind: type, name: str, request: Any) -> Any:
        if name not in clients:
            clients[name] = known_client(node, kind, name, until)
        answer = clients[name].call_async(request)
        until(answer.done)
        return answer.result()

    yield call
    executor.remove_node(node)
    node.destroy_node()
    executor.shutdown()
    context.try_shutdown()


@pytest.mark.parametrize("node", NODES)
def test_parameter_services(call: Call, node: str) -> None:
    listed = call(ListParameters, f"{node}/list_parameters", ListParameters.Request()).result.names
    assert {"vehicle", "body_frame", "use_sim_time"} <= set(listed)
    described = call(
        DescribeParameters, f"{node}/describe_parameters", DescribeParameters.Request(names=listed)
    ).descriptors
    types = call(
        GetParameterTypes, f"{node}/get_parameter_types", GetParameterTypes.Request(names=listed)
    ).types
    values = call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=listed)).values
    assert [one.name for one in described] == listed
    assert [one.type for one in described] == list(types) == [one.type for one in values]
    assert dict(zip(listed, values, strict=True))["vehicle"].string_value == "neurobem"
    unknown = GetParameters.Request(names=["no_such_parameter"])
    assert not call(GetParameters, f"{node}/get_parameters", unknown).values


def setting(name: str, **value: Any) -> ParameterMessage:
    return ParameterMessage(name=name, value=ParameterValue(**value))


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize(
    "wrong",
    [
        setting("vehicle", type=ParameterType.PARAMETER_STRING, string_value="other"),
        setting("vehicle", type=ParameterType.PARAMETER_NOT_SET),
        setting("no_such_parameter", type=ParameterType.PARAMETER_BOOL, bool_value=True),
        setting("imu_rate_hz", type=ParameterType.PARAMETER_DOUBLE, double_value=float("nan")),
        setting("use_sim_time", type=ParameterType.PARAMETER_STRING, string_value="yes"),
        setting("body_frame", type=NO_TYPE),
    ],
)
def test_what_cannot_be_set_is_refused(call: Call, node: str, wrong: ParameterMessage) -> None:
    request = SetParameters.Request(parameters=[wrong])
    results = call(SetParameters, f"{node}/set_parameters", request).results
    assert not any(one.successful for one in results)
    atomically = SetParametersAtomically.Request(parameters=[wrong])
    answer = call(SetParametersAtomically, f"{node}/set_parameters_atomically", atomically)
    assert not answer.result.successful


@pytest.mark.parametrize("node", NODES)
def test_what_can_be_set_is_set(call: Call, node: str) -> None:
    for value in (True, False):
        given = [setting("use_sim_time", type=ParameterType.PARAMETER_BOOL, bool_value=value)]
        (one,) = call(
            SetParameters, f"{node}/set_parameters", SetParameters.Request(parameters=given)
        ).results
        assert one.successful, one.reason
        request = SetParametersAtomically.Request(parameters=given)
        assert call(SetParametersAtomically, f"{node}/set_parameters_atomically", request).result.successful


@pytest.mark.parametrize("node", NODES)
def test_type_descriptions(call: Call, node: str) -> None:
    for name in ("rcl_interfaces/msg/ParameterEvent", "no_such/msg/Type", ""):
        request = GetTypeDescription.Request(type_name=name)
        call(GetTypeDescription, f"{node}/get_type_description", request)


@pytest.mark.parametrize("node", ["estimator", "monitor"])
def test_lifecycle_services(call: Call, node: str) -> None:
    states = call(GetAvailableStates, f"{node}/get_available_states", GetAvailableStates.Request())
    assert "active" in {one.label for one in states.available_states}
    for name in ("get_available_transitions", "get_transition_graph"):
        found = call(GetAvailableTransitions, f"{node}/{name}", GetAvailableTransitions.Request())
        assert "configure" in {one.transition.label for one in found.available_transitions}

    def change(transition: Transition, *, succeeds: bool, to: int) -> None:
        request = ChangeState.Request(transition=transition)
        answer = call(ChangeState, f"{node}/change_state", request)
        assert answer.success == succeeds
        assert call(GetState, f"{node}/get_state", GetState.Request()).current_state.id == to

    for wrong in (
        Transition(id=Transition.TRANSITION_ACTIVATE),
        Transition(id=Transition.TRANSITION_DEACTIVATE),
        Transition(id=NO_TYPE),
        Transition(label="no such transition"),
    ):
        change(wrong, succeeds=False, to=State.PRIMARY_STATE_UNCONFIGURED)
    for right, to in (
        (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
        (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED),
        (Transition.TRANSITION_UNCONFIGURED_SHUTDOWN, State.PRIMARY_STATE_FINALIZED),
    ):
        change(Transition(id=right), succeeds=True, to=to)
