# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The live page: a node that listens to the results of every vehicle of the domain, and publishes nothing.

Messages are taken at the ticks of the server, not one by one by an executor: at 500 Hz that costs a fraction.
Subscriptions are best effort, so that no publisher ever waits for the page.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.vehicle_view import VehicleView
from quadpi_core.view.view_server import ADDRESS, PORT, announce, serve_page
from quadpi_ros.inbox import Inbox
from quadpi_ros.live_vehicle import (
    ALARM,
    DESCRIPTION,
    DESCRIPTION_NAME,
    PREDICTION,
    LiveVehicle,
    warm_up,
)
from quadpi_ros.runtime import run

# The graph is looked at this often for vehicles and topics that have come.
_DISCOVER_S = 0.5
# Nodes whose statuses are shown.
_TOLD_OF = {"monitor", "estimator", "mavlink_bridge"}


class LiveSource:
    """Every vehicle of the domain, as a source of the page.

    Args:
        context: initialised.
        known: models with their vehicles, whose training ranges are shown where they fly.
    """

    live = True

    def __init__(self, context: Context, known: Mapping[str, tuple[AerodynamicModel, Vehicle]]) -> None:
        self.title = f"live, ROS domain {os.environ.get('ROS_DOMAIN_ID', '0')}"
        self._context = context
        self._node = Node("quadpi_view", context=context, start_parameter_services=False, enable_rosout=False)
        self._known = known
        self._vehicles: dict[str, LiveVehicle] = {}
        self._diagnostics = Inbox(self._node, DiagnosticArray, "/diagnostics", raw=False)
        self._discovered_s = 0.0

    @property
    def vehicles(self) -> Mapping[str, VehicleView]:
        """By namespace."""
        return {name: vehicle.view for name, vehicle in self._vehicles.items()}

    @property
    def ended(self) -> bool:
        """Whether ROS has been shut down, as on Ctrl-C."""
        return not self._context.ok()

    def poll(self) -> None:
        """Take what has come on all topics."""
        if self.ended:
            return
        now_s = time.monotonic()
        if now_s - self._discovered_s >= _DISCOVER_S:
            self._discovered_s = now_s
            self._discover()
            for array in self._diagnostics.take():
                self._take_diagnostics(array)
            for vehicle in self._vehicles.values():
                vehicle.report()
        for vehicle in self._vehicles.values():
            vehicle.take()

    def close(self) -> None:
        """Leave the domain."""
        if self._context.ok():
            self._node.destroy_node()

    def _discover(self) -> None:
        types_by_topic = dict(self._node.get_topic_names_and_types())
        claims = {topic: vehicle for vehicle in self._vehicles.values() for topic in vehicle.claimed}
        for topic, types in types_by_topic.items():
            if topic in claims:
                continue
            if ALARM in types or (PREDICTION in types and self._owner(topic) is None):
                self._add(topic.rpartition("/")[0] or "/")
            elif DESCRIPTION in types and topic.endswith(f"/monitor/{DESCRIPTION_NAME}"):
                self._add(topic.rsplit("/", 2)[0] or "/")
        # What was taken for a vehicle before the monitor said that these topics are its own.
        for name, vehicle in list(self._vehicles.items()):
            if vehicle.heard and all(claims.get(topic, vehicle) is not vehicle for topic in vehicle.heard):
                vehicle.close()
                del self._vehicles[name]
        for vehicle in self._vehicles.values():
            vehicle.listen(
                {
                    topic: types
                    for topic, types in types_by_topic.items()
                    if claims.get(topic, self._owner(topic)) is vehicle
                }
            )

    def _add(self, namespace: str) -> None:
        if namespace not in self._vehicles:
            self._vehicles[namespace] = LiveVehicle(self._node, namespace, self._known)

    def _owner(self, topic: str) -> LiveVehicle | None:
        """The vehicle whose namespace is the innermost around a topic."""
        namespace = topic
        while namespace:
            namespace = namespace.rpartition("/")[0]
            if (vehicle := self._vehicles.get(namespace or "/")) is not None:
                return vehicle
        return None

    def _take_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            node = "/" + status.name.partition(":")[0]
            vehicle = self._vehicles.get(node.rpartition("/")[0] or "/")
            if vehicle is not None and node.rpartition("/")[2] in _TOLD_OF:
                vehicle.take_status(status)


def view_live(
    models: Sequence[AerodynamicModel],
    vehicle: str | None,
    port: int,
    address: str,
    on_start: Callable[[str], None],
    context: Context | None = None,
) -> None:
    """Serve the page of the live nodes of this ROS domain until interrupted.

    Args:
        models: whose training ranges are shown where they fly.
        vehicle: of all of them; each one's own unless given.
        port: see :class:`quadpi_core.view.view_server.ViewServer`.
        address: see there.
        on_start: called with the address of the page.
        context: of ROS; one is made unless given.

    Raises:
        QuadpiError: for a model of another vehicle, or a port in use.
    """
    known = {model.identity: (model, model.load_vehicle(vehicle)) for model in models}
    is_new = context is None
    the_context = Context() if context is None else context
    if is_new:
        the_context.init(args=[])
    try:
        warm_up()
        source = LiveSource(the_context, known)
        serve_page(source, port, address, on_start, until=lambda: source.ended)
    finally:
        if is_new:
            the_context.try_shutdown()


def main() -> int:
    """Run the page in a process of its own, as launch files do."""
    return run(lambda: _serve(remove_ros_args(sys.argv)[1:]))


def _serve(arguments: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(prog="view", description="The page of the live nodes.")
    parser.add_argument("--model", action="append", default=[], help="model folder; may be repeated")
    parser.add_argument("--vehicle", help="vehicle of the models")
    parser.add_argument("--port", type=int, default=PORT, help="port of the page; 0 takes any")
    parser.add_argument("--bind", default=ADDRESS, help="address to listen on")
    parser.add_argument("--open", action=argparse.BooleanOptionalAction, help="open the page")
    options = parser.parse_args(arguments)
    models = [AerodynamicModel.load(Path(folder)) for folder in options.model]

    def say(url: str) -> None:
        announce(_say, url, options.open)

    view_live(models, options.vehicle, options.port, options.bind, say, rclpy.get_default_context())


def _say(line: str) -> None:
    print(line, flush=True)


if __name__ == "__main__":
    raise SystemExit(main())
