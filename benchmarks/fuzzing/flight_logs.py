# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink packets and logs of every autopilot, written here, of one flight whose truth is known."""

from __future__ import annotations

import struct
import zlib
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation


class Sender:
    """One system; numbers its packets, and signs them if there is a key."""

    def __init__(self, system: int = 1, component: int = 1, key: bytes | None = None) -> None:
        from quadpi_core.logs.mavlink_frames import load_dialect

        self.dialect = load_dialect()
        self.mav = self.dialect.MAVLink(None, system, component)
        self.kinds = {kind.msgname: kind for kind in self.dialect.mavlink_map.values()}
        if key:
            self.mav.signing.secret_key = key
            self.mav.signing.sign_outgoing = True

    def packet(self, name: str, *values: Any, version: int = 2) -> bytes:
        """A packet of a message by its fields in the order of the XML; extensions may be left out."""
        packed = self.kinds[name](*values).pack(self.mav, force_mavlink1=version == 1)
        self.mav.seq = (self.mav.seq + 1) % 256
        return bytes(packed)

    def raw(self, kind: Any, payload: bytes) -> bytes:
        """A packet of a message with any payload."""
        head = bytes((0xFD, len(payload), 0, 0, 0, 1, 1)) + kind.id.to_bytes(3, "little")
        checksum = self.dialect.x25crc(head[1:] + payload + bytes((kind.crc_extra,))).crc
        return bytes(head + payload + checksum.to_bytes(2, "little"))


class Flown(NamedTuple):
    """A flight at 200 Hz whose every value is known, FRD and NED; the truth of written logs.

    Attributes:
        time_us: (N,) since boot.
        rates: (N, 3) rad/s.
        force: (N, 3) m/s².
        position: (N, 3) m.
        attitude: (N, 4), body to world.
        velocity_world: (N, 3) m/s.
        rpm: (N, 4) of rear right, front right, rear left, front left: the rotors of neurobem.
    """

    time_us: Any
    rates: Any
    force: Any
    position: Any
    attitude: Any
    velocity_world: Any
    rpm: Any


def hover(samples: int = 200) -> Flown:
    """Hovering, slowly turning and drifting; a second of it by default."""
    seconds = np.arange(samples) * 0.005
    one = np.ones_like(seconds)
    turn = Rotation.from_euler("ZYX", np.stack((1.0 + 0.5 * seconds, 0.1 * one, -0.05 * one), axis=1))
    up = turn.inv().apply([0.0, 0.0, -9.80665])
    return Flown(
        time_us=np.round(12_000_000 + seconds * 1e6).astype(int),
        rates=np.stack((0.125 * one, -0.25 * one, 0.5 * seconds), axis=1),
        force=up,
        position=np.stack((seconds, 2.0 * seconds, -3.0 * one), axis=1),
        attitude=turn.as_quat(scalar_first=True),
        velocity_world=np.stack((one, 2.0 * one, 0.0 * one), axis=1),
        rpm=np.stack((9000 + 100 * seconds, 6000 * one, 7000 * one, 8000 * one), axis=1).round(),
    )


def dataflash(flown: Flown) -> bytes:
    """ArduPilot: outputs 1 to 4 drive motors 2, 1, 3, 4 (rear left, front right, front left, rear right)."""
    formats = {
        "PARM": (64, "QNf", "TimeUS,Name,Value"),
        "IMU": (65, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        "XKQ": (66, "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
        "XKF1": (67, "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
        "ESC": (68, "QBfc", "TimeUS,Instance,RPM,Temp"),
        "BAT": (69, "QBf", "TimeUS,Instance,Volt"),
    }
    letters = {"Q": "Q", "N": "16s", "f": "f", "B": "B", "c": "h"}
    packers = {
        name: struct.Struct("<" + "".join(letters[x] for x in form)) for name, (_, form, _) in formats.items()
    }
    out = bytearray()
    for name, (number, form, columns) in {
        "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
        **formats,
    }.items():
        length = 89 if name == "FMT" else 3 + packers[name].size
        packed = struct.pack("<BB4s16s64s", number, length, name.encode(), form.encode(), columns.encode())
        out += bytes((0xA3, 0x95, 128)) + packed

    def put(name: str, *values: Any) -> None:
        out.extend(bytes((0xA3, 0x95, formats[name][0])) + packers[name].pack(*values))

    parameters = {"FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0}
    parameters |= {
        f"SERVO{output}_FUNCTION": 32.0 + motor for output, motor in enumerate((2, 1, 3, 4), start=1)
    }
    for key, value in parameters.items():
        put("PARM", int(flown.time_us[0]), key.encode(), value)
    for index, now in enumerate(flown.time_us.tolist()):
        put("IMU", now, 0, *flown.rates[index], *flown.force[index])
        put("IMU", now, 1, *[9.0] * 6)
        put("XKQ", now, 0, *flown.attitude[index])
        put("XKF1", now, 0, *flown.velocity_world[index], *flown.position[index])
        put("XKF1", now, 1, *[9.0] * 6)
        rear_right, front_right, rear_left, front_left = flown.rpm[index]
        for output, rpm in enumerate((rear_left, front_right, front_left, rear_right)):
            put("ESC", now, output, rpm, 2500)
    put("BAT", int(flown.time_us[0]), 0, 12.5)
    return bytes(out)


def ulog(flown: Flown) -> bytes:
    """PX4: reports 1 to 4 are of motors 1 to 4, which sit where CA_ROTOR says: not its standard frame."""
    formats = {
        "esc_report": "uint64_t timestamp;int32_t esc_rpm;uint8_t actuator_function;uint8_t[3] _padding0;",
        "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;",
        "vehicle_attitude": "uint64_t timestamp;float[4] q;",
        "vehicle_local_position": (
            "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz;"
            "bool xy_valid;bool z_valid;bool v_xy_valid;bool v_z_valid;"
        ),
        "vehicle_visual_odometry": (
            "uint64_t timestamp;uint64_t timestamp_sample;float[3] position;float[4] q;uint8_t pose_frame;"
        ),
        "esc_status": "uint64_t timestamp;esc_report[8] esc;",
    }
    out = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", int(flown.time_us[0])))

    def put(kind: str, payload: bytes) -> None:
        out.extend(struct.pack("<HB", len(payload), ord(kind)) + payload)

    put("B", bytes(40))
    for name, fields in formats.items():
        put("F", f"{name}:{fields}".encode())
    corners = {0: (-1.0, 1.0), 1: (1.0, 1.0), 2: (-1.0, -1.0), 3: (1.0, -1.0)}
    for motor, corner in corners.items():
        for axis, value in zip("XY", corner, strict=True):
            key = f"float CA_ROTOR{motor}_P{axis}".encode()
            put("P", bytes((len(key),)) + key + struct.pack("<f", value))
    topics = [name for name in formats if name != "esc_report"]
    for number, name in enumerate(topics):
        put("A", struct.pack("<BH", 0, number) + name.encode())

    def data(name: str, form: str, *values: Any) -> None:
        put("D", struct.pack("<H" + form, topics.index(name), *values))

    for index, now in enumerate(flown.time_us.tolist()):
        position = flown.position[index]
        data("sensor_combined", "Q6f", now, *flown.rates[index], *flown.force[index])
        data("vehicle_attitude", "Q4f", now, *flown.attitude[index])
        data("vehicle_local_position", "Q6f4?", now, *position, *flown.velocity_world[index], *[True] * 4)
        # Motion capture comes 10 ms after its sample.
        sampled = (now + 10_000, now)
        data("vehicle_visual_odometry", "QQ7fB", *sampled, *position, *flown.attitude[index], 1)
        # The report of motor 1 comes last: motors 2, 3, 4, 1 are in reports 1 to 4.
        rpm = flown.rpm[index][[1, 2, 3, 0]]
        reports: list[Any] = []
        for report in range(8):
            is_motor = report < 4
            function = (102, 103, 104, 101)[report] if is_motor else 0
            reports += [now, -int(rpm[report]) if is_motor else 0, function]
        data("esc_status", "Q" + "QiB3x" * 8, now, *reports)
    return bytes(out)


def tlog(flown: Flown) -> bytes:
    """PX4 by telemetry: its packets take 20 ms or more to arrive at a clock of 2023."""
    sender, out = Sender(), bytearray()
    random = np.random.default_rng(1)
    for index, now in enumerate(flown.time_us.tolist()):
        arrival = 1_690_000_000_000_000 + now + 20_000 + int(random.exponential(2000))
        position, velocity = flown.position[index], flown.velocity_world[index]
        packets = [
            sender.packet("HIGHRES_IMU", now, *flown.force[index], *flown.rates[index], *[0.0] * 7, 0x3F, 0),
            sender.packet("ATTITUDE_QUATERNION", now // 1000, *flown.attitude[index], *flown.rates[index]),
            sender.packet("LOCAL_POSITION_NED", now // 1000, *position, *velocity),
            sender.packet("ATT_POS_MOCAP", now, flown.attitude[index].tolist(), *position),
            # Motors of PX4's standard frame: front right, rear left, front left, rear right.
            sender.packet(
                "ESC_STATUS",
                0,
                now,
                flown.rpm[index][[1, 2, 3, 0]].astype(int).tolist(),
                [0.0] * 4,
                [0.0] * 4,
            ),
        ]
        for packet in packets:
            out += struct.pack(">Q", arrival) + packet
    return bytes(out)


def blackbox(flown: Flown) -> bytes:
    """Betaflight: motors of its standard frame, which is neurobem's order; forward-left-up."""
    names = [
        "loopIteration",
        "time",
        *(f"gyroADC[{i}]" for i in range(3)),
        *(f"accSmooth[{i}]" for i in range(3)),
    ]
    names += [f"eRPM[{i}]" for i in range(4)]
    count = len(names)
    head = [
        "Product:Blackbox flight data recorder by Nicholas Sherlock",
        "Data version:2",
        f"Field I name:{','.join(names)}",
        f"Field I signed:{','.join('0' if i < 2 else '1' for i in range(count))}",
        f"Field I predictor:{','.join('0' for _ in names)}",
        f"Field I encoding:{','.join('1' if i < 2 else '0' for i in range(count))}",
        f"Field P predictor:{','.join('0' for _ in names)}",
        f"Field P encoding:{','.join('0' for _ in names)}",
        "gyro_scale:0x3f800000",
        "acc_1G:2048",
        "dshot_bidir:1",
        "motor_poles:14",
    ]
    out = bytearray("".join(f"H {line}\n" for line in head).encode())
    flip = np.array([1.0, -1.0, -1.0])
    gyro = np.round(np.degrees(flown.rates) * flip).astype(int)
    force = np.round(flown.force / 9.80665 * flip * 2048).astype(int)
    erpm = np.round(flown.rpm * 7 / 100).astype(int)
    for index, now in enumerate(flown.time_us.tolist()):
        out += b"I" + _variable(index) + _variable(now)
        for value in (*gyro[index], *force[index], *erpm[index]):
            out += _variable(((int(value) << 1) ^ (int(value) >> 31)) & 0xFFFFFFFF)
    return bytes(out + b"E\xffEnd of log\x00")


def _variable(value: int) -> bytes:
    """Seven bits per byte, the lowest first."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def cfusdlog(flown: Flown) -> bytes:
    """A Crazyflie's uSD log, version 2: gyro, accelerometer and rotor speeds in one event."""
    names = ["gyro.x(f)", "gyro.y(f)", "gyro.z(f)", "acc.x(f)", "acc.y(f)", "acc.z(f)", "pm.vbatMV(H)"]
    names += [f"rpm.m{i}(H)" for i in (1, 2, 3, 4)]
    out = bytearray(struct.pack("<BHH", 0xBC, 2, 1) + struct.pack("<H", 0) + b"fixedFrequency\0")
    out += struct.pack("<H", len(names)) + b"".join(name.encode() + b"\0" for name in names)
    flip = np.array([1.0, -1.0, -1.0])
    gyro, force = np.degrees(flown.rates) * flip, flown.force / 9.80665 * flip
    for index, now in enumerate(flown.time_us.tolist()):
        rpm = (2.0 * flown.rpm[index]).astype(int).tolist()
        out += struct.pack("<HQ6fH4H", 0, now, *gyro[index], *force[index], 3900, *rpm)
    return bytes(out) + struct.pack("<I", zlib.crc32(bytes(out)))
