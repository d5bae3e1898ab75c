# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""An evaluation says of a flight what its replay says: each cause, when it is raised, what has changed."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from quadpi_core.evaluation.evaluate import predict_flight
from quadpi_core.flight import Stamps
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs.bags import read_outputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import CUTOFF_HZ, IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.monitor.replay import replay
from quadpi_core.paths import bags_directory
from quadpi_core.results import CAUSES, CHANGE, LEVEL_ALARM
from quadpi_core.vehicle import Vehicle

from ..monitor.sound_flights_of_blocks import limits_of

_SIZE = re.compile(r"[\d.]+ ± [\d.]+")
_GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "model"


def begins(time_ns: Stamps, flags: npt.NDArray[np.bool_]) -> Stamps:
    """Stamps at which flags begin to be true."""
    return time_ns[1:][flags[1:] & ~flags[:-1]]


def causes_of_both(model: AerodynamicModel, log: Path, out: Path, mapping: str | None = None) -> set[int]:
    """The causes that a flight raises, the same in both, at the same samples and with the same words."""
    vehicle = model.load_vehicle()
    replay(model, vehicle, log, out, mapping=mapping)
    _, rows = read_outputs(out)
    (flight,) = prepare_flights(log, vehicle, model.cutoff_hz, mapping=mapping)
    alarm = predict_flight(model, flight, model.confidence, with_alarm=True).alarm
    assert alarm is not None
    stamps = rows.time_ns[0] + np.round(1e9 * alarm.time).astype(np.int64)
    found = set()
    for column, cause in enumerate(CAUSES):
        told, own = rows.cause_level[:, column] == LEVEL_ALARM, alarm.raised[:, column]
        for of, mine in ((told, own), (~told, ~own)):
            np.testing.assert_array_equal(begins(rows.time_ns, of), begins(stamps, mine))
        if told.any():
            found.add(cause)
    assert bool(alarm.change) == (CHANGE in found)
    if CHANGE in found:
        last = int(np.flatnonzero(rows.cause_level[:, CAUSES.index(CHANGE)] == LEVEL_ALARM)[-1])
        assert alarm.change is not None
        # Sizes go on to be known better after the last row.
        assert {_SIZE.sub("", one) for one in alarm.change} <= {
            _SIZE.sub("", one) for one in rows.reasons[last]
        }
    return found


@pytest.mark.parametrize("name", ["extrapolation", "interpolation", "faults"])
def test_the_bundled_flights(name: str, tmp_path: Path) -> None:
    model = AerodynamicModel.load(_GOLDEN)
    model = replace(model, change_limits=limits_of(model.load_vehicle()))
    assert causes_of_both(model, bags_directory() / f"{name}.mcap", tmp_path / "out.mcap")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("logs", "vehicle", "mapping"),
    [
        ("imrc_brushless/eckart*", "crazyflie_rpm", None),
        ("nanodrone_benchmark/*.parquet", "nanodrone", "nanodrone"),
        ("indiflight/*.BFL", "indiflight", None),
        ("neurobem/*.mat", "neurobem", None),
    ],
)
def test_real_flights(
    shared_data: Path, logs: str, vehicle: str, mapping: str | None, tmp_path: Path
) -> None:
    """A model of the first three judges the next four, with a noise so small that some raise CHANGE."""
    flown, paths = Vehicle.load(vehicle), sorted(shared_data.glob(logs))
    flights = prepare_flights(paths[:3], flown, CUTOFF_HZ["default"], mapping=mapping)
    model = identify(flights, flown, load_pools("quadrotor"), IdentifyOptions(method="physical"))
    model = replace(model, change_limits=limits_of(flown, scale=0.2))
    found = [causes_of_both(model, path, tmp_path / f"{path.stem}.mcap", mapping) for path in paths[3:7]]
    assert any(CHANGE in one for one in found)
