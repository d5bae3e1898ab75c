# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator node: what it refuses."""

from __future__ import annotations

from collections.abc import Callable

import pytest

pytestmark = pytest.mark.usefixtures("ros_domain")


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["vehicle:=neurobem", "vehikel:=x"],
            "node estimator: unknown parameter `vehikel`; known: adapters, autostart, body_frame",
        ),
        ([], "node estimator: parameter `vehicle` is required"),
        (
            ["vehicle:=neurobem", "imu_rate_hz:=fast"],
            "parameter `imu_rate_hz` must be a double, found 'fast'",
        ),
        (
            ["vehicle:=neurobem", "imu_rate_hz:=9000"],
            "parameter `imu_rate_hz` must lie between 0 and 5000, found 9000",
        ),
        (["vehicle:=neurobem", "imu_rate_hz:=.nan"], "parameter `imu_rate_hz` must lie between"),
        (["vehicle:=no_such"], "no such vehicle file; known vehicles:"),
    ],
)
def test_estimator_refuses_wrong_parameters(
    run_main: Callable[..., tuple[int, str]], overrides: list[str], message: str
) -> None:
    arguments = [part for override in overrides for part in ("-p", override)]
    status, errors = run_main("estimator_node", "--ros-args", *arguments)
    assert status == 2
    (line,) = errors.splitlines()
    assert line.startswith("quadpi: ")
    assert message in line
