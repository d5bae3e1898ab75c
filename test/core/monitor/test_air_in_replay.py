# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A bag with pressure and temperature is judged in the air that it was flown in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from quadpi_core.flight import AirStream, TemperatureStream
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.inputs import ASSUMED, MEASURED
from quadpi_core.logs.bags import read_bag, read_outputs, write_bag
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.replay import replay
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.flight_parts import judged

# From 5 s on the vehicle is 1000 m higher, as if it had been carried up.
THICK, THIN = (101325.0, 15.0), (89874.6, 8.5)


@pytest.fixture(scope="module")
def bags(tmp_path_factory) -> tuple[Path, Path]:
    """A flight without and with what tells its air."""
    folder, vehicle = tmp_path_factory.mktemp("air"), Vehicle.load("bebop2")
    flight = read_bag(bags_directory() / "interpolation.mcap", vehicle)
    times_ns = flight.imu.time_ns[::50]
    later = times_ns - times_ns[0] > 5_000_000_000
    nothing = np.full(len(times_ns), np.nan)
    pressure = AirStream(times_ns, np.where(later, THIN[0], THICK[0]), nothing)
    celsius = TemperatureStream(times_ns, nothing, np.where(later, THIN[1], THICK[1]))
    write_bag(folder / "plain.mcap", flight)
    write_bag(folder / "air.mcap", replace(flight, pressure=pressure, temperature=celsius))
    return folder / "plain.mcap", folder / "air.mcap"


def identified_in(air: str, folder: Path) -> AerodynamicModel:
    """A model whose flights had their air told so."""
    model = AerodynamicModel.load(folder)
    return replace(model, flights=tuple(replace(flight, air=air) for flight in model.flights))


def test_a_model_of_unknown_air_stays_with_it(bags, physical_folder: Path, tmp_path: Path) -> None:
    """Thin air may be what its coefficients are of: they are not taken for those of the standard one."""
    model, vehicle = identified_in(ASSUMED, physical_folder), Vehicle.load("bebop2")
    found = []
    for number, bag in enumerate(bags):
        replay(model, vehicle, bag, tmp_path / f"{number}.mcap")
        found.append(read_outputs(tmp_path / f"{number}.mcap")[0].predicted)
    assert np.array_equal(*found)
    (air,) = prepare_flights([bags[1]], vehicle)
    without = air.derivatives.copy()
    without["density_excess"] = 0.0
    told, untold = (model.evaluate(air.inputs, derivatives=one) for one in (air.derivatives, without))
    assert np.array_equal(told.predicted, untold.predicted)


def test_predictions_go_with_the_density(bags, physical_folder: Path, tmp_path: Path) -> None:
    model, vehicle = identified_in(MEASURED, physical_folder), Vehicle.load("bebop2")
    found = []
    for number, bag in enumerate(bags):
        replay(model, vehicle, bag, tmp_path / f"{number}.mcap")
        found.append(read_outputs(tmp_path / f"{number}.mcap")[0])
    plain, air = found
    assert np.array_equal(plain.time_ns, air.time_ns)
    seconds = 1e-9 * (air.time_ns - air.time_ns[0])
    ratios = air.predicted[:, 2] / plain.predicted[:, 2]
    assert np.median(ratios[seconds < 3.0]) == pytest.approx(1.0, abs=2e-3)
    assert np.median(ratios[seconds > 6.0]) == pytest.approx(1.1117 / 1.225, abs=2e-3)
    # The page shows the same.
    page = Mock()
    for part in judged(bags[1], [model], vehicle, None):
        part(page)
    shown = [call.args[1].predicted for call in page.take_predictions.call_args_list]
    assert np.array_equal(np.concatenate(shown), air.predicted)


def test_prepared_flights_have_the_density_of_their_air(bags) -> None:
    vehicle = Vehicle.load("bebop2")
    plain, air = prepare_flights([bags[0]], vehicle), prepare_flights([bags[1]], vehicle)
    assert not plain[0].derivatives["density_excess"].any()
    assert (plain[0].air, air[0].air) == ("", MEASURED)
    assert air[0].derivatives["density_excess"] == pytest.approx(1.1117 / 1.225 - 1.0, abs=2e-3)
    assert np.array_equal(plain[0].wrench, air[0].wrench)
