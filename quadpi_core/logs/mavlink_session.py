# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Protocol with an autopilot over MAVLink: bytes in, stamped samples out, and the packets to send.

No sockets and no ROS; all times are nanoseconds since 1970 by this computer's clock.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from quadpi_core.frames import Array
from quadpi_core.logs.clocks import ClockOffset, Offset
from quadpi_core.logs.mavlink_frames import FrameCounts, Framer, load_dialect, signature_stamp
from quadpi_core.logs.mavlink_samples import (
    ARDUPILOT,
    AUTOPILOT_INVALID,
    BESIDE,
    LATEST_US,
    ONBOARD_CONTROLLER,
    PX4,
    SOURCES,
    MavlinkSamples,
    Sample,
    is_autopilot,
    is_epoch,
)
from quadpi_core.logs.reader_steps import Airframe
from quadpi_core.rotor_order import RotorOrder
from quadpi_core.vehicle import Vehicle

_SECOND = 1_000_000_000
_HEARTBEAT_NS = _SECOND
# More often in the first seconds, so that the offset is known soon.
_TIMESYNC_NS, _FIRST_TIMESYNC_NS, _FIRST_ROUND_NS = _SECOND // 2, _SECOND // 10, 3 * _SECOND
_PENDING = 16
_REQUEST_NS = 5 * _SECOND
_ENOUGH = 0.8
# A message type that has been silent for this long is replaced by the next best one.
_SILENT_NS = _SECOND
# Three heartbeats; after a longer silence the vehicle may come back from another address.
_GONE_NS = 3 * _SECOND
# Largest plausible delay of a link to a flying vehicle: stamps older than this on arrival, or more than a
# second ahead of it, are wrong.
_DELAY_MAX_NS = 10 * _SECOND
_ACTIVE, _PROTOCOL = 4, 3
_SET_MESSAGE_INTERVAL = 511
# Topics that are told: of the air nothing, as the temperature is that of the barometer's board.
_TOLD = SOURCES | {topic: BESIDE[topic] for topic in ("motor_commands", "battery")}
# Battery voltages asked for, per second: they change slowly.
_BATTERY_HZ = 2.0
_ESC_TELEMETRY = ("ESC_TELEMETRY_1_TO_4", "ESC_TELEMETRY_5_TO_8", "ESC_TELEMETRY_9_TO_12")


@dataclass(frozen=True)
class SessionSettings:
    """Requests to the autopilot.

    Attributes:
        system: its system id; 0 for the first system that sends an autopilot's heartbeat.
        rates_hz: requested rate per topic; "odometry" is the rate of all states.
        imu_source: name of the only IMU message to use, or "auto".
        key: 32 bytes to sign packets and to verify signatures.
        passive: send nothing, as with a recorded stream.
    """

    system: int = 0
    rates_hz: dict[str, float] = field(
        default_factory=lambda: {"imu": 250.0, "rotor_speeds": 250.0, "odometry": 100.0}
    )
    imu_source: str = "auto"
    key: bytes | None = None
    passive: bool = False


class Received(NamedTuple):
    """A sample stamped by this computer's clock; `values` is a row for :func:`mavlink_samples.stream_of`."""

    topic: str
    time_ns: int
    values: Array


class Peer(NamedTuple):
    """The autopilot of a session; `address` identifies it on the link."""

    system: int
    component: int
    address: object


class SessionReport(NamedTuple):
    """The state of a session; counts are since its start.

    Attributes:
        system: of the autopilot, None before its first heartbeat.
        silent_s: time since its last packet.
        others: number of unused packets by other senders.
        rivals: number of heartbeats of other autopilots, unless a certain system was requested.
        samples: number per topic.
        sources: message from which each topic is taken.
        refused: number of refused messages by message and reason.
        clock: offset to the autopilot's clock.
        clock_restarts: number of restarts of that clock.
        other_airframe: how the autopilot's airframe is another than the vehicle's, so that its rotor speeds
            are not used; empty where it may be the same.
    """

    system: int | None
    silent_s: float
    others: dict[str, int]
    rivals: dict[str, int]
    frames: FrameCounts
    samples: dict[str, int]
    sources: dict[str, str]
    refused: dict[str, int]
    clock: Offset | None
    clock_restarts: int
    other_airframe: str


class MavlinkSession:
    """One vehicle over one link: the first system that sends a heartbeat of an autopilot.

    Only packets of this system from the same address are used, both for samples and for the clock offset.
    """

    def __init__(self, vehicle: Vehicle | None, order: RotorOrder, settings: SessionSettings) -> None:
        self._settings = settings
        self._order, self._vehicle = order, vehicle
        self._kinds = {kind.msgname: kind for kind in load_dialect().mavlink_map.values()}
        self._framer = Framer(settings.key)
        self._samples = MavlinkSamples(vehicle, order)
        self._peer: Peer | None = None
        self._heard_ns = 0
        self._others: Counter[str] = Counter()
        self._rivals: Counter[str] = Counter()
        self._clocks: dict[tuple[int, int, bool], ClockOffset] = {}
        self._sources: dict[str, tuple[str, int]] = {}
        self._last_ns: dict[str, int] = {}
        self._counts: Counter[str] = Counter()
        self._seen: Counter[str] = Counter()
        self._seen_before: Counter[str] = Counter()
        self._pending: deque[int] = deque(maxlen=_PENDING)
        self._answers: deque[bytes] = deque(maxlen=_PENDING)
        self._next_ns = {"heartbeat": 0, "timesync": 0, "requests": 0}
        self._first_ns = 0

    @property
    def address(self) -> object:
        """Address of the autopilot, as given to `take`; None before its first heartbeat."""
        return self._peer.address if self._peer else None

    def take(self, data: bytes, arrival_ns: int, *, complete: bool, address: object = None) -> list[Received]:
        """Samples in received bytes.

        Args:
            data: received bytes.
            arrival_ns: time of their arrival.
            complete: whether no packet continues after them, as in a datagram.
            address: of the sender; None for a link with only one other end.
        """
        received = []
        for message in self._framer.feed(data, complete=complete):
            name = message.get_type()
            if name == "HEARTBEAT" and is_autopilot(message):
                self._meet(message, arrival_ns, address)
            sender = self._stranger(message, address)
            if sender is not None:
                self._others[sender] += 1
                continue
            self._heard_ns = arrival_ns
            self._seen[name] += 1
            if name == "TIMESYNC":
                self._timesync(message, arrival_ns)
                continue
            sample = self._samples.decode(message, arrival_ns * 1e-9)
            if sample is not None and (stamped := self._stamped(message, sample, arrival_ns)) is not None:
                received.append(stamped)
        return received

    def _meet(self, heartbeat: Any, arrival_ns: int, address: object) -> None:
        """Accept the sender of a heartbeat as the autopilot, or count it as a rival of the present one."""
        wanted, system = self._settings.system, heartbeat.get_srcSystem()
        # Of either sign: this computer's clock may be set back.
        gone = abs(arrival_ns - self._heard_ns) > _GONE_NS
        if self._peer is None and wanted in (0, system):
            self._first_ns = arrival_ns
        elif self._peer is None or self._peer.system != system or not gone:
            sender = self._stranger(heartbeat, address)
            if sender is not None and (not wanted or wanted == system):
                self._rivals[sender] += 1
            return
        self._peer = Peer(system, heartbeat.get_srcComponent(), address)

    def _stranger(self, message: Any, address: object) -> str | None:
        """Name in the diagnostics of a sender that is not the autopilot; None for the autopilot."""
        system = message.get_srcSystem()
        if self._peer is None or system != self._peer.system:
            return f"system {system}"
        return None if address == self._peer.address else f"system {system} at another address"

    def _timesync(self, message: Any, arrival_ns: int) -> None:
        if message.tc1 == 0:
            self._answers.append(self._pack(arrival_ns, "TIMESYNC", arrival_ns, message.ts1))
        elif (
            message.ts1 in self._pending
            and self._peer is not None
            and message.get_srcComponent() == self._peer.component
        ):
            self._pending.remove(message.ts1)
            remote_us = message.tc1 // 1000
            if 0 < remote_us <= LATEST_US:
                self._clock(message, remote_us).exchange(message.ts1, message.tc1, arrival_ns)
            else:
                self._samples.refused["TIMESYNC: an impossible stamp"] += 1

    def _clock(self, message: Any, remote_us: int) -> ClockOffset:
        """The clock of a sender; it may have two, since its boot and since 1970."""
        key = (message.get_srcSystem(), message.get_srcComponent(), is_epoch(remote_us))
        return self._clocks.setdefault(key, ClockOffset())

    def _stamped(self, message: Any, sample: Sample, arrival_ns: int) -> Received | None:
        """The sample on this computer's clock; None if its topic uses another message or the stamp falls."""
        if sample.topic not in _TOLD or not self._is_chosen(sample, arrival_ns):
            return None
        if sample.topic in {"rotor_speeds", "motor_commands"} and (why := self._other_airframe()):
            self._samples.refused[f"{sample.source}: {why}"] += 1
            return None
        time_ns = arrival_ns
        if sample.clock_us is not None:
            remote_ns = sample.clock_us * 1000
            clock = self._clock(message, sample.clock_us)
            clock.arrival(remote_ns, arrival_ns)
            time_ns = clock.to_local(remote_ns, arrival_ns)
            if not -_DELAY_MAX_NS <= time_ns - arrival_ns <= _SECOND:
                self._samples.refused[f"{sample.source}: the stamp is far from the arrival"] += 1
                return None
        last_ns = self._last_ns.get(sample.topic, 0)
        if time_ns <= last_ns <= arrival_ns + _SECOND:
            self._samples.refused[f"{sample.source}: the stamp does not rise"] += 1
            return None
        self._last_ns[sample.topic] = time_ns
        self._counts[sample.topic] += 1
        return Received(sample.topic, time_ns, sample.values)

    def _other_airframe(self) -> str:
        mav_type = self._samples.vehicle_type or 0
        airframe = Airframe.of_mav_type(f"MAV_TYPE {mav_type}", mav_type)
        return "" if airframe is None else airframe.other_than(self._vehicle)

    def _is_chosen(self, sample: Sample, arrival_ns: int) -> bool:
        ranks = _TOLD[sample.topic]
        if sample.topic == "imu" and self._settings.imu_source not in {"auto", sample.source}:
            return False
        current, seen_ns = self._sources.get(sample.topic, (sample.source, arrival_ns))
        is_better = ranks.index(sample.source) < ranks.index(current)
        if sample.source != current and not is_better and abs(arrival_ns - seen_ns) < _SILENT_NS:
            return False
        self._sources[sample.topic] = (sample.source, arrival_ns)
        return True

    @property
    def is_met(self) -> bool:
        """Whether an autopilot has been heard."""
        return self._peer is not None

    def tell(self, name: str, values: Sequence[Any], now_ns: int) -> None:
        """Send a message of these values, the time of NAMED_VALUE_FLOAT aside, once there is an autopilot."""
        if not self.is_met:
            return
        if name == "NAMED_VALUE_FLOAT":
            values = ((now_ns - self._first_ns) // 1_000_000 % 2**32, *values)
        self._answers.append(self._pack(now_ns, name, *values))

    def due(self, now_ns: int) -> list[bytes]:
        """Packets to send now: heartbeat, clock exchange, answers, requests for missing messages."""
        packets = list(self._answers)
        self._answers.clear()
        if self._settings.passive:
            return []
        if self._is_due("heartbeat", now_ns, _HEARTBEAT_NS):
            beat = (ONBOARD_CONTROLLER, AUTOPILOT_INVALID, 0, 0, _ACTIVE, _PROTOCOL)
            packets.append(self._pack(now_ns, "HEARTBEAT", *beat))
        if self._peer is None:
            return packets
        is_first_round = abs(now_ns - self._first_ns) < _FIRST_ROUND_NS
        if self._is_due("timesync", now_ns, _FIRST_TIMESYNC_NS if is_first_round else _TIMESYNC_NS):
            self._pending.append(now_ns)
            packets.append(self._pack(now_ns, "TIMESYNC", 0, now_ns))
        if self._is_due("requests", now_ns, _REQUEST_NS):
            packets += self._requests(self._peer, now_ns)
        return packets

    def _is_due(self, what: str, now_ns: int, period_ns: int) -> bool:
        # If it is further ahead than one period, this computer's clock has been set back since.
        if 0 < self._next_ns[what] - now_ns <= period_ns:
            return False
        self._next_ns[what] = now_ns + period_ns
        return True

    def _requests(self, peer: Peer, now_ns: int) -> list[bytes]:
        """Requests for every message that has been slower than requested since the last round."""
        recent = self._seen - self._seen_before
        packets = []
        for name, rate_hz in self._desired().items():
            if rate_hz > 0.0 and recent[name] < _ENOUGH * rate_hz * (_REQUEST_NS / _SECOND):
                interval_us = round(1e6 / rate_hz)
                command = (_SET_MESSAGE_INTERVAL, 0, self._kinds[name].id, interval_us, 0, 0, 0, 0, 0)
                packets.append(self._pack(now_ns, "COMMAND_LONG", peer.system, peer.component, *command))
        self._seen_before = Counter(self._seen)
        return packets

    def _desired(self) -> dict[str, float]:
        """Requested rate by message, for messages that this autopilot can send."""
        rates = self._settings.rates_hz
        imu, rotors, states = rates["imu"], rates["rotor_speeds"], rates["odometry"]
        # Commands stand in for speeds that nobody tells.
        silent = self._seen_before and not any(self._seen[name] for name in ("ESC_STATUS", *_ESC_TELEMETRY))
        commands = rotors if silent else 0.0
        desired = {"HIGHRES_IMU": imu, "ATTITUDE_QUATERNION": states, "BATTERY_STATUS": _BATTERY_HZ}
        if self._samples.autopilot == ARDUPILOT:
            groups = {controller // 4 for controller in self._order.controllers}
            desired |= {_ESC_TELEMETRY[group]: rotors for group in groups if group < len(_ESC_TELEMETRY)}
            desired |= {"LOCAL_POSITION_NED": states, "SERVO_OUTPUT_RAW": commands}
            if self._seen_before and not self._seen["HIGHRES_IMU"]:
                desired["RAW_IMU"] = imu
            return desired
        desired |= {"ODOMETRY": states, "ESC_STATUS": rotors, "ACTUATOR_OUTPUT_STATUS": commands}
        return desired | ({"ESC_INFO": 1.0} if self._samples.autopilot == PX4 else {})

    def _pack(self, now_ns: int, name: str, *values: Any) -> bytes:
        # Autopilots refuse a signature that is a minute older than their newest, or not newer than the last.
        mav = self._framer.mav
        mav.signing.timestamp = max(mav.signing.timestamp, signature_stamp(now_ns * 1e-9))
        packed = bytes(self._kinds[name](*values).pack(mav))
        mav.seq = (mav.seq + 1) % 256
        return packed

    def report(self, now_ns: int) -> SessionReport:
        """State of the session, for diagnostics."""
        clocks = []
        if self._peer is not None:
            of_peer = (self._peer.system, self._peer.component)
            clocks = [clock for key, clock in self._clocks.items() if key[:2] == of_peer]
        estimates = [one for clock in clocks if (one := clock.estimate(now_ns)) is not None]
        return SessionReport(
            system=self._peer.system if self._peer else None,
            silent_s=(now_ns - self._heard_ns) * 1e-9 if self._heard_ns else math.inf,
            others=dict(self._others),
            rivals=dict(self._rivals),
            # Of the autopilot alone: packets that a ground station lost are no fault of this link.
            frames=replace(self._framer.counts, lost=self._framer.lost[self._peer[:2]] if self._peer else 0),
            samples={topic: self._counts[topic] for topic in _TOLD},
            sources={topic: source for topic, (source, _) in self._sources.items()},
            refused=dict(self._samples.refused),
            # A sender may have two clocks: since its boot, and since 1970.
            clock=max(estimates, key=lambda one: one.exchanged, default=None),
            clock_restarts=sum(known.restarts for known in self._clocks.values()),
            other_airframe=self._other_airframe(),
        )
