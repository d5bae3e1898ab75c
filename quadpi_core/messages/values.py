# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How many numbers messages end with, and where; core/include/quadpi/messages/values.hpp converts them.

A live node converts thousands of single messages a second. One call does it for all fields of a message;
array operations field by field cost several times as much.
"""

from __future__ import annotations

from quadpi_core.core import compiled

# How many float64 fields end nav_msgs/Odometry and quadpi/WrenchPrediction.
ODOMETRY_VALUES, PREDICTION_VALUES = compiled.ODOMETRY_VALUES, compiled.PREDICTION_VALUES
# Position and orientation among those of nav_msgs/Odometry.
POSE = slice(0, 7)
