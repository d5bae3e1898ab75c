# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Positions by satellites: sensor_msgs/NavSatFix, as metres to north, east and down of the first fix."""

from __future__ import annotations

from collections import Counter

import numpy as np

from quadpi_core.core import compiled, cosine, sine
from quadpi_core.flight import NOT_MEASURED, OdometryStream
from quadpi_core.frames import Array
from quadpi_core.messages.adapters.adapter_definition import STAMP, Adapter, Reading
from quadpi_core.messages.cdr import Columns, header_stamps
from quadpi_core.vehicle import Vehicle

# Semi-major axis [m] and squared eccentricity of WGS 84 (NIMA TR8350.2).
_AXIS_M, _ECCENTRICITY = 6_378_137.0, 6.694_379_990_14e-3
# Least `status` of a fix, and `position_covariance_type` of one that is not known.
_LEAST_STATUS, _UNKNOWN = 0, 0


def local_position(latitude: Array, longitude: Array, height: Array, origin: Array) -> Array:
    """Metres (N, 3) to north, east and down of an origin (3,), by the radii of curvature there.

    Exact to a millimetre within a kilometre of it. Source: P. Groves, Principles of GNSS, Inertial, and
    Multisensor Integrated Navigation Systems (2013), eqs. 2.105, 2.106, 2.111.

    Args:
        latitude: (N,) degrees.
        longitude: (N,) degrees.
        height: (N,) m above the ellipsoid.
        origin: latitude, longitude and height.
    """
    turned = np.deg2rad(origin[:1])
    flatness = 1.0 - _ECCENTRICITY * sine(turned) * sine(turned)
    along = _AXIS_M * (1.0 - _ECCENTRICITY) / (flatness * np.sqrt(flatness)) + origin[2]
    across = (_AXIS_M / np.sqrt(flatness) + origin[2]) * cosine(turned)
    # The shorter way round, where a flight crosses 180°.
    east = (longitude - origin[1] + 180.0) % 360.0 - 180.0
    return np.column_stack(
        (along * np.deg2rad(latitude - origin[0]), across * np.deg2rad(east), origin[2] - height)
    )


def _start(_settings: object, _vehicle: Vehicle | None) -> Reading:
    dropped: Counter[str] = Counter()
    origin: list[Array] = []

    def read(columns: Columns, _items: object) -> OdometryStream:
        fixes = np.column_stack([columns[name] for name in ("latitude", "longitude", "altitude")])
        # Receivers say zeros until they know better, some with the status of a fix.
        possible = (np.abs(fixes[:, 0]) <= 90.0) & (np.abs(fixes[:, 1]) <= 360.0) & fixes[:, :2].any(axis=1)
        fixed = possible & np.isfinite(fixes[:, 2]) & (columns["status.status"] >= _LEAST_STATUS)
        if not fixed.all():
            dropped["no fix"] += int(np.sum(~fixed))
        covariance = columns["position_covariance"]
        mean = (covariance[:, 0] + covariance[:, 4] + covariance[:, 8]) / 3.0
        told = columns["position_covariance_type"] != _UNKNOWN
        vague = fixed & told & (mean >= compiled.UNKNOWN_VARIANCE)
        if vague.any():
            dropped["position is not known"] += int(np.sum(vague))
            fixed &= ~vague
        fixes, time_ns = fixes[fixed], header_stamps(columns)[fixed]
        if len(fixes) and not origin:
            origin.append(fixes[0])
        position = (
            local_position(fixes[:, 0], fixes[:, 1], fixes[:, 2], origin[0])
            if len(fixes)
            else np.empty((0, 3))
        )
        deviation = np.full((len(fixes), 3), NOT_MEASURED)
        deviation[:, 0] = np.sqrt(np.where(told & (mean > 0.0), mean, 0.0)[fixed])
        level, nothing = np.zeros((len(fixes), 4)), np.zeros((len(fixes), 3))
        level[:, 0] = 1.0
        return OdometryStream(time_ns, position, level, nothing, nothing.copy(), deviation)

    return Reading(read, lambda: dropped)


NAVSATFIX = Adapter(
    name="fix",
    type_name="sensor_msgs/msg/NavSatFix",
    topic="fix",
    kind="odometry",
    columns=STAMP
    | {"status.status": 1, "latitude": 1, "longitude": 1, "altitude": 1}
    | {"position_covariance": 9, "position_covariance_type": 1},
    start=_start,
    without_attitude=True,
)
