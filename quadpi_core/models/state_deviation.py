# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How unsure the states of a model's flights were, and the drag that told their wind.

A model's intervals hold what both did to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from quadpi_core.config_schema import Within

# What motion capture never exceeds once a filter has settled: see buffer.hpp for the velocity; a pose errs by
# half of this angle.
_VELOCITY_M_S, _ATTITUDE_RAD = 0.05, 0.02


@dataclass(frozen=True, kw_only=True)
class StateDeviation:
    """Standard deviations of the states that a monitor had, root mean squares over the axes.

    Attributes:
        velocity_m_s: of the velocity.
        attitude_rad: of the attitude.
    """

    velocity_m_s: Annotated[float, Within(0.0)] = _VELOCITY_M_S
    attitude_rad: Annotated[float, Within(0.0)] = _ATTITUDE_RAD

    @classmethod
    def of_flights(cls, flights: Sequence[tuple[float, float]]) -> StateDeviation:
        """Of a model of flights whose median deviations, m/s and rad, these are."""
        velocity, attitude = np.median(np.array(flights), axis=0).tolist()
        return cls(velocity_m_s=max(velocity, _VELOCITY_M_S), attitude_rad=max(attitude, _ATTITUDE_RAD))


# Of motion capture, and of models of earlier versions.
SETTLED = StateDeviation()


@dataclass(frozen=True, kw_only=True)
class WindDrag:
    """Linear drag along body x and y, which tells the wind of a flight where nothing measures it.

    Attributes:
        per_mass_x_1_s, per_mass_y_1_s: drag over mass and airspeed.
        noise_x_m_s2, noise_y_m_s2: deviation of a fifth of a second's specific force from it, in which errors
            that hang together count as often as they are independent.
        wind_m_s: standard deviation of the wind to north and east before a flight.
        known_m_s: that a monitor knew it by in the model's flights, whose intervals hold what that does.
    """

    per_mass_x_1_s: Annotated[float, Within(0.0)]
    per_mass_y_1_s: Annotated[float, Within(0.0)]
    noise_x_m_s2: Annotated[float, Within(0.0)]
    noise_y_m_s2: Annotated[float, Within(0.0)]
    wind_m_s: Annotated[float, Within(0.0)]
    known_m_s: Annotated[float, Within(0.0)] = 0.0
