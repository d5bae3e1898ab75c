# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The live page in a real browser: what comes on the topics is drawn, and what stops is said."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.node import Node

from benchmarks.chromium import PROGRAM, Tab, chromium
from benchmarks.view_cost import await_port, free_port
from quadpi_ros.live_session import Child

from .test_launching import GOLDEN_MODEL
from .test_view_node import Publishing

pytestmark = pytest.mark.skipif(PROGRAM is None, reason="no Chromium: apt-get install chromium")

WORD = "document.getElementById('state').textContent"
HOSTILE = '<img src=x onerror="window.hostile=1">'


@pytest.fixture(scope="module")
def tab(ros_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    """The page of a server in a process of its own, as it is opened once for all tests."""
    folder, port = tmp_path_factory.mktemp("page"), free_port()
    del ros_domain
    page = ("--port", str(port), "--no-open", "--model", str(GOLDEN_MODEL))
    with Child("quadpi_ros.view_node", page, folder), chromium(folder) as tab:
        await_port(port)
        tab.open(f"http://127.0.0.1:{port}/")
        tab.wait("document.getElementById('link').textContent === 'connected'")
        yield tab
        assert tab.problems == []


class Flying:
    """Vehicles that publish in a thread until the block ends."""

    def __init__(self, *vehicles: Publishing) -> None:
        self._vehicles = vehicles
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._fly)

    def _fly(self) -> None:
        while not self._ends.wait(0.05):
            for vehicle in self._vehicles:
                vehicle.fly()

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join()


@pytest.fixture
def node(ros: None) -> Iterator[Node]:
    del ros
    node = Node("flown", context=rclpy.get_default_context())
    yield node
    node.destroy_node()


def test_it_says_that_nothing_flies(tab: Tab) -> None:
    tab.wait("document.getElementById('reasons').textContent.includes('in this ROS domain')")
    assert tab.value(WORD) == "NO DATA"


def test_live_data_are_drawn_and_an_alarm_appears_and_goes(tab: Tab, node: Node) -> None:
    vehicle = Publishing(node, "/quad", HOSTILE)
    with Flying(vehicle):
        tab.wait("window.quadpi.drawn?.newest > 1")
        tab.wait(f"{WORD} === 'TRUSTED'")
        vehicle.level = 2
        tab.wait(f"{WORD} === 'ALARM'")
        tab.wait("document.getElementById('reasons').textContent.includes('forward or backward speed')")
        vehicle.level = 1
        tab.wait(f"{WORD} === 'WARNING'")
        vehicle.level = 0
        tab.wait(f"{WORD} === 'TRUSTED'")
        tab.wait("quadpi.page.overview.codes.includes('2')")
        # A hostile model is text; so is what the page says of it.
        assert HOSTILE in tab.value("document.getElementById('models').textContent")
        assert tab.value("document.querySelectorAll('img').length === 0 && window.hostile === undefined")
        tab.press(" ")
        paused = tab.value("quadpi.page.cursor")
        tab.wait(f"quadpi.page.vehicles.get('/quad').newest * 0.05 > {paused} + 1")
        assert tab.value("quadpi.page.cursor") == paused
        tab.press("l")
        tab.wait(f"quadpi.page.cursor > {paused} + 1")
    tab.wait("document.getElementById('reasons').textContent.includes('/quad/extrapolation_alarm')")
    assert tab.value(WORD) == "NO DATA"


def test_each_vehicle_has_a_button_with_its_state(tab: Tab, node: Node) -> None:
    first, second = Publishing(node, "/quad", "m@1"), Publishing(node, "/other", "m@2")
    second.level = 2
    with Flying(first, second):
        tab.wait("document.querySelectorAll('#vehicles button').length >= 2")
        buttons = "[...document.querySelectorAll('#vehicles button')]"
        button = f"{buttons}.find((one) => one.textContent.includes('/other'))"
        tab.wait(f"{button}.textContent.includes('ALARM')")
        tab.wait(f"{WORD} === 'TRUSTED'")
        tab.value(f"{button}.click()")
        tab.wait(f"{WORD} === 'ALARM'")
        tab.wait("quadpi.store.vehicle?.models[0]?.identity === 'm@2'")
