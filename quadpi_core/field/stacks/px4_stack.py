# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""PX4: what a log with default settings holds, and the parameters by which it holds more.

Source: PX4's message definitions and parameter reference, releases 1.9 to 1.16.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quadpi_core.field.field_log import (
    FRAMES,
    FieldLog,
    Series,
    Setting,
    Stack,
    held_series,
    places_of,
    series_of,
)
from quadpi_core.frames import Array
from quadpi_core.inputs import density_of
from quadpi_core.logs.formats.px4 import FORMAT, airframe_of, live_topics, load_ulog, motors_of
from quadpi_core.logs.reader_steps import finite_parameters, normalised_attitude

Topics = Mapping[str, Mapping[str, Any]]

_TOPICS = (
    *("sensor_combined", "vehicle_attitude", "vehicle_local_position", "vehicle_mocap_odometry"),
    *("vehicle_visual_odometry", "actuator_motors", "actuator_outputs", "esc_status", "battery_status"),
    *("vehicle_land_detected", "vehicle_air_data"),
)
_ROTORS_MOST = 12
_MAV_TYPE_ROTORS = {2: 4, 13: 6, 14: 8, 15: 3, 29: 12, 35: 10}
_PWM_US = (1000.0, 2000.0)
# PX4 drives DShot by the same numbers as its mixers: 0 to 1999 steps.
_DSHOT_STEPS = 1999.0
_DRONECAN_STEPS = 8191.0
_VALID = ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")


def read_px4_field(path: Path, _number: int | None = None, _poles: int | None = None) -> FieldLog:
    """What one log holds; see :class:`quadpi_core.field.field_log.FieldLog`.

    Raises:
        LogError: if it is no ULog.
    """
    source = str(path)
    log = load_ulog(source, path, _TOPICS)
    parameters = finite_parameters(log.parameters)
    topics = dict(live_topics(source, log.instances))
    outputs = [
        columns for name, _, columns in log.instances if name == "actuator_outputs" and "output[0]" in columns
    ]
    if outputs:
        # Each driver has an instance; that of the motors varies the most.
        topics["actuator_outputs"] = max(outputs, key=lambda columns: np.ptp(columns["output[0]"]))
    start_ns = _start_ns(topics)

    def read(topic: str, *names: str, where: str = "timestamp") -> Series | None:
        columns = topics.get(topic)
        if columns is None or not all(name in columns for name in ("timestamp", *names)):
            return None
        return series_of(_stamps(columns, where), _stack(columns, names), start_ns)

    airframe = airframe_of(parameters)
    rotors = _rotor_count(parameters)
    commands, said = _commands(topics, start_ns, rotors)
    speeds, poles = _speeds(topics, start_ns, rotors)
    quaternion = read("vehicle_attitude", *_indexed("q", 4), where="timestamp_sample")
    air = read("vehicle_air_data", "rho") or read("vehicle_air_data", "baro_pressure_pa", "baro_temp_celcius")
    if air is not None and air.values.shape[1] == 2:
        air = Series(air.time, density_of(air.values[:, :1], air.values[:, 1:]))
    return FieldLog(
        name=path.stem,
        source=source,
        stack="PX4",
        firmware=_firmware(log.information),
        frame=FRAMES.get(rotors or 0, f"{rotors} rotors" if rotors else ""),
        rotors=rotors,
        no_multirotor=str(airframe) if airframe and not airframe.is_multicopter else "",
        imu=read("sensor_combined", *_indexed("gyro_rad", 3), *_indexed("accelerometer_m_s2", 3)),
        attitude=quaternion and Series(quaternion.time, normalised_attitude(quaternion.values)),
        velocity=_local(topics, start_ns, ("vx", "vy", "vz"), _VALID[2:]),
        position=_local(topics, start_ns, ("x", "y", "z"), _VALID[:2]),
        commands=commands,
        rotor_speeds=speeds,
        battery=read("battery_status", "voltage_v"),
        landed=_landed(topics, start_ns),
        density=air,
        places=places_of(motors_of(parameters, rotors or 0)),
        drag_prefix="EKF2_",
        facts=_facts(parameters, log.information) | poles,
        parameters=parameters,
        settings=tuple(_settings(parameters, topics, speeds)),
        notes=said,
    )


def _start_ns(topics: Topics) -> int:
    """The first stamp of the sensors, which are never stale; of any topic where there are none."""
    wanted = [topics["sensor_combined"]] if "sensor_combined" in topics else list(topics.values())
    return min((int(_stamps(one)[0]) for one in wanted if len(one.get("timestamp", ()))), default=0)


def _stamps(columns: Mapping[str, Any], name: str = "timestamp") -> Any:
    name = name if name in columns and np.all(columns[name] > 0) else "timestamp"
    return np.minimum(columns[name], np.uint64(2**62 // 1000)).astype(np.int64) * 1000


def _indexed(name: str, count: int) -> list[str]:
    return [f"{name}[{place}]" for place in range(count)]


def _stack(columns: Mapping[str, Any], names: Any) -> Array:
    return np.stack([columns[name].astype(np.float64) for name in names], axis=1)


def _local(topics: Topics, start_ns: int, names: tuple[str, ...], valid: tuple[str, ...]) -> Series | None:
    columns = topics.get("vehicle_local_position")
    if columns is None or not all(name in columns for name in ("timestamp", *names, *valid)):
        return None
    good = np.all([columns[name].astype(bool) for name in valid], axis=0)
    values = np.where(good[:, np.newaxis], _stack(columns, names), np.nan)
    return series_of(_stamps(columns, "timestamp_sample"), values, start_ns)


def _landed(topics: Topics, start_ns: int) -> Series | None:
    columns = topics.get("vehicle_land_detected", {})
    if not {"timestamp", "landed"} <= set(columns):
        return None
    return held_series(_stamps(columns), columns["landed"], start_ns)


def _rotor_count(parameters: Mapping[str, float]) -> int | None:
    said = int(parameters.get("CA_ROTOR_COUNT", 0))
    return said or _MAV_TYPE_ROTORS.get(int(parameters.get("MAV_TYPE", 0)))


def _commands(topics: Topics, start_ns: int, rotors: int | None) -> tuple[Series | None, tuple[str, ...]]:
    """Commands from actuator_motors; before 1.13 from the outputs of the first driver that turns motors."""
    columns = topics.get("actuator_motors")
    if columns is not None:
        names = [name for name in _indexed("control", _ROTORS_MOST) if name in columns]
        values = _stack(columns, names)
        used = [place for place in range(len(names)) if np.isfinite(values[:, place]).mean() > 0.5]
        used = used[:rotors] if rotors else used
        if used:
            return series_of(
                _stamps(columns, "timestamp_sample"), np.clip(values[:, used], 0.0, 1.0), start_ns
            ), ()
    columns = topics.get("actuator_outputs")
    if columns is None or rotors is None or "output[0]" not in columns:
        return None, ()
    names = [name for name in _indexed("output", rotors) if name in columns]
    values = _stack(columns, names)
    most = float(np.nanmax(values, initial=0.0))
    if len(names) < rotors or most <= 1.0:
        return None, ()
    if most > 1.1 * _PWM_US[1]:
        low, high = 0.0, _DRONECAN_STEPS
    elif most > _DSHOT_STEPS or np.nanmin(values[-1]) >= 0.8 * _PWM_US[0]:
        low, high = _PWM_US
    else:
        low, high = 0.0, _DSHOT_STEPS
    said = f"commands are actuator_outputs 1 to {rotors}, taken as {low:g} to {high:g}"
    return series_of(_stamps(columns), np.clip((values - low) / (high - low), 0.0, 1.0), start_ns), (said,)


def _speeds(topics: Topics, start_ns: int, rotors: int | None) -> tuple[Series | None, dict[str, str]]:
    """Speeds of the motors by their numbers, where the controllers report any."""
    columns = topics.get("esc_status")
    if columns is None:
        return None, {}
    reports = {}
    for report in range(_ROTORS_MOST):
        if f"esc[{report}].esc_rpm" not in columns:
            break
        function = columns.get(f"esc[{report}].actuator_function")
        motor = int(function[-1]) - 101 if function is not None and function[-1] >= 101 else report
        if np.any(columns[f"esc[{report}].esc_rpm"]):
            reports[motor] = report
    if not reports or (rotors and sorted(reports)[:rotors] != list(range(rotors))):
        return None, {}
    rpm = _stack(columns, [f"esc[{reports[motor]}].esc_rpm" for motor in sorted(reports)[:rotors]])
    found = series_of(_stamps(columns), np.abs(rpm) * (2.0 * np.pi / 60.0), start_ns)
    return found, {"rotor speeds": f"esc_status, {found.rate_hz:.1f} Hz"} if found else {}


def _firmware(information: Mapping[str, Any]) -> str:
    release = information.get("ver_sw_release")
    version = ""
    if isinstance(release, int):
        version = ".".join(str(release >> shift & 0xFF) for shift in (24, 16, 8))
    parts = (version, str(information.get("ver_sw", ""))[:8], str(information.get("ver_hw", "")))
    return " ".join(("PX4", *filter(None, parts)))


def _facts(parameters: Mapping[str, float], information: Mapping[str, Any]) -> dict[str, str]:
    facts = {"board": str(information["ver_hw"])} if "ver_hw" in information else {}
    names = {
        "hover thrust": "MPC_THR_HOVER",
        "thrust model factor": "THR_MDL_FAC",
        "airframe": "SYS_AUTOSTART",
    }
    facts |= {key: f"{parameters[name]:.4g} ({name})" for key, name in names.items() if name in parameters}
    named = [name for name in parameters if name.startswith(("DSHOT_MOT_POL", "MOT_POLE_COUNT"))]
    if named:
        facts["poles"] = f"{max(parameters[name] for name in named):g} (MOT_POLE_COUNT)"
    return facts


def _settings(parameters: Mapping[str, float], topics: Topics, speeds: Series | None) -> Iterator[Setting]:
    def present(name: str) -> str:
        return f"{parameters[name]:g}" if name in parameters else "not in the log"

    name = "SDLOG_PROFILE"
    profile = int(parameters.get(name, 0))
    if profile & 24 != 24:
        gains = "commands, state and reports of the speed controllers at full rate instead of 10 Hz"
        yield Setting(name, present(name), f"set it to {profile | 25}", gains)
    if speeds is None:
        wire = "set it to the port of the telemetry wire, or DSHOT_BIDIR_EN to 1 (DroneCAN: UAVCAN_ENABLE 3)"
        yield Setting("DSHOT_TEL_CFG", present("DSHOT_TEL_CFG"), wire, "measured rotor speeds")
    if "vehicle_local_position" not in topics or "vehicle_attitude" not in topics:
        yield Setting(name, present(name), "add 1 to it", "position, velocity and attitude")


STACK = Stack(FORMAT, read_px4_field)
