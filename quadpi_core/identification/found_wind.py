# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The wind of flights in the open that nothing measures: found with the drag of their vehicle.

As a report finds it (:mod:`quadpi_core.field.drag`): the specific force along x and y is drag, in a wind
that walks slowly. Inputs of a model are then relative to the air, those of live samples by the wind that a
monitor would have known by then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from quadpi_core.field.drag import STEP_S, WIND, DragFit, DragSamples, identify_drag, piece_lengths_s
from quadpi_core.flight import Flight
from quadpi_core.frames import Array, rotate_body_to_world, rotate_world_to_body, rotation_matrix
from quadpi_core.identification.prepared_flights import LiveSamples, PreparedFlight
from quadpi_core.inputs import INPUT_INDEX, VELOCITY_INPUTS, aerodynamic_inputs, flight_inputs
from quadpi_core.models.interval_rules import WindDrag
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.wind_state import WindState
from quadpi_core.vehicle import Vehicle

_RATES = [INPUT_INDEX[name] for name in "pqr"]
_TILT = slice(INPUT_INDEX["sin_phi"], INPUT_INDEX["cos_theta"] + 1)


def with_found_wind(
    flights: Sequence[PreparedFlight], vehicle: Vehicle
) -> tuple[Sequence[PreparedFlight], WindDrag | None]:
    """Flights with the wind of those in which nothing measures it, and the drag that told it.

    None, and flights as they are, where no flight lacks its wind, or they do not tell drag along both axes.
    """
    open_air = [one.flight for one in flights if one.wind_unknown and one.flight is not None]
    samples = _drag_samples(open_air)
    if not samples or any(one.value is None for one in identify_drag(samples).per_mass):
        return flights, None
    known = WIND if vehicle.noise.wind_m_s is None else vehicle.noise.wind_m_s
    fit = DragFit(samples, quadratic=False, wind=known)
    (along, across), (noise_x, noise_y) = fit.theta[:2].tolist(), fit.scale.tolist()
    drag = WindDrag(
        per_mass_x_1_s=along,
        per_mass_y_1_s=across,
        noise_x_m_s2=noise_x,
        noise_y_m_s2=noise_y,
        wind_m_s=known,
    )
    found, deviations = [], []
    for one in flights:
        flight, deviation = _in_wind(one, drag, vehicle)
        found.append(flight)
        deviations += [deviation] if deviation else []
    # Without live samples nothing is known of it but what is before a flight.
    return found, replace(drag, known_m_s=float(np.median(deviations or [known])))


def in_found_wind(flight: PreparedFlight, drag: WindDrag | None, vehicle: Vehicle) -> PreparedFlight:
    """A flight with its wind by the drag of a model; as it is where something measures the wind."""
    return flight if drag is None else _in_wind(flight, drag, vehicle)[0]


def _in_wind(prepared: PreparedFlight, drag: WindDrag, vehicle: Vehicle) -> tuple[PreparedFlight, float]:
    """The flight, and the median deviation of the wind that a monitor would have known; 0 without a wind."""
    flight = prepared.flight
    if not prepared.wind_unknown or flight is None or not (samples := _drag_samples([flight])):
        return prepared, 0.0
    fit = DragFit(
        samples, quadratic=False, known=(drag.per_mass_x_1_s, drag.per_mass_y_1_s), wind=drag.wind_m_s
    )
    blown = replace(flight, wind=np.column_stack((fit.wind_at(0, flight.time), np.zeros(len(flight)))))
    live, deviation = None, 0.0
    if prepared.live is not None:
        live, deviation = _live_in_wind(prepared.live, flight, drag, vehicle)
    found = replace(
        prepared, flight=blown, inputs=flight_inputs(blown, vehicle), live=live, wind_unknown=False
    )
    return found, deviation


def _live_in_wind(
    live: LiveSamples, flight: Flight, drag: WindDrag, vehicle: Vehicle
) -> tuple[LiveSamples, float]:
    """Live samples relative to the air, by the wind that a monitor would have known before each."""
    known = live.known
    velocity, rates = live.inputs[known][:, VELOCITY_INPUTS], live.inputs[known][:, _RATES]
    attitude, speeds = flight.attitude[known], live.derivatives["rotor_speeds"][known]
    samples, deviation = WindState(drag, 0.0).take(
        PairedSamples.join(
            flight.stamps_ns[known],
            velocity=velocity,
            attitude=attitude,
            rates=rates,
            specific_force=live.wrench[known, :3] / vehicle.mass_kg,
            rotor_speeds=speeds,
            wind=np.zeros_like(velocity),
        )
    )
    air = velocity - rotate_world_to_body(attitude, samples.wind)
    inputs = live.inputs.copy()
    inputs[known] = aerodynamic_inputs(air, attitude, rates, speeds, vehicle)
    # The heading alone is that of the smoothed state.
    inputs[:, _TILT] = live.inputs[:, _TILT]
    return live._replace(inputs=inputs), float(np.median(deviation)) if len(deviation) else 0.0


def _drag_samples(flights: Sequence[Flight]) -> list[DragSamples]:
    """A sample each fifth of a second of each flight that is long enough for some."""
    lengths = piece_lengths_s([float(flight.time[-1] - flight.time[0]) for flight in flights])
    return [
        _samples_of(flight, piece_s)
        for flight, piece_s in zip(flights, lengths, strict=True)
        if flight.time[-1] - flight.time[0] > piece_s
    ]


def _samples_of(flight: Flight, piece_s: float) -> DragSamples:
    steps = np.floor(flight.time / STEP_S).astype(np.int64)
    kept, begins, counts = np.unique(steps, return_index=True, return_counts=True)

    def means(values: Array) -> Array:
        return np.add.reduceat(values, begins) / counts.reshape(-1, *[1] * (values.ndim - 1))

    time: Array = STEP_S * (kept.astype(np.float64) + 0.5)
    return DragSamples(
        time,
        np.floor(time / piece_s).astype(np.int64),
        means(flight.specific_force),
        means(rotate_body_to_world(flight.attitude, flight.velocity)),
        rotation_matrix(flight.attitude[begins + counts // 2]),
        None,
    )
