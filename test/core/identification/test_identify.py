# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From flights to a model and its intervals, on simulated flights whose physics is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.identification.identify import identify
from quadpi_core.models.kinds.polynomial import Polynomial
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.vehicle import Vehicle

from ..dragged_flights import CUTOFF_HZ, DRAG_KG_S, POOLS, THRUST_N_S2


@pytest.fixture(scope="module")
def vehicle():
    return Vehicle.load("neurobem")


def coefficient(model, axis, term):
    polynomial = model.fitted.axes[axis]
    return dict(zip(map(str, polynomial.regressors), polynomial.coefficients, strict=True))[term]


def test_physics_is_recovered(dragged_model):
    assert coefficient(dragged_model, "Fx", "u") == pytest.approx(-DRAG_KG_S, rel=0.02)
    assert coefficient(dragged_model, "Fz", "w") == pytest.approx(-DRAG_KG_S, rel=0.05)
    assert coefficient(dragged_model, "Fz", "omega_avg^2") == pytest.approx(-4 * THRUST_N_S2, rel=0.05)


def test_intervals_cover_what_the_live_path_would_have_measured(dragged_flights, vehicle):
    pools, rng = {"Fx": POOLS["Fx"]}, np.random.default_rng(8)

    def noisier(flight):
        wrench = flight.wrench + rng.normal(scale=0.1, size=flight.wrench.shape)
        return replace(flight, live=flight.judged._replace(wrench=wrench))

    flights = [replace(flight, live=None) for flight in dragged_flights]
    plain = identify(flights[:3], vehicle, pools, IdentifyOptions(method="polynomial", cutoff_hz=CUTOFF_HZ))
    wider = identify(
        [noisier(flight) for flight in flights[:3]],
        vehicle,
        pools,
        IdentifyOptions(method="polynomial", cutoff_hz=CUTOFF_HZ),
    )
    np.testing.assert_array_equal(wider.fitted.axes["Fx"].coefficients, plain.fitted.axes["Fx"].coefficients)
    for flight in map(noisier, flights[3:]):
        covered = []
        for model in (plain, wider):
            said = model.evaluate(flight.judged.inputs, 0.95)
            measured = flight.judged.wrench[:, 0]
            covered.append(np.mean((said.lower[:, 0] <= measured) & (measured <= said.upper[:, 0])))
        assert covered[0] < 0.9
        assert covered[1] > 0.94


def test_model_remembers_what_it_came_from(dragged_model, dragged_flights):
    assert dragged_model.axes == ("Fx", "Fz")
    assert (dragged_model.vehicle, dragged_model.cutoff_hz, dragged_model.confidence) == (
        "neurobem",
        CUTOFF_HZ,
        0.95,
    )
    assert [(f.name, f.sha256, f.samples) for f in dragged_model.flights] == [
        (f.name, f.sha256, len(f.time)) for f in dragged_flights[:3]
    ]
    wrench = np.concatenate([flight.wrench for flight in dragged_flights[:3]])
    for axis in dragged_model.axes:
        assert dragged_model.training_range[axis] == np.ptp(wrench[:, AXES.index(axis)])


def test_settings_of_the_paper(dragged_flights, vehicle):
    model = identify(
        dragged_flights[:1],
        vehicle,
        POOLS,
        IdentifyOptions(method="polynomial", cutoff_hz=CUTOFF_HZ, settings="paper"),
    )
    assert model.settings == "paper"
    assert model.fitted.axes["Fx"].rule.to_json()["kind"] == "residual"


def test_stop_rule_can_be_chosen(dragged_flights, vehicle):
    log = {}
    for stop in ("r2", "bic"):
        options = IdentifyOptions(cutoff_hz=CUTOFF_HZ, method=Polynomial(stop))
        model = identify(dragged_flights[:3], vehicle, POOLS, options)
        log[stop] = [row["criterion"] for row in model.selection["Fx"] if row["r2"] is not None]
    assert log["r2"][0] != log["bic"][0]


def test_progress_names_each_axis(dragged_flights, vehicle):
    words = []
    identify(
        dragged_flights[:2],
        vehicle,
        POOLS,
        IdentifyOptions(method="polynomial", cutoff_hz=CUTOFF_HZ),
        progress=words.append,
    )
    assert [progress.task for progress in words] == ["Identifying Fx", "Identifying Fz"]


def test_an_ensemble_needs_inputs(dragged_flights, vehicle):
    for method in ("bootstrap", "quality-driven"):
        with pytest.raises(ModelError, match="Fx: the candidate file lists no `inputs` for networks"):
            identify(dragged_flights[:2], vehicle, POOLS, IdentifyOptions(cutoff_hz=CUTOFF_HZ, method=method))


def test_errors_name_the_axis(dragged_flights, vehicle):
    with pytest.raises(ModelError, match=r"^Fx: .*needs two flights or more; pse, r2 and bic take one$"):
        identify(
            dragged_flights[:1],
            vehicle,
            POOLS,
            IdentifyOptions(
                cutoff_hz=CUTOFF_HZ,
                settings="paper",
                method=Polynomial("leave-one-flight-out"),
            ),
        )
    with pytest.raises(ModelError, match=r"^confidence 1\.5"):
        identify(
            dragged_flights[:2],
            vehicle,
            POOLS,
            IdentifyOptions(method="polynomial", cutoff_hz=CUTOFF_HZ, confidence=1.5),
        )


def test_one_flight_cannot_be_left_out_and_two_can(dragged_flights, vehicle):
    pools = {"Fx": POOLS["Fx"]}
    with pytest.raises(ModelError, match="too few flights: 1 given, 2 or more needed"):
        identify(
            dragged_flights[:1], vehicle, pools, IdentifyOptions(method="polynomial", cutoff_hz=CUTOFF_HZ)
        )
    assert (
        len(
            identify(
                dragged_flights[:2], vehicle, pools, IdentifyOptions(method="polynomial", cutoff_hz=CUTOFF_HZ)
            ).flights
        )
        == 2
    )
