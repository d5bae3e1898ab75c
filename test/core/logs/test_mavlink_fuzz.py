# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Packets that no autopilot sends, through the whole session: what comes out can be published."""

from __future__ import annotations

import re
import struct
from collections import Counter
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from quadpi_core.logs.mavlink_samples import ARDUPILOT, PX4, MavlinkSamples, stream_of
from quadpi_core.logs.mavlink_session import MavlinkSession, SessionSettings
from quadpi_core.messages import sensor_messages
from quadpi_core.rotor_order import RotorOrder

S = 1_000_000_000
START = 1_700_000_000 * S
ORDER = RotorOrder((3, 0, 1, 2), "rpm")
TIMESYNC = 111
PACK: dict[str, Any] = {
    "imu": sensor_messages.pack_imu,
    "rotor_speeds": sensor_messages.pack_rotor_speeds,
    "mocap/pose": sensor_messages.pack_pose,
    "odometry": sensor_messages.pack_odometry,
}
FORM = re.compile(r"(\d*)([a-zA-Z])")
EXTREMES = (np.inf, -np.inf, np.nan, 0.0, 3.4e38, -3.4e38, 1e-45, 1e19)


class Fuzzer:
    """Sends packets whose values are right, extreme or random, some damaged, and looks at what comes."""

    def __init__(self, sender: Any, seed: int) -> None:
        self.sender = sender
        self.rng = np.random.default_rng(seed)
        self.session = MavlinkSession(None, ORDER, SessionSettings())
        self.kinds = [sender.kinds[name] for name in sorted(MavlinkSamples(None, ORDER).names | {"TIMESYNC"})]
        self.now_ns = START
        self.asked_ns = 0
        self.latest: dict[str, int] = {}
        self.taken: Counter[str] = Counter()

    def real(self) -> float:
        if self.rng.random() < 0.1:
            return float(self.rng.choice(EXTREMES))
        return float(self.rng.normal() * 10.0 ** self.rng.integers(-3, 4))

    def integer(self, letter: str) -> int:
        bits = 8 * struct.calcsize(letter)
        low = 0 if letter.isupper() else -(2 ** (bits - 1))
        since_boot_ns = self.now_ns - START
        candidates = (
            *(low, low + 2**bits - 1, 10**15, 4 * 10**15, int(self.rng.integers(0, 64))),
            *(self.asked_ns, self.now_ns, self.now_ns // 1000),
            *([since_boot_ns, since_boot_ns // 1000, since_boot_ns // 10**6] * 4),
        )
        fitting = [value for value in candidates if low <= value < low + 2**bits]
        return int(fitting[self.rng.integers(len(fitting))])

    def packet(self) -> bytes:
        kind = self.kinds[self.rng.integers(len(self.kinds))]
        form = str(kind.unpacker.format)
        letters = "".join(int(count or 1) * letter for count, letter in FORM.findall(form))
        values = [self.real() if letter == "f" else self.integer(letter) for letter in letters]
        places = [place for place, name in enumerate(kind.ordered_fieldnames) if name in ("q", "q1")]
        if places and self.rng.random() < 0.9:
            # Else no attitude would be a unit quaternion.
            first = sum(kind.lengths[: places[0]])
            values[first : first + 4] = [1.0, 0.0, 0.0, 0.0]
        return self.damaged(self.sender.raw(kind, kind.unpacker.pack(*values)))

    def damaged(self, data: bytes) -> bytes:
        damage, at = self.rng.random(), int(self.rng.integers(len(data)))
        if damage < 0.05:
            return data[:at] + self.rng.bytes(1) + data[at + 1 :]
        if damage < 0.1:
            return data[:at]
        return self.rng.bytes(at) + data if damage < 0.15 else data

    def run(self, count: int) -> None:
        for number in range(count):
            self.now_ns += int(self.rng.integers(0, 20_000_000))
            if number % 50 == 0:
                kind = (PX4, ARDUPILOT)[number // 1000 % 2]
                self.take(self.sender.packet("HEARTBEAT", 2, kind, 0, 0, 4, 3))
            self.take(self.packet())
            for packet in self.session.due(self.now_ns):
                if packet[7] == TIMESYNC:
                    self.asked_ns = struct.unpack_from("<q", packet.ljust(26, b"\0"), 18)[0]
            self.session.report(self.now_ns)

    def take(self, data: bytes) -> None:
        for topic, time_ns, values in self.session.take(data, self.now_ns, complete=True):
            self.taken[topic] += 1
            assert np.isfinite(values).all()
            assert -10 * S <= time_ns - self.now_ns <= S
            assert time_ns > self.latest.get(topic, 0)
            self.latest[topic] = time_ns
            assert len(PACK[topic](stream_of(topic, np.array([time_ns]), values[np.newaxis]))) == 1


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_strange_packets_give_samples_that_can_be_published_or_none(mavlink_sender: Any) -> None:
    fuzzer = Fuzzer(mavlink_sender(), seed=1)
    fuzzer.run(5000)
    assert fuzzer.taken.keys() == PACK.keys()
