# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulated flight is to follow, on an even time grid."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from quadpi_core.frames import Array

# Instants per second at which a flight is simulated, and a reference followed.
STEP_HZ = 1000


@dataclass(frozen=True)
class Reference:
    """N instants, evenly spaced; world north-east-down, SI.

    Attributes:
        position: (N, 3) m.
        velocity: (N, 3) m/s, its derivative.
        acceleration: (N, 3) m/s², its second derivative.
        yaw: (N,) rad, not wrapped.
        yaw_rate: (N,) rad/s, its derivative.
        tilt: (N, 2) rad of roll and pitch put on top of the controller's demand, to excite moments.
        thrust: (N,) put on top of the controller's demand, as a share of the weight.
    """

    position: Array
    velocity: Array
    acceleration: Array
    yaw: Array
    yaw_rate: Array
    tilt: Array
    thrust: Array

    def __len__(self) -> int:
        return len(self.yaw)

    def every(self, step: int) -> Reference:
        """Every `step`-th instant, from the first."""
        return Reference(**{column.name: getattr(self, column.name)[::step] for column in fields(self)})

    @classmethod
    def hover(cls, position: Array, samples: int) -> Reference:
        """Stand still at a position (3,), nose north."""
        still = np.zeros((samples, 3))
        level = np.zeros(samples)
        return cls(still + position, still, still, level, level, np.zeros((samples, 2)), level)
