# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results of a bag with what its monitor said of itself, of any number of rotors, and up to a cut."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError, ModelError, QuadpiError
from quadpi_core.flight import PoseStream, RotorSpeedStream
from quadpi_core.logs import bag_files
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic, read_bag, read_outputs, write_bag
from quadpi_core.messages.definitions import codec, typestore
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.result_messages import pack_description, unpack_model
from quadpi_core.messages.sensor_messages import pack_rotor_speeds
from quadpi_core.monitor.replay import replay
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.rerun_recording import open_bag
from quadpi_core.view.trust import State

from .conftest import BAG, read_whole

STRING, BATTERY = "std_msgs/msg/String", "sensor_msgs/msg/BatteryState"


def described(text: str, time_ns: int) -> Topic:
    payloads = codec(STRING).encode(1, {"data": text})
    return Topic("/uav/monitor/description", STRING, np.array([time_ns]), payloads)


@pytest.fixture(scope="module")
def rotors(vehicle) -> RotorSpeedStream:
    stream = read_bag(BAG, vehicle).rotor_speeds
    assert stream is not None
    return stream


def recorded(results: Path, target: Path, more: Sequence[Topic]) -> Path:
    """A bag of results with further topics, as a recorder of all topics writes it."""
    with Bag(results) as bag:
        topics = list(bag.read([connection.topic for connection in bag.connections]).values())
    write_mcap(target, [*topics, *more], {})
    return target


def rotor_topic(rotors: RotorSpeedStream) -> Topic:
    return output_topic("rotor_speeds", rotors.time_ns, pack_rotor_speeds(rotors))


def test_a_replayed_bag_takes_its_training_ranges_from_the_model(results_bag, judged_view, model, vehicle):
    source = open_bag(results_bag, [model], vehicle)
    assert source.title == f"{results_bag.name}, results as recorded"
    view = read_whole(source)
    # Without rotor speeds there is nothing to compare with the ranges, which is said.
    assert [row[0] for row in view.overview()["health"]] == ["rotor_speeds"]
    assert "inputs of the models" in view.overview()["health"][0][2]
    given, judged = view.describe(), judged_view.describe()
    assert given["inputs"] == judged["inputs"]
    assert given["inputs"][0]["upper"] is not None
    other = replace(model, identity="other@1")
    with pytest.raises(QuadpiError, match=rf"holds predictions of {model.identity}, none of other@1$"):
        open_bag(results_bag, [other], vehicle)
    with pytest.raises(QuadpiError, match=r"--confidence: .* holds results, whose intervals have theirs"):
        open_bag(results_bag, [model], vehicle, 0.9)


@pytest.mark.parametrize("messages", [bag_files.BLOCK_MESSAGES, 1500])
def test_a_lack_of_motion_capture_is_called_so(model, vehicle, tmp_path, monkeypatch, messages):
    monkeypatch.setattr(bag_files, "BLOCK_MESSAGES", messages)
    flown = read_bag(BAG, vehicle)
    assert flown.pose is not None
    seconds = 1e-9 * (flown.pose.time_ns - flown.pose.time_ns[0])
    seen = (seconds < 4.0) | (seconds > 8.0)
    pose = PoseStream(flown.pose.time_ns[seen], flown.pose.position[seen], flown.pose.attitude[seen])
    write_bag(tmp_path / "gap.mcap", replace(flown, pose=pose))
    view = read_whole(open_bag(tmp_path / "gap.mcap", [model], vehicle))
    said = {text for _, words, _ in view.window(102, 138)[2] for text in words}
    assert "no motion capture for 3.0 s" in said
    assert not any("missing" in text for text in said)
    events = [one for one in view.overview()["events"] if one["cause"] == "bad data"]
    assert [(one["reasons"], one["end"] is None) for one in events] == [
        (["no motion capture for 2.1 s"], False)
    ]
    replay(model, vehicle, tmp_path / "gap.mcap", tmp_path / "replayed.mcap")
    _, alarms = read_outputs(tmp_path / "replayed.mcap")
    assert {text for words in alarms.reasons for text in words} >= {"no motion capture for 3.0 s"}
    late = alarms.where(alarms.time_ns - alarms.time_ns[0] > 3_500_000_000)
    assert not any("missing" in text for words in late.reasons for text in words)
    given = read_whole(open_bag(tmp_path / "replayed.mcap", [model], vehicle)).overview()["events"]
    assert [one["reasons"] for one in given if one["cause"] == "bad data"] == [events[0]["reasons"]]


def battery(stamps_ns: Sequence[int], volts: Sequence[float]) -> Topic:
    """Voltages of a battery that does not measure its charge."""
    types, payloads = typestore(), []
    kinds = types.types
    for stamp_ns, voltage in zip(stamps_ns, volts, strict=True):
        stamp = kinds["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
        given = dict.fromkeys(
            ("temperature", "current", "charge", "capacity", "design_capacity", "percentage"), np.nan
        )
        states = dict.fromkeys(
            ("power_supply_status", "power_supply_health", "power_supply_technology", "present"), 0
        )
        cells = dict.fromkeys(("cell_voltage", "cell_temperature"), np.empty(0, np.float32))
        header = kinds["std_msgs/msg/Header"](stamp, "")
        texts = {"location": "", "serial_number": ""}
        message = kinds[BATTERY](header=header, voltage=voltage, **given, **states, **cells, **texts)
        payloads.append(bytes(types.serialize_cdr(message, BATTERY)))
    return Topic("/mavros/battery", BATTERY, np.array(stamps_ns), Payloads.join(payloads))


def test_a_battery_is_told_from_its_stamps_on(results_bag, judged_view, tmp_path):
    begin = judged_view.start_ns
    stamps = [begin, begin + 10**9, begin + 8 * 10**9]
    second = replace(battery(stamps[:1], [1.0]), name="/mavros/second/battery")
    bag = recorded(results_bag, tmp_path / "flown.mcap", [second, battery(stamps, [16.1, 16.1, 14.9])])
    view = read_whole(open_bag(bag, [], None))
    for block, words in ((100, "16.1 V"), (140, "no message for 5 s"), (200, "14.9 V")):
        (_, _, told), *_ = view.window(block, block)[2]
        assert told == {"battery": words}
    assert view.summary()["told"] == {"battery": "no message for 5 s"}


def test_ranges_and_inputs_come_with_the_description_of_the_monitor(
    results_bag, judged_view, model, vehicle, rotors, tmp_path
):
    text = pack_description([model.described()], {}, vehicle)
    bag = recorded(
        results_bag, tmp_path / "flown.mcap", [described(text, rotors.time_ns[0]), rotor_topic(rotors)]
    )
    view = read_whole(open_bag(bag, [], None))
    assert view.overview()["health"] == []
    given, judged = view.describe()["inputs"], judged_view.describe()["inputs"]
    assert given == judged
    assert given[0]["upper"] is not None
    number = round(10.5 / 0.05)
    assert any("trained up to" in word for _, words, _ in view.window(number, number)[2] for word in words)
    # But for the low-pass, see the tests of the inputs of a motion.
    assert np.isfinite(view.blocks.value(200, "inputs")).all()


def test_a_description_without_a_vehicle_gives_ranges_alone(results_bag, model, rotors, tmp_path):
    text = pack_description([replace(model.described(), cutoff_hz=None)], {})
    bag = recorded(results_bag, tmp_path / "flown.mcap", [described(text, rotors.time_ns[0])])
    view = read_whole(open_bag(bag, [], None))
    assert view.describe()["inputs"][0]["upper"] is not None
    assert np.isnan(view.blocks.value(200, "inputs")).all()


def test_a_topic_of_that_name_of_another_node_is_named(results_bag, rotors, tmp_path):
    bag = recorded(results_bag, tmp_path / "flown.mcap", [described("<robot/>", rotors.time_ns[0])])
    view = read_whole(open_bag(bag, [], None))
    about, level, text = view.overview()["health"][0]
    assert (about, level) == ("/uav/monitor/description", "warn")
    assert text.startswith("gives no training ranges: not the description of a monitor")
    assert view.describe()["inputs"][0]["upper"] is None


def test_six_rotors_are_shown_and_the_inputs_of_four_are_not(results_bag, model, vehicle, rotors, tmp_path):
    six = replace(rotors, speeds=np.concatenate((rotors.speeds, rotors.speeds[:, :2] + 50.0), axis=1))
    text = pack_description([model.described()], {}, vehicle)
    bag = recorded(
        results_bag, tmp_path / "hexa.mcap", [described(text, rotors.time_ns[0]), rotor_topic(six)]
    )
    view = read_whole(open_bag(bag, [], None))
    assert view.describe()["columns"]["rotors"][1] == 6
    shown = view.blocks.value(200, "rotors")
    np.testing.assert_allclose(shown[4:] - shown[:2], 50.0, rtol=1e-4)
    rows = [row for row in view.overview()["health"] if row[0] == "inputs"]
    assert rows == [
        (
            "inputs",
            "warn",
            "not shown: topic rotor_speeds: 6 rotors, vehicle bebop2 has 4: its inputs are not known",
        )
    ]
    assert view.describe()["inputs"][0]["upper"] is not None


@pytest.mark.parametrize("share", [0.6, 0.999])
def test_results_are_shown_up_to_a_cut_which_is_said(results_bag, judged_view, tmp_path, share):
    content = results_bag.read_bytes()
    bag = tmp_path / "cut.mcap"
    bag.write_bytes(content[: round(share * len(content))])
    source = open_bag(bag, [], None)
    assert source.title == "cut.mcap, results as recorded, as far as the file goes: it is cut off"
    view = read_whole(source)
    assert 0.3 * judged_view.blocks.newest < view.blocks.newest <= judged_view.blocks.newest
    np.testing.assert_allclose(
        view.blocks.value(60, "0.upper"), judged_view.blocks.value(60, "0.upper"), rtol=1e-5
    )
    about, level, text = view.overview()["health"][0]
    assert (about, level) == ("bag", "warn")
    assert "`mcap recover`" in text


def test_a_flight_that_is_cut_off_is_judged_up_to_the_cut(model, vehicle, tmp_path):
    content = BAG.read_bytes()
    bag = tmp_path / "cut.mcap"
    bag.write_bytes(content[: round(0.7 * len(content))])
    view = read_whole(open_bag(bag, [model], vehicle))
    assert view.blocks.newest > 150
    assert [row[:2] for row in view.overview()["health"]] == [("bag", "warn")]


def test_a_cut_bag_without_results_is_named_with_the_cut(tmp_path):
    content = BAG.read_bytes()
    bag = tmp_path / "cut.mcap"
    bag.write_bytes(content[: round(0.7 * len(content))])
    with pytest.raises(LogError, match=r"cut.mcap: holds no predictions; .*\(the file is cut off\)"):
        open_bag(bag, [], None)


def test_stamps_that_jump_in_a_bag_are_drawn_on_and_listed(results_bag, tmp_path):
    with Bag(results_bag) as bag:
        topics = bag.read([connection.topic for connection in bag.connections])
    moved = []
    for topic in topics.values():
        half = topic.log_time_ns > np.median(topics["/prediction"].log_time_ns)
        payloads = [
            _with_stamp_s(payload, 1000) if late else payload
            for payload, late in zip(topic.payloads, half, strict=True)
        ]
        moved.append(replace(topic, payloads=Payloads.join(payloads)))
    write_mcap(tmp_path / "jump.mcap", moved, {})
    view = read_whole(open_bag(tmp_path / "jump.mcap", [], None))
    jumps = [event for event in view.overview()["events"] if event["cause"] == "stamps jumped"]
    assert [reason[:11] for event in jumps for reason in event["reasons"]] == ["by +1000.0 "]
    # What comes behind it is a second later, not a thousand.
    assert 370 < view.blocks.newest < 420
    assert view.state is not State.NO_DATA


def _with_stamp_s(payload: bytes, seconds: int) -> bytes:
    """A message with a header whose stamp is later."""
    stamp = int.from_bytes(payload[4:8], "little", signed=True) + seconds
    return payload[:4] + stamp.to_bytes(4, "little", signed=True) + payload[8:]


# A bag as the page gets it: judged here, or with the results that it holds.


def test_a_judged_bag_shows_what_replay_writes(judged_view, results_bag):
    predictions, alarms = read_outputs(results_bag)
    start_ns = predictions.time_ns[0]
    numbers = (predictions.time_ns - start_ns) // judged_view.blocks.block_ns
    for block in (0, 17, 200, judged_view.blocks.newest):
        inside = numbers == block
        assert judged_view.blocks.value(block, "0.count")[0] == inside.sum()
        for name, values in (
            ("measured", predictions.measured),
            ("0.lower", predictions.lower),
            ("0.predicted", predictions.predicted),
        ):
            np.testing.assert_allclose(judged_view.blocks.value(block, name), values[inside][-1], rtol=1e-6)
        missed = (predictions.measured < predictions.lower) | (predictions.measured > predictions.upper)
        np.testing.assert_array_equal(judged_view.blocks.value(block, "0.misses"), missed[inside].sum(axis=0))
    assert alarms.level.max() == 2
    assert str(int(State.ALARM)) in judged_view.timeline.codes


def test_a_flight_of_training_is_known_by_what_it_holds(judged_view, model, vehicle, tmp_path):
    copy = tmp_path / "renamed.mcap"
    copy.write_bytes((BAG.parent / "train_2.mcap").read_bytes())
    rows = read_whole(open_bag(copy, [model], vehicle)).overview()["health"]
    assert [row[2] for row in rows] == [f"in sample: {model.name} was identified on this flight"]
    assert judged_view.overview()["health"] == []


def test_a_bag_of_results_shows_the_same_without_a_model(judged_view, results_bag):
    recorded = read_whole(open_bag(results_bag, [], None))
    assert recorded.timeline.codes == judged_view.timeline.codes
    assert recorded.describe()["models"][0]["identity"] == judged_view.describe()["models"][0]["identity"]
    for name in ("measured", "0.upper", "speed", "position"):
        np.testing.assert_allclose(
            recorded.blocks.value(300, name), judged_view.blocks.value(300, name), rtol=1e-5, atol=1e-6
        )
    assert np.isnan(recorded.blocks.value(300, "inputs")).all()


def without(source: Path, target: Path, *left_out: str) -> Path:
    """A bag of results that lacks topics."""
    with Bag(source) as bag:
        topics = bag.read([connection.topic for connection in bag.connections])
    write_mcap(target, [topic for name, topic in topics.items() if name.strip("/") not in left_out], {})
    return target


def test_a_recorded_bag_shows_all_its_models(results_bag, tmp_path):
    with Bag(results_bag) as bag:
        topics = list(bag.read([connection.topic for connection in bag.connections]).values())
    prediction = next(topic for topic in topics if topic.name == "/prediction")
    payloads = prediction.payloads
    identity = unpack_model(payloads[0]).identity
    other = identity.replace("model@", "other@")
    second = Payloads.join([payload.replace(identity.encode(), other.encode()) for payload in payloads])
    topics.append(replace(prediction, name="/prediction/other", payloads=second))
    write_mcap(tmp_path / "two.mcap", topics, {})
    view = read_whole(open_bag(tmp_path / "two.mcap", [], None))
    assert [one["identity"] for one in view.describe()["models"]] == [identity, other]
    np.testing.assert_array_equal(view.blocks.value(100, "1.upper"), view.blocks.value(100, "0.upper"))


def test_topics_that_a_bag_lacks_are_named(results_bag, tmp_path):
    bag = without(results_bag, tmp_path / "few.mcap", "odometry", "extrapolation_alarm")
    rows = read_whole(open_bag(bag, [], None)).overview()["health"]
    assert [(about, level) for about, level, _ in rows] == [
        ("extrapolation_alarm", "warn"),
        ("odometry", "warn"),
        ("rotor_speeds", "warn"),
    ]
    assert rows[1][2] == "the bag has no topic odometry: flight, speed and height are not shown"


@pytest.mark.parametrize("name", ["bebop2", "", "nobody"])
def test_electrical_speeds_are_shown_where_the_bag_names_its_vehicle(results_bag, tmp_path, name):
    with Bag(BAG) as flown:
        erpm = flown.read(["/erpm"])["/erpm"]
    with Bag(results_bag) as bag:
        topics = list(bag.read([connection.topic for connection in bag.connections]).values())
    write_mcap(tmp_path / "erpm.mcap", [*topics, erpm], {"vehicle": name})
    view = read_whole(open_bag(tmp_path / "erpm.mcap", [], None))
    rows = view.overview()["health"]
    if name == "bebop2":
        assert rows == []
        assert view.blocks.value(100, "rotors")[0] > 100.0
    else:
        about, _, text = rows[-1]
        assert about == "erpm"
        assert (name or "does not name its vehicle") in text


def test_several_models_side_by_side(model, vehicle, judged_view):
    second = replace(model, name="second", identity="second@1")
    both = read_whole(open_bag(BAG, [model, second], vehicle))
    assert [one["name"] for one in both.describe()["models"]] == [model.name, "second"]
    np.testing.assert_array_equal(both.blocks.value(100, "1.upper"), judged_view.blocks.value(100, "0.upper"))


def test_models_of_one_name_are_refused(model, vehicle):
    with pytest.raises(QuadpiError, match="--model: two models have the same name"):
        open_bag(BAG, [model, model], vehicle)


def test_a_bag_without_predictions_says_how_to_get_them():
    with pytest.raises(LogError, match=r"holds no predictions; judge it by a model: quadpi view .* --model"):
        open_bag(BAG, [], None)


def test_a_model_of_another_vehicle_is_refused(model):
    with pytest.raises(ModelError, match="is of vehicle bebop2, not neurobem"):
        open_bag(BAG, [model], Vehicle.load("neurobem"))


def test_closing_ends_the_reader_at_once(model, vehicle):
    source = open_bag(BAG, [model], vehicle)
    source.close()
    assert "bag reader" not in {thread.name for thread in threading.enumerate()}


def test_a_bag_that_cannot_be_read_further_shows_what_was_read_and_says_so(model, vehicle, monkeypatch):
    from quadpi_core.view import flight_parts

    whole = flight_parts.judged

    def cut(*arguments):
        for number, part in enumerate(whole(*arguments)):
            if number == 2:
                raise LogError("flight.mcap: damaged")
            yield part

    monkeypatch.setattr(flight_parts, "judged", cut)
    source = open_bag(BAG, [model], vehicle)
    with pytest.raises(LogError, match="damaged"):
        read_whole(source)
    (view,) = source.vehicles.values()
    assert view.blocks.newest > 0
    assert view.summary()["state"] == State.NO_DATA
    assert view.overview()["health"] == [("bag", "error", "flight.mcap: damaged")]
