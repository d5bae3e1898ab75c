# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""ArduPilot: what a DataFlash log with default settings holds, and the parameters by which it holds more.

Source: ardupilot.org, "Onboard Message Log Messages" and "Complete Parameter List", Copter 3.3 to 4.6.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from quadpi_core.field.field_log import FieldLog, Series, Setting, Stack, held_series, places_of, series_of
from quadpi_core.inputs import density_of
from quadpi_core.logs.dataflash import Messages, decode_dataflash
from quadpi_core.logs.formats.ardupilot import (
    FORMAT,
    LAYOUT_OF_FRAME,
    airframe_of,
    attitude_of,
    controllers_of,
    longest_boot,
    motion_of,
    parameters_of,
)
from quadpi_core.rotor_order import LAYOUTS

_CLASSES = {
    1: ("quadcopter", 4),
    2: ("hexacopter", 6),
    3: ("octocopter", 8),
    4: ("coaxial octocopter", 8),
} | {5: ("Y6", 6), 7: ("tricopter", 3), 12: ("dodecahexacopter", 12), 14: ("decacopter", 10)}
_TYPES = {0: "plus", 1: "X", 2: "V", 3: "H", 12: "X of Betaflight", 13: "X, DJI order", 14: "X, clockwise"}
_FACTS = {"hover thrust": "MOT_THST_HOVER", "thrust exponent": "MOT_THST_EXPO", "poles": "SERVO_BLH_POLES"}
_FIRST_MOTOR_FUNCTION = 33
_OUTPUTS = 14
_PWM_US = (1000.0, 2000.0)
# EV: a land detector's words, which autopilots since 2013 log.
_LAND_COMPLETE, _NOT_LANDED = 18, 28
_FAST_ATTITUDE, _RC_OUTPUT, _FAST_IMU, _RAW_IMU = 1, 1 << 10, 1 << 18, 1 << 19


def read_ardupilot_field(path: Path, _number: int | None = None, _poles: int | None = None) -> FieldLog:
    """What one log holds; see :class:`quadpi_core.field.field_log.FieldLog`.

    Raises:
        LogError: if it holds no record.
    """
    source = str(path)
    log = decode_dataflash(source, path.read_bytes())
    messages, quality = longest_boot(log.messages)
    parameters = parameters_of(messages)
    airframe = airframe_of(messages)
    start_ns = min(
        (int(own.time_ns()[0]) for own in messages.values() if own.holds() and len(own)), default=0
    )
    if "IMU" in messages and messages["IMU"].holds():
        start_ns = int(messages["IMU"].time_ns()[0])

    def read(kinds: str, *columns: str, scale: float = 1.0) -> Series | None:
        for name in kinds.split():
            logged = messages.get(name)
            if logged is not None and logged.holds(*columns):
                for instance in ("I", "IMU", "Instance", "Inst"):
                    logged = logged.where(instance, 0)
                return series_of(logged.time_ns(), logged.stack(*columns) * scale, start_ns)
        return None

    frame_class, frame_type = (int(parameters.get(name, -1)) for name in ("FRAME_CLASS", "FRAME_TYPE"))
    frame, rotors = _CLASSES.get(frame_class, ("", None))
    if not frame and "ArduCopter" in " ".join(_texts(messages)):
        # Until 2016 FRAME said the type alone, and each number of rotors had a firmware of its own.
        frame_type = int(parameters.get("FRAME", -1))
    commands, outputs = _commands(messages, parameters, rotors, start_ns)
    assumed: tuple[str, ...] = ()
    if rotors is None and commands is not None:
        rotors = commands.values.shape[1]
        assumed = (f"taken to have {rotors} motors: the log has no FRAME_CLASS of a multirotor",)
    moved, attitude = motion_of(messages), attitude_of(source, messages)
    speeds = _speeds(messages, outputs, start_ns)
    baro = read("BARO", "Press", "Temp")
    layout = LAYOUT_OF_FRAME.get((frame_class, frame_type))
    return FieldLog(
        name=path.stem,
        source=source,
        stack="ArduPilot",
        firmware=next((text for text in _texts(messages) if text.startswith(("Ardu", "Blimp"))), ""),
        frame=" ".join(filter(None, (frame, _TYPES.get(frame_type, "")))),
        rotors=rotors,
        no_multirotor=str(airframe) if airframe and not airframe.is_multicopter else "",
        imu=read("IMU", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
        attitude=None if attitude is None else series_of(*attitude, start_ns),
        velocity=None if moved is None else series_of(moved[0], moved[2], start_ns),
        position=None if moved is None else series_of(moved[0], moved[1], start_ns),
        commands=commands,
        rotor_speeds=speeds,
        battery=read("BAT CURR", "Volt"),
        landed=_landed(messages, start_ns),
        density=baro and Series(baro.time, density_of(baro.values[:, :1], baro.values[:, 1:])),
        vibe=read("VIBE", "VibeX", "VibeY", "VibeZ"),
        places=places_of(LAYOUTS[layout]) if layout else None,
        drag_prefix="EK3_DRAG_",
        facts={key: f"{parameters[name]:.4g} ({name})" for key, name in _FACTS.items() if name in parameters},
        parameters=parameters,
        settings=tuple(_settings(parameters, speeds, messages)),
        notes=(*assumed, *quality.sentences()),
    )


def _texts(messages: Mapping[str, Messages]) -> list[str]:
    return messages["MSG"].text("Message") if "MSG" in messages else []


def _commands(
    messages: Mapping[str, Messages], parameters: Mapping[str, float], rotors: int | None, start_ns: int
) -> tuple[Series | None, list[int]]:
    """Commands by motor number from RCOU, whose outputs SERVOn_FUNCTION names, and those outputs."""
    logged = messages.get("RCOU")
    if logged is None or not logged.holds():
        return None, []
    prefix = "C" if "C1" in logged else "Ch"
    function = {
        int(parameters.get(f"SERVO{output}_FUNCTION", 0)) - _FIRST_MOTOR_FUNCTION: output
        for output in range(_OUTPUTS, 0, -1)
    }
    # The use of motors from 9 on has numbers of its own: 82 to 85.
    function |= {number - 41: output for number, output in list(function.items()) if 49 <= number <= 52}
    outputs = [function.get(motor, motor + 1) for motor in range(rotors or 4)]
    names = [f"{prefix}{output}" for output in outputs]
    if not logged.holds(*names):
        return None, []
    pulses = logged.stack(*names)
    low, high = _PWM_US
    if parameters.get("MOT_PWM_MAX", 0.0) > parameters.get("MOT_PWM_MIN", 0.0) > 0.0:
        low, high = parameters["MOT_PWM_MIN"], parameters["MOT_PWM_MAX"]
    elif "SERVO1_FUNCTION" in parameters:
        ends = [
            (parameters.get(f"SERVO{one}_MIN", 0.0), parameters.get(f"SERVO{one}_MAX", 0.0))
            for one in outputs
        ]
        low, high = max(ends) if all(end[1] > end[0] > 0.0 for end in ends) else (low, high)
        # Without MOT_PWM_MIN the ends are those of the throttle channel, which the pulses of the log show.
        low, high = (
            min(low, float(pulses[pulses > 0].min(initial=low))),
            max(high, float(pulses.max(initial=high))),
        )
    return series_of(logged.time_ns(), np.clip((pulses - low) / (high - low), 0.0, 1.0), start_ns), outputs


def _speeds(messages: dict[str, Messages], outputs: list[int], start_ns: int) -> Series | None:
    controllers = controllers_of(messages)
    if not outputs or not all(output - 1 in controllers for output in outputs):
        return None
    series = [
        series_of(own.time_ns(), own.column("RPM"), start_ns)
        for own in (controllers[output - 1] for output in outputs)
    ]
    known = [one for one in series if one is not None]
    if len(known) < len(series) or not any(np.any(one.values) for one in known):
        return None
    clock = max(known, key=len).time
    together = np.hstack([one.at(clock) for one in known]) * (2.0 * np.pi / 60.0)
    return series_of(np.round(clock * 1e9).astype(np.int64), together, 0)


def _landed(messages: Mapping[str, Messages], start_ns: int) -> Series | None:
    """What the land detector said, held until it said otherwise."""
    logged, imu = messages.get("EV"), messages.get("IMU")
    if logged is None or imu is None or not (logged.holds("Id") and imu.holds()):
        return None
    said = {_LAND_COMPLETE: 1.0, _NOT_LANDED: 0.0}
    numbers = logged.column("Id").astype(int)
    words = np.isin(numbers, list(said))
    if not words.any():
        return None
    values = np.array([said[number] for number in numbers[words]])
    time_ns = np.concatenate([imu.time_ns()[:1], logged.time_ns()[words]])
    return held_series(time_ns, np.concatenate([1.0 - values[:1], values]), start_ns)


def _settings(
    parameters: Mapping[str, float], speeds: Series | None, messages: Mapping[str, Messages]
) -> Iterator[Setting]:
    def present(name: str) -> str:
        return f"{parameters[name]:g}" if name in parameters else "not in the log"

    bits = int(parameters.get("LOG_BITMASK", 0))
    lacking = {}
    if not bits & _FAST_ATTITUDE:
        lacking[_FAST_ATTITUDE] = "the state at the rate of the loop"
    if not bits & (_FAST_IMU | _RAW_IMU):
        lacking[_FAST_IMU] = "gyro and accelerometer (Fast IMU) at the rate of the loop instead of 25 Hz"
    if "RCOU" not in messages and not bits & _RC_OUTPUT:
        lacking[_RC_OUTPUT] = "commands (RC output)"
    if lacking:
        wanted = f"set it to {bits | sum(lacking)}"
        yield Setting("LOG_BITMASK", present("LOG_BITMASK"), wanted, "; ".join(lacking.values()))
    if speeds is None:
        name = "SERVO_BLH_AUTO"
        wanted = (
            f"{'check' if parameters.get(name) == 1.0 else 'set it to 1, with'} the telemetry wire on a port "
            "of SERIALn_PROTOCOL 16, or set SERVO_BLH_BDMASK to the outputs of two-way DShot"
        )
        yield Setting(name, present(name), wanted, "measured rotor speeds")
    if parameters.get("INS_LOG_BAT_MASK") == 0.0:
        name, gains = "INS_LOG_BAT_OPT", "vibration at the sensor's rate, in tools that read such batches"
        yield Setting(name, present(name), "set it to 1, with INS_LOG_BAT_MASK 1", gains)


STACK = Stack(FORMAT, read_ardupilot_field)
