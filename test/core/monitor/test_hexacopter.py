# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A hexacopter from its arrays to the alarm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import ArgumentError
from quadpi_core.evaluation.evaluate import predict_flight
from quadpi_core.frames import Array
from quadpi_core.identification.identify import identify
from quadpi_core.library.flights import Flights
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.results import JUDGED
from quadpi_core.vehicle import Vehicle
from test.core.multicopters import measured, multicopter_file, swung

RATE_HZ = 500.0
NAMES = ("velocity", "attitude", "rates", "specific_force", "rotor_speeds")


@pytest.fixture(scope="module")
def hexacopter(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return multicopter_file(tmp_path_factory.mktemp("vehicle"), 6)


@pytest.fixture(scope="module", params=["physical", "polynomial"])
def model(
    hexacopter: Path, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> AerodynamicModel:
    """Fitted to two flights of 12 s, and read from its folder."""
    truths = [swung(hexacopter, seed, 12.0) for seed in (0, 1)]
    arrays = [measured(truth, seed) for seed, truth in enumerate(truths)]
    flights = Flights.from_arrays(
        np.concatenate([truth.time_ns for truth in truths]),
        vehicle=hexacopter,
        flight=np.repeat(["first", "second"], [len(truth.time_ns) for truth in truths]),
        **{name: np.concatenate([own[name] for own in arrays]) for name in NAMES},
    )
    options = IdentifyOptions(method=request.param)
    found = identify(flights.prepared, Vehicle.load(hexacopter), load_pools("quadrotor"), options)
    folder = tmp_path_factory.mktemp("model") / request.param
    found.save(folder)
    return AerodynamicModel.load(folder)


def rows_of(arrays: dict[str, Array]) -> Array:
    """Samples (K, 22) as the monitor takes them, without wind."""
    return np.column_stack([*(arrays[name] for name in NAMES), np.zeros_like(arrays["rates"])])


def test_the_alarm_on_its_flights_is_judged(hexacopter: Path, model: AerodynamicModel) -> None:
    flown = swung(hexacopter, 2, 6.0)
    flights = Flights.from_arrays(flown.time_ns, vehicle=hexacopter, **measured(flown, 2))
    (result,) = (predict_flight(model, one, 0.95, with_alarm=True) for one in flights.prepared)
    assert result.alarm is not None
    assert np.mean(result.alarm.why_not_judged == JUDGED) > 0.5


def test_a_hexacopter_is_fitted_predicted_and_watched(hexacopter: Path, model: AerodynamicModel) -> None:
    vehicle, flown = Vehicle.load(hexacopter), swung(hexacopter, 1, 6.0)
    values = rows_of(measured(flown, 7))
    predictions, alarms, _ = Monitor(model, vehicle, RATE_HZ).step(flown.time_ns, values)
    error = np.sqrt(np.mean(np.square(predictions.predicted - predictions.measured), axis=0))
    assert np.all(error[:3] < 0.2 * predictions.measured[:, :3].std(axis=0))
    assert not alarms.level.any()

    one_by_one = Monitor(model, vehicle, RATE_HZ)
    parts = [one_by_one.step(flown.time_ns[k : k + 1], values[k : k + 1]) for k in range(len(values))]
    for name in ("predicted", "lower", "upper", "measured", "relative_width"):
        joined = np.concatenate([getattr(part[0], name) for part in parts])
        assert joined.tobytes() == getattr(predictions, name).tobytes()
    for name in ("level", "faults", "more_faults", "cause_evidence", "leverage"):
        joined = np.concatenate([getattr(part[1], name) for part in parts])
        assert joined.tobytes() == getattr(alarms, name).tobytes()

    # The sixth rotor reads half its speed from the third second on.
    values[1500:, 18] *= 0.5
    _, alarms, _ = Monitor(model, vehicle, RATE_HZ).step(flown.time_ns, values)
    assert "rotor 6 reads half" in reasons(alarms, len(alarms) - 1)
    with pytest.raises(ArgumentError, match="values: expected shape"):
        Monitor(model, vehicle, RATE_HZ).step(flown.time_ns, values[:, :20])
