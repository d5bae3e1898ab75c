# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Limits beyond which a sample comes from a broken sensor or is in a wrong unit, the same live and offline.

NaN is beyond every limit. What each is and where it comes from stands in core/include/quadpi/limits.hpp.
"""

from __future__ import annotations

from quadpi_core.core import compiled

RATE_MAX_RAD_S = compiled.RATE_MAX_RAD_S
STANDARD_GRAVITY = compiled.STANDARD_GRAVITY
SPECIFIC_FORCE_MAX_M_S2 = compiled.SPECIFIC_FORCE_MAX_M_S2
AIRSPEED_MAX_M_S = compiled.AIRSPEED_MAX_M_S
POSITION_MAX_M = compiled.POSITION_MAX_M
MEASURED_SPEED_MAX_M_S = compiled.MEASURED_SPEED_MAX_M_S
# Of a state. What an estimator is given may be off by any scale: it is normalised.
QUATERNION_NORM_TOLERANCE = compiled.QUATERNION_NORM_TOLERANCE
# Of an attitude in a log or message.
NORM_TOLERANCE = compiled.NORM_TOLERANCE
