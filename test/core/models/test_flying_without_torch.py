# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""An ensemble is loaded, evaluated, monitored and replayed where PyTorch is not installed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.logs.bags import read_outputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from test.conftest import run_without_torch

FLIGHT = """
import numpy as np
from quadpi_core.cli import main
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor import Monitor
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.vehicle import Vehicle

model, bag, inputs, output = sys.argv[1:]
loaded = AerodynamicModel.load(model)
evaluation = loaded.evaluate(np.load(inputs))
np.save(inputs, evaluation.upper)

monitor = Monitor(loaded, Vehicle.load(loaded.vehicle), 400.0)
hover = PairedSamples.join(
    np.zeros(1, dtype=np.int64),
    velocity=np.zeros((1, 3)),
    attitude=np.array([[1.0, 0.0, 0.0, 0.0]]),
    rates=np.zeros((1, 3)),
    specific_force=np.array([[0.0, 0.0, -9.81]]),
    rotor_speeds=np.full((1, 4), 1100.0),
    wind=np.zeros((1, 3)),
)
for k in range(20):
    stamp = np.array([1_700_000_000_000_000_000 + k * 2_500_000])
    predictions, alarms, events = monitor.step(stamp, hover.values)
    assert np.isfinite(predictions.upper).all() and len(predictions.time_ns) == 1

sys.argv = ["quadpi", "replay", model, bag, "-o", output]
try:
    main()
except SystemExit as ended:
    assert not ended.code, ended.code
"""


def run(code: str, *arguments: object) -> str:
    done = run_without_torch(code, *arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_flies_where_torch_is_not(
    model: AerodynamicModel, X: Array, bags: list[Path], tmp_path: Path
) -> None:
    model.save(tmp_path / "model")
    np.save(tmp_path / "inputs.npy", X)
    run(FLIGHT, tmp_path / "model", bags[0], tmp_path / "inputs.npy", tmp_path / "out.mcap")
    np.testing.assert_array_equal(np.load(tmp_path / "inputs.npy"), model.evaluate(X).upper)
    predictions, _ = read_outputs(tmp_path / "out.mcap")
    assert len(predictions.time_ns) > 1000
    assert np.all(predictions.lower < predictions.upper)


def test_models_import_without_torch() -> None:
    modules = run(
        "import importlib, pkgutil, sys, quadpi_core.models as models, quadpi_core.monitor\n"
        "for found in pkgutil.walk_packages(models.__path__, 'quadpi_core.models.'):\n"
        "    importlib.import_module(found.name)\n"
        "print(*sys.modules)"
    ).split()
    assert "quadpi_core.models.fitted_ensemble" in modules
    assert "torch" not in modules
