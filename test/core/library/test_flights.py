# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of paths, patterns and lists, their parts, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import quadpi_core as qp
from quadpi_core.identification.prepared_flights import PreparedFlight, prepare_flights
from quadpi_core.paths import bags_directory

BAGS = bags_directory()


def test_they_are_those_of_the_commands(training):
    expected = prepare_flights([BAGS / f"train_{k}.mcap" for k in (1, 2, 3, 4)], qp.Vehicle.load("bebop2"))
    assert training.names == ("train_1", "train_2", "train_3", "train_4")
    for one, other in zip(training.prepared, expected, strict=True):
        assert np.array_equal(one.inputs, other.inputs)
        assert np.array_equal(one.wrench, other.wrench)
        assert one.sha256 == other.sha256


def test_any_path_pattern_or_list(training, monkeypatch):
    monkeypatch.chdir(BAGS.parent)
    vehicle = qp.Vehicle.load("bebop2")
    for logs in ("bags/train_1.mcap", BAGS / "train_1.mcap", ["bags/train_[1].mcap"], "b*/train_1*"):
        assert np.array_equal(qp.load_flights(logs, vehicle).inputs, training[0].inputs)
    both = qp.load_flights(["bags/interpolation.mcap", "bags/train_1.m*"], vehicle)
    assert both.names == ("interpolation", "train_1")


def test_parts_are_flights_too(training):
    assert [flight.names for flight in training] == [(name,) for name in training.names]
    assert training[1:3].names == ("train_2", "train_3")
    assert training[-1].names == training["train_4"].names == ("train_4",)
    assert training[np.array([True, False, False, True])].names == ("train_1", "train_4")
    assert training[[2, 0]].names == ("train_3", "train_1")
    assert (training[:1] + training[2:]).names == ("train_1", "train_3", "train_4")
    samples = len(training.time)
    assert training.inputs.shape == (samples, 19)
    assert training.wrench.shape == (samples, 6)
    assert training.labels.shape == training.speed.shape == (samples,)
    assert np.array_equal(training.wrench[training.labels == 1], training[1].wrench)


def test_what_cannot_be_used_is_left_out_where_it_is_asked_for(tmp_path):
    (tmp_path / "broken.mcap").write_bytes(b"nothing")
    logs, left_out = [tmp_path / "broken.mcap", BAGS / "train_1.mcap"], []
    with pytest.raises(qp.QuadpiError, match=r"broken\.mcap"):
        qp.load_flights(logs, "bebop2")
    assert qp.load_flights(logs, "bebop2", left_out=left_out).names == ("train_1",)
    assert [flight.flight for flight in left_out] == ["broken"]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda _: qp.load_flights("no/*.mcap", "bebop2"), r"no/\*\.mcap: no file fits this pattern"),
        (lambda _: qp.load_flights("no.mcap", "bebop2"), r"no\.mcap: no such file"),
        (lambda _: qp.load_flights(7, "bebop2"), "logs: expected paths, found int 7"),
        (lambda _: qp.load_flights(BAGS / "train_1.mcap", "bebop3"), "bebop3"),
        (
            lambda f: qp.load_flights(BAGS / "train_1.mcap", f.vehicle, workers=0),
            "workers: expected a whole num",
        ),
        (
            lambda f: qp.load_flights("no.mcap", f.vehicle, left_out=()),
            "left_out: expected list, found tuple",
        ),
        (lambda f: qp.Flights(f.prepared, "bebop2"), "vehicle: expected Vehicle, found str 'bebop2'"),
        (lambda f: qp.Flights(f.prepared, f.vehicle, -1.0), "cutoff_hz: expected a positive number"),
        (lambda f: f + f, "flights: two are called train_1: load them in one call, which names them"),
        (
            lambda f: f[:1] + qp.Flights([replace(f.prepared[0], name="copy")], f.vehicle),
            "flights: train_1 and copy are the same flight: give it once",
        ),
        (lambda f: f[[]], "flights: expected one at least, found none"),
        (lambda f: f[:1] + replace(f[1:2], cutoff_hz=20.0), "low-passed at 30 and at 20 Hz: load them alike"),
        (
            lambda f: f[:1] + replace(f[1:2], vehicle=qp.Vehicle.load("neurobem")),
            "of two vehicles, bebop2",
        ),
        (
            lambda _: qp.load_flights("bebop2", BAGS / "train_1.mcap"),
            r"vehicle: .*train_1.mcap is a log: load_flights\(logs",
        ),
        (lambda f: qp.Flights([f], f.vehicle), "prepared, entry 1: expected PreparedFlight"),
    ],
)
def test_a_plausible_mistake_is_one_clear_line(training, call, message):
    with pytest.raises(qp.QuadpiError, match=message) as caught:
        call(training)
    assert "\n" not in str(caught.value)


def test_flights_by_their_names(training):
    assert "train_2" in training
    assert training[["train_3", "train_1"]].names == ("train_3", "train_1")
    for key in ("train_9", ["train_1", "train_9"]):
        with pytest.raises(KeyError, match="no flight train_9; there are train_1, train_2"):
            training[key]


def test_a_likely_mistake_in_the_data_is_a_warning(training):
    flight = training.prepared[0].flight
    wrong = {name: getattr(flight, name) for name in NAMES[:5]} | {
        "specific_force": 1.1 * flight.specific_force
    }
    with pytest.warns(UserWarning, match=r"flight flight: topic odometry: the accelerometer reads 1\.1"):
        flights = qp.Flights.from_arrays(flight.stamps_ns, vehicle="bebop2", **wrong)
    assert "the accelerometer reads 1.1" in flights._repr_html_()


def test_they_show_themselves(training):
    assert repr(training) == (
        "<Flights: 4 flights of bebop2 (train_1, train_2, train_3, train_4), 76 s, 38004 samples, "
        "up to 6.2 m/s, low-pass 30 Hz>"
    )
    assert "<td>train_2</td><td>19.0</td><td>9501</td><td>500</td><td>5.6</td>" in training._repr_html_()


# Flights of arrays and of tables: as those of logs, there and back, each bad column named.


NAMES = ("velocity", "attitude", "rates", "specific_force", "rotor_speeds", "position", "wind")

FORCES = ("force_x_m_s2", "force_y_m_s2", "force_z_m_s2")


@pytest.fixture(scope="module")
def state(unseen):
    """Stamps and arrays of a flight, as a user may have them."""
    flight = unseen.prepared[0].flight
    return flight.stamps_ns, {name: getattr(flight, name) for name in NAMES}


@pytest.fixture(scope="module")
def frame(training):
    """Two flights as a table, without what was derived."""
    table = training[:2].to_pandas()
    return table.drop(columns=["p_rad_s2", "q_rad_s2", "r_rad_s2"])


def test_filtered_flights_go_there_and_back(training):
    """The same states, inputs and wrench, to the rounding of their time."""
    table = training[:2].to_pandas()
    assert list(table)[:5] == ["flight", "time_ns", "north_m", "east_m", "down_m"]
    assert list(table)[-6:] == ["fx_n", "fy_n", "fz_n", "mx_nm", "my_nm", "mz_nm"]
    again = qp.Flights.from_pandas(table, flight="flight", time="time_ns", vehicle="bebop2", filtered=True)
    assert again.names == ("train_1", "train_2")
    assert np.array_equal(again.inputs, training[:2].inputs)
    assert np.array_equal(again.wrench, training[:2].wrench)
    both = again.to_pandas()
    assert both.equals(table)


def test_a_table_keeps_its_low_pass(training, quick):
    slow = replace(training[:1], cutoff_hz=20.0)
    table = slow.to_pandas()
    assert qp.Flights.from_pandas(table, vehicle="bebop2", filtered=True).cutoff_hz == 20.0
    table.attrs.clear()
    with pytest.raises(qp.QuadpiError, match="cutoff_hz: the table does not say which low-pass"):
        qp.Flights.from_pandas(table, vehicle="bebop2", filtered=True)
    told = qp.Flights.from_pandas(table, vehicle="bebop2", filtered=True, cutoff_hz=30.0)
    assert np.array_equal(quick.predict(told), quick.predict(training[:1]), equal_nan=True)


def test_holes_of_a_log_go_there_and_back(training):
    """Rotor speeds may be unknown for a while; rows that a user took out are another matter."""
    flight = training.prepared[0].flight
    holed = PreparedFlight.from_flight(flight.slice(np.arange(len(flight)) // 100 != 3), training.vehicle, "")
    table = qp.Flights((holed,), training.vehicle).to_pandas()
    again = qp.Flights.from_pandas(table, vehicle="bebop2", filtered=True)
    assert np.array_equal(again.inputs, holed.inputs)
    with pytest.raises(qp.QuadpiError, match="sample 300: rows before it are left out"):
        qp.Flights.from_pandas(table[:-1], vehicle="bebop2", filtered=True)


def test_a_model_predicts_the_same_on_them(quick, training):
    table = training[:1].to_pandas()
    again = qp.Flights.from_pandas(table, vehicle="bebop2", filtered=True)
    assert np.array_equal(quick.predict(again), quick.predict(training[:1]), equal_nan=True)


def test_a_table_of_states_is_filtered_and_cut_to_the_flight(frame, training):
    flights = qp.Flights.from_pandas(frame, flight="flight", time="time_ns", vehicle="bebop2")
    assert flights.names == ("train_1", "train_2")
    assert flights.prepared[0].live is not None
    # Filtered twice, but what was slow stays.
    assert np.corrcoef(flights.wrench[:, 2], training[:2].wrench[-len(flights.time) :, 2])[0, 1] > 0.9
    model = qp.WrenchModel("polynomial", axes=["Fz"]).fit(flights)
    assert model.score(flights) > 0.9


def test_arrays_and_tables_are_the_same(frame):
    one = frame[frame["flight"] == "train_1"]
    table = qp.Flights.from_pandas(one, vehicle="bebop2")
    columns = {
        "velocity": ["u_m_s", "v_m_s", "w_m_s"],
        "attitude": ["qw", "qx", "qy", "qz"],
        "rates": ["p_rad_s", "q_rad_s", "r_rad_s"],
        "specific_force": ["force_x_m_s2", "force_y_m_s2", "force_z_m_s2"],
        "rotor_speeds": [f"rotor_{k}_rad_s" for k in (1, 2, 3, 4)],
        "position": ["north_m", "east_m", "down_m"],
        "wind": ["wind_north_m_s", "wind_east_m_s", "wind_down_m_s"],
    }
    arrays = {name: one[own].to_numpy() for name, own in columns.items()}
    same = qp.Flights.from_arrays(one["time_ns"], vehicle="bebop2", flight=one["flight"], **arrays)
    assert np.array_equal(same.inputs, table.inputs)
    renamed = one.rename(columns={"p_rad_s": "p", "q_rad_s": "q", "r_rad_s": "r", "time_ns": "t"})
    mine = qp.Flights.from_pandas(renamed, vehicle="bebop2", time="t", columns={"rates": ["p", "q", "r"]})
    assert np.array_equal(mine.inputs, table.inputs)
    for dates in ("datetime64[ns]", "datetime64[ns, UTC]"):
        dated = one.assign(time_ns=one["time_ns"].astype(dates))
        assert np.array_equal(qp.Flights.from_pandas(dated, vehicle="bebop2").inputs, table.inputs)


def test_position_and_wind_may_be_absent(state):
    stamps, arrays = state
    known = {name: arrays[name] for name in NAMES[:5]}
    flights = qp.Flights.from_arrays(stamps, vehicle="bebop2", **known)
    whole = qp.Flights.from_arrays(stamps, vehicle="bebop2", **arrays)
    assert flights.names == ("flight",)
    assert np.array_equal(flights.wrench, whole.wrench)
    moved = flights.prepared[0].height - whole.prepared[0].height
    assert np.ptp(moved) < 0.2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rates": np.zeros((3, 2))}, r"rates: expected shape \(\d+, 3\) for time_ns"),
        ({"rotor_speeds": None}, "rotor_speeds: expected numbers, found None; only position and wind may"),
        ({"time_ns": np.linspace(0.0, 1.0, 9501)}, "time_ns: expected whole nanoseconds, int64.* of seconds"),
        ({"time_ns": np.zeros(9501, dtype=int)}, "flight flight: time_ns: sample 1: the stamp repeats"),
        (
            {"time_ns": np.arange(9501) * 2e6 + 1e18},
            "whole nanoseconds, int64, found an array .* of float64$",
        ),
        (
            {"time_ns": np.arange(9501) * 2000},
            "flight flight: time_ns: 2000 from .* looks like µs or ms, not",
        ),
        # As of motion capture of 20 Hz.
        (
            {"time_ns": np.arange(9501) * 50_000},
            "flight flight: time_ns: 50000 from .* looks like µs or ms, not",
        ),
        ({"flight": np.where(np.arange(9501) < 3, 1.0, np.nan)}, "flight: no label in row 3"),
        ({"flight": [None] * 9501}, "flight: no label in row 0"),
        ({"flight": [1, 2]}, r"flight: expected shape \(9501,\) for time_ns, found \(2,\)"),
        ({"vehicle": "no_vehicle"}, "no_vehicle"),
        ({"cutoff_hz": -1.0}, "cutoff_hz: expected a positive number"),
    ],
)
def test_bad_arrays_are_refused_by_name(state, change, message):
    stamps, arrays = state
    given = {"time_ns": stamps, "vehicle": "bebop2", **arrays} | change
    with pytest.raises(qp.QuadpiError, match=message):
        qp.Flights.from_arrays(**given)


def test_no_samples_are_refused():
    empty = {name: np.zeros((0, 4 if name in {"attitude", "rotor_speeds"} else 3)) for name in NAMES}
    with pytest.raises(qp.QuadpiError, match="time_ns: expected samples, found none"):
        qp.Flights.from_arrays(np.zeros(0, dtype=int), vehicle="bebop2", **empty)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda frame: frame.drop(columns="qw"), "frame: attitude needs the columns qw, qx, qy, qz: no qw"),
        (lambda frame: frame.set_index("flight"), r"frame: no column flight; reset_index\(\) makes it one$"),
        (
            lambda frame: frame.astype({"u_m_s": "Float64"}).assign(
                u_m_s=lambda own: own["u_m_s"].mask(own.index == 7)
            ),
            "velocity: expected finite numbers, .* first in row 7",
        ),
        (lambda frame: frame.drop(columns="flight"), "frame: no column flight; it has time_ns, north_m"),
        (
            lambda frame: frame.drop(columns="down_m"),
            "frame: position needs the columns north_m.*: no down_m",
        ),
        (lambda frame: frame.assign(p_rad_s="fast"), "rates: expected numbers"),
        (lambda frame: frame.assign(u_m_s=np.nan), "velocity: expected finite numbers, .* first in row 0"),
        (lambda frame: frame.to_numpy(), "frame: expected DataFrame, found an array"),
        (lambda frame: frame.assign(p_rad_s2=0.0, q_rad_s2=0.0, r_rad_s2=0.0), "pass filtered=True"),
    ],
)
def test_bad_tables_are_refused_by_column(frame, change, message):
    with pytest.raises(qp.QuadpiError, match=message):
        qp.Flights.from_pandas(change(frame), vehicle="bebop2")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table[:1], "flight train_1: has 1 row, expected 2 or more"),
        (
            lambda table: table.drop(index=range(300, 400)),
            "flight train_1: sample 300: rows before it are left out: filter rows after loading, not before",
        ),
        (
            lambda table: table.assign(qw=table["qw"].where(table.index != 7, 2.0)),
            r"flight train_1: attitude: sample 7: norm of 2\.\d+, expected 1",
        ),
        (
            lambda table: table.assign(**{name: table[name] / 9.81 for name in FORCES}),
            "flight train_1: topic imu: the median specific force is .*: looks like g",
        ),
        (
            lambda table: table.assign(u_m_s=table["u_m_s"].where(table.index != 7, 1e300)),
            r"flight train_1: velocity: sample 7: magnitude of 1e\+300, which no flight has",
        ),
    ],
)
def test_filtered_tables_are_checked_as_raw_ones_are(training, change, message):
    table = change(training[:1].to_pandas())
    with pytest.raises(qp.QuadpiError, match=message) as caught:
        qp.Flights.from_pandas(table, vehicle="bebop2", filtered=True)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("filtered", [True, False])
@pytest.mark.parametrize("measured", [True, False], ids=["position", "no position"])
def test_quaternions_in_the_other_order_are_refused(training, filtered, measured):
    """Without a position that of the flight is the integral of its velocity, by the wrong attitude."""
    order, derived = ["qw", "qx", "qy", "qz"], ["p_rad_s2", "q_rad_s2", "r_rad_s2"]
    absent = [*([] if filtered else derived), *([] if measured else ["north_m", "east_m", "down_m"])]
    for flight in training:
        table = flight.to_pandas().drop(columns=absent)
        told = qp.Flights.from_pandas(table, vehicle="bebop2", filtered=filtered).prepared[0].quality
        assert [finding for finding in told.findings if finding.topic == "odometry"] == []
        table[order] = table[[*order[1:], "qw"]].to_numpy()
        with pytest.raises(qp.QuadpiError, match="attitude of odometry look ordered xyzw where the other"):
            qp.Flights.from_pandas(table, vehicle="bebop2", filtered=filtered)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"rate": ["p", "q", "r"]}, "columns: no quantity 'rate'; there are position, attitude"),
        ({"rates": 5}, "columns, rates: expected 3 names, found 5"),
        ({"rates": ["p", "q", None]}, "columns, rates: expected 3 names"),
        (["p", "q", "r"], "columns: expected Mapping, found list"),
        ({"rates": ["p", "q"]}, r"columns, rates: expected 3 names, found \['p', 'q'\]"),
        ({"rates": ["p", "q", "r"]}, "frame: rates needs the columns p, q, r: no p, q, r"),
    ],
)
def test_bad_names_of_columns_are_refused(frame, columns, message):
    with pytest.raises(qp.QuadpiError, match=message):
        qp.Flights.from_pandas(frame, vehicle="bebop2", columns=columns)
