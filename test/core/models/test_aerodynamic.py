# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.synthetic_inputs import smooth_inputs
from quadpi_core.errors import ArgumentError, ModelError
from quadpi_core.evaluation.evaluate import judge
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.inputs import DERIVATIVES, INPUT_INDEX
from quadpi_core.models.aerodynamic import AerodynamicModel, TrainingFlight
from quadpi_core.models.envelope import Envelope, SpreadShape, leverage_of, squared_speed
from quadpi_core.models.fitted_polynomial import FittedPolynomials
from quadpi_core.models.kinds.polynomial import KIND
from quadpi_core.models.model_folder import ARRAYS_FILE, MODEL_FILE
from quadpi_core.models.model_kind import Evaluation, IdentifyOptions, TrainingSamples
from quadpi_core.models.regressors import CandidatePool, RegressorProgram, load_pools
from quadpi_core.parallel import ignore_progress
from quadpi_core.vehicle import Vehicle

POOLS = {
    "Fx": load_pools("bebop2_simulation")["Fx"],
    "Fz": CandidatePool.parse(["mu_x^2 + mu_y^2", "mu_z - mu_v_in"], ["P^2(|u|, |v|, w)·{1, omega_avg}"]),
    "Mz": CandidatePool.parse(["U_r"], ["P^3(|p|, q, r)"]),
}


def identified(pools: dict[str, CandidatePool], paper_axes: tuple[str, ...] = ()) -> AerodynamicModel:
    """A model of four synthetic flights; the axes alternate between the two kinds of noise."""
    X = smooth_inputs(2400, seed=1, vehicle_name="bebop2")
    groups = np.arange(2400) // 600
    rng = np.random.default_rng(2)
    wrench = np.zeros((2400, 6))
    for axis in pools:
        y = 0.3 * X[:, INPUT_INDEX["u"]] + 20.0 * X[:, INPUT_INDEX["mu_x"]] ** 2 + rng.normal(size=2400)
        wrench[:, AXES.index(axis)] = y
    samples = TrainingSamples(
        Vehicle.load("bebop2"), np.arange(2400) / 100.0, X, np.zeros(2400, DERIVATIVES), wrench, groups, []
    )
    calibrated, paper = (
        KIND.fit(samples, pools, IdentifyOptions(settings=settings), ignore_progress)
        for settings in ("default", "paper")
    )
    fits = {axis: paper if axis in paper_axes else calibrated for axis in pools}
    model = AerodynamicModel(
        name="model",
        vehicle="bebop2",
        vehicle_fingerprint=Vehicle.load("bebop2").fingerprint,
        settings="default",
        cutoff_hz=25.0,
        confidence=0.95,
        fitted=FittedPolynomials({axis: fit.fitted.axes[axis] for axis, fit in fits.items()}),
        envelope=Envelope.fit(X, groups, np.zeros((2400, 6)), np.zeros((2400, 6))),
        training_range={axis: float(np.ptp(samples.target(axis))) for axis in pools},
        flights=(TrainingFlight("first", "ab" * 32, 1200), TrainingFlight("second", "cd" * 32, 1200)),
        selection={axis: fit.log[axis] for axis, fit in fits.items()},
        held_out_coverage={axis: [0.9, 1.0] for axis in fits},
    )
    evaluation = model.evaluate(X)
    envelope = Envelope.fit(X, groups, evaluation.leverage, evaluation.relative_width)
    return replace(model, envelope=envelope)


@pytest.fixture(scope="module")
def model() -> AerodynamicModel:
    return identified(POOLS, paper_axes=("Fz",))


@pytest.fixture(scope="module")
def inputs() -> Array:
    return 1.5 * smooth_inputs(500, seed=3, vehicle_name="bebop2")


@pytest.fixture
def folder(model: AerodynamicModel, tmp_path: Path) -> Path:
    model.save(tmp_path / "model")
    return tmp_path / "model"


def same(one: Evaluation, other: Evaluation) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in Evaluation._fields)


@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_compiled_evaluation_equals_that_of_each_axis(
    model: AerodynamicModel, inputs: Array, confidence: float
) -> None:
    evaluation = model.evaluate(inputs, confidence)
    for axis in POOLS:
        own, k = model.fitted.axes[axis], AXES.index(axis)
        z = RegressorProgram.compile(own.regressors).evaluate(inputs)
        leverage, predicted = leverage_of(z, own.whitening), z @ own.coefficients
        spread = SpreadShape(own.inflation, own.growth).of(leverage, squared_speed(inputs))
        half = own.rule.factor(confidence) * spread
        expected = {
            "predicted": predicted,
            "lower": predicted - half,
            "upper": predicted + half,
            "leverage": leverage,
            "relative_width": spread / own.rms_spread,
        }
        for name, values in expected.items():
            np.testing.assert_allclose(
                getattr(evaluation, name)[:, k], values, rtol=1e-12, atol=1e-12, err_msg=name
            )


def test_axes_not_held_are_zero(model: AerodynamicModel, inputs: Array) -> None:
    assert model.axes == ("Fx", "Fz", "Mz")
    evaluation = model.evaluate(inputs)
    for name in Evaluation._fields:
        assert np.all(getattr(evaluation, name)[:, [1, 3, 4]] == 0.0)


def test_own_confidence_is_the_default(model: AerodynamicModel, inputs: Array) -> None:
    assert same(model.evaluate(inputs), model.evaluate(inputs, 0.95))
    assert not same(model.evaluate(inputs), model.evaluate(inputs, 0.9))
    assert same(model.evaluate(inputs), model.evaluate(inputs, 0.95))
    with pytest.raises(ModelError, match="confidence"):
        model.evaluate(inputs, 0.0)


@pytest.mark.parametrize("block", [1, 7, 64])
def test_blocks_give_the_same_bits_as_the_whole(model: AerodynamicModel, inputs: Array, block: int) -> None:
    whole = model.evaluate(inputs)
    parts = [model.evaluate(inputs[start : start + block]) for start in range(0, len(inputs), block)]
    for name in Evaluation._fields:
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(whole, name))


def test_inputs_of_another_shape_are_refused(model: AerodynamicModel, inputs: Array) -> None:
    with pytest.raises(ArgumentError, match="shape"):
        model.evaluate(inputs[:, :18])


def test_saved_model_evaluates_to_the_same_bits(
    model: AerodynamicModel, inputs: Array, tmp_path: Path
) -> None:
    saved = model.save(tmp_path / "bebop")
    loaded = AerodynamicModel.load(tmp_path / "bebop")
    assert same(loaded.evaluate(inputs), model.evaluate(inputs))
    assert loaded.name == saved.name == "bebop"
    assert loaded.identity == saved.identity
    assert loaded.identity.startswith("bebop@")
    assert model.identity == ""
    for name in ("vehicle", "settings", "cutoff_hz", "confidence", "training_range", "flights", "axes"):
        assert getattr(loaded, name) == getattr(model, name)
    assert loaded.selection == model.selection
    assert loaded.envelope.to_json() == model.envelope.to_json()


def test_model_with_numbers_that_are_not_finite_is_not_saved(model: AerodynamicModel, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        replace(model, cutoff_hz=float("nan")).save(tmp_path / "model")
    assert list(tmp_path.iterdir()) == []


def test_altered_description_shows_in_the_identity(folder: Path) -> None:
    before = AerodynamicModel.load(folder).identity
    path = folder / MODEL_FILE
    path.write_text(path.read_text().replace('"cutoff_hz": 25.0', '"cutoff_hz": 26.0'))
    after = AerodynamicModel.load(folder)
    assert after.cutoff_hz == 26.0
    assert after.identity != before


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (["format"], 99),
        (["method"], "ensemble"),
        (["axes"], {}),
        (["axes", "Fw"], {}),
        (["axes", "Fx"], None),
        (["axes", "Fx", "regressors"], ["bias", "mu_x"]),
        (["axes", "Fx", "regressors", 1], "zeta"),
        (["axes", "Fx", "rule"], {"kind": "magic"}),
        (["axes", "Fx", "inflation"], -1.0),
        (["axes", "Fx", "inflation"], float("nan")),
        (["axes", "Fx", "rule", "flight_factors"], [[1.0, 2.0]]),
        (["axes", "Fx", "rms_spread"], 0.5),
        (["axes", "Fx", "training_range"], "wide"),
        (["confidence"], "high"),
        (["envelope"], {}),
        (["flights"], [{"name": "x"}]),
        (["vehicle"], ...),
        (["arrays_sha256"], ...),
    ],
)
def test_description_that_makes_no_sense_is_refused(
    folder: Path, keys: list[str | int], value: object
) -> None:
    """`...` stands for a key taken out."""
    path = folder / MODEL_FILE
    content = json.loads(path.read_text())
    place = content
    for key in keys[:-1]:
        place = place[key]
    if value is ...:
        del place[keys[-1]]
    else:
        place[keys[-1]] = value
    path.write_text(json.dumps(content))
    with pytest.raises(ModelError) as caught:
        AerodynamicModel.load(folder)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


def test_arrays_of_another_model_are_refused(folder: Path) -> None:
    """Shapes are checked even where someone recomputed the hash."""
    other = folder.parent / "other"
    identified({"Fx": POOLS["Fz"], "Fz": POOLS["Fx"], "Mz": POOLS["Mz"]}).save(other)
    shutil.copy(other / ARRAYS_FILE, folder / ARRAYS_FILE)
    hashes = [json.loads((f / MODEL_FILE).read_text())["arrays_sha256"] for f in (folder, other)]
    text = (folder / MODEL_FILE).read_text().replace(*hashes)
    (folder / MODEL_FILE).write_text(text)
    with pytest.raises(ModelError, match="shapes do not fit"):
        AerodynamicModel.load(folder)


def test_inputs_alone_are_refused_where_the_kind_goes_by_more(physical_folder: Path, inputs: Array) -> None:
    physical = AerodynamicModel.load(physical_folder)
    with pytest.raises(ArgumentError, match="pass a flight of prepare_flights, or derivatives="):
        physical.evaluate(inputs, 0.95)
    with pytest.raises(ArgumentError, match=r"derivatives: expected shape \(500,\) for inputs"):
        physical.evaluate(inputs, 0.95, np.zeros(1, DERIVATIVES))


@pytest.mark.parametrize("place", ["inputs", "derivatives"])
def test_numbers_that_are_not_finite_are_refused(physical_folder: Path, inputs: Array, place: str) -> None:
    physical, moving = AerodynamicModel.load(physical_folder), np.zeros(len(inputs), DERIVATIVES)
    inputs = inputs.copy()
    (inputs if place == "inputs" else moving["rotor_jerks"])[7, 1] = np.nan
    with pytest.raises(ArgumentError, match=f"{place}: expected finite numbers, found others first in row 7"):
        physical.evaluate(inputs, 0.95, moving)


def test_numbers_beyond_what_the_model_can_predict_are_refused(
    model: AerodynamicModel, inputs: Array
) -> None:
    with pytest.raises(ModelError, match="sample 0: beyond what the model can predict"):
        model.evaluate(1e200 * inputs)


@pytest.mark.slow
def test_the_call_of_the_page_covers_unseen_flights(shared_data: Path) -> None:
    """Of a real vehicle whose yaw moment goes by the change of its rotor speeds.

    Without that, half of Mz lay outside its intervals; the bundled flights do not show it.
    """
    vehicle = Vehicle.load("crazyflie_rpm")
    folder = shared_data / "imrc_brushless"
    training, unseen = (
        prepare_flights([folder / f"eckart{number}" for number in numbers.split()], vehicle)
        for numbers in ("00 03 06 09 12 15 17 20", "01 07 13 18")
    )
    model = identify(training, vehicle, load_pools("quadrotor"), IdentifyOptions())
    _, evaluation = judge(model, unseen, {"unseen": [flight.name for flight in unseen]}, 0.95)
    for flight in unseen:
        said = model.evaluate(flight, 0.95)
        inside = np.mean((said.lower <= flight.wrench) & (flight.wrench <= said.upper), axis=0)
        assert np.all(inside > 0.95)
        judged = evaluation.flights[flight.name].axes
        np.testing.assert_array_equal(inside, [judged[axis].picp for axis in AXES])
