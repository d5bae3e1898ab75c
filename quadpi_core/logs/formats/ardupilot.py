# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reader for ArduPilot's DataFlash logs (.BIN): IMU, attitude, the EKF's state, ESC telemetry.

ArduPilot's body axes are forward-right-down, its world is north-east-down, its quaternions turn body into
world; gyros are in rad/s, accelerometers in m/s² (specific force), angles in degrees. Source: ardupilot.org,
"Onboard Message Log Messages".
"""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType

import numpy as np

from quadpi_core import flight
from quadpi_core.errors import LogError
from quadpi_core.findings import NOTHING_TO_SAY, DataQuality
from quadpi_core.frames import Array, quaternion_from_roll_pitch_yaw
from quadpi_core.logs.dataflash import HEAD, Messages, decode_dataflash
from quadpi_core.logs.log_format import LogFormat
from quadpi_core.logs.reader_steps import (
    Airframe,
    attitude_alone,
    finite_parameters,
    has_rotors,
    note,
    odometry_of,
    require_imu,
    rising,
    rotors_together,
    unit_attitudes,
)
from quadpi_core.rotor_order import RPM, RotorOrder, usual_layout
from quadpi_core.screening.sample_order import breaks, longest, order_of, used_run
from quadpi_core.vehicle import ROTORS, Vehicle

_GYRO, _ACCELERATION = ("GyrX", "GyrY", "GyrZ"), ("AccX", "AccY", "AccZ")
_QUATERNION = ("Q1", "Q2", "Q3", "Q4")
_ANGLES = ("Roll", "Pitch", "Yaw")
_POSITION, _VELOCITY = ("PN", "PE", "PD"), ("VN", "VE", "VD")
# EKF 3, EKF 2 and the first; each logs its cores as instances of C where there are several.
_STATES = ("XKF1", "NKF1", "EKF1")
_ATTITUDES = ("XKQ", "XKQ1", "NKQ", "NKQ1", "AHR2", "ATT")
# A better kind of attitude must hold at least this share of the samples of the most frequent one.
_FEW = 0.5
_FIRST_MOTOR_FUNCTION = 33
# Messages of all speed controllers, and the column with the number of one.
_NUMBERED = (("ESC", "Instance"), ("CESC", "Id"))
NO_TELEMETRY = (
    "no telemetry: set SERVO_BLH_AUTO 1 with the telemetry wire on a port of SERIALn_PROTOCOL 16, or "
    "SERVO_BLH_BDMASK to the outputs of bidirectional DShot; on DroneCAN, CAN_D1_UC_ESC_BM"
)
# FRAME_CLASS: number of rotors, or the name of what is no multicopter.
_FRAME_CLASSES: MappingProxyType[int, int | str] = MappingProxyType(
    {
        **{1: 4, 2: 6, 3: 8, 4: 8, 5: 6, 7: 3, 12: 12, 14: 10},
        **{6: "a helicopter", 8: "a single-rotor copter", 9: "a coaxial helicopter", 10: "a bicopter"},
        **{11: "a helicopter", 13: "a helicopter of four rotors"},
    }
)
_FIRMWARES = MappingProxyType(
    {
        "ArduPlane": "the firmware of planes",
        "ArduRover": "the firmware of rovers",
        "ArduSub": "the firmware of submarines",
        "Blimp": "the firmware of airships",
    }
)
# The adapter of mavros_msgs/RCOut, of the same scale.
RC_OUT = "mavros_rc_out"
# By FRAME_CLASS and FRAME_TYPE.
LAYOUT_OF_FRAME = MappingProxyType(
    {
        **{(1, 0): "quad-plus", (1, 1): "quad-x", (1, 3): "quad-h", (1, 12): "betaflight"},
        # Numbered clockwise from the front right.
        **{(1, 14): "crazyflie", (2, 0): "hexa-plus", (2, 1): "hexa-x", (2, 14): "hexa-cw-x"},
        **{(3, 0): "octo-plus", (3, 1): "octo-x", (4, 1): "octo-coaxial-x"},
    }
)


def read_ardupilot(path: Path, vehicle: Vehicle | None, order: RotorOrder | None = None) -> flight.Recording:
    """Read one log, stamped since the boot of the autopilot.

    Args:
        path: the log.
        vehicle: as for every reader.
        order: of the rotors; by default SERVOn_FUNCTION and FRAME_TYPE in the log tell it.

    Raises:
        LogError: if it holds no record, or no IMU samples.
    """
    source = str(path)
    log = decode_dataflash(source, path.read_bytes())
    if log.skipped:
        note(source, f"byte {log.first_skipped}: {log.skipped} damaged bytes from here on are passed over")
    if log.cut_off is not None:
        note(source, f"byte {log.cut_off}: the file is cut off in this record; all before it is read")
    messages, quality = longest_boot(log.messages)
    its_rotors = has_rotors(source, airframe_of(messages), vehicle)
    imu = require_imu(source, _imu(messages), "IMU")
    battery = messages.get("BAT") or messages.get("CURR")
    commands = _commands(messages, vehicle, order) if its_rotors else None
    return flight.Recording(
        name=path.stem,
        vehicle=vehicle.name if vehicle else "",
        source=source,
        imu=imu,
        rotor_speeds=_rotor_speeds(source, messages, vehicle, order) if its_rotors else None,
        odometry=_odometry(source, messages, imu),
        commands=commands,
        command_source="" if commands is None else RC_OUT,
        battery=None if battery is None else _battery(battery),
        pressure=_air(messages.get("BARO")),
        board_air=True,
        quality=quality,
    )


def airframe_of(messages: dict[str, Messages]) -> Airframe | None:
    """What the frame class, or else the name of the firmware, says of the vehicle."""
    parameters = parameters_of(messages)
    if parameters.get("Q_ENABLE", 0.0) > 0.0:
        return Airframe("Q_ENABLE 1", "a VTOL aircraft")
    frame_class = int(parameters.get("FRAME_CLASS", 0.0))
    known = _FRAME_CLASSES.get(frame_class)
    if isinstance(known, int):
        return Airframe.of_rotors(f"FRAME_CLASS {frame_class}", known)
    if known is not None:
        return Airframe(f"FRAME_CLASS {frame_class}", known)
    told = messages["MSG"].text("Message") if "MSG" in messages else []
    for firmware, name in _FIRMWARES.items():
        said = next((text for text in told if text.startswith(firmware)), None)
        if said is not None:
            return Airframe(said, name)
    return None


def longest_boot(messages: dict[str, Messages]) -> tuple[dict[str, Messages], DataQuality]:
    """The records of the longest boot in a file, by the clock of the IMU, and what is left out."""
    logged = messages.get("IMU")
    if logged is None or not logged.holds():
        return messages, NOTHING_TO_SAY
    first = logged.where("I", 0)
    time_ns = first.time_ns()
    order = order_of(time_ns)
    runs = order.runs()
    if len(runs) == 1:
        return messages, NOTHING_TO_SAY
    chosen = longest(time_ns, runs)
    begin = first.offsets[runs[chosen - 1].max()] if chosen else -1
    end = first.offsets[runs[chosen + 1].min()] if chosen + 1 < len(runs) else np.iinfo(np.int64).max
    # Parameters are logged at the start of a boot, before its first sample.
    kept = {
        name: logged if name == "PARM" else logged.take((logged.offsets > begin) & (logged.offsets < end))
        for name, logged in messages.items()
    }
    quality = DataQuality(
        breaks=tuple(breaks("imu", time_ns, order)), used=(used_run(time_ns, runs, chosen),)
    )
    return {name: logged for name, logged in kept.items() if len(logged)}, quality


def _imu(messages: dict[str, Messages]) -> flight.ImuStream | None:
    logged = messages.get("IMU")
    if logged is None or not logged.holds(*_GYRO, *_ACCELERATION):
        return None
    first = logged.where("I", 0)
    return flight.ImuStream(first.time_ns(), first.stack(*_GYRO), first.stack(*_ACCELERATION))


def _battery(logged: Messages) -> flight.BatteryStream | None:
    if not logged.holds("Volt"):
        return None
    first = logged.where("Instance", 0).where("Inst", 0)
    time_ns, (volts,) = rising(first.time_ns(), first.column("Volt"))
    return flight.BatteryStream(time_ns, volts) if len(time_ns) else None


def _air(logged: Messages | None) -> flight.AirStream | None:
    """Of the first barometer: pressure, and the temperature of its board."""
    if logged is None or not logged.holds("Press", "Temp"):
        return None
    first = logged.where("I", 0)
    time_ns, (pascal, celsius) = rising(first.time_ns(), first.column("Press"), first.column("Temp"))
    return flight.AirStream(time_ns, pascal, celsius) if len(time_ns) else None


def _odometry(
    source: str, messages: dict[str, Messages], imu: flight.ImuStream
) -> flight.OdometryStream | None:
    moved, attitude = motion_of(messages), attitude_of(source, messages)
    if moved is None or attitude is None:
        return attitude_alone(attitude, imu)
    return odometry_of(*moved, attitude, imu)


def motion_of(messages: dict[str, Messages]) -> tuple[flight.Stamps, Array, Array] | None:
    """Stamps (N,), positions and velocities (N, 3) of the first core of the EKF; None without one."""
    wanted = (*_POSITION, *_VELOCITY)
    name = next((name for name in _STATES if name in messages and messages[name].holds(*wanted)), None)
    if name is None:
        return None
    logged = messages[name]
    if "C" in logged:
        logged = logged.where("C", int(logged.column("C").min()))
    time_ns, (position, velocity) = rising(
        logged.time_ns(), logged.stack(*_POSITION), logged.stack(*_VELOCITY)
    )
    return time_ns, position, velocity


def attitude_of(source: str, messages: dict[str, Messages]) -> tuple[flight.Stamps, Array] | None:
    """Stamps and quaternions (K, 4) of the best kind of message that is there in number."""
    known = {}
    for name in _ATTITUDES:
        if name in messages and messages[name].holds(*(_ANGLES if name == "ATT" else _QUATERNION)):
            logged = messages[name]
            known[name] = logged.where("C", int(logged.column("C").min())) if "C" in logged else logged
    if not known:
        return None
    most = max(map(len, known.values()))
    name, logged = next((name, logged) for name, logged in known.items() if len(logged) >= _FEW * most)
    if name == "ATT":
        quaternion = quaternion_from_roll_pitch_yaw(np.radians(logged.stack(*_ANGLES)))
    else:
        quaternion = logged.stack(*_QUATERNION)
    return unit_attitudes(source, flight.OdometryStream.topic, logged.time_ns(), quaternion)


def _rotor_speeds(
    source: str, messages: dict[str, Messages], vehicle: Vehicle | None, order: RotorOrder | None
) -> flight.RotorSpeedStream | None:
    controllers = controllers_of(messages)
    if not controllers:
        return None
    try:
        order = order or _order(source, parameters_of(messages), vehicle)
    except LogError as error:
        note(source, f"topic rotor_speeds: left out, {error}")
        return None
    absent = [str(number + 1) for number in order.controllers if number not in controllers]
    if absent:
        note(source, f"topic rotor_speeds: left out, speed controllers {', '.join(absent)} are not logged")
        return None
    speeds = [_speeds(controllers[number]) for number in order.controllers]
    if not any(np.any(rpm) for _, rpm in speeds):
        note(source, f"topic rotor_speeds: left out, every rpm is zero: {NO_TELEMETRY}")
        return None
    return rotors_together(speeds, order, vehicle)


def _commands(
    messages: dict[str, Messages], vehicle: Vehicle | None, order: RotorOrder | None
) -> flight.MotorCommandStream | None:
    """Pulses of the outputs of the motors, 1000 µs as 0 and 2000 µs as 1."""
    logged = messages.get("RCOU")
    if logged is None or not logged.holds():
        return None
    try:
        order = order or _order("", parameters_of(messages), vehicle)
    except LogError:
        return None  # of rotors in no order that is known
    prefix = "C" if "C1" in logged else "Ch"
    names = [f"{prefix}{output + 1}" for output in order.controllers]
    if not logged.holds(*names):
        return None
    time_ns, (pulses,) = rising(logged.time_ns(), logged.stack(*names))
    return flight.MotorCommandStream(time_ns, 1e-3 * (pulses - 1000.0))


def _speeds(logged: Messages) -> tuple[flight.Stamps, Array]:
    """Stamps (K,) and mechanical rpm (K, 1) of one speed controller."""
    time_ns, (rpm,) = rising(logged.time_ns(), logged.stack("RPM"))
    return time_ns, rpm


def controllers_of(messages: dict[str, Messages]) -> dict[int, Messages]:
    """Records by number of the speed controller from 0 on; logs before 2021 have a name for each.

    Those on CAN had records of their own until 2020. Of two kinds the one with speeds is taken.
    """
    kinds = []
    for name, number_column in _NUMBERED:
        if name in messages and messages[name].holds(number_column, "RPM"):
            logged = messages[name]
            numbers = np.unique(logged.records[number_column]).tolist()
            kinds.append({int(number): logged.where(number_column, number) for number in numbers})
    kinds.append(
        {
            number - 1: messages[f"ESC{number}"]
            for number in range(1, 9)
            if f"ESC{number}" in messages and messages[f"ESC{number}"].holds("RPM")
        }
    )
    kinds = [kind for kind in kinds if kind]
    live = (kind for kind in kinds if any(np.any(logged.column("RPM")) for logged in kind.values()))
    return next(live, kinds[0] if kinds else {})


def parameters_of(messages: dict[str, Messages]) -> dict[str, float]:
    """As the flight began: a test may change the use of an output under way."""
    logged = messages.get("PARM")
    if logged is None or "Value" not in logged:
        return {}
    known: dict[str, float] = {}
    for name, value in zip(logged.text("Name"), logged.column("Value").tolist(), strict=False):
        known.setdefault(name, value)
    return finite_parameters(known)


def _order(source: str, parameters: dict[str, float], vehicle: Vehicle | None) -> RotorOrder:
    """Which output drives which motor, and where the frame type puts it."""
    told = [parameters.get(name) for name in ("FRAME_CLASS", "FRAME_TYPE")]
    frame_class, frame_type = (None if one is None else int(one) for one in told)
    # Until 2016 the type stood alone, of a firmware for each number of rotors.
    layout = LAYOUT_OF_FRAME.get((frame_class or 1, -1 if frame_type is None else frame_type))
    if layout is None:
        known = _FRAME_CLASSES.get(frame_class or 1)
        layout = usual_layout(vehicle, known if isinstance(known, int) else ROTORS)
        said = "nothing" if frame_type is None else f"FRAME_TYPE {frame_type}"
        if source:
            note(
                source,
                f"topic rotor_speeds: the log says {said} of the frame; its motors are taken as {layout}",
            )
    motors = RotorOrder.by_layout(vehicle, layout, RPM).controllers
    outputs = {
        int(parameters[f"SERVO{output + 1}_FUNCTION"]) - _FIRST_MOTOR_FUNCTION: output
        for output in range(16)
        if f"SERVO{output + 1}_FUNCTION" in parameters
    }
    if not all(motor in outputs for motor in motors):
        return RotorOrder(motors, RPM)
    return RotorOrder(tuple(outputs[motor] for motor in motors), RPM)


FORMAT = LogFormat(
    description="ArduPilot log (.bin)",
    read=read_ardupilot,
    begins=lambda head: head.startswith(HEAD),
    suffixes=(".bin",),
    load_mapping=RotorOrder.load,
    remedies={
        "imu": "LOG_BITMASK with Fast IMU (bit 18) logs it at the rate of the loop",
        "rotor_speeds": "SERVO_BLH_TRATE sets how often ESCs report, LOG_FILE_RATEMAX 0 logs all",
        "odometry": "LOG_BITMASK with Fast Attitude (bit 0) logs it at the rate of the loop",
    },
)
