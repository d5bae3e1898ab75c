# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated flights: flown, sensed and written as bags, their true states under /truth/."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from quadpi_core import array_checks
from quadpi_core.config_schema import Positive, Section, parse_config
from quadpi_core.core import arctangent
from quadpi_core.errors import LogError, SimulationError, named_in, one_line
from quadpi_core.flight import Flight, OdometryStream, PoseStream, RotorSpeedStream, Stamps, WindStream
from quadpi_core.frames import Array, from_rotation_vector, rotate_world_to_body
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_topics import find_topic, unpacked_topic
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic, recording_topics
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.topics import TOPIC_TYPES
from quadpi_core.parallel import DEFAULT_WORKERS, Progress, Workers
from quadpi_core.paths import parse_json, require_file, whole_outputs
from quadpi_core.records import CONVENTION, Threshold, brief_repr
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.sensors import Sensed, sense
from quadpi_core.simulation.state_records import TILT_MAX_DEG
from quadpi_core.simulation.truth import STEP_HZ, Reference, Truth
from quadpi_core.version import __version__

_Content = TypeVar("_Content")


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


def _sensor_topics(sensed: Sensed) -> Iterator[Topic]:
    """The sensors, logged at their arrival; rotor speeds as the controllers of a vehicle send them."""
    rotors = sensed.recording.rotor_speeds
    for topic in recording_topics(sensed.recording):
        name, payloads = topic.name.removeprefix("/"), topic.payloads
        arrival_ns = sensed.arrival_ns[name]
        if name == RotorSpeedStream.topic and rotors is not None and sensed.erpm is not None:
            name, payloads = "erpm", sensor_messages.pack_erpm(rotors.time_ns, sensed.erpm)
        yield output_topic(name, arrival_ns, payloads)


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


class RecordedTruth(NamedTuple):
    """The truth in a bag at N instants, as flown and as if the estimator were perfect.

    Attributes:
        odometry: position, attitude, velocity over ground and rates.
        flight: the same, with what else a flight has; accelerations are those of the mass as it flew.
        wrench: (N, 6) N and Nm of aerodynamics and effects, gravity not included.
    """

    odometry: OdometryStream
    flight: Flight
    wrench: Array

    @property
    def time_ns(self) -> Stamps:
        """Stamps (N,)."""
        return self.odometry.time_ns


def read_truth(path: Path | str) -> RecordedTruth:
    """Read the truth of a bag of :func:`write_simulated_bag`.

    Numbers are those that were written; attitudes, which are rotated, to a few roundings.

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
        topics, metadata = bag.read(names.values()), bag.metadata
    if "truth" not in metadata:
        raise LogError(f"{path}: no `truth` in its metadata: no flight of quadpi's simulation")
    where = f"{path}: `truth` in its metadata"
    try:
        mass_kg = parse_config(_FlownBody, parse_json(metadata["truth"]), where, LogError).mass_kg
    except ValueError as error:
        raise LogError(f"{where}: {one_line(error)}") from error

    def unpacked(name: str, unpack: Callable[[Payloads], _Content]) -> _Content:
        return unpacked_topic(path, topics[names[f"truth/{name}"]], unpack)

    state = unpacked("odometry", sensor_messages.unpack_odometry)
    vectors = sensor_messages.unpack_body_vectors
    _, wrench = unpacked("wrench", partial(vectors, type_name=sensor_messages.WRENCH))
    _, accelerations = unpacked("acceleration", partial(vectors, type_name=sensor_messages.ACCELERATION))
    rotor_speeds = unpacked("rotor_speeds", sensor_messages.unpack_rotor_speeds).speeds
    wind = unpacked("wind", sensor_messages.unpack_wind).velocity
    columns = {"wrench": wrench, "acceleration": accelerations, "rotor_speeds": rotor_speeds, "wind": wind}
    for name, values in columns.items():
        if len(values) != len(state):
            raise LogError(
                f"{path}: topic truth/{name}: {len(values)} samples, of truth/odometry {len(state)}"
            )
    flight = Flight(
        name=path.stem,
        vehicle=metadata.get("vehicle", ""),
        source=str(path),
        start_ns=int(state.time_ns[0]),
        time=1e-9 * (state.time_ns - state.time_ns[0]),
        position=state.position,
        attitude=state.attitude,
        velocity=state.velocity,
        rates=state.rates,
        angular_acceleration=accelerations[:, 3:],
        specific_force=wrench[:, :3] / mass_kg,
        rotor_speeds=rotor_speeds,
        wind=wind,
    )
    return RecordedTruth(state, flight, wrench)


@dataclass(frozen=True, kw_only=True)
class _FlownBody(Section):
    """The metadata `truth` of a bag: the rigid body as it truly flew."""

    mass_kg: Positive
    inertia_kg_m2: Any
    gravity_m_s2: Any


SIMULATED_AIRSPEED_M_S = Threshold(
    "largest airspeed of a reference",
    16.0,
    "m/s",
    "the rotor-local model was measured up to 14; a flight against such a wind moves forward in it too",
    "Bebop 2 in a wind tunnel",
)
EXCITED_TILT_MAX_DEG = Threshold(
    "largest tilt of path and excitation together", 75.0, "degrees", "ten more than of the path", CONVENTION
)
YAW_RATE_MAX_DEG_S = Threshold(
    "largest yaw rate of a reference", 360.0, "degrees/s", "a faster turn is a mistake in units", CONVENTION
)


@dataclass(frozen=True)
class SimulatedFlight:
    """A flight that was flown and written as a bag."""

    __repr__ = brief_repr

    plan: FlightPlan
    truth: Truth
    bag: Path


def simulate(
    plans: Sequence[FlightPlan],
    output: Path | str,
    *,
    workers: Workers = DEFAULT_WORKERS,
) -> list[SimulatedFlight]:
    """Fly the plans, several at a time, and write a bag for each into a folder: all of them or none.

    Args:
        plans: with different names, such as `load_scenario(name_or_path).flights`.
        output: folder; bags of the same names in it are replaced.
        workers: their count is the number of simultaneous flights, by default one per core. Flights fly in
            threads of this process, with any scheduler.

    Returns:
        The flights in the order of the plans.

    Raises:
        ArgumentError: for what are no plans, folder or workers.
        SimulationError: naming flight, time and state, for a reference that the vehicle cannot follow and a
            vehicle out of control; and for sensors that are not possible.
        VehicleError: for a vehicle that cannot be simulated.
        OutputError: if a bag cannot be written.
    """
    hint = "load_scenario(name_or_path).flights gives them"
    plans = array_checks.several("plans", plans, FlightPlan, hint)
    output = array_checks.path("output", output)
    array_checks.instance("workers", workers, Workers)
    vehicles, suites = {}, {}
    for plan in plans:
        with named_in(f"scenario {plan.scenario}, flight {plan.name}"):
            if plan.vehicle not in vehicles:
                vehicles[plan.vehicle] = SimulatedVehicle.load(plan.vehicle)
            if plan.noise not in suites:
                suites[plan.noise] = SensorSuite.load(plan.noise)
        require_file(output / f"{plan.name}.mcap")

    def flown(plan: FlightPlan, staging: Path) -> SimulatedFlight:
        bag = f"{plan.name}.mcap"
        truth, sensed = fly_and_sense(plan, vehicles[plan.vehicle], suites[plan.noise])
        write_simulated_bag(staging / bag, plan, truth, sensed)
        return SimulatedFlight(plan, truth, output / bag)

    flights: list[SimulatedFlight] = []
    whole_s = sum(plan.duration_s for plan in plans)
    # Threads suffice: flight, random numbers and compression run outside the interpreter's lock.
    with whole_outputs(output) as staging, ThreadPoolExecutor(workers.count or os.cpu_count()) as pool:
        # Of several that fail, the first of the plans is reported, not the first in time.
        for flight in pool.map(flown, plans, repeat(staging)):
            flights.append(flight)
            seconds = sum(flight.plan.duration_s for flight in flights)
            note = f"{len(flights)} of {len(plans)} flights"
            workers.progress(Progress("Flying", seconds, whole_s, "s", note))
    return flights


def fly_and_sense(plan: FlightPlan, vehicle: SimulatedVehicle, suite: SensorSuite) -> tuple[Truth, Sensed]:
    """Truth of a flight, and the messages of its sensors.

    Raises:
        SimulationError: see :func:`simulate`.
    """
    truth = fly_plan(plan, vehicle)
    effects = vehicle.with_own(plan.effects)
    return truth, sense(truth, vehicle.vehicle, suite, effects, plan.faults, plan.seed)


def fly_plan(plan: FlightPlan, vehicle: SimulatedVehicle) -> Truth:
    """Truth of a flight.

    Raises:
        SimulationError: see :func:`simulate`.
    """
    reference = plan.reference(STEP_HZ)
    require_reachable(plan, vehicle, reference)
    known_wind, effects, seed = plan.known_wind, plan.effects, plan.seed
    return simulate_flight(plan.name, vehicle, reference, known_wind=known_wind, effects=effects, seed=seed)


def require_reachable(plan: FlightPlan, vehicle: SimulatedVehicle, reference: Reference) -> None:
    """Refuse a reference of a plan that demands more than the vehicle can do; drag is neglected.

    Raises:
        SimulationError: naming flight and instant, the demand and the limit.
    """
    nominal = vehicle.vehicle
    wind = 0.0 if plan.known_wind is None else plan.known_wind
    gravity = np.array([0.0, 0.0, nominal.gravity_m_s2])
    force = reference.acceleration - gravity
    upright = arctangent(_size(force[:, :2]), -force[:, 2])
    thrust = _size(force) + reference.thrust * nominal.gravity_m_s2
    limits: tuple[tuple[str, str, Array, float], ...] = (
        ("specific force", "m/s²", thrust, vehicle.greatest_thrust / nominal.mass_kg),
        ("specific force downward", "m/s²", -thrust, 0.0),
        ("airspeed", "m/s", _size(reference.velocity - wind), SIMULATED_AIRSPEED_M_S.value),
        ("tilt along the path", "degrees", np.degrees(upright), TILT_MAX_DEG.value),
        ("tilt", "degrees", np.degrees(upright + _size(reference.tilt)), EXCITED_TILT_MAX_DEG.value),
        ("yaw rate", "degrees/s", np.degrees(np.abs(reference.yaw_rate)), YAW_RATE_MAX_DEG_S.value),
    )
    for quantity, unit, demanded, available in limits:
        worst = int(np.argmax(demanded))
        # Written so that NaN is refused, too.
        if not demanded[worst] <= available:
            seconds = plan.duration_s * worst / (len(reference) - 1)
            raise SimulationError(
                f"flight {plan.name}: unreachable reference: at {seconds:.2f} s it demands "
                f"{demanded[worst]:.1f} {unit} of {quantity}, and {nominal.name} has {available:.1f}"
            )


def _size(vectors: Array) -> Array:
    return np.sqrt((vectors * vectors).sum(axis=1))
