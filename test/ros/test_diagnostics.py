# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Statuses for /diagnostics: what is said of a topic, and of which vehicle."""

from __future__ import annotations

from quadpi_ros import diagnostics
from quadpi_ros.estimator_node import EstimatorNode

from .rig import started


def test_diagnostics_name_the_vehicle_and_whose_it_is(ros_domain: int) -> None:
    with started(
        ros_domain, "-r", "__ns:=/uav1", "-p", "autostart:=false", "-p", "vehicle:=some/my-quad.yaml"
    ):
        node = EstimatorNode()
        status = diagnostics.status(diagnostics.full_name(node, "state"), diagnostics.OK, "", {})
        (told,) = diagnostics.array(node, [status]).status
        node.destroy_node()
    assert (told.name, told.hardware_id) == ("uav1/estimator: state", "uav1/my-quad")
