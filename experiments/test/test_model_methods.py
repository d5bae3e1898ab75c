# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The tool that renews results/models.md, on the bundled flights."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from quadpi_core.flight import AXES
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.paths import bags_directory
from quadpi_core.reading_options import ReadingOptions, TimeRange
from quadpi_core.vehicle import Vehicle

METHOD = "physical"
BAGS = tuple(f"train_{k}.mcap" for k in (1, 2, 3))

pytestmark = pytest.mark.slow


@pytest.fixture
def folder(tmp_path) -> Path:
    data = tmp_path / "data" / "bundled"
    data.mkdir(parents=True)
    vehicle, half = Vehicle.load("bebop2"), ReadingOptions(part=TimeRange(to_s=10.0))
    for name in BAGS:
        write_bag(data / name, read_recording(bags_directory() / name, vehicle, half))
    return tmp_path


@pytest.fixture
def job(tool: ModuleType, folder):
    bundled = tool.DataSet("Bundled", "bundled/*", "bebop2")
    return tool.Job(folder / "data", folder / "work", (METHOD,), sets=(bundled,))


@pytest.fixture(scope="module")
def flights():
    return prepare_flights([bags_directory() / name for name in BAGS], Vehicle.load("bebop2"))


def judged(tool, rmse, coverage=0.95):
    return tool.Judged([rmse] * 6, [coverage] * 6, [4.0 * rmse] * 6)


def test_the_page_has_places_for_the_tables(tool: ModuleType) -> None:
    marks = re.findall(r"^<!-- table: (\S+) -->$", tool.PAGE.read_text(), flags=re.MULTILINE)
    assert marks == ["summary", "sets"]


def test_flights_are_judged_by_models_of_others_and_results_kept(tool, job, folder, monkeypatch):
    (folder / "data" / "bundled" / "broken.mcap").write_bytes(b"no bag")
    first = tool.tables(job)
    assert re.search(r"Flights by their greatest speed in m/s: train_\d \(\d\.\d\), ", first["sets"])
    assert "- broken: " in first["sets"]
    assert "- bootstrap, polynomial, quality-driven: not computed" in first["sets"]
    assert len(list((folder / "work" / "results").iterdir())) == len(BAGS) + 1
    (row,) = re.findall(r"^\| in turn \| physical \| RMSE \|(.*)\|$", first["sets"], flags=re.MULTILINE)
    errors = [float(cell) for cell in row.split("|")]
    assert len(errors) == len(AXES)
    assert 0.001 < errors[0] < 0.2

    def never(*_):
        raise AssertionError("was found before")

    monkeypatch.setattr(tool, "judge", never)
    assert tool.tables(job) == first
    # Other code: found anew, unless results are kept, which the page then says.
    monkeypatch.setattr(tool, "code", lambda _: "other")
    with pytest.raises(AssertionError, match="was found before"):
        tool.tables(job)
    kept = tool.tables(replace(job, kept=(METHOD,)))
    assert "; physical: " in kept["summary"]
    # What is kept is not computed where a part of it is missing.
    next((folder / "work" / "results").iterdir()).unlink()
    assert "- physical, " in tool.tables(replace(job, kept=(METHOD,)))["sets"]


def test_a_flight_whose_rotor_sensor_fails_is_left_out_and_said(tool, job, folder):
    vehicle = Vehicle.load("bebop2")
    recording = read_recording(bags_directory() / BAGS[0], vehicle)
    speeds = recording.rotor_speeds.speeds.copy()
    speeds[5000:6000, 1] = 0.0
    failing = replace(recording, rotor_speeds=replace(recording.rotor_speeds, speeds=speeds))
    write_bag(folder / "data" / "bundled" / "failing.mcap", failing)
    flights, _, remarks = tool.read(job, job.sets[0])
    assert sorted(flight.name for flight in flights) == [Path(name).stem for name in BAGS]
    assert remarks == ["failing: a rotor reads the same for long in flight"]


def test_a_model_that_cannot_be_identified_is_a_remark(tool, job, monkeypatch):
    def fails(*_):
        raise tool.QuadpiError("Fz: too little")

    monkeypatch.setattr(tool, "judge", fails)
    made = tool.tables(job)
    assert "- physical, the fastest: without " in made["sets"]
    assert ": Fz: too little" in made["sets"]
    assert "No method has results on all data sets." in made["summary"]


def test_flights_are_spread_over_speeds_and_the_fastest_go_together(tool, flights):
    speeds = [tool.speed(flight) for flight in flights]
    two = tool.spread_over_speeds(flights, 2)
    assert [tool.speed(flight) for flight in two] == [min(speeds), max(speeds)]
    ordered = tool.spread_over_speeds(flights, 9)
    last, *turns = tool.cases(ordered)
    assert [case.judged[0].name for case in turns] == [flight.name for flight in ordered]
    assert all(len(case.identified) == len(flights) - 1 for case in turns)
    limit = tool.FASTEST * max(speeds)
    assert all((tool.speed(flight) >= limit) == (flight in last.judged) for flight in flights)


def test_networks_are_told_by_what_they_import_and_see_fewer_samples(tool, flights):
    assert [tool.trains_networks(name) for name in ("polynomial", "physical", "bootstrap")] == [
        *(False, False, True)
    ]
    thin = tool.thinned(flights[0], 20.0)
    rate = 1.0 / float(np.median(np.diff(thin.time)))
    assert rate == pytest.approx(20.0, rel=0.1)
    assert len(thin.inputs) == len(thin.wrench) == len(thin.judged.known) == len(thin.time)


def test_the_best_has_the_least_errors_of_those_that_cover(tool):
    def compared(**methods):
        found = {(case, name): own for name, own in methods.items() for case in tool.BOTH}
        return tool.Compared(tool.DATA_SETS[0], found, (("a", 1.0),), 1, ())

    good, bold = judged(tool, 0.5), judged(tool, 0.1, coverage=0.7)
    sets = [compared(polynomial=judged(tool, 1.0), physical=good, bootstrap=bold)]
    names = ("polynomial", "physical", "bootstrap")
    assert tool.best(sets, names) == "physical"
    assert tool.ratios(sets, tool.IN_TURN, "physical") == pytest.approx(np.full((1, 6), 0.5))
    # A method without results on some data set is not judged.
    assert tool.best([*sets, compared(polynomial=judged(tool, 1.0))], names) == "polynomial"
    assert tool.best([], names) is None
