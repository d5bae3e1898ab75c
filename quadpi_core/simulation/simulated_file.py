# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulation is read from: a vehicle file with the key `simulation`, or the folder of a model.

A model folder stands for the vehicle file that :meth:`.AerodynamicModel.vehicle_file` gives, so both fly the
same.
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from xml.sax.saxutils import escape

import numpy as np
import yaml

from quadpi_core.config_schema import ReadBy, Section, Within, check_config, parse_config, read_config
from quadpi_core.errors import ModelError, VehicleError
from quadpi_core.field.estimates import Estimate
from quadpi_core.field.motor_use import ThrustCurve
from quadpi_core.frames import Array, body_frd_to_flu
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_folder import MODEL_FILE
from quadpi_core.models.small_model import SmallModel
from quadpi_core.paths import finite_json, whole_output
from quadpi_core.records import Threshold
from quadpi_core.vehicle import Vehicle, is_rigid_body, simulation_section
from quadpi_core.version import __version__

MOTOR_TIME_CONSTANT = Threshold(
    "time constant of a motor",
    0.033,
    "s",
    "of a vehicle identified from flights without recorded commands, which alone would tell it",
    "rotor speeds lag their command by 25 to 45 ms on quadrotors of 37 to 770 g; 33 ms on the Bebop 2",
)


@dataclass(frozen=True)
class IdentifiedRange:
    """Ranges (19,) of the inputs over the flights that a vehicle was identified on."""

    lower: Array
    upper: Array

    def to_section(self) -> dict[str, list[float]]:
        """The content of `simulation.identified_range` in a vehicle file."""
        pairs = zip(self.lower.tolist(), self.upper.tolist(), strict=True)
        return {name: list(pair) for name, pair in zip(INPUT_NAMES, pairs, strict=True)}


def _read_range(data: Any) -> IdentifiedRange | None:
    if data is None:
        return None
    limits = check_config(dict[str, tuple[float, float]], data)
    if set(limits) != set(INPUT_NAMES):
        raise ValueError(f"must have a range for each of {', '.join(INPUT_NAMES)}")
    lower, upper = np.array([limits[name] for name in INPUT_NAMES]).T
    if not (np.all(np.isfinite(lower)) and np.all(np.isfinite(upper)) and np.all(lower <= upper)):
        raise ValueError("must hold pairs of numbers, the smaller first")
    return IdentifiedRange(lower, upper)


@dataclass(frozen=True, kw_only=True)
class SimulationSection(Section):
    """The key `simulation` of a vehicle file.

    Attributes:
        motor_time_constant_s: time constant of the first-order response of a rotor's speed.
        rotor_local: aerodynamics measured in a wind tunnel, read by `rotor_local`.
        physical: aerodynamics identified from flights, read by `physical_aerodynamics`.
        identified_range: of the flights that they were identified on.
        effects: effects, read by :func:`quadpi_core.simulation.flying.own_effects`.
        tolerances: tolerances, read where simulations are compared with flights.
    """

    motor_time_constant_s: Annotated[float, Within(0.001, 1.0)] | None = None
    rotor_local: Any = None
    physical: Any = None
    identified_range: Annotated[IdentifiedRange | None, ReadBy(_read_range)] = None
    effects: Any = None
    tolerances: Any = None


class SimulatedFile(NamedTuple):
    """A file or folder with the vehicle and the simulation that it holds."""

    path: Path
    vehicle: Vehicle
    section: SimulationSection


def read_simulation(name_or_path: str | Path) -> SimulatedFile:
    """Read a vehicle that may be simulated.

    Args:
        name_or_path: name of a file in config/vehicles, path of a vehicle file, or folder of a model.

    Raises:
        VehicleError: naming the file and the key that is unknown or impossible.
        ModelError: for a folder that is no model, and a model that is no simulation, saying why.
    """
    folder = model_folder(name_or_path)
    if folder is None:
        path, data = simulation_section(name_or_path)
        vehicle = Vehicle.load(path)
    else:
        path = folder
        _, vehicle, data = _of_model(folder)
    section = parse_config(SimulationSection, data, str(path), VehicleError, ("simulation",))
    return SimulatedFile(path, vehicle, section)


def model_folder(name_or_path: str | Path) -> Path | None:
    """The folder of a model, where a name or path of a vehicle is one; else None."""
    path = Path(name_or_path)
    return path if (path / MODEL_FILE).is_file() else None


def _of_model(folder: Path) -> tuple[AerodynamicModel, Vehicle, dict[str, Any]]:
    """The model in a folder, its vehicle, and the key `simulation` that flies as the model."""
    model = AerodynamicModel.load(folder)
    section, vehicle = model.simulation_section(), model.load_vehicle()
    motor = {"motor_time_constant_s": motor_time_constant(vehicle)}
    limits = IdentifiedRange(model.envelope.lower, model.envelope.upper)
    return model, vehicle, {**motor, **section, "identified_range": limits.to_section()}


def motor_time_constant(vehicle: Vehicle) -> float:
    """Of the motors [s], as the vehicle file of the vehicle's name has them, if it is of this vehicle."""
    with contextlib.suppress(VehicleError):
        _, data = simulation_section(vehicle.name)
        if Vehicle.load(vehicle.name).fingerprint == vehicle.fingerprint:
            return float(data.get("motor_time_constant_s", MOTOR_TIME_CONSTANT.value))
    return MOTOR_TIME_CONSTANT.value


def vehicle_content(name_or_path: str | Path) -> tuple[str, dict[str, Any]]:
    """Name and content of a vehicle file, or of the one that flies as the model in a folder.

    Raises:
        VehicleError, ModelError: see :func:`read_simulation`.
    """
    folder = model_folder(name_or_path)
    if folder is None:
        path, data = read_config("vehicle", name_or_path, VehicleError)
        return path.name, data
    _, vehicle, section = _of_model(folder)
    return folder.name, {**vehicle.to_file(), "simulation": section}


def write_vehicle_file(folder: Path, path: Path) -> None:
    """Write the vehicle file that flies as the model in a folder; it appears whole or not at all.

    Raises:
        ModelError: for a folder that is no model, and a model that is no simulation, saying why.
        VehicleError: if its vehicle is not known.
        OutputError: if the file cannot be written.
    """
    if model_folder(folder) is None:
        AerodynamicModel.load(folder)
        raise VehicleError(f"{folder}: not the folder of a model")
    model, vehicle, section = _of_model(folder)
    source = f"Identified by quadpi {__version__} from flights: model {model.identity}."
    data = {"source": source, **vehicle.to_file(), "simulation": section}
    text: str = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)
    with whole_output(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


# Each number stands with its 95 % interval and the condition under which it holds; where flights do not tell
# it, the file says why in a comment and sets nothing, or takes what the vehicle file says where the form
# needs a number. Sources: PX4's and ArduPilot's parameter references; gz-sim's MulticopterMotorModel.hh;
# MuJoCo's XML reference and "Computation", fluid forces by the inertia box.

# Names of both stacks: momentum drag, ballistic coefficients, exponent of thrust, thrust of hover.
_NAMES = {
    "px4": ("EKF2_MCOEF", "EKF2_BCOEF_X", "EKF2_BCOEF_Y", "THR_MDL_FAC", "MPC_THR_HOVER"),
    "ardupilot": (
        "EK3_DRAG_MCOEF",
        "EK3_DRAG_BCOEF_X",
        "EK3_DRAG_BCOEF_Y",
        "MOT_THST_EXPO",
        "MOT_THST_HOVER",
    ),
}
# Of MAVLink's MAV_PARAM_TYPE_REAL32, as QGroundControl writes it.
_REAL32 = 9
_MOTOR_PLUGIN = (
    '<plugin filename="gz-sim-multicopter-motor-model-system" name="gz::sim::systems::MulticopterMotorModel">'
)
# Share of the mass that each rotor of the Gazebo model has: joints need some, which no flight tells.
_ROTOR_SHARE = 1e-3


class Exported(NamedTuple):
    """What is written."""

    small: SmallModel
    curve: ThrustCurve
    motor_time_constant_s: float


def exported_text(form: str, exported: Exported) -> str:
    """The content of a file.

    Args:
        form: px4, ardupilot, sdf, mjcf or json.
        exported: what to write.

    Raises:
        ModelError: of a simulator's form, for a model that tells no thrust or torque.
    """
    writers = {"sdf": _sdf, "mjcf": _mjcf, "json": _json}
    return writers[form](exported) if form in writers else _parameters(form, exported)


def estimates_of(exported: Exported) -> dict[str, Estimate]:
    """Estimates that the files hold, by name."""
    small = exported.small
    return {
        "thrust_n_s2": small.thrust,
        "torque_over_thrust_m": small.torque,
        "hover_rotor_speed_rad_s": small.hover_speed,
        **{f"inertia_{axis}_kg_m2": own for axis, own in zip("xyz", small.inertia, strict=True)},
        "momentum_drag_1_s": small.momentum,
        "ballistic_x_kg_m2": small.ballistic[0],
        "ballistic_y_kg_m2": small.ballistic[1],
        "thrust_exponent": exported.curve.exponent,
        "hover_thrust": exported.curve.hover,
    }


def _about(one: Estimate) -> str:
    """A number's interval and condition, in words."""
    if one.value is None:
        return one.reason
    interval = "" if one.low is None or one.high is None else f"95 % {one.low:.4g} to {one.high:.4g} "
    return f"{interval}{one.unit}; {one.reason}".strip("; ")


def _title(exported: Exported) -> str:
    return f"quadpi {__version__}, model {exported.small.identity} of {exported.small.vehicle.name}"


def _parameters(form: str, exported: Exported) -> str:
    small, curve = exported.small, exported.curve
    estimates = (small.momentum, *small.ballistic, curve.exponent, curve.hover)
    lines = [f"# {_title(exported)}"]
    for name, one in zip(_NAMES[form], estimates, strict=True):
        lines.append(f"# {name}: {_about(one)}")
        if one.value is not None:
            value = f"{one.value:.6g}"
            lines.append(f"1\t1\t{name}\t{value}\t{_REAL32}" if form == "px4" else f"{name},{value}")
    return "\n".join(lines) + "\n"


def _json(exported: Exported) -> str:
    vehicle = exported.small.vehicle
    content = {
        "quadpi": __version__,
        "model": exported.small.identity,
        "vehicle": vehicle.name,
        "mass_kg": vehicle.mass_kg,
        "air_density_kg_m3": vehicle.air_density_kg_m3,
        "motor_time_constant_s": exported.motor_time_constant_s,
        "rotors": vehicle.to_file()["rotors"],
        "parameters": {name: asdict(one) for name, one in estimates_of(exported).items()},
    }
    return json.dumps(finite_json(content), indent=1, allow_nan=False) + "\n"


class _Body(NamedTuple):
    """What both simulators need, in axes forward-left-up: numbers, and rotors with their yaw's sign."""

    thrust: float
    torque: float
    inertia: Array
    places: Array
    spins: Array
    greatest: float


def _body(exported: Exported) -> _Body:
    small, vehicle = exported.small, exported.small.vehicle
    if small.thrust.value is None or small.torque.value is None:
        lacking = "thrust" if small.thrust.value is None else "torque"
        reason = (small.thrust if small.thrust.value is None else small.torque).reason
        raise ModelError(f"model {small.identity}: the form needs the {lacking} of a rotor: {reason}")
    flip = np.array([1.0, -1.0, -1.0])
    inertia = vehicle.inertia * np.outer(flip, flip)
    for axis, own in enumerate(small.inertia):
        inertia[axis, axis] = inertia[axis, axis] if own.value is None else own.value
    if not is_rigid_body(inertia):
        # Simulators refuse it, or fly what cannot be.
        found = ", ".join(f"{moment:.3g}" for moment in np.diag(inertia))
        raise ModelError(
            f"model {small.identity}: the moments of inertia {found} kg m² are those of no rigid body: arms "
            "or inertia of the vehicle file are wrong, or flights tell x and y too little"
        )
    return _Body(
        small.thrust.value,
        small.torque.value,
        inertia,
        body_frd_to_flu(vehicle.rotor_positions),
        vehicle.rotor_spins,
        vehicle.rotor_speed_max_rad_s,
    )


def _drag_per_mass(small: SmallModel) -> float:
    """Linear drag over mass, 1/s; 0 where it is not identified, which the comment says."""
    return small.momentum.value or 0.0


def _comment(exported: Exported, *notes: str) -> Iterator[str]:
    told = [_title(exported)]
    for name, one in estimates_of(exported).items():
        number = "" if one.value is None else f"{one.value:.6g}; "
        told.append(f"{name}: {number}{_about(one)}")
    yield "<!--"
    # Two hyphens would end a comment.
    yield from (f"  {re.sub('-+', '-', line)}" for line in (*told, *notes))
    yield "-->"


def _sdf(exported: Exported) -> str:
    small, body, vehicle = exported.small, _body(exported), exported.small.vehicle
    name, count = escape(vehicle.name, {'"': "&quot;"}), vehicle.rotor_count
    rotor_mass = _ROTOR_SHARE * vehicle.mass_kg
    spin_inertia = 0.5 * rotor_mass * vehicle.rotor_radius_m**2
    hover = small.hover_speed.value or 1.0
    # Gazebo's drag of a rotor is per its speed: all of the vehicle's is given to the rotors, as at hover.
    drag = vehicle.mass_kg * _drag_per_mass(small) / (count * hover)
    # What the rotors have of mass and inertia, the base link has not: together they are the vehicle's.
    base_mass = vehicle.mass_kg - count * rotor_mass
    centre = -rotor_mass * body.places.sum(axis=0) / base_mass
    inertia = body.inertia - base_mass * _of_point(centre) - count * spin_inertia * np.eye(3)
    inertia = inertia - rotor_mass * sum(_of_point(place) for place in body.places)
    moments = {f"i{'xyz'[i]}{'xyz'[j]}": inertia[i, j] for i in range(3) for j in range(i, 3)}
    lines = ['<?xml version="1.0"?>', '<sdf version="1.9">']
    lines += _comment(
        exported,
        f"each rotor has {_ROTOR_SHARE:g} of the mass, the base the rest; drag is the rotors', as at hover",
    )
    lines += [f'<model name="{name}">', '  <link name="base_link">']
    lines += _inertial(base_mass, moments, centre)
    lines.append("  </link>")
    for number, (place, spin) in enumerate(zip(body.places.tolist(), body.spins, strict=True)):
        pose = " ".join(f"{value:.6g}" for value in (*place, 0.0, 0.0, 0.0))
        lines += [f'  <link name="rotor_{number}">', f"    <pose>{pose}</pose>"]
        lines += _inertial(rotor_mass, {"ixx": spin_inertia, "iyy": spin_inertia, "izz": spin_inertia})
        lines += [
            "  </link>",
            f'  <joint name="rotor_{number}_joint" type="revolute">',
            "    <parent>base_link</parent>",
            f"    <child>rotor_{number}</child>",
            "    <axis><xyz>0 0 1</xyz><limit><lower>-1e16</lower><upper>1e16</upper></limit></axis>",
            "  </joint>",
            f"  {_MOTOR_PLUGIN}",
            f"    <jointName>rotor_{number}_joint</jointName>",
            f"    <linkName>rotor_{number}</linkName>",
            f"    <turningDirection>{'cw' if spin > 0.0 else 'ccw'}</turningDirection>",
            f"    <timeConstantUp>{exported.motor_time_constant_s:.6g}</timeConstantUp>",
            f"    <timeConstantDown>{exported.motor_time_constant_s:.6g}</timeConstantDown>",
            f"    <maxRotVelocity>{body.greatest:.6g}</maxRotVelocity>",
            f"    <motorConstant>{body.thrust:.6g}</motorConstant>",
            f"    <momentConstant>{body.torque:.6g}</momentConstant>",
            f"    <rotorDragCoefficient>{drag:.6g}</rotorDragCoefficient>",
            "    <rollingMomentCoefficient>0</rollingMomentCoefficient>",
            "    <rotorVelocitySlowdownSim>1</rotorVelocitySlowdownSim>",
            "    <commandSubTopic>command/motor_speed</commandSubTopic>",
            f"    <actuator_number>{number}</actuator_number>",
            "    <motorType>velocity</motorType>",
            "  </plugin>",
        ]
    return "\n".join([*lines, "</model>", "</sdf>"]) + "\n"


def _of_point(place: Array) -> Array:
    """Inertia (3, 3) over mass of a point, about the origin (Steiner)."""
    return float(place @ place) * np.eye(3) - np.outer(place, place)


def _inertial(mass: float, moments: dict[str, float], centre: Array | None = None) -> Iterator[str]:
    pose = "" if centre is None else f"<pose>{_numbers([*centre, 0.0, 0.0, 0.0])}</pose>"
    yield f"    <inertial>{pose}<mass>{mass:.6g}</mass><inertia>"
    yield "      " + "".join(f"<{key}>{value:.6g}</{key}>" for key, value in moments.items())
    yield "    </inertia></inertial>"


def _mjcf(exported: Exported) -> str:
    body, vehicle = _body(exported), exported.small.vehicle
    name = escape(vehicle.name, {'"': "&quot;"})
    # MuJoCo's drag of a body is 3 π d µ v, d the mean edge of the box that has its principal inertia.
    moments = np.linalg.eigvalsh(body.inertia)
    edges = np.sqrt(6.0 * np.maximum(moments.sum() - 2.0 * moments, 0.0) / vehicle.mass_kg)
    viscosity = vehicle.mass_kg * _drag_per_mass(exported.small) / (3.0 * np.pi * float(edges.mean()))
    lines = [
        *_comment(exported, "controls are squares of rotor speeds in (rad/s)²; linear drag is the viscosity")
    ]
    full = [body.inertia[row, column] for row, column in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    lines += [
        f'<mujoco model="{name}">',
        '  <compiler inertiafromgeom="false"/>',
        f'  <option timestep="0.002" integrator="RK4" density="0" viscosity="{viscosity:.6g}"'
        f' gravity="0 0 {-vehicle.gravity_m_s2:.6g}"/>',
        "  <worldbody>",
        f'    <body name="{name}" pos="0 0 1">',
        "      <freejoint/>",
        f'      <inertial pos="0 0 0" mass="{vehicle.mass_kg:.6g}" fullinertia="{_numbers(full)}"/>',
    ]
    lines += [
        f'      <site name="rotor_{n}" pos="{_numbers(place)}"/>' for n, place in enumerate(body.places)
    ]
    lines += ["    </body>", "  </worldbody>", "  <actuator>"]
    for number, spin in enumerate(body.spins):
        gear = _numbers([0.0, 0.0, body.thrust, 0.0, 0.0, spin * body.torque * body.thrust])
        limits = f'ctrllimited="true" ctrlrange="0 {body.greatest**2:.6g}"'
        lines.append(f'    <motor name="rotor_{number}" site="rotor_{number}" gear="{gear}" {limits}/>')
    return "\n".join([*lines, "  </actuator>", "</mujoco>"]) + "\n"


def _numbers(values: Array | list[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)
