# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Motor commands and battery voltages of any package as streams."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from quadpi_core.errors import SampleError
from quadpi_core.flight import BatteryStream, MotorCommandStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.messages.adapters.adapter_definition import Reading, start_of_numbers
from quadpi_core.messages.adapters.adapter_settings import CommandSettings
from quadpi_core.messages.cdr import Columns
from quadpi_core.vehicle import Vehicle

# µs; motors do not turn at pulses up to the second.
_PULSE_MIN, _PULSE_REST, _OUTPUT_FULL = 800.0, 1000.0, 2000.0


def start_of_commands(
    column: str, stamps: Callable[[Columns], Stamps], scaled: Callable[[Array], Array], layout: str = ""
) -> Callable[[CommandSettings, Vehicle | None], Reading]:
    """`Adapter.start` of messages with the commands of all outputs in one array.

    Args:
        column: that holds them (N, outputs).
        stamps: gives those of N messages.
        scaled: gives commands of values; 0 for a motor that stands.
        layout: of the motors unless the settings say it; the usual one unless given.
    """

    def start(settings: CommandSettings, vehicle: Vehicle | None) -> Reading:
        order = list(settings.order(vehicle, layout).controllers)
        dropped: Counter[str] = Counter()

        def read(columns: Columns, _items: object) -> MotorCommandStream:
            values, time_ns = columns[column].astype(np.float64), stamps(columns)
            if values.shape[1] <= max(order):
                if np.any(values) and isinstance(settings.rotors, tuple):
                    raise SampleError(
                        0,
                        f"{column} has {values.shape[1]} outputs, and `rotors` names output {max(order) + 1}",
                    )
                # Before the autopilot is heard, and of another vehicle.
                few = "fewer outputs than the vehicle has motors"
                dropped[few if np.any(values) else "no output is announced yet"] += len(values)
                return MotorCommandStream(time_ns[:0], np.empty((0, len(order))))
            return MotorCommandStream(time_ns, scaled(np.nan_to_num(values[:, order], nan=0.0)))

        return Reading(read, lambda: dropped)

    return start


def shares_of_outputs(outputs: Array) -> Array:
    """Commands of PX4's outputs (N, R): pulses in µs or steps of DShot, which does not matter to motors.

    Those that are identified on them know their scale. All outputs at one pulse of at most 1000 µs are of a
    vehicle that is disarmed; at rest steps of DShot are 0.
    """
    first = outputs[:, :1]
    disarmed = (outputs == first).all(axis=1, keepdims=True) & (first >= _PULSE_MIN) & (first <= _PULSE_REST)
    shares: Array = np.where(disarmed, 0.0, outputs / _OUTPUT_FULL)
    return shares


def start_of_battery(
    column: str, stamps: Callable[[Columns], Stamps]
) -> Callable[[object, Vehicle | None], Reading]:
    """`Adapter.start` of messages with a voltage [V] in a column; what is not above 0 was not measured."""
    return start_of_numbers(
        column,
        stamps,
        BatteryStream,
        lambda volts: np.isfinite(volts) & (volts > 0.0),
        "the voltage is not known",
    )
