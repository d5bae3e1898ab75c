# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated circle, against RotorPy's own simulation of the same circle.

Both fly a controlled quadrotor for as long around the same circle, nose north, and log states at 500 Hz.

    quadpi   rotor-local aerodynamics of the Bebop 2 in each of four stages of Runge-Kutta, and its
             controller, at 1 kHz; logs accelerations, wrench and reference beside the states
    RotorPy  its Hummingbird with rotor drag, flapping and body drag, stepped by scipy's `solve_ivp` as
             RotorPy sets it up, and its SE(3) controller, at 500 Hz; logs command and reference beside them

RotorPy's IMU and motion capture are silenced, for sensors are no part of this figure: with them, as in its
`Environment.run`, it takes half as long again. Its safety checks stay, as do quadpi's.
"""

from __future__ import annotations

import importlib.metadata
import math
from types import SimpleNamespace

import numpy as np

from benchmarks import Result, UnavailableError, interleaved_seconds
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.truth import STEP_HZ

NAMES = ("simulation_vs_rotorpy",)

FLIGHT_S = 6.0
RADIUS_M, SPEED_M_S, HEIGHT_M = 3.0, 4.0, 3.0
ROTORPY_HZ = 500.0
# A flight that loses its circle would not be comparable.
ERROR_MAX_M = 0.5


def run() -> list[Result]:
    try:
        version = importlib.metadata.version("rotorpy")
    except importlib.metadata.PackageNotFoundError as error:
        raise UnavailableError("no rotorpy here; `make bench` installs it") from error
    plan, vehicle = circle_plan(), SimulatedVehicle.load("bebop2")
    ours, theirs = interleaved_seconds([lambda: circle(plan, vehicle), rotorpy_circle], repetitions=3).T
    baseline = (
        f"RotorPy {version} at {ROTORPY_HZ:.0f} Hz, its sensors silent: a circle of {FLIGHT_S:.0f} s in "
        f"{np.median(theirs):.2f} s ({FLIGHT_S / np.median(theirs):.1f} times real time); "
        f"quadpi at {STEP_HZ} Hz in {np.median(ours):.4f} s"
    )
    return [Result(NAMES[0], float(np.median(theirs / ours)), "times faster", baseline, goal=100.0)]


def circle_plan() -> FlightPlan:
    hover = FlightPlan(
        name="circle",
        scenario="benchmark",
        vehicle="bebop2",
        seed=0,
        duration_s=FLIGHT_S,
        height_m=HEIGHT_M,
    )
    orbit = {"radius_m": RADIUS_M, "speed_m_s": SPEED_M_S, "start_s": 0.0, "fade_s": 2.0, "nose": "north"}
    return hover.overridden(orbit=orbit)


def circle(plan: FlightPlan, vehicle: SimulatedVehicle) -> None:
    truth = simulate_flight(plan.name, vehicle, plan.reference(STEP_HZ))
    _require_on_circle(float(truth.position_error.max()))


def rotorpy_circle() -> None:
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.simulate import simulate
    from rotorpy.trajectories.circular_traj import ThreeDCircularTraj
    from rotorpy.vehicles.hummingbird_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor
    from rotorpy.wind.default_winds import NoWind
    from rotorpy.world import World

    still, upright = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
    hover = math.sqrt(quad_params["mass"] * 9.81 / (4.0 * quad_params["k_eta"]))
    start = {
        "x": np.array([RADIUS_M, 0.0, HEIGHT_M]),
        "v": np.array([0.0, SPEED_M_S, 0.0]),
        "q": upright,
        "w": still,
        "wind": still,
        "rotor_speeds": np.full(4, hover),
    }
    around = SPEED_M_S / (2.0 * math.pi * RADIUS_M)
    silent = SimpleNamespace(with_artifacts=False, measurement=lambda *_, **__: {}, step=lambda *_: {})
    time, state, _, flat, *_ = simulate(
        World.empty((-10.0, 10.0, -10.0, 10.0, -10.0, 10.0)),
        start,
        Multirotor(quad_params, initial_state=start),
        SE3Control(quad_params),
        ThreeDCircularTraj(
            center=np.array([0.0, 0.0, HEIGHT_M]),
            radius=np.array([RADIUS_M, RADIUS_M, 0.0]),
            freq=np.full(3, around),
        ),
        NoWind(),
        imu=silent,
        mocap=silent,
        estimator=silent,
        t_final=FLIGHT_S,
        t_step=1.0 / ROTORPY_HZ,
        safety_margin=0.25,
        use_mocap=False,
        terminate=False,
    )
    if time[-1] < FLIGHT_S:
        raise RuntimeError(f"RotorPy's flight ended after {time[-1]:.2f} s")
    _require_on_circle(float(np.linalg.norm(state["x"] - flat["x"], axis=1).max()))


def _require_on_circle(error: float) -> None:
    if not error < ERROR_MAX_M:
        raise RuntimeError(f"a flight got {error:.2f} m off its circle")
