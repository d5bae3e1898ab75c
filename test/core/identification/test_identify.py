# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From flights to a model and its intervals, on simulated flights whose physics is known."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import LogError, ModelError
from quadpi_core.estimator.fusion import airborne, fuse
from quadpi_core.evaluation.evaluate import judge, predict_flight
from quadpi_core.flight import AXES
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.models.candidate_pool import CandidatePool, load_pools
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.parallel import Workers
from quadpi_core.vehicle import Vehicle

CUTOFF_HZ = 20.0
DRAG_KG_S, THRUST_N_S2 = 0.5, 2.0e-6
POOLS = {
    "Fz": CandidatePool.parse(["w"], ["P^2(omega_avg)", "P^2(|u|, |v|)"]),
    "Fx": CandidatePool.parse(["u"], ["P^2(u, |v|, w)", "P^1(q)·{1, omega_avg}"]),
}


@pytest.fixture(scope="module")
def vehicle():
    return Vehicle.load("neurobem")


@pytest.fixture(scope="module")
def paths(fly, tmp_path_factory):
    folder = tmp_path_factory.mktemp("draggy")
    paths = [folder / f"flight{seed}.mcap" for seed in range(5)]
    for seed, path in enumerate(paths):
        write_bag(path, fly(seed, drag_kg_s=DRAG_KG_S, thrust_n_s2=THRUST_N_S2))
    return paths


@pytest.fixture(scope="module")
def flights(paths, vehicle):
    return prepare_flights(paths, vehicle, CUTOFF_HZ)


@pytest.fixture(scope="module")
def model(flights, vehicle):
    return identify(flights[:3], vehicle, POOLS, IdentifyOptions(cutoff_hz=CUTOFF_HZ))


def coefficient(model, axis, term):
    polynomial = model.fitted[axis]
    return dict(zip(map(str, polynomial.regressors), polynomial.coefficients, strict=True))[term]


def test_physics_is_recovered(model):
    assert coefficient(model, "Fx", "u") == pytest.approx(-DRAG_KG_S, rel=0.02)
    assert coefficient(model, "Fz", "w") == pytest.approx(-DRAG_KG_S, rel=0.05)
    assert coefficient(model, "Fz", "omega_avg^2") == pytest.approx(-4 * THRUST_N_S2, rel=0.05)


def test_intervals_cover_new_flights(model, flights):
    for flight in flights[3:]:
        result = predict_flight(model, flight, 0.95)
        assert result.axes == ("Fx", "Fz")
        for axis in result.axes:
            measured, lower, upper = (result.column(name, axis) for name in ("measured", "lower", "upper"))
            assert np.mean((lower <= measured) & (measured <= upper)) > 0.9
            assert np.mean(upper - lower) < 0.1 * np.ptp(measured)


def test_intervals_cover_what_the_live_path_would_have_measured(flights, vehicle):
    pools, rng = {"Fx": POOLS["Fx"]}, np.random.default_rng(8)

    def noisier(flight):
        wrench = flight.wrench + rng.normal(scale=0.1, size=flight.wrench.shape)
        return replace(flight, live=flight.judged._replace(wrench=wrench))

    flights = [replace(flight, live=None) for flight in flights]
    plain = identify(flights[:3], vehicle, pools, IdentifyOptions(cutoff_hz=CUTOFF_HZ))
    wider = identify(
        [noisier(flight) for flight in flights[:3]], vehicle, pools, IdentifyOptions(cutoff_hz=CUTOFF_HZ)
    )
    np.testing.assert_array_equal(
        wider.fitted["Fx"].arrays()["coefficients"], plain.fitted["Fx"].arrays()["coefficients"]
    )
    for flight in map(noisier, flights[3:]):
        covered = []
        for model in (plain, wider):
            said = model.evaluate(flight.judged.inputs, 0.95)
            measured = flight.judged.wrench[:, 0]
            covered.append(np.mean((said.lower[:, 0] <= measured) & (measured <= said.upper[:, 0])))
        assert covered[0] < 0.9
        assert covered[1] > 0.94


def test_judging_gives_the_calibration_curve_and_tells_of_adaptation(model, flights):
    groups = {"new": [flight.name for flight in flights[3:]]}
    results, own = judge(model, flights[3:], groups, 0.95)
    assert [result.name for result in results] == groups["new"]
    curve = own.groups["new"].axes["Fx"].calibration
    assert curve == sorted(curve)
    assert curve[own.calibration_levels.index(0.95)] == own.groups["new"].axes["Fx"].picp
    _, adapted = judge(model, flights[3:], groups, 0.95, adaptive=True)
    assert (own.adaptive, adapted.adaptive) == (False, True)
    assert adapted.groups["new"].axes["Fx"].picp != own.groups["new"].axes["Fx"].picp


def test_height_is_above_the_origin(paths, flights, vehicle):
    down = read_recording(paths[0], vehicle).pose.position[:, 2]
    assert flights[0].height.max() == pytest.approx(-down.min(), abs=0.05)
    assert flights[0].height.min() == pytest.approx(-down.max(), abs=0.05)


def test_model_remembers_what_it_came_from(model, flights):
    assert model.axes == ("Fx", "Fz")
    assert (model.vehicle, model.cutoff_hz, model.confidence) == ("neurobem", CUTOFF_HZ, 0.95)
    assert [(f.name, f.sha256, f.samples) for f in model.flights] == [
        (f.name, f.sha256, len(f.time)) for f in flights[:3]
    ]
    wrench = np.concatenate([flight.wrench for flight in flights[:3]])
    for axis in model.axes:
        assert model.training_range[axis] == np.ptp(wrench[:, AXES.index(axis)])


def test_settings_of_the_paper(flights, vehicle):
    model = identify(flights[:1], vehicle, POOLS, IdentifyOptions(cutoff_hz=CUTOFF_HZ, settings="paper"))
    assert model.settings == "paper"
    assert model.fitted["Fx"].rule.to_json()["kind"] == "residual"


def test_stop_rule_can_be_chosen(flights, vehicle):
    log = {}
    for stop in ("r2", "bic"):
        model = identify(flights[:3], vehicle, POOLS, IdentifyOptions(cutoff_hz=CUTOFF_HZ, stop=stop))
        log[stop] = [row["criterion"] for row in model.selection["Fx"] if row["r2"] is not None]
    assert log["r2"][0] != log["bic"][0]


def test_progress_names_each_axis(flights, vehicle):
    words = []
    identify(flights[:2], vehicle, POOLS, IdentifyOptions(cutoff_hz=CUTOFF_HZ), progress=words.append)
    assert [progress.task for progress in words] == ["Identifying Fx", "Identifying Fz"]


def test_an_ensemble_needs_inputs_and_has_no_stop_rule(flights, vehicle):
    for method in ("bootstrap", "quality-driven"):
        with pytest.raises(ModelError, match="Fx: the candidate file lists no `inputs` for networks"):
            identify(flights[:2], vehicle, POOLS, IdentifyOptions(cutoff_hz=CUTOFF_HZ, method=method))
        with pytest.raises(ModelError, match=f"the {method} method has none"):
            identify(
                flights[:2], vehicle, POOLS, IdentifyOptions(cutoff_hz=CUTOFF_HZ, method=method, stop="pse")
            )


def test_errors_name_the_axis(flights, vehicle):
    with pytest.raises(ModelError, match=r"^Fx: .*needs two flights or more; pse, r2 and bic take one$"):
        identify(
            flights[:1],
            vehicle,
            POOLS,
            IdentifyOptions(cutoff_hz=CUTOFF_HZ, settings="paper", stop="leave-one-flight-out"),
        )
    with pytest.raises(ModelError, match=r"^confidence 1\.5"):
        identify(flights[:2], vehicle, POOLS, IdentifyOptions(cutoff_hz=CUTOFF_HZ, confidence=1.5))


def test_a_copy_of_a_flight_is_refused(paths, vehicle, tmp_path):
    copy = shutil.copy(paths[0], tmp_path / "copy.mcap")
    with pytest.raises(LogError, match=rf"{copy}: the same flight as {paths[0]}"):
        prepare_flights([*paths[:2], copy], vehicle, CUTOFF_HZ)


@pytest.mark.slow
def test_a_cluster_prepares_the_same_flights(paths, vehicle, flights, cluster):
    for own, theirs in zip(
        flights, prepare_flights(paths, vehicle, CUTOFF_HZ, workers=Workers(scheduler=cluster)), strict=True
    ):
        assert (own.name, own.sha256) == (theirs.name, theirs.sha256)
        for name in ("time", "inputs", "wrench", "height"):
            np.testing.assert_array_equal(getattr(own, name), getattr(theirs, name))


def test_flight_of_another_vehicle_is_refused(paths):
    with pytest.raises(LogError, match=rf"{paths[0]}: is a flight of vehicle neurobem, not of bebop2"):
        prepare_flights(paths[:1], Vehicle.load("bebop2"), CUTOFF_HZ)


@pytest.fixture(scope="module")
def flight(fly, vehicle):
    return fuse(fly(0), vehicle, CUTOFF_HZ)


def wait_on_ground(flight, seconds, idle_rad_s, vehicle):
    """The flight, but parked before `seconds`, the rotors idling."""
    parked = (flight.time < seconds)[:, None]
    at_rest = [0.0, 0.0, -vehicle.gravity_m_s2]
    return replace(
        flight,
        specific_force=np.where(parked, at_rest, flight.specific_force),
        rotor_speeds=np.where(parked, idle_rad_s, flight.rotor_speeds),
    )


@pytest.mark.parametrize("seconds", [2.0, 6.0])
@pytest.mark.parametrize("idle_rad_s", [0.0, 300.0])
def test_time_on_the_ground_is_cut(flight, vehicle, seconds, idle_rad_s):
    kept = airborne(wait_on_ground(flight, seconds, idle_rad_s, vehicle), vehicle.gravity_m_s2)
    assert kept.time[0] == pytest.approx(seconds, abs=0.01)
    assert kept.time[-1] == flight.time[-1]


def test_gentle_start_of_a_wild_flight_is_kept(flight, vehicle):
    wild = np.where((flight.time > 1.0)[:, None], 3.0, 1.0)
    faster = replace(
        flight,
        specific_force=flight.specific_force * wild,
        rotor_speeds=flight.rotor_speeds * np.sqrt(wild),
    )
    assert len(airborne(faster, vehicle.gravity_m_s2)) == len(flight)


def test_rotors_that_never_turn_are_refused(flight, vehicle):
    still = replace(flight, rotor_speeds=np.zeros_like(flight.rotor_speeds))
    with pytest.raises(LogError, match=r"flight0: topic rotor_speeds: the rotors never carry the vehicle"):
        airborne(still, vehicle.gravity_m_s2)


@pytest.mark.slow
def test_whole_fast_neurobem_flight_is_in_the_air(shared_data, vehicle):
    """It hovers before it races: by the median of its rotor speeds, the hover would pass for the ground."""
    path = shared_data / "neurobem" / "bemnn20210218172600seg1.mat"
    prepared = prepare_flights([path], vehicle, 30.0)[0]
    assert len(prepared.time) == len(fuse(read_recording(path, vehicle), vehicle, 30.0))


@pytest.mark.slow
def test_adaptive_intervals_cover_every_neurobem_flight(shared_data, vehicle):
    """Identified on the three slower flights; the fourth, at up to 14.3 m/s, is far outside."""
    logs = sorted((shared_data / "neurobem").glob("*.mat"))
    flights = prepare_flights(logs, vehicle, 30.0)
    slower = [flight for flight in flights if flight.name != "bemnn20210218172600seg1"]
    assert (len(slower), len(flights)) == (3, 4)
    model = identify(slower, vehicle, load_pools("quadrotor"), IdentifyOptions(cutoff_hz=30.0))
    for name, flight in judge(model, flights, {}, 0.95, adaptive=True)[1].flights.items():
        for axis in AXES:
            assert 0.93 <= flight.axes[axis].picp <= 0.97, (name, axis)
    own = judge(model, flights, {}, 0.95)[1].flights["bemnn20210218172600seg1"].axes
    assert own["Fx"].picp < 0.90
