# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bad models, vehicles, options and outputs on the command line: exit status 2, one line, no output left."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import save

from quadpi_core.logs.bags import write_bag
from quadpi_core.paths import bags_directory, config_directory


class TestModels:
    @pytest.fixture
    def copy(self, each_model, tmp_path):
        return shutil.copytree(each_model, tmp_path / "copy")

    @pytest.fixture
    def refused_model(self, refused, copy, bags, tmp_path):
        def run(message):
            refused(message, "evaluate", copy, bags[0], "--json", tmp_path / "data.json")
            refused(message, "replay", copy, bags[0], "-o", tmp_path / "out.mcap")
            refused(message, "info", copy)

        return run

    def test_good(self, quadpi, copy, bags, tmp_path):
        assert quadpi("evaluate", copy, bags[0]).status == 0
        assert quadpi("replay", copy, bags[0], "-o", tmp_path / "out.mcap").status == 0

    @pytest.mark.parametrize("name", ["model.json", "arrays.safetensors"])
    def test_file_missing(self, refused, copy, bags, tmp_path, name):
        (copy / name).unlink()
        message = rf"copy/{name}: cannot be read: No such file"
        refused(message, "evaluate", copy, bags[0], "--json", tmp_path / "data.json")
        refused(message, "replay", copy, bags[0], "-o", tmp_path / "out.mcap")

    def test_altered_numbers(self, refused_model, copy):
        arrays = bytearray((copy / "arrays.safetensors").read_bytes())
        arrays[-1] ^= 1
        (copy / "arrays.safetensors").write_bytes(arrays)
        refused_model(r"copy: arrays\.safetensors: its hash .* the file was altered")

    def test_numbers_of_another_model(self, refused_model, copy):
        (copy / "arrays.safetensors").write_bytes(save({"Fx.coefficients": np.zeros(3)}))
        refused_model(r"copy: arrays\.safetensors: its hash .* the file was altered")

    @pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"format": 1}', '{"format": 99}'])
    def test_altered_description(self, refused_model, copy, text):
        (copy / "model.json").write_text(text)
        refused_model("copy")

    def test_description_that_holds_nan(self, refused_model, copy):
        description = json.loads((copy / "model.json").read_text())
        description["axes"]["Fx"]["rms_spread"] = float("nan")
        (copy / "model.json").write_text(json.dumps(description))
        refused_model(r"copy/model\.json: not a quadpi model")

    def test_pickle_in_place_of_the_numbers(self, refused_model, copy, trap):
        (copy / "arrays.safetensors").write_bytes(trap.pickled)
        refused_model(r"copy: arrays\.safetensors: its hash .* the file was altered")
        description = json.loads((copy / "model.json").read_text())
        description["arrays_sha256"] = hashlib.sha256(trap.pickled).hexdigest()
        (copy / "model.json").write_text(json.dumps(description))
        refused_model(r"copy: arrays\.safetensors: not a quadpi model")
        assert not trap.sprung()

    @pytest.mark.parametrize(
        "name", ["model.pkl", "model.py", "__init__.py", "sitecustomize.py", "more/x.py"]
    )
    def test_foreign_file(self, refused_model, copy, trap, name):
        place = copy / name
        place.parent.mkdir(exist_ok=True)
        place.write_bytes(trap.pickled if name.endswith(".pkl") else trap.code)
        refused_model(rf"copy: holds {name.partition('/')[0]}, which is not part of a model: take it out")
        assert not trap.sprung()

    def test_absent(self, refused, bags, tmp_path):
        nowhere, options = tmp_path / "nowhere", ("-o", tmp_path / "out.mcap")
        message = r"nowhere/model\.json: cannot be read: No such file"
        refused(message, "evaluate", nowhere, bags[0])
        refused(message, "replay", nowhere, bags[0], *options)

    def test_a_bag_is_no_model(self, refused, bags, tmp_path):
        options = ("-o", tmp_path / "out.mcap")
        message = r"flight0\.mcap/model\.json: cannot be read"
        refused(message, "evaluate", bags[0], bags[1])
        refused(message, "replay", bags[0], bags[1], *options)
        refused(rf"{bags[0].parent}/model\.json: cannot be read", "evaluate", bags[0].parent, bags[1])


class Trap:
    """Writes a file if it is unpickled or run."""

    def __init__(self, mark):
        self.mark = mark
        self.pickled = pickle.dumps(self)
        self.code = f"open({str(mark)!r}, 'w')".encode()

    def __reduce__(self):
        return open, (str(self.mark), "w")

    def sprung(self):
        return self.mark.exists()


@pytest.fixture
def trap(tmp_path_factory):
    """Outside the folder that is compared."""
    trap = Trap(tmp_path_factory.mktemp("trap") / "sprung")
    pickle.loads(trap.pickled).close()
    assert trap.sprung()
    trap.mark.unlink()
    return trap


class TestVehicles:
    @pytest.fixture
    def foreign(self, bad, recording):
        write_bag(bad, replace(recording, vehicle="hdbeetle"))
        return bad

    def test_bag_of_another_vehicle(self, refused_by, foreign):
        assert foreign.exists()
        refused_by(("import", "prepare", "replay"), "is a flight of vehicle hdbeetle, not of neurobem")

    def test_realisations_of_a_flight_of_another_vehicle(self, refused, model):
        flight = bags_directory() / "interpolation.mcap"
        refused(
            "interpolation.mcap: is a flight of vehicle bebop2, not of neurobem", "validate", model, flight
        )

    def test_info_with_another_vehicle(self, refused, foreign):
        refused(
            "bad.mcap: is a flight of vehicle hdbeetle, not of bebop2", "info", foreign, "--vehicle", "bebop2"
        )

    def test_bag_without_a_vehicle_is_taken(self, quadpi, model, bad, recording):
        write_bag(bad, replace(recording, vehicle=""))
        assert quadpi("evaluate", model, bad).status == 0

    def test_model_of_another_vehicle(self, refused, model, bags, tmp_path):
        message = "is of vehicle neurobem, not bebop2"
        refused(message, "evaluate", model, bags[0], "--vehicle", "bebop2")
        refused(message, "replay", model, bags[0], "--vehicle", "bebop2", "-o", tmp_path / "out.mcap")

    def test_same_name_with_another_mass(self, refused, model, bags, tmp_path):
        heavier = (config_directory() / "vehicles" / "neurobem.yaml").read_text().replace("0.772", "1.5")
        (tmp_path / "neurobem.yaml").write_text(heavier)
        refused("another mass", "evaluate", model, bags[0], "--vehicle", tmp_path / "neurobem.yaml")

    @pytest.mark.parametrize("name", ["submarine", "../neurobem", "nowhere.yaml"])
    def test_unknown(self, refused, bags, tmp_path, name):
        refused("no such vehicle file; known", "identify", *bags, "--vehicle", name, "-o", tmp_path / "model")


class TestOptions:
    @pytest.mark.parametrize(
        ("options", "message"),
        [
            (("--axes", "Fx,Fq"), "no candidates for axis 'Fq'; there are pools for Fx, Fz, Mx"),
            (("--axes", ""), "no candidates for axis ''"),
            (("--candidates", "nothing"), "nothing.yaml: no such candidate file; known candidates: "),
            (("--confidence", "95"), "confidence 95.0 is not between 0 and 1"),
            (("--confidence", "nan"), "confidence: expected a finite number, found float nan"),
            (("--cutoff-hz", "0"), "cutoff_hz: expected a positive number"),
            (("--cutoff-hz", "-3"), "cutoff_hz: expected a positive number"),
            (("--cutoff-hz", "nan"), "cutoff_hz: expected a positive number"),
            (("--cutoff-hz", "300"), "cut-off"),
        ],
    )
    def test_identify(self, refused, bags, pool, tmp_path, options, message):
        base = ("--vehicle", "neurobem", "--candidates", pool, "-o", tmp_path / "model")
        refused(message, "identify", *bags[:2], *base, *options)

    def test_broken_pool(self, refused, bags, tmp_path):
        broken = tmp_path / "pool.yaml"
        broken.write_text('Fx: {fixed: [u], candidates: ["P^2(speed)"]}\n')
        options = ("--vehicle", "neurobem", "--candidates", broken, "-o", tmp_path / "model")
        refused(rf"{broken}: Fx: .*speed", "identify", *bags[:2], *options)

    @pytest.mark.parametrize("confidence", ["0", "1", "0.3", "0.99999", "nan"])
    def test_confidence(self, refused, model, bags, tmp_path, confidence):
        refused("confidence", "evaluate", model, bags[0], "--confidence", confidence)
        options = ("-o", tmp_path / "out.mcap", "--confidence", confidence)
        refused("confidence", "replay", model, bags[0], *options)

    def test_mapping_for_a_bag_is_one_of_messages_not_of_columns(self, refused, bags, tmp_path):
        options = ("--vehicle", "neurobem", "--mapping", "nanodrone", "-o", tmp_path / "bags")
        refused("nanodrone.yaml: no such adapter file", "import", bags[0], *options)


class TestOutputs:
    """What stood there before stays: `refused` compares every file of the folder."""

    @pytest.mark.parametrize("option", ["--json", "--html"])
    def test_report_in_place_of_an_input(self, refused, bags, model, option):
        for place in (bags[0], model, model / "model.json"):
            before = place.read_bytes() if place.is_file() else None
            refused("choose another", "evaluate", model, bags[0], option, place)
            assert place.is_dir() or place.read_bytes() == before

    def test_two_outputs_in_one_place(self, refused, bags, model, tmp_path):
        out = tmp_path / "out.mcap"
        refused("choose another", "evaluate", model, bags[0], "--json", out, "--html", out)
        refused("choose another", "replay", model, bags[0], "-o", out, "--json", out)
        options = ("--vehicle", "neurobem", "-o", tmp_path / "m", "--json", tmp_path / "m" / "data.json")
        refused("choose another", "identify", *bags, *options)

    def test_file_in_place_of_a_folder(self, refused, bags, model, tmp_path):
        file = tmp_path / "file"
        file.write_text("mine")
        message = "cannot be written: "
        refused(message, "import", bags[0], "--vehicle", "neurobem", "-o", file)
        refused(message, "replay", model, bags[0], "-o", file / "out.mcap")
        for option in ("--json", "--html"):
            refused(message, "evaluate", model, bags[0], option, file / "result")

    def test_folder_in_place_of_a_file(self, refused, bags, model, tmp_path):
        folder = tmp_path / "folder.mcap"
        folder.mkdir()
        (folder / "notes.txt").write_text("mine")
        refused(r"folder\.mcap: cannot be written: ", "replay", model, bags[0], "-o", folder)
        for option in ("--json", "--html"):
            refused(r"folder\.mcap: cannot be written: ", "evaluate", model, bags[0], option, folder)

    @pytest.mark.parametrize("option", ["--json", "--html"])
    def test_report_is_refused_before_the_work(self, refused, bags, model, tmp_path, option, monkeypatch):
        def work(*_, **__):
            raise AssertionError("began to work")

        for place in (
            "quadpi_core.identification.prepared_flights.prepare_flights",
            "quadpi_core.simulation.simulated_bags.simulate",
            "quadpi_core.validation.validation_case.run_realisations",
            "quadpi_core.validation.validation_case.given_case",
        ):
            monkeypatch.setattr(place, work)
        (tmp_path / "file").write_text("mine")
        page = (option, tmp_path / "file" / "page")
        message = "file/page: cannot be written: Not a directory"
        vehicle = ("--vehicle", "neurobem")
        refused(message, "identify", *bags, *vehicle, "-o", tmp_path / "m", *page)
        refused(message, "evaluate", model, *bags, *page)
        refused(message, "simulate", "orbit", "-o", tmp_path / "bags", *page)
        refused(message, "validate", model, *bags, *page)

    def test_model_folder_is_refused_before_the_work(self, refused, bags, tmp_path, monkeypatch):
        monkeypatch.setattr("quadpi_core.identification.prepared_flights.prepare_flights", None)
        (tmp_path / "mine").mkdir()
        (tmp_path / "mine" / "thesis.tex").write_text("mine")
        options = ("--vehicle", "neurobem", "-o", tmp_path / "mine")
        refused(
            "mine: holds thesis.tex, which is not part of a model: not replaced", "identify", *bags, *options
        )

    def test_folder_of_something_else(self, refused, bags, pool, tmp_path):
        (tmp_path / "thesis.tex").write_text("mine")
        options = ("--vehicle", "neurobem", "--candidates", pool, "-o", tmp_path)
        refused("holds .*, which is not part of a model: not replaced", "identify", *bags[:2], *options)

    def test_bag_without_its_suffix(self, refused, bags, model, tmp_path):
        refused(r"a file that ends in \.mcap", "replay", model, bags[0], "-o", tmp_path / "out")

    def test_input_in_place_of_the_output(self, refused, bags, model, tmp_path):
        bag = shutil.copy(bags[0], tmp_path / "flight.mcap")
        refused("would replace or alter an input", "replay", model, bag, "-o", bag)
        refused(
            "its bag would replace .*; choose another folder",
            "import",
            bag,
            "--vehicle",
            "neurobem",
            "-o",
            tmp_path,
        )

    def test_pipe_or_device_is_not_replaced(self, refused, model, tmp_path):
        pipe = tmp_path / "pipe"
        os.mkfifo(pipe)
        refused("pipe: is neither a file nor a folder: not replaced", "info", model, "--json", pipe)
        assert pipe.is_fifo()

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
    def test_no_permission(self, refused, bags, model, tmp_path):
        locked = tmp_path / "locked"
        locked.mkdir(mode=0o500)
        refused("cannot be written: Permission denied", "replay", model, bags[0], "-o", locked / "out.mcap")
