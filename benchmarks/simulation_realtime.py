# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One simulated flight at 1 kHz, against the time that it would take for real.

From the plan of the flight to its truth: the reference at 1 kHz, trim, controller, rotor-local wrench in each
stage of Runge-Kutta, and states, accelerations and wrench logged at 500 Hz. The first flight, which loads the
compiled kernels, does not count.
"""

from __future__ import annotations

import numpy as np

from benchmarks import Result, interleaved_seconds
from quadpi_core.simulation.applied_effects import EFFECTS, read_effects
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.truth import STEP_HZ

NAMES = ("simulation_realtime",)

# A flight that the controller holds in the air with every effect at once.
SCENARIO, FLIGHT = "validation", "y_height_sines"
REPETITIONS = 9


def run() -> list[Result]:
    plan = next(plan for plan in load_scenario(SCENARIO).flights if plan.name == FLIGHT)
    vehicle = SimulatedVehicle.load(plan.vehicle)
    on_wrench = [name for name, effect in EFFECTS.items() if effect.kind == "wrench"]
    every_effect = read_effects(dict.fromkeys(on_wrench), "benchmark")
    seconds, with_effects = np.median(
        interleaved_seconds(
            [
                lambda: simulate_flight(plan.name, vehicle, plan.reference(STEP_HZ)),
                lambda: simulate_flight(plan.name, vehicle, plan.reference(STEP_HZ), effects=every_effect),
            ],
            REPETITIONS,
        ),
        axis=0,
    )
    baseline = (
        f"real time: {plan.duration_s:.0f} s of a {plan.vehicle}, flown in {seconds:.3f} s on one core; with "
        f"all {len(on_wrench)} effects on the wrench at once in {with_effects:.3f} s, "
        f"{plan.duration_s / with_effects:.0f} times real time"
    )
    return [Result(NAMES[0], plan.duration_s / float(seconds), "times real time", baseline, goal=200.0)]
