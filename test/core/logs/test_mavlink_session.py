# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The conversation with an autopilot, packet by packet on a clock that the test turns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from benchmarks.fuzzing.cases import judge, make
from benchmarks.fuzzing.formats import FORMATS
from quadpi_core.logs.mavlink_frames import Framer
from quadpi_core.logs.mavlink_samples import ARDUPILOT, PX4
from quadpi_core.logs.mavlink_session import MavlinkSession, Received, SessionSettings
from quadpi_core.rotor_order import RotorOrder
from quadpi_core.vehicle import Vehicle

MS, S = 1_000_000, 1_000_000_000
START = 1_700_000_000 * S
ORDER = RotorOrder((0, 1, 2, 3), "rpm")


class Autopilot:
    """One that the test steps through time; its clock is zero at `boot_ns`, its packets take 4 ms."""

    def __init__(self, sender: Any, settings: SessionSettings | None = None, kind: int = PX4) -> None:
        self.sender = sender
        self.kind = kind
        self.boot_ns = START
        self.session = MavlinkSession(Vehicle.load("bebop2"), ORDER, settings or SessionSettings())
        self.framer = Framer()
        self.heard: list[Any] = []

    def deliver(self, packet: bytes, sent_ns: int) -> list[Received]:
        return self.session.take(packet, sent_ns + 4 * MS, complete=True)

    def heartbeat(self, at_ns: int) -> None:
        self.deliver(self.sender.packet("HEARTBEAT", 2, self.kind, 0, 0, 4, 3), at_ns)

    def imu(self, at_ns: int, name: str = "HIGHRES_IMU") -> list[Received]:
        if name == "HIGHRES_IMU":
            values: tuple[Any, ...] = ((at_ns - self.boot_ns) // 1000, *[0.0] * 13, 0x3F, 0)
        else:
            values = ((at_ns - self.boot_ns) // MS, *[0] * 9)
        return self.deliver(self.sender.packet(name, *values), at_ns)

    def listen(self, at_ns: int, *, answers: bool = True) -> list[Any]:
        """What the session sends now; TIMESYNC takes 4 ms there and back."""
        heard = []
        for packet in self.session.due(at_ns):
            (message,) = self.framer.feed(packet)
            heard.append(message)
            if answers and message.get_type() == "TIMESYNC" and message.tc1 == 0:
                here = at_ns + 4 * MS
                self.deliver(self.sender.packet("TIMESYNC", here - self.boot_ns, message.ts1), here)
        return heard


@pytest.fixture
def autopilot(mavlink_sender: Any) -> Autopilot:
    """One that was heard."""
    heard = Autopilot(mavlink_sender())
    heard.heartbeat(START)
    return heard


def test_stamps_are_those_of_this_computer(autopilot: Autopilot) -> None:
    for step in range(1000):
        autopilot.listen(START + step * 10 * MS)
        (sample,) = autopilot.imu(START + step * 10 * MS)
        if step > 100:
            assert sample.time_ns == pytest.approx(START + step * 10 * MS, abs=MS // 10)
    report = autopilot.session.report(START + 10 * S)
    assert report.clock
    assert report.clock.exchanged
    assert abs(report.clock.offset_ns - START) <= report.clock.uncertainty_ns < 6 * MS


@pytest.mark.parametrize(
    ("mav_type", "said"),
    [
        (2, ""),
        (13, "MAV_TYPE 13 is a hexacopter; vehicle bebop2 has 4 rotors"),
        (20, "MAV_TYPE 20 is a VTOL aircraft; vehicle bebop2 has 4 rotors"),
    ],
)
def test_rotor_speeds_of_what_is_no_quadrotor_are_refused_by_its_name(
    mavlink_sender: Any, mav_type: int, said: str
) -> None:
    autopilot = Autopilot(mavlink_sender())
    autopilot.deliver(autopilot.sender.packet("HEARTBEAT", mav_type, PX4, 0, 0, 4, 3), START)
    status = autopilot.sender.packet("ESC_STATUS", 0, 10_000, [4000] * 4, [0.0] * 4, [0.0] * 4)
    assert len(autopilot.deliver(status, START + 10 * MS)) == (not said)
    assert len(autopilot.imu(START + 10 * MS)) == 1
    report = autopilot.session.report(START + S)
    assert report.other_airframe == said
    assert report.refused == ({f"ESC_STATUS: {said}": 1} if said else {})


def test_without_answers_stamps_are_late_by_the_delay_and_the_report_says_so(autopilot: Autopilot) -> None:
    for step in range(300):
        autopilot.listen(START + step * 10 * MS, answers=False)
        (sample,) = autopilot.imu(START + step * 10 * MS)
    assert sample.time_ns == START + 2990 * MS + 4 * MS
    report = autopilot.session.report(START + 3 * S)
    assert report.clock
    assert not report.clock.exchanged
    assert report.clock.uncertainty_ns is None


def names(messages: list[Any]) -> set[str]:
    return {message.get_type() for message in messages}


def asked(messages: list[Any]) -> dict[int, int]:
    """Interval in µs per message id."""
    return {int(m.param1): int(m.param2) for m in messages if m.get_type() == "COMMAND_LONG"}


@pytest.mark.parametrize(("kind", "rotors", "state"), [(PX4, 291, 331), (ARDUPILOT, 11030, 32)])
def test_messages_that_lack_are_asked_for(kind: int, rotors: int, state: int, mavlink_sender: Any) -> None:
    settings = SessionSettings(rates_hz={"imu": 200.0, "rotor_speeds": 100.0, "odometry": 50.0})
    autopilot = Autopilot(mavlink_sender(), settings, kind)
    assert names(autopilot.listen(START)) == {"HEARTBEAT"}
    autopilot.heartbeat(START + S)
    wanted = asked(autopilot.listen(START + S))
    assert (wanted[105], wanted[rotors], wanted[state], wanted[31]) == (5_000, 10_000, 20_000, 20_000)
    # What comes is not asked for again.
    for step in range(1000):
        autopilot.imu(START + S + step * 5 * MS)
    again = asked(autopilot.listen(START + 6 * S))
    assert 105 not in again
    assert rotors in again


@pytest.mark.parametrize(("kind", "outputs"), [(PX4, 375), (ARDUPILOT, 36)])
@pytest.mark.parametrize("told", [False, True])
def test_commands_are_asked_for_where_no_speed_is_told(
    kind: int, outputs: int, told: bool, mavlink_sender: Any
) -> None:
    settings = SessionSettings(rates_hz={"imu": 200.0, "rotor_speeds": 100.0, "odometry": 50.0})
    autopilot = Autopilot(mavlink_sender(), settings, kind)
    autopilot.heartbeat(START)
    assert outputs not in asked(autopilot.listen(START))
    if told and kind == PX4:
        status = autopilot.sender.packet("ESC_STATUS", 0, 10_000, [4000] * 4, [0.0] * 4, [0.0] * 4)
        autopilot.deliver(status, START + S)
    elif told:
        zeros = [0] * 4
        speeds = ([30] * 4, zeros, zeros, zeros, [4000] * 4, zeros)
        autopilot.deliver(autopilot.sender.packet("ESC_TELEMETRY_1_TO_4", *speeds), START + S)
    assert (outputs in asked(autopilot.listen(START + 6 * S))) == (not told)


def test_a_passive_session_sends_nothing(mavlink_sender: Any) -> None:
    autopilot = Autopilot(mavlink_sender(), SessionSettings(passive=True))
    autopilot.heartbeat(START)
    assert autopilot.listen(START + S) == []


def test_the_autopilot_s_own_timesync_is_answered(autopilot: Autopilot) -> None:
    autopilot.deliver(autopilot.sender.packet("TIMESYNC", 0, 987_654), START)
    answers = [m for m in autopilot.listen(START + S) if m.get_type() == "TIMESYNC" and m.tc1]
    assert [(m.tc1, m.ts1) for m in answers] == [(START + 4 * MS, 987_654)]


def test_the_best_imu_message_is_used_while_it_comes(autopilot: Autopilot) -> None:
    assert autopilot.imu(START, "SCALED_IMU2")
    assert autopilot.imu(START + 10 * MS)
    assert not autopilot.imu(START + 20 * MS, "SCALED_IMU2")
    assert autopilot.session.report(START).sources["imu"] == "HIGHRES_IMU"
    assert autopilot.imu(START + 2 * S, "SCALED_IMU2")


def test_only_the_chosen_imu_message_is_used(mavlink_sender: Any) -> None:
    autopilot = Autopilot(mavlink_sender(), SessionSettings(imu_source="SCALED_IMU2"))
    autopilot.heartbeat(START)
    assert not autopilot.imu(START)
    assert autopilot.imu(START + 10 * MS, "SCALED_IMU2")


def test_the_peer_is_the_first_that_sends_a_heartbeat(mavlink_sender: Any) -> None:
    """Nothing that another sends is used, samples and motion capture alike, nor moves the clock."""
    autopilot = Autopilot(mavlink_sender())
    assert not autopilot.imu(START)
    assert autopilot.session.report(START).system is None
    autopilot.heartbeat(START)
    assert autopilot.imu(START)
    autopilot.listen(START + S)
    offset_ns = autopilot.session.report(START + S).clock
    other = autopilot.sender = mavlink_sender(system=2)
    autopilot.heartbeat(START + S)
    assert not autopilot.imu(START + S)
    mocap = other.packet("ATT_POS_MOCAP", 5_000, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
    assert not autopilot.deliver(mocap, START + S)
    # It answers a clock exchange, and asks for one.
    for step in range(20):
        now_ns = START + 2 * S + step * 500 * MS
        for packet in autopilot.session.due(now_ns):
            message = autopilot.framer.feed(packet)[0]
            assert getattr(message, "target_system", 1) == 1
            if message.get_type() == "TIMESYNC":
                assert message.tc1 == 0
                autopilot.deliver(other.packet("TIMESYNC", 12345, message.ts1), now_ns)
                autopilot.deliver(other.packet("TIMESYNC", 0, 99), now_ns)
    report = autopilot.session.report(START + S)
    assert report.system == 1
    assert report.clock == offset_ns
    assert report.others == {"system 1": 1, "system 2": 43}
    assert report.rivals == {"system 2": 1}


def test_lost_counts_the_packets_of_the_autopilot_alone(autopilot: Autopilot, mavlink_sender: Any) -> None:
    ground = mavlink_sender(system=255)
    for gap in (0, 7):
        ground.mav.seq = (ground.mav.seq + gap) % 256
        autopilot.deliver(ground.packet("TIMESYNC", 0, 99), START)
    assert autopilot.session.report(START).frames.lost == 0
    autopilot.sender.mav.seq = (autopilot.sender.mav.seq + 3) % 256
    autopilot.heartbeat(START)
    assert autopilot.session.report(START).frames.lost == 3


def test_motion_capture_of_the_vehicle_s_own_system_is_used(autopilot: Autopilot) -> None:
    """From whatever component: a companion computer on board sends it through the autopilot."""
    autopilot.sender.mav.srcComponent = 197
    mocap = autopilot.sender.packet("ATT_POS_MOCAP", 5_000, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
    assert [one.topic for one in autopilot.deliver(mocap, START)] == ["mocap/pose"]


@pytest.mark.parametrize("kind", [PX4, ARDUPILOT])
def test_commands_of_the_motors_and_the_battery_are_told(kind: int, mavlink_sender: Any) -> None:
    autopilot = Autopilot(mavlink_sender(), kind=kind)
    autopilot.heartbeat(START)
    if kind == PX4:
        outputs = autopilot.sender.packet("ACTUATOR_OUTPUT_STATUS", 5_000, 4, [1500.0] * 4 + [0.0] * 28)
    else:
        outputs = autopilot.sender.packet("SERVO_OUTPUT_RAW", 5_000, 0, *[1500] * 4, *[0] * 12)
    cells = [4000] * 4 + [0xFFFF] * 6
    battery = autopilot.sender.packet("BATTERY_STATUS", 0, 0, 1, 2500, cells, 100, 0, 0, 50)
    air = autopilot.sender.packet("SCALED_PRESSURE", 5, 950.25, 0.0, 2310)
    packets, now = (outputs, battery, air), START + 5 * MS
    received = [one for packet in packets for one in autopilot.deliver(packet, now)]
    assert [one.topic for one in received] == ["motor_commands", "battery"]
    assert received[0].values.shape == (4,)
    assert 0.4 < received[0].values.min() <= received[0].values.max() < 0.8
    assert received[1].values.tolist() == [pytest.approx(16.0)]
    report = autopilot.session.report(START)
    assert (report.samples["motor_commands"], report.samples["battery"]) == (1, 1)


def test_nobody_takes_the_place_of_the_peer_by_its_number(mavlink_sender: Any) -> None:
    session = MavlinkSession(None, ORDER, SessionSettings())
    sender = mavlink_sender()

    def send(name: str, at_ns: int, address: str, *values: Any) -> list[Received]:
        stamp = () if name == "HEARTBEAT" else ((at_ns - START) // 1000 + 1,)
        return session.take(sender.packet(name, *stamp, *values), at_ns, complete=True, address=address)

    beat, imu = (2, PX4, 0, 0, 4, 3), (*[0.0] * 13, 0x3F, 0)
    send("HEARTBEAT", START, "here", *beat)
    assert session.address == "here"
    send("HEARTBEAT", START + S, "there", *beat)
    assert not send("HIGHRES_IMU", START + S, "there", *imu)
    assert session.address == "here"
    assert send("HIGHRES_IMU", START + S, "here", *imu)
    assert session.report(START).rivals == {"system 1 at another address": 1}
    # A vehicle that starts again has another port, and its old one is silent.
    send("HEARTBEAT", START + 6 * S, "there", *beat)
    assert session.address == "there"
    assert send("HIGHRES_IMU", START + 6 * S, "there", *imu)
    assert not send("HIGHRES_IMU", START + 7 * S, "here", *imu)


@pytest.mark.parametrize(("kind", "autopilot"), [(6, 0), (18, 0), (26, 8), (2, 8)])
def test_a_ground_station_or_companion_is_no_peer(kind: int, autopilot: int, mavlink_sender: Any) -> None:
    session = MavlinkSession(None, ORDER, SessionSettings())
    session.take(
        mavlink_sender(system=255).packet("HEARTBEAT", kind, autopilot, 0, 0, 4, 3), START, complete=True
    )
    report = session.report(START)
    assert (report.system, report.others, report.rivals) == (None, {"system 255": 1}, {})


def test_the_system_that_is_asked_for_is_the_peer(mavlink_sender: Any) -> None:
    autopilot = Autopilot(mavlink_sender(system=1), SessionSettings(system=2))
    autopilot.heartbeat(START)
    assert autopilot.session.report(START).system is None
    autopilot.sender = mavlink_sender(system=2)
    autopilot.heartbeat(START)
    report = autopilot.session.report(START)
    assert (report.system, report.others, report.rivals) == (2, {"system 1": 1}, {})


@pytest.mark.parametrize("remote_ns", [-1, -(2**63), 1, 2**63 - 1, 4 * 10**18 + 10**9, 3 * 10**18])
def test_a_clock_exchange_may_claim_anything(remote_ns: int, autopilot: Autopilot) -> None:
    """No stamp is far from its arrival, and the first true answer puts the clock right."""
    for step in range(3000):
        now_ns = START + step * 10 * MS
        for packet in autopilot.session.due(now_ns):
            message = autopilot.framer.feed(packet)[0]
            if message.get_type() == "TIMESYNC":
                claimed = remote_ns if step < 200 else now_ns - START
                autopilot.deliver(autopilot.sender.packet("TIMESYNC", claimed, message.ts1), now_ns)
        for sample in autopilot.imu(now_ns):
            assert abs(sample.time_ns - now_ns) < 11 * S
    assert autopilot.imu(START + 30 * S)[0].time_ns == pytest.approx(START + 30 * S, abs=4 * MS)


def test_an_answer_counts_once(autopilot: Autopilot) -> None:
    (asked,) = [m for m in autopilot.listen(START, answers=False) if m.get_type() == "TIMESYNC"]
    for claimed in (1 * S, 5 * S):
        autopilot.deliver(autopilot.sender.packet("TIMESYNC", claimed, asked.ts1), START)
    clock = autopilot.session.report(START).clock
    assert clock
    assert abs(clock.offset_ns - (START - S)) < 5 * MS


def test_a_repeated_stamp_is_refused(autopilot: Autopilot) -> None:
    assert autopilot.imu(START + S)
    assert not autopilot.imu(START + S)
    assert autopilot.session.report(START).refused == {"HIGHRES_IMU: the stamp does not rise": 1}


def test_a_restart_of_the_autopilot_is_followed(autopilot: Autopilot) -> None:
    for step in range(500):
        autopilot.imu(START + step * 10 * MS)
    later = START + 60 * S
    packet = autopilot.sender.packet("HIGHRES_IMU", 0, *[0.0] * 13, 0x3F, 0)
    (sample,) = autopilot.session.take(packet, later, complete=True)
    assert sample.time_ns == later
    assert autopilot.session.report(later).clock_restarts == 1


def test_the_clock_of_this_computer_may_be_set_back(autopilot: Autopilot) -> None:
    for step in range(300):
        autopilot.listen(START + step * 10 * MS)
        autopilot.imu(START + step * 10 * MS)
    autopilot.boot_ns -= 3600 * S
    sent = []
    for step in range(300, 600):
        here = START - 3600 * S + step * 10 * MS
        sent += [message.get_type() for message in autopilot.listen(here)]
        samples = autopilot.imu(here)
        if step >= 400:
            assert [sample.time_ns for sample in samples] == [pytest.approx(here, abs=MS)]
    assert sent.count("HEARTBEAT") == 3
    assert sent.count("TIMESYNC") >= 5


def test_a_worse_message_takes_over_though_the_clock_was_set_back(autopilot: Autopilot) -> None:
    assert autopilot.imu(START)
    autopilot.boot_ns -= 3600 * S
    assert autopilot.imu(START - 3600 * S + 2 * S, "SCALED_IMU")


def test_with_a_key_what_is_sent_is_signed(mavlink_sender: Any) -> None:
    key = bytes(range(32))
    autopilot = Autopilot(mavlink_sender(key=key), SessionSettings(key=key))
    autopilot.sender.mav.signing.timestamp = int(2e14)
    autopilot.heartbeat(START)
    assert autopilot.session.report(START).system == 1
    packets = autopilot.session.due(START) + autopilot.session.due(START + S)
    # What an autopilot does: each is signed, by now, and later than the one before.
    framer = Framer(key, START / S)
    assert [len(framer.feed(packet)) for packet in packets] == [1] * len(packets)
    assert len(packets) > 4
    stranger = Autopilot(mavlink_sender(), SessionSettings(key=key))
    stranger.heartbeat(START)
    report = stranger.session.report(START)
    assert (report.system, report.frames.refused_signatures) == (None, 1)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_strange_packets_give_samples_that_can_be_published_or_none(tmp_path: Path) -> None:
    """Whatever bytes packets of known messages carry, damaged or not."""
    form = FORMATS["mavlink"]
    outcomes = [judge(form, make(form, 1, number), number, tmp_path) for number in range(300)]
    assert [outcome for outcome in outcomes if outcome.is_finding] == []
