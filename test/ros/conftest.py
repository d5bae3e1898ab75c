# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Real DDS for tests: on this machine only, in a domain that no other test run uses."""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from quadpi_core.flight import AXES, ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.inputs import aerodynamic_inputs
from quadpi_core.logs.bags import write_bag
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.fitted_polynomial import FittedPolynomials, PolynomialAxis
from quadpi_core.models.interval_rules import ResidualRule
from quadpi_core.models.regressors import Regressor, RegressorProgram
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_ros.live_session import Child

    from .rig import Rig

VEHICLE = "neurobem"
START_NS = 1_700_000_000_000_000_000
DURATION_S = 3.0
OUTSIDE_FROM_S = 2.3
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def ros_domain() -> Iterator[int]:
    """Reserve a ROS domain for a module; nodes in other processes inherit it.

    On one computer, the participants of a domain beyond the first 32 are not discovered, and a context that
    is shut down stays one until its nodes are collected: so no module sees those of another.
    """
    import domain_coordinator

    with pytest.MonkeyPatch.context() as patch, domain_coordinator.domain_id() as domain:
        patch.setenv("ROS_DOMAIN_ID", str(domain))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield domain
    # A process of nodes freezes what exists when it begins to spin; here it was a test.
    gc.unfreeze()
    gc.collect()


@pytest.fixture
def ros(ros_domain: int) -> Iterator[None]:
    """Initialise rclpy for one test and shut it down after it."""
    import rclpy

    rclpy.init(domain_id=ros_domain)
    yield
    rclpy.try_shutdown()


@pytest.fixture
def run_main(
    ros_domain: int, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str]]:
    """Run a program of quadpi_ros in this process; gives its exit status and what it wrote to stderr."""
    del ros_domain

    def run(module: str, *arguments: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", [module, *arguments])
        capfd.readouterr()
        status = importlib.import_module(f"quadpi_ros.{module}").main()
        return status, capfd.readouterr().err

    return run


def stamps(rate_hz: float) -> np.ndarray:
    return START_NS + np.round(np.arange(DURATION_S * rate_hz) * 1e9 / rate_hz).astype(np.int64)


def hovering(vehicle: Vehicle, seed: int) -> Recording:
    """Hover, rotors swinging a little; from OUTSIDE_FROM_S on they turn far faster than ever trained."""
    rng = np.random.default_rng(seed)
    imu_ns, rotor_ns, pose_ns = stamps(500.0), stamps(500.0) + 700_000, stamps(120.0)
    time_s = 1e-9 * (rotor_ns - START_NS)
    swing = np.stack([np.sin(7.0 * time_s + phase) for phase in range(4)], axis=1)
    speeds = 1100.0 + 60.0 * swing + 5.0 * rng.standard_normal(swing.shape)
    speeds[time_s >= OUTSIDE_FROM_S] += 600.0
    gravity = np.array([0.0, 0.0, -vehicle.gravity_m_s2])
    return Recording(
        name="hover",
        vehicle=vehicle.name,
        source="hover",
        imu=ImuStream(
            imu_ns,
            0.02 * rng.standard_normal((len(imu_ns), 3)),
            gravity + 0.3 * rng.standard_normal((len(imu_ns), 3)),
        ),
        rotor_speeds=RotorSpeedStream(rotor_ns, speeds),
        pose=PoseStream(
            pose_ns, 0.002 * rng.standard_normal((len(pose_ns), 3)), np.tile(LEVEL, (len(pose_ns), 1))
        ),
    )


def trained_on_hover(vehicle: Vehicle) -> AerodynamicModel:
    """Fx and Mz of a few terms, whose envelope is the undisturbed hover."""
    rng = np.random.default_rng(2)
    count = 2000
    inputs = aerodynamic_inputs(
        0.1 * rng.standard_normal((count, 3)),
        np.tile(LEVEL, (count, 1)) + 0.01 * rng.standard_normal((count, 4)),
        0.05 * rng.standard_normal((count, 3)),
        1100.0 + 60.0 * rng.uniform(-1.2, 1.2, (count, 4)),
        vehicle,
    )
    polynomials = {}
    for axis, terms in {"Fx": ("1", "u"), "Mz": ("1", "U_r")}.items():
        regressors = tuple(Regressor.parse(term) for term in terms)
        z = RegressorProgram.compile(regressors).evaluate(inputs)
        whitening = np.linalg.inv(np.linalg.cholesky(z.T @ z))
        rule = ResidualRule(0.2, 500.0)
        polynomials[axis] = PolynomialAxis(regressors, np.array([0.1, 0.01]), whitening, 1.0, 0.0, rule, 1.0)
    fitted = FittedPolynomials(polynomials)
    evidence = fitted.evaluate(inputs, np.ones(len(AXES)))
    return AerodynamicModel(
        name="hover",
        vehicle=vehicle.name,
        vehicle_fingerprint=vehicle.fingerprint,
        settings="default",
        cutoff_hz=30.0,
        confidence=0.95,
        fitted=fitted,
        envelope=Envelope.fit(inputs, np.zeros(count), evidence.leverage, evidence.relative_width),
        training_range=dict.fromkeys(polynomials, 1.0),
        flights=(),
        selection={axis: [] for axis in polynomials},
        held_out_coverage={axis: [] for axis in polynomials},
    )


@pytest.fixture(scope="session")
def hover() -> Recording:
    """The flight of hover.mcap."""
    return hovering(Vehicle.load(VEHICLE), seed=1)


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory, hover: Recording) -> Path:
    """hover.mcap, blind.mcap without mocap, model/, and other/ of another name."""
    folder = tmp_path_factory.mktemp("live")
    write_bag(folder / "hover.mcap", hover)
    write_bag(folder / "blind.mcap", replace(hover, pose=None))
    model = trained_on_hover(Vehicle.load(VEHICLE))
    model.save(folder / "model")
    replace(model, name="other").save(folder / "other")
    return folder


@pytest.fixture(scope="module")
def running(live: Child, hover: Recording) -> Iterator[Rig]:
    """The vehicle around the nodes `live` of a module, as long as that runs."""
    from .rig import Rig

    with Rig(hover, live) as rig:
        yield rig
