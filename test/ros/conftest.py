# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Real DDS for tests: on this machine only, in a domain that no other test run uses."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

rclpy = pytest.importorskip("rclpy", reason="ROS 2 is not installed")
domain_coordinator = pytest.importorskip("domain_coordinator", reason="ROS 2 is not installed")


@pytest.fixture(scope="session")
def ros_domain() -> Iterator[int]:
    """Reserve a ROS domain for the whole run; nodes in other processes inherit it."""
    with pytest.MonkeyPatch.context() as patch, domain_coordinator.domain_id() as domain:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield domain


@pytest.fixture
def ros(ros_domain: int) -> Iterator[None]:
    """Initialise rclpy for one test and shut it down after it."""
    rclpy.init(domain_id=ros_domain)
    yield
    rclpy.try_shutdown()
