# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results of a bag with what its monitor said of itself, of any number of rotors, and up to a cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.flight import PoseStream, RotorSpeedStream
from quadpi_core.logs import bag_files
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic, read_bag, read_outputs, write_bag
from quadpi_core.messages.definitions import codec, typestore
from quadpi_core.messages.payloads import Payloads, Topic
from quadpi_core.messages.result_messages import pack_description
from quadpi_core.messages.sensor_messages import pack_rotor_speeds
from quadpi_core.monitor.replay import replay
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
    # But for the low-pass, see `test_motion_inputs`.
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
