# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Names that load simulations and additions, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.simulations import VehicleSimulation
from quadpi_core.errors import DiscrepancyError, QuadpiError
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.applied_effects import read_effects


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("json:dumps", "json:dumps: names no vehicle: give it with --vehicle"),
        ("no_such_module:f", "no_such_module:f: cannot be imported: ModuleNotFoundError"),
        ("json:nothing", "json:nothing: cannot be imported: AttributeError"),
        ("json:__name__", "json:__name__: is str, not a function"),
        ("bebob2", "bebob2: no simulation: .*did you mean `bebop2`"),
        ("recorded", "gives no thrust"),
    ],
)
def test_what_names_no_simulation(text, message):
    with pytest.raises(DiscrepancyError, match=message) as caught:
        load_simulation(text, None if text == "json:dumps" else "bebop2")
    assert "\n" not in str(caught.value)


def test_a_module_that_raises(tmp_path, monkeypatch):
    (tmp_path / "broken_simulation.py").write_text("raise RuntimeError('no licence')\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        DiscrepancyError, match=r"cannot be imported: .*\.py, line \d+: RuntimeError: no licence"
    ):
        load_simulation("broken_simulation:f", "bebop2")


def test_an_addition_is_the_simulation_with_effects(tmp_path, flight):
    path = tmp_path / "addition.json"
    effects = {"body_drag": {"x_n_s2_m2": 0.002}}
    adjusted = {"thrust": 1.5}
    path.write_text(
        json.dumps({"simulation": "bebop2", "vehicle": "bebop2", "effects": effects, "adjusted": adjusted})
    )
    simulation = load_simulation(str(path))
    plain = load_simulation("bebop2")
    expected = AugmentedSimulation(plain.with_coefficients(adjusted), read_effects(effects, "test"))
    np.testing.assert_allclose(simulation.wrench(flight), expected.wrench(flight), atol=1e-9)
    assert np.abs(simulation.wrench(flight) - plain.wrench(flight))[:, 2].max() > 0.01


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not a readable JSON file"),
        ('{"simulation": "bebop2", "vehicle": "bebop2", "effect": {}}', "unknown key `effect`"),
        ('{"simulation": "bebop2", "vehicle": "bebop2", "effects": {"drag": {}}}', "unknown effect `drag`"),
    ],
)
def test_what_is_no_addition(tmp_path, text, message):
    path = tmp_path / "addition.json"
    path.write_text(text)
    with pytest.raises(QuadpiError, match=message):
        load_simulation(str(path))


def test_code_that_an_addition_names_is_not_even_imported(tmp_path, monkeypatch):
    """Nor through an addition to an addition."""
    (tmp_path / "trap_simulation.py").write_text("from pathlib import Path\nPath('sprung').touch()\n")
    monkeypatch.chdir(tmp_path)
    for name, named in (("one", "trap_simulation:f"), ("two", str(tmp_path / "one.json"))):
        (tmp_path / f"{name}.json").write_text(json.dumps({"simulation": named, "vehicle": "bebop2"}))
        with pytest.raises(DiscrepancyError, match=r"one\.json: names code to run, .*--allow-code"):
            load_simulation(str(tmp_path / f"{name}.json"))
        assert not (tmp_path / "sprung").exists()
    with pytest.raises(DiscrepancyError, match="cannot be imported: AttributeError"):
        load_simulation(str(tmp_path / "two.json"), allow_code=True)
    assert (tmp_path / "sprung").exists()


def test_a_physical_model_serves_as_a_vehicle_file_does(physical_folder, flights):
    """It flies, has uncertain coefficients, intervals, and the place of its accelerometer as an effect."""
    simulation = load_simulation(str(physical_folder))
    assert list(simulation.effects) == ["imu_lever_arm"]
    base = simulation.base
    assert isinstance(base, VehicleSimulation)
    lower, upper, _ = base.margins(flights[0])
    assert np.all(lower < 0.0)
    assert np.all(upper > 0.0)
    names = [column.name for column in base.uncertain(flights[0])]
    assert {"thrust", "rotor_drag"} <= set(names)
    error = measured_wrench(flights[0], base.vehicle) - simulation.wrench(flights[0])
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < [0.05, 0.05, 0.2, 0.005, 0.005, 0.002])


def test_another_model_serves_by_its_predictions(flights):
    simulation = load_simulation(str(Path(__file__).parents[2] / "golden" / "model"))
    assert not isinstance(simulation, VehicleSimulation)
    assert simulation.margins(flights[0]) is not None
    assert simulation.unjudged(flights[0]) == 0
