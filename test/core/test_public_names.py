# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The names of `import quadpi_core`: there, typed, documented, and imported when they are first used."""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import quadpi_core
from quadpi_core.errors import VehicleError
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.regressors import load_pools
from quadpi_core.paths import bags_directory
from quadpi_core.records import LONGEST, brief_repr
from quadpi_core.vehicle import Vehicle

ROOT = Path(__file__).resolve().parents[2]
NAMES = [name for name in dir(quadpi_core) if not name.startswith("__")]


def test_each_is_there_and_in_the_documents():
    page = (ROOT / "docs" / "library.md").read_text()
    assert NAMES
    for name in NAMES:
        assert getattr(quadpi_core, name).__name__ == name
        assert re.search(rf"\b{name}\b", page), name


def test_type_checkers_see_the_same_names():
    tree = ast.parse((ROOT / "quadpi_core" / "__init__.py").read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    typed = {
        name.name: getattr(importlib.import_module(str(node.module)), name.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    assert typed == {name: getattr(quadpi_core, name) for name in NAMES}


def test_another_name_is_refused():
    with pytest.raises(AttributeError, match="has no attribute 'Vehicles'"):
        quadpi_core.Vehicles  # noqa: B018


def test_the_import_brings_nothing_heavy():
    code = "import sys, quadpi_core; print('numpy' in sys.modules, quadpi_core.Vehicle.load('bebop2').name)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "bebop2"]


def test_a_name_that_was_replaced_names_the_new_one():
    page = (ROOT / "docs" / "library.md").read_text()
    for name, new in quadpi_core._REPLACED.items():
        with pytest.warns(DeprecationWarning, match=rf"quadpi_core\.{name}: use {re.escape(new)}"):
            getattr(quadpi_core, name)
        assert new.partition("(")[0] in NAMES
        assert f"`{name}`" in page


USER_SCRIPT = """
import numpy as np
import quadpi_core as qp


class Mean:
    def fit(self, inputs: np.ndarray, target: np.ndarray) -> None:
        self.mean = target.mean()

    def predict(self, inputs: np.ndarray) -> np.ndarray:
        return np.full(len(inputs), self.mean)


flights: qp.Flights = qp.load_flights("bags/train_*.mcap", vehicle="bebop2")
model = qp.WrenchModel(estimator="physical", confidence=0.95).fit(flights)
interval = model.predict_interval(flights[:1], confidence=0.9)
width: np.ndarray[tuple[int, ...], np.dtype[np.float64]] = interval.upper - interval.lower
score: float = model.score(flights)
for row in qp.evaluate(model, flights, by="speed", bins=5).rows:
    print(row.axis, row.low + row.high)
own = qp.WrenchModel(estimator=Mean(), axes=["Fz"])
monitor = qp.Monitor(qp.load_model("my-model"))
for said in monitor.step(
    [0, 1],
    velocity=np.zeros((2, 3)),
    attitude=np.zeros((2, 4)),
    rates=np.zeros((2, 3)),
    specific_force=np.zeros((2, 3)),
    rotor_speeds=np.zeros((2, 4)),
):
    alarm: str = said.alarm
    said.alarms  # type: ignore[attr-defined]
qp.WrenchModel(estimator=7)  # type: ignore[arg-type]
found = qp.find_discrepancy("bebop2", flights)
names: list[str] = [effect.name for effect in found.effects]
"""


@pytest.mark.slow
def test_type_checkers_understand_a_users_script(tmp_path):
    pytest.importorskip("mypy", reason="mypy is not installed")
    (tmp_path / "script.py").write_text(USER_SCRIPT)
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "script.py"]
    environment = os.environ | {"MYPYPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_dir_shows_nothing_else():
    others = [name for name in dir(quadpi_core) if name not in quadpi_core._ROOMS]
    assert all(name.startswith("__") and name.endswith("__") for name in others)
    assert "__version__" in others
    assert issubclass(VehicleError, quadpi_core.QuadpiError)


@pytest.mark.filterwarnings("ignore:quadpi_core:DeprecationWarning")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda flown: quadpi_core.prepare_flights("no.mcap", flown), "no.mcap: no such file"),
        (
            lambda flown: quadpi_core.prepare_flights([None], flown),
            "paths, entry 1: expected a path, found None",
        ),
        (
            lambda _: quadpi_core.prepare_flights(["a.mcap"], "bebop2"),
            "vehicle: expected Vehicle, found str 'bebop2'; Ve",
        ),
        (
            lambda _: quadpi_core.simulate("bundled", "bags"),
            "plans: expected a list of FlightPlan, found str 'bun",
        ),
        (
            lambda _: quadpi_core.study("bebop2", []),
            "simulation: expected Simulation, found str 'bebop2'; load_",
        ),
        (
            lambda flown: quadpi_core.read_flights("a.mcap", flown),
            "simulation: expected Simulation, found Vehicle",
        ),
        (
            lambda _: quadpi_core.judge("model", [], {}),
            "model: expected AerodynamicModel, found str 'model'; Aero",
        ),
        (
            lambda flown: quadpi_core.Monitor(flown, "model", 500.0),
            "model: expected a kind of model, found Vehicle; load_model",
        ),
        (
            lambda flown: quadpi_core.identify([], flown, "quadrotor", quadpi_core.IdentifyOptions()),
            "pools: expected",
        ),
        (
            lambda _: quadpi_core.IdentifyOptions(confidence="0.95"),
            "confidence: expected a finite number, found str",
        ),
        (
            lambda _: quadpi_core.IdentifyOptions(settings="papers"),
            "settings: expected default or paper, found str",
        ),
        (lambda _: quadpi_core.MonitorSettings(adaptive=1), "adaptive: expected bool, found int 1"),
        (lambda _: quadpi_core.Vehicle.load(None), "vehicle: expected a path, found None"),
        (lambda _: quadpi_core.load_pools(5), "candidate: expected a path, found int 5"),
        (
            lambda _: quadpi_core.read_recording("a.bag", "bebop2"),
            "vehicle: expected Vehicle, found str 'bebop2'",
        ),
        (
            lambda flown: replace(flown, rotor_spins=np.ones(3)),
            r"vehicle bebop2: rotor_spins: expected shape \(4,\)",
        ),
        (lambda flown: replace(flown, mass_kg=-1.0), "vehicle bebop2: mass_kg: expected a positive number"),
    ],
)
def test_a_plausible_mistake_is_one_clear_line(call, message):
    with pytest.raises(quadpi_core.QuadpiError, match=message):
        call(quadpi_core.Vehicle.load("bebop2"))


# Records with long arrays show themselves in one line.


@dataclass
class Record:
    __repr__ = brief_repr
    name: str
    values: np.ndarray
    rate_hz: float = 500.0
    parts: tuple = (1, 2)
    rest: None = None


def test_one_line():
    assert (
        repr(Record("a", np.zeros((5, 3))))
        == "Record(name='a', values=array(5, 3), rate_hz=500.0, parts=<tuple of 2>, rest=None)"
    )
    assert len(repr(Record("a" * 1000, np.zeros(3)))) < LONGEST


@pytest.fixture(scope="module")
def vehicle():
    return Vehicle.load("bebop2")


def test_public_records(vehicle, physical_folder):
    bag = bags_directory() / "interpolation.mcap"
    recording = read_recording(bag, vehicle)
    (flight,) = prepare_flights(bag, vehicle)
    model = AerodynamicModel.load(physical_folder)
    said = model.evaluate(flight)
    for record in (
        vehicle,
        recording,
        recording.imu,
        flight,
        flight.live,
        said,
        load_pools("quadrotor")["Fx"],
    ):
        text = repr(record)
        assert text.startswith(f"{type(record).__name__}(")
        assert len(text) <= LONGEST, text
        assert "\n" not in text
    assert repr(model) == (
        "<AerodynamicModel flown: physical of bebop2, Fx Fy Fz Mx My Mz, 4 flights, confidence 0.95>"
    )
    assert len(repr(replace(model, name="a" * 500, vehicle="b" * 500))) <= LONGEST
