# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of the bundled bags beside the simulation that flew them, an effect it lacks; random states."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.discrepancy.discrepancy_result import Study
from quadpi_core.discrepancy.simulations import VehicleSimulation
from quadpi_core.discrepancy.study import study
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights, read_flight
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.paths import bags_directory
from quadpi_core.simulation.applied_effects import effect_wrench
from quadpi_core.vehicle import Vehicle

from .dragged_flights import dragged_flights, dragged_model, dragged_paths  # noqa: F401
from .known_flights import noisy_vehicle, simulate_flight, simulated, true_flight  # noqa: F401
from .messages.adapters.vendor_messages import DEFINITIONS, PX4_1_18, Messages

# A search looks for these in tests: each candidate takes time.
SOUGHT = ("body_drag", "rate_damping", "payload", "wind", "moment_bias")
DRAG = {"x_n_s2_m2": 0.006, "y_n_s2_m2": 0.009, "z_n_s2_m2": 0.006}


@pytest.fixture(scope="session")
def simulation() -> VehicleSimulation:
    """Of the Bebop 2."""
    return VehicleSimulation.load("bebop2")


@pytest.fixture(scope="session")
def flights() -> list[Flight]:
    """Four flights of 20 s at up to 6 m/s, fused, thinned to 125 Hz."""
    vehicle = Vehicle.load("bebop2")
    paths = [bags_directory() / f"train_{k}.mcap" for k in (1, 2, 3, 4)]
    return [read_flight(path, vehicle, 30.0).slice(slice(None, None, 4)) for path in paths]


def pushed(flight: Flight, vehicle: Vehicle, wrench: Array) -> Flight:
    """The flight as if a wrench (N, 6) more had acted on it along its path; no longer that of its bag."""
    turn = wrench[:, 3:] @ np.linalg.inv(vehicle.inertia)
    return replace(
        flight,
        source=f"{flight.name}, pushed",
        specific_force=flight.specific_force + wrench[:, :3] / vehicle.mass_kg,
        angular_acceleration=flight.angular_acceleration + turn,
    )


@pytest.fixture(scope="session", name="pushed")
def pushed_fixture() -> Callable[[Flight, Vehicle, Array], Flight]:
    """See :func:`pushed`."""
    return pushed


@pytest.fixture(scope="session")
def dragged(simulation, flights) -> list[Flight]:
    """The flights with drag of the airframe that the simulation lacks."""

    def drag(flight: Flight, parameters: Mapping[str, float]) -> Array:
        return effect_wrench("body_drag", parameters, simulation.states(flight), simulation.record())

    return [pushed(flight, simulation.vehicle, drag(flight, DRAG)) for flight in flights]


@pytest.fixture(scope="session")
def found(simulation, dragged) -> Study:
    """What a search finds in the flights with drag.

    Pushed flights keep their paths, so their roll-outs are better without the drag: they do not count here.
    """
    result = study(simulation, dragged, names=SOUGHT)
    passed = tuple(check for check in result.discovery.checks if check.passed)
    discovery = replace(result.discovery, checks=passed)
    return replace(result, discovery=discovery)


@pytest.fixture(scope="session")
def random_states():
    """random_states(model, samples, seed): fast flight in any attitude, up to 5 m above the ground."""

    def draw(model, samples, seed):
        rng = np.random.default_rng(seed)
        attitude = rng.normal(size=(samples, 4))
        return model.states(
            rng.normal(0.0, 5.0, (samples, 3)),
            rng.normal(0.0, 4.0, (samples, 3)),
            rng.uniform(200.0, 1200.0, (samples, 4)),
            rotor_accelerations=rng.normal(0.0, 1000.0, (samples, 4)),
            position=rng.uniform(-5.0, 0.0, (samples, 3)),
            attitude=attitude / np.linalg.norm(attitude, axis=1, keepdims=True),
        )

    return draw


@pytest.fixture(scope="session")
def vendor():
    """Messages by version of px4_msgs: `vendor.px4_1_14` (to 1.17) and `vendor.px4_1_18`; others in both."""
    return SimpleNamespace(px4_1_14=Messages(DEFINITIONS), px4_1_18=Messages(PX4_1_18))


@pytest.fixture(scope="session")
def predicting(bags: list[Path], made_once) -> Path:
    """Folder of a physical model of the first two flights of `bags`, which predicts ahead."""

    def identified(folder: Path) -> None:
        vehicle, options = Vehicle.load("neurobem"), IdentifyOptions(method="physical")
        flights = prepare_flights(bags[:2], vehicle, options.cutoff_hz)
        identify(flights, vehicle, load_pools("quadrotor"), options).save(folder / "model")

    return made_once("predicting", identified) / "model"
