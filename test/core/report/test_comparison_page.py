# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Several models on the same flights, from the command line: table, JSON and page."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from quadpi_core.flight import AXES
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs.bag_files import Bag
from quadpi_core.messages.definitions import typestore
from quadpi_core.models import kinds
from quadpi_core.models.kind_registry import kind_named
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import CandidatePool
from quadpi_core.plugins import names_in
from quadpi_core.report import ASSETS
from quadpi_core.report.comparison_page import comparison_rows, comparison_table
from quadpi_core.report.table import GROUPS, method_colours
from quadpi_core.vehicle import Vehicle

FORCES = {
    "Fx": CandidatePool.parse(["u"], ["P^2(u, |v|, w)"]),
    "Fz": CandidatePool.parse(["w"], ["P^2(omega_avg)"]),
}


@pytest.fixture(scope="module")
def folders(bags, tmp_path_factory):
    """Models of both settings, each with its own low-pass, and one that holds one axis."""
    place, vehicle = tmp_path_factory.mktemp("models"), Vehicle.load("neurobem")
    kinds = {
        "faithful": ("paper", 100.0, FORCES),
        "calibrated": ("default", 30.0, FORCES),
        "thrust": ("default", 30.0, {"Fz": FORCES["Fz"]}),
    }
    for name, (settings, cutoff_hz, pools) in kinds.items():
        flights = prepare_flights(bags[:2], vehicle, cutoff_hz)
        identify(
            flights,
            vehicle,
            pools,
            IdentifyOptions(method="polynomial", cutoff_hz=cutoff_hz, settings=settings),
        ).save(place / name)
    return {name: place / name for name in kinds}


@pytest.fixture
def groups(bags):
    return ("--group", f"known={bags[0]},{bags[1]}", "--group", f"new={bags[2]}")


def test_each_model_is_judged_as_if_alone(quadpi, folders, groups, read_page, tmp_path):
    data, page, alone = tmp_path / "data.json", tmp_path / "page.html", tmp_path / "alone.json"
    ran = quadpi("evaluate", *folders.values(), *groups, "--json", data, "--html", page)
    assert (ran.status, ran.errors) == (0, "")
    result = json.loads(data.read_text())
    assert set(result) == {
        *("quadpi_version", "vehicle", "confidence", "adaptive", "groups", "published", "models"),
        "left_out",
    }
    assert result["groups"] == {"known": ["flight0", "flight1"], "new": ["flight2"]}
    assert result["published"] is None
    assert [(m["settings"], m["cutoff_hz"]) for m in result["models"].values()] == [
        ("paper", 100.0),
        ("default", 30.0),
        ("default", 30.0),
    ]
    for name, folder in folders.items():
        assert quadpi("evaluate", folder, *groups, "--json", alone).status == 0
        told = dict(result["models"][name])
        del told["settings"], told["cutoff_hz"]
        assert told == json.loads(alone.read_text())
        assert name in ran.output

    read = read_page(page)
    read.assert_needs_nothing_from_outside()
    assert set(read.figures()) == {"groups"}
    for flight in ("flight0", "flight1", "flight2"):
        assert set(read.figures(flight)) == {"intervals", *(f"model {name}" for name in folders)}
        assert read.commands[flight].endswith(" ".join(f"--model {folder}" for folder in folders.values()))
    assert "omega_avg^2" in read.text


def test_terminal_of_80_characters_suffices(quadpi, folders, groups, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = quadpi("evaluate", *folders.values(), *groups).output
    assert "…" not in shown
    assert all(len(line) <= 80 for line in shown.splitlines())


def test_what_cannot_be_compared_is_refused(quadpi, folders, groups, bags, tmp_path):
    model = folders["thrust"]
    refusals = {
        ("evaluate", model, model, *groups): "another model is called thrust",
        ("evaluate",): "Missing argument 'paths'",
        ("evaluate", *groups): "Missing argument 'paths'",
        ("evaluate", model, folders["faithful"]): "no flights given",
        ("evaluate", model, bags[0], "-o", tmp_path): "No such option",
    }
    for arguments, message in refusals.items():
        ran = quadpi(*arguments)
        assert ran.status == 2
        assert message in ran.errors
    assert list(tmp_path.iterdir()) == []


def test_different_confidences_need_one_that_is_asked_for(quadpi, folders, groups, bags, tmp_path):
    vehicle = Vehicle.load("neurobem")
    flights = prepare_flights(bags[:2], vehicle, 30.0)
    pools = {"Fz": FORCES["Fz"]}
    loose = tmp_path / "loose"
    identify(
        flights, vehicle, pools, IdentifyOptions(method="polynomial", cutoff_hz=30.0, confidence=0.8)
    ).save(loose)
    assert "different confidences" in quadpi("evaluate", folders["thrust"], loose, *groups).errors
    data = tmp_path / "data.json"
    asked = ("--confidence", "0.9", "--json", data)
    assert quadpi("evaluate", folders["thrust"], loose, *groups, *asked).status == 0
    assert json.loads(data.read_text())["confidence"] == 0.9


def test_a_model_of_another_vehicle_is_refused(quadpi, folders, groups, bags, tmp_path):
    vehicle = Vehicle.load("neurobem")
    heavy = replace(vehicle, mass_kg=2.0 * vehicle.mass_kg)
    flights = prepare_flights(bags[:2], vehicle, 30.0)
    other = tmp_path / "other"
    identify(flights, heavy, {"Fz": FORCES["Fz"]}, IdentifyOptions(method="polynomial", cutoff_hz=30.0)).save(
        other
    )
    ran = quadpi("evaluate", folders["thrust"], other, *groups)
    assert ran.status == 2
    assert "model other was identified with another mass" in ran.errors


def test_a_folder_may_be_that_of_a_bag(quadpi, folders, bags, tmp_path):
    recorded, data = tmp_path / "recorded", tmp_path / "data.json"
    with (
        Bag(bags[2]) as flight,
        Writer(recorded, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        for topic in flight.read([connection.topic for connection in flight.connections]).values():
            connection = writer.add_connection(topic.name, topic.type_name, typestore=typestore())
            for stamp, payload in zip(topic.log_time_ns.tolist(), topic.payloads, strict=True):
                writer.write(connection, stamp, payload)
    models = folders["thrust"], folders["faithful"]
    assert quadpi("evaluate", *models, recorded, "--json", data).status == 0
    result = json.loads(data.read_text())
    assert list(result["models"]) == ["thrust", "faithful"]
    assert result["groups"] == {"all": ["recorded"]}
    spoiled = shutil.copytree(folders["faithful"], tmp_path / "spoiled")
    shutil.copy(bags[2], spoiled)
    ran = quadpi("evaluate", folders["thrust"], spoiled, recorded)
    assert ran.status == 2
    assert f"spoiled: holds {bags[2].name}, which is not part of a model" in ran.errors


def test_every_model_has_a_colour_and_none_that_of_a_method():
    names = [f"mine {k}" for k in range(3 * len(GROUPS))]
    own = list(names_in(kinds))
    colours = method_colours([*own, *names])
    # Each kind's own colour is one of the style sheet, which has a form of it for dark screens.
    style = (ASSETS / "look.css").read_text()
    assert all(style.count(f"--{colours[method]}:") == 2 for method in own)
    declared = {kind_named(method).colour for method in own}
    assert len({colours[method] for method in own}) == len(declared)
    assert not {colours[name] for name in names} & {colours[method] for method in own}
    assert colours["mine 0"] != colours["mine 1"]


def test_rows_are_by_axis_then_by_model(comparison, markdown_cells):
    order = [(row.axis, row.model) for row in comparison_rows(comparison)]
    assert order[:4] == [("Fx", "poly-paper"), ("Fx", "poly"), ("Fx", "net"), ("Fy", "poly-paper")]
    assert [axis for axis, model in order if model == "net"] == list(AXES[:3])

    heading, *body = markdown_cells(comparison_table(comparison))
    assert heading[2:] == ["PICP % known", "PICP % new & fast", "MPIW known", "MPIW new & fast"]
    assert len(body) == len(order)
    assert body[0][:2] == ["Fx [N]", "poly-paper"]
    assert all(row[3].startswith("▼") for row in body)
