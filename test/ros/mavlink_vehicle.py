# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A vehicle that speaks MAVLink over UDP or TCP, in a process of its own: `python mavlink_vehicle.py --help`.

Its clock was zero some time ago, sample n of the IMU turns about x at n / 1024 rad/s, and
motor i turns at 1000 i rpm. It answers TIMESYNC unless told not to, and prints what it was asked for.
"""

from __future__ import annotations

import argparse
import socket
import time

from quadpi_core.logs.mavlink_frames import Framer, load_dialect, signing_key

PX4 = 12


def main() -> None:
    """Fly for a while."""
    parser = argparse.ArgumentParser()
    parser.add_argument("port", type=int)
    parser.add_argument("--tcp", action="store_true", help="listen, instead of sending datagrams")
    parser.add_argument("--rate", type=float, default=500.0)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--epoch-ns", type=int, required=True, help="when its clock was zero")
    parser.add_argument("--deaf", action="store_true", help="answer no TIMESYNC")
    parser.add_argument("--passphrase", help="sign with it")
    parser.add_argument("--noise", action="store_true", help="garbage and cut packets in between")
    options = parser.parse_args()
    Vehicle(options).fly()


class Vehicle:
    """See the module."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.dialect = load_dialect()
        self.mav = self.dialect.MAVLink(None, 1, 1)
        if options.passphrase:
            self.mav.signing.secret_key = signing_key(options.passphrase)
            self.mav.signing.sign_outgoing = True
            self.mav.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)
        self.framer = Framer()
        self.asked: set[int] = set()
        if options.tcp:
            server = socket.create_server(("127.0.0.1", options.port))
            server.settimeout(20.0)
            print("listening", flush=True)
            self.socket = server.accept()[0]
            self.transmit = self.socket.send
        else:
            # Not connected: a connected socket loses a packet for each that nobody received before.
            self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.transmit = lambda data: self.socket.sendto(data, ("127.0.0.1", options.port))
        self.socket.setblocking(False)

    def clock_ns(self) -> int:
        return time.time_ns() - self.options.epoch_ns

    def send(self, name: str, *values: object) -> None:
        kind = next(k for k in self.dialect.mavlink_map.values() if k.msgname == name)
        packet = bytes(kind(*values).pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        self.transmit(packet)
        if self.options.noise:
            self.transmit(bytes(range(0, 256, 7)) + b"\xfd\xff\x00")
            self.transmit(packet[:-4])

    def listen(self) -> None:
        while True:
            try:
                data = self.socket.recv(65_536)
            except BlockingIOError:
                return
            arrived_ns = self.clock_ns()
            for message in self.framer.feed(data):
                name = message.get_type()
                if name == "TIMESYNC" and message.tc1 == 0 and not self.options.deaf:
                    self.send("TIMESYNC", arrived_ns, message.ts1)
                if name == "COMMAND_LONG" and message.command == 511 and message.param1 not in self.asked:
                    self.asked.add(int(message.param1))
                    print("asked for", int(message.param1), "every", int(message.param2), "us", flush=True)
            if not data:
                return

    def fly(self) -> None:
        period_s = 1.0 / self.options.rate
        due = time.monotonic()
        for sample in range(round(self.options.seconds * self.options.rate)):
            if sample % round(self.options.rate) == 0:
                self.send("HEARTBEAT", 2, PX4, 0, 0, 4, 3)
            now_us = self.clock_ns() // 1000
            gyro = (sample / 1024.0, 0.0, -0.5)
            force = (0.25, -0.5, -9.75)
            self.send("HIGHRES_IMU", now_us, *force, *gyro, *[0.0] * 7, 63, 0)
            self.send("ESC_STATUS", 0, now_us, [1000, -2000, 3000, 4000], [0.0] * 4, [0.0] * 4)
            if sample % 5 == 0:
                covariance = [0.0] * 21
                position, attitude, velocity = (1.0, 2.0, -3.0), [0.5, 0.5, -0.5, 0.5], (4.0, 5.0, 6.0)
                self.send(
                    "ODOMETRY",
                    *(now_us, 1, 12, *position, attitude, *velocity, *gyro, covariance, covariance, 0, 1, 0),
                )
            due += period_s
            self.listen()
            time.sleep(max(0.0, due - time.monotonic()))


if __name__ == "__main__":
    main()
