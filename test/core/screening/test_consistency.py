# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The consistency check names the mistakes that people make, and says nothing of sound flights."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from quadpi_core.config_schema import read_config
from quadpi_core.errors import LogError, VehicleError
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.logs.inspect import inspect_recording
from quadpi_core.paths import bags_directory
from quadpi_core.screening import consistency
from quadpi_core.screening.consistency import checked, contradictions, findings
from quadpi_core.screening.motion_consistency import Hypothesis
from quadpi_core.screening.plausibility import is_slow, thrust_coefficient
from quadpi_core.vehicle import Vehicle
from test.core.mistakes import MISTAKES
from test.core.screening.conftest import RECORDINGS

BAGS = bags_directory()
# Files of each real data set, and the vehicle and mapping that they take.
REAL = {
    "neurobem": ("*.mat", "neurobem", None),
    "imrc_brushless": ("eckart*[048]", "crazyflie_rpm", None),
    "imrc_payload": ("eckart*[14689]", "crazyflie_rpm", None),
    "imrc_brushed": ("jana0?", "crazyflie_rpm", None),
    "nanodrone": ("*run[23].parquet", "nanodrone", "nanodrone"),
    "nanodrone_benchmark": ("*run2.parquet", "nanodrone", "nanodrone"),
    "arpl": ("log10", "crazyflie_rpm", None),
    "logs": ("*.[Bu]*", None, None),
}


# Mistakes that hardly show in the innovations of a small vehicle.
SMALL = (
    *("accelerometer x and y swapped", "accelerometer x reversed", "accelerometer reads 5 % more"),
    *("mocap origin 8 cm in front", "mocap origin 8 cm below", "mocap frozen"),
    *("two rotors on one channel", "squares of rotor speeds", "arms twice"),
)


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_named(flown, vehicle, name):
    recording = flown[RECORDINGS[list(MISTAKES).index(name) % len(RECORDINGS)]]
    mistake = MISTAKES[name]
    found = list(findings(*mistake.done(recording, vehicle)))
    assert mistake.named in [finding.mistake for finding in found], found


@pytest.mark.parametrize("bag", sorted(BAGS.glob("*.mcap")), ids=lambda bag: bag.stem)
def test_nothing_is_said_of_the_bundled_bags(vehicle, bag):
    assert list(contradictions(read_recording(bag, vehicle), vehicle)) == []


@pytest.mark.parametrize("rate_hz", [11, 20, 25, 50])
def test_nothing_is_said_of_rotor_speeds_that_come_seldom(vehicle, rate_hz):
    recording = read_recording(bags_directory() / "train_2.mcap", vehicle)
    rotors = recording.rotor_speeds
    due = np.arange(rotors.time_ns[0], rotors.time_ns[-1], 10**9 // rate_hz)
    thinned = rotors.take(np.unique(np.searchsorted(rotors.time_ns, due)))
    assert list(findings(replace(recording, rotor_speeds=thinned), vehicle)) == []


@pytest.mark.parametrize("before_s", [60, 1_600_000_000])
def test_motion_capture_by_another_clock_is_no_other_unit(vehicle, before_s):
    recording = read_recording(bags_directory() / "train_2.mcap", vehicle)
    early = replace(recording.pose, time_ns=recording.pose.time_ns - before_s * 10**9)
    (finding,) = checked(replace(recording, pose=early), vehicle).quality.findings
    assert finding.mistake == "clock offset"


@pytest.mark.parametrize("name", REAL)
def test_nothing_is_said_of_real_flights(shared_data, name):
    pattern, vehicle_name, mapping = REAL[name]
    vehicle = None if vehicle_name is None else Vehicle.load(vehicle_name)
    logs = sorted((shared_data / name).glob(pattern))[:2]
    assert logs
    for log in logs:
        assert list(findings(read_recording(log, vehicle, mapping), vehicle)) == [], log


@pytest.mark.parametrize(
    ("log", "rotor"), [("imrc_brushed/jana27", 1), ("imrc_payload/eckart52", 3)], ids=["zeros", "half"]
)
def test_real_rotor_sensors_that_fail_are_named(shared_data, log, rotor):
    vehicle = Vehicle.load("crazyflie_rpm")
    found = list(findings(read_recording(shared_data / log, vehicle), vehicle))
    assert [finding.mistake for finding in found] == ["one rotor"]
    assert f"rotor {rotor} looks as if" in found[0].text


def test_motion_capture_of_a_real_flight_turned_from_its_imu_is_said(shared_data):
    found = list(findings(read_recording(shared_data / "indiflight" / "LOG00264.BFL", None), None))
    assert [(finding.mistake, finding.certain) for finding in found] == [("body tilted", False)]


@pytest.mark.slow
@pytest.mark.parametrize("log", ["imrc_brushless/eckart01", "imrc_brushless/eckart18", "imrc_brushed/jana02"])
def test_small_mistakes_of_real_flights_are_named(shared_data, log):
    """In flights that no threshold was set on, or whose neighbours are as fast."""
    vehicle = Vehicle.load("crazyflie_rpm")
    recording = read_recording(shared_data / log, vehicle)
    for name in SMALL:
        found = [finding.mistake for finding in findings(*MISTAKES[name].done(recording, vehicle))]
        assert found == [MISTAKES[name].named], name


def test_a_certain_mistake_is_refused_and_another_one_said(flown, vehicle):
    recording = flown["train_2"]
    with pytest.raises(
        LogError,
        match=r"train_2\.mcap: topic mocap/pose: the attitude of mocap/pose looks conjugated .*: inverting "
        r"it lowers the innovation of the attitude from [\d.]+ to 0\.\d+ rad/s",
    ):
        checked(*MISTAKES["quaternion conjugated"].done(recording, vehicle))
    warned = checked(*MISTAKES["mocap yawed by 20"].done(recording, vehicle))
    (sentence,) = warned.quality.sentences()
    assert "turned against each other by 20°" in sentence
    assert warned.quality.to_json()["findings"][0]["mistake"] == "body yawed"
    assert checked(recording, vehicle).quality.findings == ()


def test_a_small_mistake_shows_beside_a_large_one(flown, vehicle):
    both = MISTAKES["mocap yawed by 20"].done(
        *MISTAKES["accelerometer reads 5 % more"].done(flown["train_2"], vehicle)
    )
    assert [one.mistake for one in findings(*both)] == ["body yawed", "accelerometer scale"]


def test_the_rotor_speeds_tell_which_of_imu_and_mocap_is_turned(flown, vehicle):
    recording = flown["train_2"]
    for name, right in (("imu yawed by 90", "mocap/pose"), ("mocap yawed by 90", "the IMU")):
        (finding,) = findings(*MISTAKES[name].done(recording, vehicle))
        assert finding.text.endswith(f"the rotor speeds agree with {right}")


def test_info_shows_what_import_says(flown, vehicle, tmp_path):
    recording, _ = MISTAKES["neighbours swapped"].done(flown["train_2"], vehicle)
    write_bag(tmp_path / "swapped.mcap", recording)
    shown = inspect_recording(read_recording(tmp_path / "swapped.mcap", vehicle), vehicle).findings
    assert any("rotors 1 and 2 look swapped" in text for text in shown)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position_m": [0.0875, -0.115, 0.0]}, "must lie one in each quadrant"),
        ({"spin": "clockwise"}, "opposite rotors must turn the same way"),
    ],
)
def test_vehicles_that_cannot_fly_are_refused(tmp_path, change, message):
    _, data = read_config("vehicle", "bebop2", VehicleError)
    data["rotors"] = [{**rotor, **change} for rotor in data["rotors"]]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(VehicleError, match=message):
        Vehicle.load(path)


SOUND = SimpleNamespace(
    lag_s=0.0,
    explained=0.8,
    explained_now=0.8,
    correlation=np.full(3, 0.8),
    ratio=np.full(2, 0.7),
    order=(0, 1, 2, 3),
    spins_inverted=False,
    order_correlation=np.full(3, 0.8),
    mean_squares=np.ones(4),
    followed=0.8,
    growth=1.0,
    same=None,
    windows=4,
)


@pytest.fixture
def said_of_rotors(flown, vehicle, monkeypatch):
    """said_of_rotors(evidence…) → the mistakes named, where rotors and motion agree but for those numbers."""

    def said(**changes):
        monkeypatch.setattr(
            consistency, "rotor_evidence", lambda *_: SimpleNamespace(**vars(SOUND) | changes)
        )
        return [finding.mistake for finding in findings(flown["train_2"], vehicle)]

    return said


SWAPPED = {"order": (1, 0, 2, 3)}


@pytest.mark.parametrize(
    ("mistake", "silent", "named"),
    [
        ("rotor stamps", {"lag_s": 0.059, "explained_now": 0.3}, {"lag_s": 0.061, "explained_now": 0.3}),
        ("rotor stamps", {"lag_s": -0.1, "explained_now": 0.71}, {"lag_s": -0.1, "explained_now": 0.69}),
        (
            "rotor stamps",
            {"lag_s": 0.1, "explained": 0.24, "explained_now": 0.0},
            {"lag_s": 0.1, "explained": 0.26, "explained_now": 0.0},
        ),
        # Squares of correlations rise by a half, which follow by 0.35 and more.
        (
            "rotor order",
            {**SWAPPED, "correlation": np.sqrt([0.15, 0.64, 0.64])},
            {**SWAPPED, "correlation": np.sqrt([0.13, 0.64, 0.64])},
        ),
        (
            "rotor order",
            {**SWAPPED, "correlation": np.zeros(3), "order_correlation": np.array([0.8, 0.34, 0.8])},
            {**SWAPPED, "correlation": np.zeros(3), "order_correlation": np.array([0.8, 0.36, 0.8])},
        ),
        (
            "spins inverted",
            {"spins_inverted": True, "correlation": np.array([0.8, 0.8, -0.29])},
            {"spins_inverted": True, "correlation": np.array([0.8, 0.8, -0.31])},
        ),
        ("foreign rotors", {"followed": 0.31}, {"followed": 0.29}),
        ("squared speeds", {"growth": 0.64}, {"growth": 0.62}),
        ("squared speeds", {"growth": 0.5, "followed": None}, {"growth": 0.5}),
        ("inertia", {"ratio": np.array([0.7, 1.34])}, {"ratio": np.array([0.7, 1.36])}),
        (
            "inertia",
            {"ratio": np.array([1.5, 0.7]), "correlation": np.array([0.34, 0.8, 0.8])},
            {"ratio": np.array([1.5, 0.7]), "correlation": np.array([0.36, 0.8, 0.8])},
        ),
        (
            "one rotor",
            {"mean_squares": np.array([1.0, 0.94**2, 1.0, 1.0])},
            {"mean_squares": np.array([1.0, 0.92**2, 1.0, 1.0])},
        ),
        (
            "one rotor",
            {"mean_squares": np.array([1.0, 0.91**2, 1.0, 1.0]), "windows": 2},
            {"mean_squares": np.array([1.0, 0.89**2, 1.0, 1.0]), "windows": 2},
        ),
    ],
)
def test_rotors_are_blamed_beyond_what_real_flights_have(said_of_rotors, mistake, silent, named):
    assert said_of_rotors(**silent) == []
    assert said_of_rotors(**named) == [mistake]


@pytest.mark.parametrize(("slow", "named"), [(True, True), (False, False)])
def test_speeds_look_squared_only_where_the_air_hardly_matters(said_of_rotors, monkeypatch, slow, named):
    monkeypatch.setattr(consistency, "is_slow", lambda *_: slow)
    assert said_of_rotors(growth=0.5) == ["squared speeds"] * named


@pytest.mark.parametrize(("left", "named"), [(0.34, True), (0.36, False)])
def test_one_rotor_is_blamed_if_it_explains_all_but_a_third_of_what_is_unbalanced(
    said_of_rotors, vehicle, left, named
):
    """Roll, pitch and yaw, in units of a rotor's lever."""
    places = vehicle.rotor_positions[:, :2] / np.abs(vehicle.rotor_positions[:, :2]).mean(axis=0)
    levers = np.stack((-places[:, 1], places[:, 0], -vehicle.rotor_spins))
    along = -levers[:, 1] / np.linalg.norm(levers[:, 1])
    across = np.cross(along, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    wanted = 0.5 * (np.sqrt(1.0 - left**2) * along + left * across)
    # The squares of that imbalance, whose mean is one.
    squares = np.linalg.pinv(np.vstack((levers, np.ones(4)))) @ [*wanted, 4.0]
    assert ("one rotor" in said_of_rotors(mean_squares=squares)) == named


@pytest.mark.parametrize(
    ("hovers", "ratio", "named"),
    [
        *((False, 0.39, True), (False, 0.41, False), (False, 1.17, False), (False, 1.19, True)),
        *((True, 0.87, True), (True, 0.89, False), (True, 1.11, False), (True, 1.13, True)),
    ],
)
def test_a_thrust_is_blamed_beyond_what_flying_through_air_changes(
    said_of_rotors, flown, vehicle, monkeypatch, hovers, ratio, named
):
    def coefficient(*_, in_hover=False):
        return 0.02 * ratio if hovers or not in_hover else None

    known = replace(vehicle, thrust_coefficient=0.02)
    monkeypatch.setattr(consistency, "thrust_coefficient", coefficient)
    said_of_rotors()
    assert [one.mistake for one in findings(flown["train_2"], known)] == ["thrust"] * named


@pytest.mark.parametrize(
    ("ratio", "shape", "named"), [(0.79, 0.19, True), (0.81, 0.19, False), (0.79, 0.21, False)]
)
def test_arms_are_blamed_where_moments_and_inertia_are_both_small_for_them(
    said_of_rotors, flown, vehicle, ratio, shape, named
):
    said_of_rotors(ratio=np.full(2, ratio))
    inertia = vehicle.inertia.copy()
    inertia[2, 2] = shape * vehicle.mass_kg * np.mean(np.sum(vehicle.rotor_positions[:, :2] ** 2, axis=1))
    found = [one.mistake for one in findings(flown["train_2"], replace(vehicle, inertia=inertia))]
    assert found == ["arms"] * named


def test_a_thrust_coefficient_is_that_of_hover_where_the_flight_hovers(flown, vehicle):
    """Flying through air lowers it by a tenth."""
    recording = flown["train_2"]
    assert thrust_coefficient(recording, vehicle) == pytest.approx(0.0142, rel=0.02)
    assert thrust_coefficient(recording, vehicle, in_hover=True) == pytest.approx(0.0153, rel=0.02)
    gone = replace(recording, pose=recording.pose.take(slice(0, 20)), odometry=None)
    assert thrust_coefficient(gone, vehicle, in_hover=True) is None


@pytest.mark.parametrize(("factor", "slow"), [(1.0, True), (2.0, False)])
def test_a_vehicle_is_slow_by_its_speed_over_that_of_its_blades(flown, vehicle, factor, slow):
    pose = flown["train_2"].pose
    assert (
        is_slow(replace(flown["train_2"], pose=replace(pose, position=factor * pose.position)), vehicle)
        == slow
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "shift"),
    [("imrc_brushless/*", 1), ("imrc_brushless/*", 13), ("imrc_payload/eckart[12]?", 1)],
)
def test_rotor_speeds_of_another_real_flight_are_named(shared_data, pattern, shift):
    """Of the same programme, flown by the same vehicle."""
    vehicle = Vehicle.load("crazyflie_rpm")
    logs = sorted(shared_data.glob(pattern))
    flights = [read_recording(log, vehicle) for log in (*logs[::5], *logs[shift % 5 :: 5])]
    named = []
    for own, other in zip(flights, [*flights[1:], flights[0]], strict=True):
        foreign, start = other.rotor_speeds, own.rotor_speeds.time_ns[0]
        moved = replace(foreign, time_ns=foreign.time_ns - foreign.time_ns[0] + start)
        found = [one.mistake for one in findings(replace(own, rotor_speeds=moved), vehicle)]
        named.append(found == ["foreign rotors"])
    assert np.mean(named) >= 0.9


@pytest.fixture
def said_of_motion(flown, monkeypatch):
    """said_of_motion(cost, (cost once undone, size…)…) → findings; hypotheses are named by their place."""

    def said(before, *tried):
        def judged(sample):
            return SimpleNamespace(price=sample.price, motion=(0.0, 0.0), turn_rad_s=1.0, fall_m_s2=1.0)

        def named(*_):
            for place, (price, sizes) in enumerate(tried):
                undone = SimpleNamespace(price=price)
                yield Hypothesis(f"{place}", lambda _, undone=undone: undone, "looks", "remedy", **sizes)

        monkeypatch.setattr(consistency, "excerpt", lambda *_: SimpleNamespace(price=before))
        monkeypatch.setattr(consistency, "innovation", judged)
        monkeypatch.setattr(consistency, "cost", lambda found, _: found.price)
        monkeypatch.setattr(consistency, "hypotheses", named)
        monkeypatch.setattr(consistency, "small_mistakes", lambda *_, **__: ())
        return list(findings(flown["train_2"], None))

    return said


@pytest.mark.parametrize(
    ("before", "after", "sizes", "named", "certain"),
    [
        (1.9, 0.1, {}, False, False),
        (2.1, 0.1, {}, True, False),
        (6.0, 3.1, {}, False, False),
        (6.0, 2.9, {}, True, False),
        (9.9, 0.1, {}, True, False),
        (10.1, 0.1, {}, True, True),
        (12.0, 2.5, {}, True, False),
        (12.0, 2.3, {}, True, True),
        (5.0, 0.1, {"angle_deg": 5.9}, False, False),
        (5.0, 0.1, {"angle_deg": 6.1}, True, False),
        (5.0, 0.1, {"scale": 1.11}, False, False),
        (5.0, 0.1, {"scale": 1.0 / 1.11}, False, False),
        (5.0, 0.1, {"scale": 1.0 / 1.13}, True, False),
    ],
)
def test_motion_is_blamed_beyond_what_real_flights_differ_by(
    said_of_motion, before, after, sizes, named, certain
):
    found = said_of_motion(before, (after, sizes))
    assert [finding.certain for finding in found] == [certain] * named


@pytest.mark.parametrize(("price", "name"), [(1.09, "0"), (1.11, "1")])
def test_of_mistakes_that_explain_equally_well_the_simplest_is_named(said_of_motion, price, name):
    assert [one.mistake for one in said_of_motion(8.0, (price, {}), (1.0, {}))] == [name]
