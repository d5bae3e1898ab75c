# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What holds for every effect of the registry, a new one included: formula, exported function, discovery."""

from __future__ import annotations

import inspect
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.discrepancy import discover, load_simulation
from quadpi_core.discrepancy.effect_formulas import python_source
from quadpi_core.simulation.applied_effects import effect_wrench
from quadpi_core.simulation.effect_registry import EFFECTS, read_effects
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.state_records import STATE, VEHICLE

ROOT = Path(__file__).parents[3]
EACH = pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda effect: effect.name)
WRENCH = pytest.mark.parametrize(
    "effect", [e for e in EFFECTS.values() if e.kind == "wrench"], ids=lambda effect: effect.name
)


def defaults(effect):
    return dict(read_effects({effect.name: None}, "test")[effect.name])


def module_of(effect):
    namespace = {}
    exec(compile(python_source({effect.name: defaults(effect)}), effect.name, "exec"), namespace)
    return namespace


@pytest.fixture(scope="module")
def model():
    return RotorLocalModel.load("bebop2")


@pytest.fixture(scope="module")
def states(model, random_states):
    return random_states(model, 40, seed=3)


@EACH
def test_has_a_formula_with_every_parameter(effect):
    assert len(effect.symbols) == len(effect.parameters)
    bare = effect.formula.replace("{", "").replace("}", "")
    for symbol in effect.symbols:
        # An index j names one rotor: it is a subscript.
        assert symbol in bare or f"_{symbol}" in bare, symbol
    assert effect.formula.count("{") == effect.formula.count("}")
    assert effect.formula.count(r"\left") == effect.formula.count(r"\right")
    assert "=" in effect.formula or r"\propto" in effect.formula


@WRENCH
def test_exported_function_gives_the_wrench_of_the_effect(effect, model, states):
    module = module_of(effect)
    record = model.record()
    given = {name: states[name] for name in STATE.names}
    vehicle = {name: record[name][0] for name in VEHICLE.names}
    found = module["wrench_of"](
        module[effect.name], module[f"{effect.name.upper()}_PARAMETERS"], given, vehicle
    )
    expected = effect_wrench(effect.name, defaults(effect), states, record)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13 * scale)


@EACH
def test_exported_file_runs_by_itself(effect):
    source = python_source({effect.name: defaults(effect)})
    imported = {line.split()[1] for line in source.splitlines() if line.startswith(("import ", "from "))}
    assert imported <= {"__future__", "numpy", "dataclasses", "math"}
    assert callable(module_of(effect)[effect.name])


def test_exported_source_is_that_of_the_library():
    """People read the same lines here and there."""
    exported = python_source({"ground_effect": defaults(EFFECTS["ground_effect"])})
    source = inspect.getsource(EFFECTS["ground_effect"].function.py_func)
    assert source[source.index("def ") :].strip() in exported
    assert "njit" not in exported
    assert "noqa" not in python_source({"tether": defaults(EFFECTS["tether"])})


def test_exported_effects_share_one_file():
    effects = {name: defaults(effect) for name, effect in EFFECTS.items()}
    namespace = {}
    exec(compile(python_source(effects), "all", "exec"), namespace)
    assert all(callable(namespace[name]) for name in effects)


@EACH
def test_documentation_states_form_and_size(effect):
    text = inspect.cleandoc(effect.function.__doc__)
    assert "Size" in text or "k = 1" in text


# What these leave in such flights is small, or another effect's as well, or just what a coefficient of the
# simulation leaves that is far beyond its tolerance (rotor_drag); the blind benchmark judges them.
HARD = {"tether", "ground_effect", "rotor_speed_scale", "rotor_drag"}


@pytest.mark.slow
@pytest.mark.parametrize("name", [e.name for e in EFFECTS.values() if e.shown_by and e.name not in HARD])
def test_is_found_in_flights_of_its_own(name, flown):
    """No proof of anything but that nothing is broken: library and flights share the formula."""
    found = discover(load_simulation("bebop2"), flown(name))
    named = {effect.name for effect in found.effects} | {r for e in found.effects for r in e.rivals}
    assert name in named


_USE = """
import numpy as np
from quadpi_core.simulation.applied_effects import effect_wrench
from quadpi_core.simulation.effect_registry import EFFECTS, read_effects
from quadpi_core.simulation.rotor_local import RotorLocalModel

assert list(EFFECTS).index("canopy_lift") < list(EFFECTS).index("cg_offset")
model = RotorLocalModel.load("bebop2")
states = model.states(np.array([[5.0, 0.0, 0.0]]), np.zeros((1, 3)), np.full((1, 4), 700.0))
parameters = read_effects({"canopy_lift": {"lift_n_s2_m2": 0.004}}, "test")["canopy_lift"]
wrench = effect_wrench("canopy_lift", parameters, states, model.record())
np.testing.assert_allclose(wrench, [[0.0, 0.0, -0.1, 0.0, 0.0, 0.0]])
"""


GUIDE = (ROOT / "docs" / "effects.md").read_text()
EXAMPLE = GUIDE.split("```py\n")[1].split("```")[0]


@pytest.mark.slow
def test_a_new_effect_is_one_file(tmp_path):
    """The documented example beside the others, in a copy of the package."""
    for name in ("quadpi_core", "config"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "package.xml", tmp_path)
    (tmp_path / "quadpi_core" / "simulation" / "effects" / "canopy.py").write_text(EXAMPLE)
    use(tmp_path)


@pytest.mark.slow
def test_so_is_one_in_a_package_of_ones_own(tmp_path):
    information = tmp_path / "my_package-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1.0\n")
    entry_points = GUIDE.split("# pyproject.toml\n")[1].split("```")[0].replace('"', "")
    (information / "entry_points.txt").write_text(entry_points.replace("project.entry-points.", ""))
    package = tmp_path / "my_package"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "canopy.py").write_text(EXAMPLE)
    use(tmp_path)


def use(tmp_path):
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", _USE],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
