# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Services, parameter, keys and clock of the player."""

from __future__ import annotations

import itertools
import os
import pty
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from quadpi_ros import playback_controls
from quadpi_ros.parameters import ParameterError
from quadpi_ros.playback import Playback
from quadpi_ros.playback_controls import Controls
from quadpi_ros.player import player_node

from .rig import known_client, wait_until

pytestmark = pytest.mark.usefixtures("ros")
SECOND = 1_000_000_000
START_NS = 1_700_000_000 * SECOND + 7


@pytest.fixture
def user() -> Iterator[Node]:
    node = rclpy.create_node("user")
    yield node
    node.destroy_node()


def call(user: Node, kind: type, name: str, request: Any) -> Any:
    def until(condition: Callable[[], bool]) -> None:
        wait_until(condition, lambda: rclpy.spin_once(user, timeout_sec=0.02))

    answer = known_client(user, kind, f"player/{name}", until).call_async(request)
    until(answer.done)
    return answer.result()


def trigger(user: Node, name: str) -> tuple[bool, str]:
    answer = call(user, Trigger, name, Trigger.Request())
    return answer.success, answer.message


def test_services_and_the_parameter_control_the_playback(user: Node) -> None:
    playback = Playback(paused=True, position_ns=2 * SECOND)
    with Controls(player_node(2.0), playback, START_NS, None, keys=False):
        assert playback.rate == 2.0
        assert trigger(user, "is_paused") == (True, "paused, at 2.000 s")
        assert trigger(user, "play_next") == (True, "paused, at 2.000 s")
        assert playback.wait_until(3 * SECOND, lambda: True)
        assert playback.position_ns == 3 * SECOND
        assert trigger(user, "resume")[0]
        assert not playback.paused
        success, where = trigger(user, "is_paused")
        assert not success
        assert where.startswith("playing at 2 x real time, at ")
        assert trigger(user, "play_next") == (False, "not paused")
        assert trigger(user, "toggle_paused")[0]
        assert playback.paused
        assert trigger(user, "toggle_paused")[0]
        assert trigger(user, "pause")[0]
        assert playback.paused
        for value, taken in ((0.5, True), (0.0, False), (4, True)):
            request = SetParameters.Request(parameters=[Parameter("rate", value=value).to_parameter_msg()])
            (result,) = call(user, SetParameters, "set_parameters", request).results
            assert result.successful == taken, result.reason
        assert playback.rate == 4.0


def test_the_clock_is_the_log_time_at_the_position(user: Node) -> None:
    """While paused too: nodes that start meanwhile get the time."""
    heard: list[int] = []
    user.create_subscription(
        Clock, "/clock", lambda one: heard.append(10**9 * one.clock.sec + one.clock.nanosec), 10
    )
    playback = Playback(paused=True, position_ns=2 * SECOND)
    with Controls(player_node(), playback, START_NS, 100.0, keys=False):
        wait_until(lambda: len(heard) > 3, lambda: rclpy.spin_once(user, timeout_sec=0.02))
        assert set(heard) == {START_NS + 2 * SECOND}
        playback.resume()
        wait_until(lambda: len(set(heard)) > 3, lambda: rclpy.spin_once(user, timeout_sec=0.02))
        assert heard == sorted(heard)
        playback.pause()
        playback.seek(SECOND)
        wait_until(lambda: heard[-1] == START_NS + SECOND, lambda: rclpy.spin_once(user, timeout_sec=0.02))


def test_keys_are_those_of_ros2_bag_play(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    keyboard, terminal = pty.openpty()
    monkeypatch.setattr(playback_controls, "_terminal", lambda: terminal)
    before = playback_controls.termios.tcgetattr(terminal)
    playback = Playback()
    glances = itertools.count()
    with Controls(player_node(), playback, START_NS, None, keys=True):
        assert playback_controls.termios.tcgetattr(terminal) != before
        for key, reached in (
            (b" ", lambda: playback.paused),
            (b"\x1b[C", lambda: playback.wait_until(9 * SECOND, lambda: next(glances) < 300)),
            (b"\x1b[A\x1b[A", lambda: playback.rate == pytest.approx(1.21)),
            (b"x\x1b[D\x1b[B", lambda: playback.rate == pytest.approx(1.1)),
            (b" ", lambda: not playback.paused),
        ):
            os.write(keyboard, key)
            wait_until(reached)
    assert playback_controls.termios.tcgetattr(terminal) == before
    for descriptor in (keyboard, terminal):
        os.close(descriptor)
    assert "space: pause, resume" in capfd.readouterr().out


def test_a_rate_out_of_bounds_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"node player: parameter `rate` must lie between 0\.01 and 100"):
        Controls(player_node(1000.0), Playback(), START_NS, None, keys=False)
