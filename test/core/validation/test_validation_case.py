# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What may be validated, and flights with and without the low-pass of the models."""

from __future__ import annotations

import json
import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import quadpi_core
from quadpi_core.config_schema import check_config
from quadpi_core.errors import LogError, ModelError, SignalError
from quadpi_core.inputs import flight_inputs
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bags import write_bag
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.simulated_bags import simulate
from quadpi_core.validation import validation_case as case_module
from quadpi_core.validation.validation_case import (
    Tally,
    ValidationError,
    code_fingerprint,
    given_case,
    low_passed,
    noisy_flight,
    realise,
)
from quadpi_core.validation.validation_result import VARIATIONS, Validation, summarise
from quadpi_core.vehicle import Vehicle


@pytest.fixture(scope="module")
def bags(scenario, tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulated")
    return [flown.bag for flown in simulate(load_scenario(scenario).flights, folder)]


@pytest.fixture(scope="module")
def folder(model, tmp_path_factory):
    folder = tmp_path_factory.mktemp("models") / "stored"
    model.save(folder)
    return folder


def test_truth_of_a_bag_is_the_flight_that_was_flown(bags, clean, folder):
    for bag, flown in zip(bags, clean, strict=True):
        (read,) = given_case([folder], [bag]).flights
        assert read.name == flown.name
        for name in ("time", "velocity", "rates", "angular_acceleration", "specific_force", "rotor_speeds"):
            np.testing.assert_allclose(getattr(read, name), getattr(flown, name), atol=1e-12)
        np.testing.assert_allclose(read.attitude, flown.attitude, atol=1e-9)


def test_given_models_and_bags(bags, folder, model):
    case = given_case([folder], bags, seed=4)
    case.check()
    assert (list(case.models), case.confidence, case.seed) == (["stored"], model.confidence, 4)
    assert [flight.name for flight in case.flights] == ["ahead", "up"]
    assert given_case([folder], bags, confidence=0.8).confidence == 0.8


def test_what_is_given_must_fit(bags, folder, fly, tmp_path, monkeypatch):
    with pytest.raises(ValidationError, match="no model folder given"):
        given_case([], bags)
    with pytest.raises(ValidationError, match="no bag of a simulated flight given"):
        given_case([folder], [])
    with pytest.raises(ModelError, match="another model is called stored"):
        given_case([folder, folder], bags)
    real = tmp_path / "real.mcap"
    write_bag(real, fly(1))
    with pytest.raises(
        LogError, match=r"real.mcap: topic truth/\S+: missing: no flight of quadpi's simulation"
    ):
        given_case([folder], [real])
    monkeypatch.setattr(Bag, "metadata", Bag(bags[0]).metadata | {"vehicle": "neurobem"})
    with pytest.raises(LogError, match="is a flight of vehicle neurobem, not of bebop2"):
        given_case([folder], bags)


def test_what_cannot_be_compared_is_refused(case, model, clean):
    case.check()
    with pytest.raises(ValidationError, match="needs models and noise-free flights"):
        replace(case, models={}).check()
    with pytest.raises(ValidationError, match="flight ahead: present twice"):
        replace(case, flights=(clean[0], clean[0])).check()
    filtered = replace(model, cutoff_hz=30.0)
    with pytest.raises(ValidationError, match=r"different low-pass \(fitted 250 Hz, filtered 30 Hz\)"):
        replace(case, models={"fitted": model, "filtered": filtered}).check()
    with pytest.raises(ModelError, match="is of vehicle bebop2, not neurobem"):
        replace(case, vehicle=Vehicle.load("neurobem")).check()
    with pytest.raises(ModelError, match="not between 0 and 1"):
        replace(case, confidence=1.0).check()


def test_models_of_a_low_pass_get_filtered_signals(case, clean):
    noisy = noisy_flight(case, clean[0], 0)
    assert low_passed(noisy, 250.0) is noisy
    filtered = low_passed(noisy, 30.0)
    inner = slice(100, -100)

    def noise(flight, name):
        return (getattr(flight, name) - getattr(clean[0], name))[inner].std()

    for name in ("velocity", "rates", "specific_force", "rotor_speeds"):
        # Of white noise up to 250 Hz, the fourth order run both ways passes 30 Hz less a little.
        assert noise(filtered, name) == pytest.approx(np.sqrt(27.0 / 250.0) * noise(noisy, name), rel=0.15)
    # As in flight, the angular acceleration is now the derivative of noisy rates.
    slope = np.gradient(filtered.rates, filtered.time, axis=0)
    np.testing.assert_allclose(slope[inner], filtered.angular_acceleration[inner], atol=0.1)
    with pytest.raises(SignalError, match=r"^ahead: 50 samples are too few"):
        low_passed(noisy.slice(slice(0, 50)), 30.0)


def test_a_case_travels_without_what_was_computed(case):
    assert case.references
    fingerprint = case.fingerprint
    arrived = pickle.loads(pickle.dumps(case))
    assert set(vars(arrived)) == {"vehicle", "models", "flights", "noise", "confidence", "seed"}
    assert arrived.fingerprint == fingerprint


def test_counts_of_other_code_are_not_taken_for_these(bags, folder, monkeypatch):
    """Stored numbers stay the same where only the code changes that makes intervals of them."""
    fingerprint = given_case([folder], bags).fingerprint
    assert given_case([folder], bags).fingerprint == fingerprint
    monkeypatch.setattr(case_module, "code_fingerprint", lambda: "other")
    assert given_case([folder], bags).fingerprint != fingerprint


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    """The sources of the package, to change."""
    package = Path(quadpi_core.__file__).parent
    ignored = shutil.ignore_patterns("__pycache__")
    return shutil.copytree(package, tmp_path_factory.mktemp("copy") / "quadpi_core", ignore=ignored)


def fingerprint_with_a_comment_in(file):
    original = file.read_text()
    file.write_text(f"{original}# changed\n")
    try:
        return code_fingerprint.__wrapped__(file.parents[1])
    finally:
        file.write_text(original)


@pytest.mark.parametrize("name", ["cli/options.py", "report/table.py"])
def test_counts_are_kept_when_only_the_presentation_changes(name, copied):
    assert fingerprint_with_a_comment_in(copied / name) == code_fingerprint()


@pytest.mark.parametrize("name", ["models/kinds/polynomial.py", "identification/identify.py"])
def test_counts_are_made_again_when_the_mathematics_change(name, copied):
    assert fingerprint_with_a_comment_in(copied / name) != code_fingerprint()


# What realisations add up to.


@pytest.fixture
def tally(case):
    """Two realisations; of Fx a tenth and three tenths of all samples lie inside, and every width is 2 N."""
    tally = Tally.empty(2, 1, 2)
    sizes = np.array([len(flight) for flight in case.flights])
    for row, share in enumerate((0.1, 0.3)):
        for inside in (tally.model, tally.measurement, tally.combined):
            inside[row, 0, :, 0] = np.round(share * sizes)
    tally.width[:] = 2.0 * sizes[:, None]
    tally.measured[..., 0], tally.measured[..., 1] = -1.0, 3.0
    tally.measured[1, 1, 0] = -2.0, 5.0
    tally.predicted[..., 1] = 0.5
    return tally


def test_numbers_of_known_counts(case, tally, model):
    result = summarise(case, tally).models["fitted"].axes["Fx"]
    assert result.training is None
    combined = result.combined_variation
    assert combined.picp == pytest.approx(0.2, abs=1e-3)
    assert combined.picp_sd == pytest.approx(0.2 / np.sqrt(2.0), abs=1e-3)
    assert combined.mpiw == pytest.approx(2.0)
    # Over both flights the measurements span 4 N in one realisation and 7 N in the other.
    assert combined.range == pytest.approx(5.5)
    assert combined.nmpiw == pytest.approx(2.0 / 5.5)
    assert combined.nmpiw_training == pytest.approx(2.0 / model.training_range["Fx"])
    assert result.model_variation.range == pytest.approx(0.5)


def test_width_of_model_and_measurement_variation_is_that_without_noise(case, tally, model, vehicle):
    result = summarise(case, tally).models["fitted"].axes["Fz"]
    said = model.evaluate(np.concatenate([flight_inputs(flight, vehicle) for flight in case.flights]), 0.95)
    width = (said.upper - said.lower)[:, 2].mean()
    for variation in VARIATIONS[:2]:
        assert getattr(result, variation).mpiw == pytest.approx(width, rel=1e-12)


def test_flights_add_up_to_the_whole(case):
    result = summarise(case, realise(case, range(3))).models["fitted"]
    sizes = [len(flight) for flight in case.flights]
    for axis in case.models["fitted"].axes:
        for variation in VARIATIONS:
            shares = [getattr(result.flights[flight.name][axis], variation) for flight in case.flights]
            assert np.average(shares, weights=sizes) == pytest.approx(
                getattr(result.axes[axis], variation).picp
            )


def test_one_realisation_is_json_without_nan(case):
    result = summarise(case, realise(case, range(1)))
    text = json.dumps(result.to_json(), allow_nan=False)
    assert json.loads(text)["models"]["fitted"]["axes"]["Fx"]["model_variation"]["picp_sd"] is None
    assert check_config(Validation, json.loads(text)) == result
    assert set(result.models["fitted"].axes) == {"Fx", "Fz"}
