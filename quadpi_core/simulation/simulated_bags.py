# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated flights as bags: sensor streams on the standard topics, the true states under /truth/."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from quadpi_core.config_schema import Positive, Section, Vector, parse_config
from quadpi_core.errors import LogError, one_line
from quadpi_core.flight import OdometryStream, PoseStream, RotorSpeedStream, Stamps, WindStream
from quadpi_core.frames import Array
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_topics import find_topic, unpacked_topic
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.topics import TOPIC_TYPES
from quadpi_core.paths import parse_json
from quadpi_core.rotations import from_rotation_vector, rotate_body_to_world, rotate_world_to_body
from quadpi_core.simulation.sensors import Sensed
from quadpi_core.simulation.truth import Truth
from quadpi_core.vehicle import is_rigid_body
from quadpi_core.version import __version__

if TYPE_CHECKING:
    from quadpi_core.simulation.scenario import FlightPlan

_Content = TypeVar("_Content")


@dataclass(frozen=True)
class RecordedTruth:
    """The truth in a bag at N instants; body axes forward-right-down, world north-east-down, SI.

    Attributes:
        mass, gravity: [kg], [m/s²] of the vehicle as it truly flew.
        inertia: (3, 3) kg m².
        odometry: position, attitude, velocity over ground and rates.
        acceleration: (N, 3) m/s², second derivative of the position, world.
        angular_acceleration: (N, 3) rad/s².
        rotor_speeds: (N, rotors) rad/s.
        wrench: (N, 6) aerodynamics and effects, gravity not included.
        wind: (N, 3) m/s, world.
        reference: position and heading that the controller was to follow.
    """

    mass: float
    gravity: float
    inertia: Array
    odometry: OdometryStream
    acceleration: Array
    angular_acceleration: Array
    rotor_speeds: Array
    wrench: Array
    wind: Array
    reference: PoseStream

    @property
    def time_ns(self) -> Stamps:
        """Stamps (N,)."""
        return self.odometry.time_ns


def write_simulated_bag(path: Path | str, plan: FlightPlan, truth: Truth, sensed: Sensed) -> None:
    """Write a simulated flight as an MCAP bag; equal input gives equal bytes.

    Its custom data (of rosbag2) name vehicle, version, scenario, flight and seed; as JSON it holds the
    effects, the whole plan, and mass and inertia as flown. Messages of sensors are logged at their arrival.

    Args:
        path: .mcap file to write; it appears whole or not at all.
        plan: plan of the flight; its `truth_rate_hz` divides the rate of the truth.
        truth: truth of the flight.
        sensed: messages of its sensors.
    """
    step = round(1e9 / (plan.truth_rate_hz * float(truth.time_ns[1] - truth.time_ns[0])))
    vehicle = {
        "mass_kg": truth.vehicle.mass_kg,
        "inertia_kg_m2": truth.vehicle.inertia.tolist(),
        "gravity_m_s2": truth.vehicle.gravity_m_s2,
    }
    metadata = {
        "vehicle": sensed.recording.vehicle,
        "version": __version__,
        "scenario": plan.scenario,
        "flight": plan.name,
        "seed": str(plan.seed),
    }
    parts = {"effects": plan.as_dict()["effects"], "plan": plan.as_dict(), "truth": vehicle}
    metadata |= {name: json.dumps(part, allow_nan=False) for name, part in parts.items()}
    write_mcap(Path(path), [*_sensor_topics(sensed), *_truth_topics(truth, step)], metadata)


def _sensor_topics(sensed: Sensed) -> list[Topic]:
    recording, erpm = sensed.recording, sensed.erpm
    packed = {"imu": sensor_messages.pack_imu(recording.imu)}
    rotors = recording.rotor_speeds
    if rotors is not None and erpm is not None:
        packed["erpm"] = sensor_messages.pack_erpm(rotors.time_ns, erpm)
    elif rotors is not None:
        packed["rotor_speeds"] = sensor_messages.pack_rotor_speeds(rotors)
    if recording.pose is not None:
        packed["mocap/pose"] = sensor_messages.pack_pose(recording.pose)
    if recording.wind is not None:
        packed["wind"] = sensor_messages.pack_wind(recording.wind)
    arrival_ns = sensed.arrival_ns | {"erpm": sensed.arrival_ns["rotor_speeds"]}
    return [output_topic(name, arrival_ns[name], payloads) for name, payloads in packed.items()]


def _truth_topics(truth: Truth, step: int) -> list[Topic]:
    """The truth, every `step`-th instant; accelerations as a message of body axes holds them."""
    taken = slice(None, None, step)
    time_ns, attitude = truth.time_ns[taken], truth.attitude[taken]
    acceleration = rotate_world_to_body(attitude, truth.acceleration[taken])
    accelerations = np.concatenate((acceleration, truth.angular_acceleration[taken]), axis=1)
    level = np.zeros(len(time_ns))
    headings = from_rotation_vector(np.stack((level, level, truth.reference.yaw[taken]), axis=1))
    odometry = OdometryStream(
        time_ns, truth.position[taken], attitude, truth.velocity[taken], truth.rates[taken]
    )
    messages = sensor_messages
    packed = {
        "odometry": messages.pack_odometry(odometry),
        "wrench": messages.pack_body_vectors(time_ns, truth.wrench[taken], messages.WRENCH),
        "acceleration": messages.pack_body_vectors(time_ns, accelerations, messages.ACCELERATION),
        "rotor_speeds": messages.pack_rotor_speeds(RotorSpeedStream(time_ns, truth.rotor_speeds[taken])),
        "wind": messages.pack_wind(WindStream(time_ns, truth.wind[taken])),
        "reference": messages.pack_pose(PoseStream(time_ns, truth.reference.position[taken], headings)),
    }
    return [output_topic(f"truth/{name}", time_ns, payloads) for name, payloads in packed.items()]


def read_truth(path: Path | str) -> RecordedTruth:
    """Read the truth of a bag of :func:`write_simulated_bag`.

    Numbers are those that were written; attitudes and the acceleration, which are rotated, to a few
    roundings.

    Raises:
        LogError: naming bag and topic, for a bag without the truth.
    """
    path = Path(path)
    with Bag(path) as bag:
        names = {}
        for topic in TOPIC_TYPES:
            if topic.startswith("truth/"):
                if (connection := find_topic(bag, topic)) is None:
                    raise LogError(f"{path}: topic {topic}: missing: no flight of quadpi's simulation")
                names[topic] = connection.topic
        topics = bag.read(names.values())
        text = bag.metadata.get("truth")
    if text is None:
        raise LogError(f"{path}: no `truth` in its metadata: no flight of quadpi's simulation")
    where = f"{path}: `truth` in its metadata"
    try:
        body = parse_config(_FlownBody, parse_json(text), where, LogError)
    except ValueError as error:
        raise LogError(f"{where}: {one_line(error)}") from error

    def unpacked(name: str, unpack: Callable[[Payloads], _Content]) -> _Content:
        return unpacked_topic(path, topics[names[f"truth/{name}"]], unpack)

    odometry = unpacked("odometry", sensor_messages.unpack_odometry)
    vectors = sensor_messages.unpack_body_vectors
    _, wrench = unpacked("wrench", partial(vectors, type_name=sensor_messages.WRENCH))
    _, accelerations = unpacked("acceleration", partial(vectors, type_name=sensor_messages.ACCELERATION))
    return RecordedTruth(
        mass=body.mass_kg,
        gravity=body.gravity_m_s2,
        inertia=np.array(body.inertia_kg_m2),
        odometry=odometry,
        acceleration=rotate_body_to_world(odometry.attitude, accelerations[:, :3]),
        angular_acceleration=accelerations[:, 3:],
        rotor_speeds=unpacked("rotor_speeds", sensor_messages.unpack_rotor_speeds).speeds,
        wrench=wrench,
        wind=unpacked("wind", sensor_messages.unpack_wind).velocity,
        reference=unpacked("reference", sensor_messages.unpack_pose),
    )


@dataclass(frozen=True, kw_only=True)
class _FlownBody(Section):
    """The metadata `truth` of a bag: the rigid body as it truly flew."""

    mass_kg: Positive
    inertia_kg_m2: tuple[Vector, Vector, Vector]
    gravity_m_s2: Positive

    def __post_init__(self) -> None:
        if not is_rigid_body(np.array(self.inertia_kg_m2)):
            raise ValueError("`inertia_kg_m2` is not the inertia of a rigid body")
