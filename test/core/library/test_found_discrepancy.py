# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulation is missing: the study of the command, as a table and as a simulation that has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import quadpi_core as qp
from quadpi_core.discrepancy.discrepancy_result import study_json
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.other_simulations import CallableSimulation
from quadpi_core.discrepancy.study import discover, read_flights, study
from quadpi_core.library.found_discrepancy import Discrepancy
from quadpi_core.paths import bags_directory

SOUGHT = ["body_drag"]


@pytest.fixture(scope="module")
def nothing(training) -> Discrepancy:
    """The bundled flights are those of this simulation."""
    return qp.find_discrepancy("bebop2", training[:2], effects=SOUGHT)


@pytest.fixture(scope="module")
def dragged_beside(found) -> Discrepancy:
    """The study of flights with drag, see the fixture `found`."""
    return Discrepancy(found)


def test_it_is_the_study_of_the_command(nothing):
    simulation = load_simulation("bebop2")
    flights = read_flights([bags_directory() / f"train_{k}.mcap" for k in (1, 2)], simulation)
    assert study_json(nothing.study) == study_json(study(simulation, flights, names=SOUGHT))


def test_nothing_is_missing_of_the_simulation_that_flew(nothing):
    assert nothing.verdict == "none"
    assert nothing.effects == nothing.doubts == ()
    assert len(nothing.to_pandas()) == 0
    assert list(nothing.to_pandas())[:5] == ["effect", "parameter", "value", "lower", "upper"]
    with pytest.raises(qp.QuadpiError, match="nothing to add to bebop2: the verdict is none"):
        nothing.simulation.save("better.yaml")
    assert repr(nothing).startswith("<Discrepancy bebop2 and 2 flights: none, no effect named, ")


def test_what_is_missing_as_a_table_and_a_simulation(dragged_beside, training, tmp_path):
    table = dragged_beside.to_pandas()
    assert set(table["effect"]) == {"body_drag"}
    assert (table["lower"] <= table["value"]).all()
    assert (table["value"] <= table["upper"]).all()
    assert "<td>body_drag</td><td>x_n_s2_m2</td>" in dragged_beside._repr_html_()
    assert any(part.startswith("F") for part in dragged_beside.where)
    better = dragged_beside.simulation
    assert repr(better) == "<BetterSimulation bebop2 with body_drag>"
    path = better.save(tmp_path / "better.yaml")
    again = load_simulation(path)
    flight = training.prepared[0].flight
    assert np.allclose(again.wrench(flight), better.wrench(training[:1]), rtol=1e-9, atol=1e-12)
    with pytest.raises(qp.QuadpiError, match=r"path: expected one that ends in \.yaml, found better\.json"):
        better.save(tmp_path / "better.json")
    axes = dragged_beside.plot()
    assert [text.get_text() for text in axes.get_xticklabels()] == ["Fx", "Fy", "Fz", "Mx", "My", "Mz"]


def still_air(flight):
    """A simulation that knows the weight alone."""
    wrench = np.zeros((len(flight), 6))
    wrench[:, 2] = -3.66
    return wrench


def test_a_function_is_a_simulation(training):
    found = qp.find_discrepancy(still_air, training[:2], effects=SOUGHT)
    assert found.study.simulation.name == "still_air"
    assert found.verdict in {"unknown", "effects"}
    assert found.study.discovery.gap.before.max() > 0.0


def test_a_function_of_the_session_has_no_file(found, simulation, dragged, tmp_path):
    function = CallableSimulation("mine", simulation.vehicle, simulation.wrench)
    discovery = discover(function, dragged, names=SOUGHT)
    mine = Discrepancy(replace(found, simulation=function, discovery=discovery)).simulation
    assert repr(mine) == "<BetterSimulation mine with body_drag>"
    with pytest.raises(qp.QuadpiError, match="mine: a file cannot name this function: give it as text"):
        mine.save(tmp_path / "better.json")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f: qp.find_discrepancy("bebop3", f), "bebop3: no simulation"),
        (lambda f: qp.find_discrepancy(7, f), "simulation: expected Simulation, found int 7"),
        (
            lambda f: qp.find_discrepancy("bebop2", replace(f, vehicle=replace(f.vehicle, mass_kg=0.5))),
            "bebop2: of another vehicle than the flights of bebop2: numbers differ",
        ),
        (
            lambda f: qp.find_discrepancy(qp.WrenchModel(), f),
            r"searched by its folder: model\.save\(folder\)",
        ),
        (lambda f: qp.find_discrepancy("bebop2", f[:1]), "flight"),
        (lambda f: qp.find_discrepancy("bebop2", f, effects=["ghosts"]), "ghosts"),
        (lambda f: qp.find_discrepancy("bebop2", f, effects=[]), "effects: expected names, found none"),
        (lambda f: qp.find_discrepancy("bebop2", replace(f, cutoff_hz=20.0)), "low-passed at 20 Hz"),
        (lambda _: qp.find_discrepancy("bebop2", np.zeros((3, 19))), "flights: expected Flights"),
    ],
)
def test_a_plausible_mistake_is_one_clear_line(training, call, message):
    with pytest.raises(qp.QuadpiError, match=message) as caught:
        call(training)
    assert "\n" not in str(caught.value)
