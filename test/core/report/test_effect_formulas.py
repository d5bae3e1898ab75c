# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What holds for every effect of the registry, a new one included: formula and exported function."""

from __future__ import annotations

import inspect
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.report.discrepancy_evidence import python_source
from quadpi_core.simulation.applied_effects import EFFECTS, effect_wrench, read_effects
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.state_records import STATE, VEHICLE

ROOT = Path(__file__).parents[3]
EACH = pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda effect: effect.name)


def defaults(effect):
    return dict(read_effects({effect.name: None}, "test")[effect.name])


def run(source):
    namespace = {}
    exec(compile(source, "exported", "exec"), namespace)
    return namespace


@EACH
def test_has_a_formula_with_every_parameter_and_a_size(effect):
    bare = effect.formula.replace("{", "").replace("}", "")
    for symbol in effect.symbols:
        # An index j names one rotor: it is a subscript.
        assert symbol in bare or f"_{symbol}" in bare, symbol
    assert len(effect.symbols) == len(effect.parameters)
    assert effect.formula.count("{") == effect.formula.count("}")
    assert effect.formula.count(r"\left") == effect.formula.count(r"\right")
    assert "=" in effect.formula or r"\propto" in effect.formula
    text = inspect.cleandoc(effect.function.__doc__)
    assert "Size" in text or "k = 1" in text


@EACH
def test_exported_function_runs_by_itself_and_gives_the_wrench_of_the_effect(effect, random_states):
    source = python_source({effect.name: defaults(effect)})
    imported = {line.split()[1] for line in source.splitlines() if line.startswith(("import ", "from "))}
    assert imported <= {"__future__", "numpy", "dataclasses", "math", "types"}
    module, model = run(source), RotorLocalModel.load("bebop2")
    assert callable(module[effect.name])
    if effect.kind == "wrench":
        states, record = random_states(model, 40, seed=3), model.record()
        given = {name: states[name] for name in STATE.names}
        vehicle = {name: record[name][0] for name in VEHICLE.names}
        parameters = module[f"{effect.name.upper()}_PARAMETERS"]
        found = module["wrench_of"](module[effect.name], parameters, given, vehicle)
        expected = effect_wrench(effect.name, defaults(effect), states, record)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13 * np.abs(expected).max())


def test_exported_effects_share_one_file_with_the_source_of_the_library():
    """People read the same lines here and there."""
    exported = python_source({name: defaults(effect) for name, effect in EFFECTS.items()})
    module = run(exported)
    assert all(callable(module[name]) for name in EFFECTS)
    source = inspect.getsource(EFFECTS["ground_effect"].function)
    assert source[source.index("def ") :].strip() in exported
    assert "quadpi_core" not in exported
    assert "noqa" not in exported


_USE = """
import numpy as np
from quadpi_core.frames import rotate_world_to_body
from quadpi_core.simulation.applied_effects import effect_wrench
from quadpi_core.simulation.applied_effects import EFFECTS, read_effects
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.truth import Reference

assert list(EFFECTS).index("canopy_lift") < list(EFFECTS).index("cg_offset")
model = RotorLocalModel.load("bebop2")
states = model.states(np.array([[5.0, 0.0, 0.0]]), np.zeros((1, 3)), np.full((1, 4), 700.0))
parameters = read_effects({"canopy_lift": {"lift_n_s2_m2": 0.004}}, "test")["canopy_lift"]
wrench = effect_wrench("canopy_lift", parameters, states, model.record())
np.testing.assert_allclose(wrench, [[0.0, 0.0, -0.1, 0.0, 0.0, 0.0]])

reference = Reference.hover(np.array([0.0, 0.0, -3.0]), 501)
truth = simulate_flight(
    "hop", SimulatedVehicle.load("bebop2"), reference, known_wind=np.array([-5.0, 0.0, 0.0]),
    effects={"canopy_lift": parameters},
)
air = truth.velocity - rotate_world_to_body(truth.attitude, truth.wind)
bare = model.wrench(air, truth.rates, truth.rotor_speeds)
np.testing.assert_allclose(truth.wrench[:, 2] - bare[:, 2], -0.004 * air[:, 0] ** 2, rtol=1e-9)
"""
GUIDE = (ROOT / "docs" / "effects.md").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("place", ["quadpi_core/simulation/effects", "my_package"])
def test_a_new_effect_is_one_file(tmp_path, place):
    """The documented example beside the others in a copy of the package, and in a package of one's own."""
    (tmp_path / place).mkdir(parents=True)
    if place == "my_package":
        information = tmp_path / "my_package-1.0.dist-info"
        information.mkdir()
        (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1.0\n")
        entry_points = GUIDE.split("# pyproject.toml\n")[1].split("```")[0].replace('"', "")
        (information / "entry_points.txt").write_text(entry_points.replace("project.entry-points.", ""))
        (tmp_path / place / "__init__.py").touch()
    else:
        ignored = shutil.ignore_patterns("__pycache__")
        for name in ("quadpi_core", "config"):
            shutil.copytree(ROOT / name, tmp_path / name, ignore=ignored, dirs_exist_ok=True)
        shutil.copy(ROOT / "package.xml", tmp_path)
    (tmp_path / place / "canopy.py").write_text(GUIDE.split("```py\n")[1].split("```")[0])
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    command = [sys.executable, "-c", _USE]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
