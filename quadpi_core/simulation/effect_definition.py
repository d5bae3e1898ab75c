# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What an effect is: a name, its parameters with their bounds, and one small pure function.

Its kind says what the function changes, and with it what it takes:

    wrench   (state, vehicle, p) -> (fx, fy, fz, mx, my, mz); adds to the wrench of the aerodynamics
    vehicle  (vehicle, p) -> Vehicle as it truly is
    wind     (time, p, rng) -> (N, 3) m/s of the air over ground, world
    sensor   (recording, vehicle, p) -> Recording as the sensors would give it

`p` holds the parameters in their order, in the unit that their names end with. A wrench effect takes N
instants at once: the state has the fields of `state_records.State`, each an array whose first axis is N, and
the vehicle those of `state_records.VehicleNumbers`; forces and moments are numbers or arrays (N,). In a
flight N is 1. The compiled core has the library's wrench effects, too: a function here says the law that
people read and that is exported. Functions that several of them use are at the end of the file.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.frames import Array, inverse, product
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.simulation.state_records import State, VehicleNumbers
from quadpi_core.vehicle import Vehicle

# Effects that are switched on: name -> all parameters with their values, in the order of the registry.
Effects: TypeAlias = Mapping[str, Mapping[str, float]]
# In the order in which they act; see the module.
EFFECT_KINDS = ("wrench", "vehicle", "wind", "sensor")
FORM_OF_AIR = Threshold(
    "error of an aerodynamic law",
    0.15,
    "of the wrench, as a standard deviation",
    "two laws of the literature for one effect differ by a third, which is about two standard deviations",
    "formulas of the blind benchmark beside those of the library",
)
# `Effect.form` of an aerodynamic law.
AERODYNAMIC = FORM_OF_AIR.value
# `Effect.indistinguishable_group` of a weak rotor and a misread rotor speed: they differ only in how the
# thrust depends on the airflow, which is known within a tolerance.
STRENGTH_OF_ONE_ROTOR = "strength of one rotor"
Component: TypeAlias = Array | float
# Fx, Fy, Fz [N] and Mx, My, Mz [Nm], body axes, each a number or an array (N,).
Wrench: TypeAlias = tuple[Component, Component, Component, Component, Component, Component]


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes:
        name: with its unit at the end, as in a scenario file.
        unit: for people; empty for a share or a count.
        default: the typical size of the effect.
        lowest, highest: physical bounds, inclusive. An effect whose parameters are all 0, where that is
            within bounds, changes nothing.
        whole: whether it is a whole number, such as that of a rotor.
    """

    name: str
    unit: str
    default: float
    lowest: float
    highest: float
    whole: bool = False


# Parameters by which flights may shape a law where its assumptions about the air fail: its wrench is
# multiplied by one plus a share for the axis plus these slopes times :func:`modulators`. In a file
# an effect may have any of them beside its own parameters.
SHAPE = tuple(
    Parameter(f"shape_{name}", "", 0.0, -100.0, 100.0)
    for name in (
        *("fx", "fy", "fz", "mx", "my", "mz"),
        *("speed", "u", "v", "w", "load", "rates", "ground", "w2"),
    )
)
SHAPE_MAX = Threshold(
    "largest factor on a law that flights shape",
    compiled.SHAPE_MAX,
    "factor, the smallest being 0",
    "beyond what was flown a law neither changes sign nor grows without bound",
    CONVENTION,
)
_MOST = SHAPE_MAX.value
# `SHAPE` begins with a share for each axis.
_AXES = 6
MODULATORS = len(SHAPE) - _AXES


@dataclass(frozen=True)
class Effect:
    """One physical effect that can be switched on.

    Attributes:
        kind: of EFFECT_KINDS.
        summary: one line.
        axes: those of `flight.AXES` in which it shows: for a wrench effect, all that can be non-zero.
        function: see the module.
        shown_by: manoeuvres that distinguish it from others; empty for one that no search looks for.
        inverse: (p) -> p of the inverse of a sensor effect; unless given, the negative.
        form: share by which the law may be wrong where its assumptions fail; 0 for an exact law.
        formula: formula in LaTeX, with the symbols of the parameters.
        symbols: symbols of the parameters in LaTeX.
        last: whether it acts after every other effect of its kind.
        composable: whether two of them act as one that has the sums of their parameters; not so where the
            effect is not linear in them.
        scales_existing: whether it only scales existing forces. It then gains nothing by the error of another
            law, and needs less evidence beside one.
        scales_thrust: whether it scales thrust beside weight, as identification does to fit its flights. A
            model has then no error that it is known by: beside one of mass, it would scale all there is.
        indistinguishable_group: name of a group whose effects look alike on one rotor, their first parameter;
            a search looks for one of them on each rotor. Empty for none.
        size_grows_with_arm: whether its typical size is in proportion to the arm of the vehicle.
        tolerance: field of `discrepancy.simulations.Tolerances` with the standard deviation of the parameters
            in a simulation that does not have the effect; empty for none.
        feasible: (vehicle, p) -> p, brings parameters to what that vehicle can have; None where bounds do.
        at_rest: (6,) state of its own in hover, for an effect on the wrench that has one: it reads
            `state.memory`, fills `state.memory_slope`, and flights integrate it. Empty for none. The
            wrench is in proportion to the first parameter, which the state does not depend on.
        start_spread: (6,) standard deviation of that state at the start of a recorded flight.
        moments_alone: names of parameters that neither that state nor the force depends on.
        of_a_flight: what makes it differ from one flight to the next, in words; empty where nothing does.
        brings: names of effects that come with it by the same act, as the hook of a load does.
        shifts_noise: whether it moves signals in time, and their noise with them.
    """

    name: str
    kind: str
    summary: str
    axes: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    function: Any
    shown_by: str = ""
    inverse: Callable[[Array], Array] | None = None
    form: float = 0.0
    formula: str = ""
    symbols: tuple[str, ...] = ()
    last: bool = False
    composable: bool = True
    scales_existing: bool = False
    scales_thrust: bool = False
    indistinguishable_group: str = ""
    size_grows_with_arm: bool = False
    tolerance: str = ""
    feasible: Callable[[Vehicle, Array], Array] | None = None
    at_rest: tuple[float, ...] = ()
    start_spread: tuple[float, ...] = ()
    moments_alone: tuple[str, ...] = ()
    of_a_flight: str = ""
    brings: tuple[str, ...] = ()
    shifts_noise: bool = False

    @property
    def shape(self) -> tuple[Parameter, ...]:
        """Parameters by which flights may shape its law; none for an exact law and effects on the air."""
        return SHAPE if self.kind == "wrench" and self.form > 0.0 else ()

    @property
    def law(self) -> str | Callable[..., Wrench]:
        """Of a wrench effect: its name where the compiled core has it, else its function."""
        return self.name if self.name in compiled.WRENCH_EFFECTS else self.function

    def undo(self, values: Array) -> Array:
        """Parameters of the inverse effect, to first order at least."""
        return -values if self.inverse is None else self.inverse(values)


def effect(
    kind: str, axes: str, *parameters: Parameter, symbols: str = "", **declared: Any
) -> Callable[[Any], Effect]:
    """Make an effect of a function: its name and the first line of its docstring are those of the effect.

    Args:
        kind: see the module.
        axes: names of axes with spaces between them.
        parameters: parameters in the order in which the function takes them.
        symbols: symbols of the parameters, with spaces between them.
        declared: other attributes of :class:`Effect` that differ from their defaults.
    """
    if kind not in EFFECT_KINDS:
        raise ValueError(f"an effect is of kind {', '.join(EFFECT_KINDS)}, not {kind!r}")

    def declare(function: Any) -> Effect:
        return Effect(
            name=function.__name__,
            kind=kind,
            summary=function.__doc__.partition("\n")[0].rstrip("."),
            axes=tuple(axes.split()),
            parameters=parameters,
            function=function,
            symbols=tuple(symbols.split()),
            **declared,
        )

    return declare


def three(
    unit_name: str, unit: str, default: float, most: float, *, lowest: float | None = None
) -> tuple[Parameter, ...]:
    """Parameters x, y and z of one size and the same bounds."""
    return tuple(
        Parameter(f"{axis}_{unit_name}", unit, default, -most if lowest is None else lowest, most)
        for axis in "xyz"
    )


def modulators(state: State, vehicle: VehicleNumbers) -> tuple[Array, ...]:
    """Quantities (N,) that a shaped law may depend on beyond its formula, as in `SHAPE` after the axes.

    Airspeed and its components over the induced velocity of hover, mean square of the rotor speeds over that
    of hover, speed of a rotor's radius at the body rates over the induced velocity, radius over height, and
    the square of the velocity along z over the induced one: climb and descent alike.
    """
    induced, radius = vehicle.hover_induced_velocity, vehicle.rotor_radius
    u, v, w = state.velocity_air.T / induced
    p, q, r = state.rates.T
    squares = 1.0 / vehicle.rotors * (state.rotor_speeds.T / vehicle.hover_rotor_speed) ** 2
    load: Array = sum(squares[1:], squares[0])
    speed = np.sqrt(u * u + v * v + w * w)
    turning = radius * np.sqrt(p * p + q * q + r * r)
    ground = radius / np.maximum(-state.position[:, 2], radius)
    return speed, u, v, w, load, turning / induced, ground, w * w


def shaped(wrench: Wrench, state: State, vehicle: VehicleNumbers, shape: Array) -> Wrench:
    """The wrench of a law as shaped by the values of `effect_definition.SHAPE`."""
    if not np.any(shape):
        return wrench
    of = modulators(state, vehicle)
    more = 1.0 + sum(slope * modulator for slope, modulator in zip(shape[_AXES:], of, strict=True))
    factors = [np.clip(more + share, 0.0, _MOST) for share in shape[:_AXES]]
    fx, fy, fz, mx, my, mz = (part * factor for part, factor in zip(wrench, factors, strict=True))
    return fx, fy, fz, mx, my, mz


def at_hubs(vehicle: VehicleNumbers, fx: Component, fy: Component, fz: Component) -> Wrench:
    """Wrench of forces (N, rotors), or 0, at the hubs of the rotors, each with its moment r × F."""
    x, y, z = vehicle.rotor_positions.T

    def total(force: Component, arm: Component = 1.0) -> Component:
        return (force * arm).sum(axis=1) if isinstance(force, np.ndarray) else 0.0

    moment = total(fz, y) - total(fy, z), total(fx, z) - total(fz, x), total(fy, x) - total(fx, y)
    return total(fx), total(fy), total(fz), *moment


def in_plane_speeds(state: State) -> Array:
    """Airspeeds (N, rotors) m/s of the hubs within the plane of their discs."""
    u, v = state.hub_velocity[:, :, 0], state.hub_velocity[:, :, 1]
    return np.sqrt(u * u + v * v)


def hub_heights(state: State, vehicle: VehicleNumbers) -> Array:
    """Heights (N, rotors) m of the hubs above the ground, negative below it."""
    down = np.stack(world_to_body(state.attitude, 0.0, 0.0, 1.0), axis=1)
    below_centre = np.sum(down[:, None] * vehicle.rotor_positions, axis=2)
    return -(state.position[:, 2, None] + below_centre)


def world_to_body(attitude: Array, x: Component, y: Component, z: Component) -> tuple[Array, Array, Array]:
    """Vectors of the world in body axes, by attitudes (N, 4)."""
    quaternion = tuple(attitude.T)
    _, forward, right, down = product(inverse(quaternion), product((0.0, x, y, z), quaternion))
    return forward, right, down


def body_to_world(attitude: Array, x: Component, y: Component, z: Component) -> tuple[Array, Array, Array]:
    """Vectors of body axes in the world, by attitudes (N, 4)."""
    quaternion = tuple(attitude.T)
    _, north, east, down = product(product(quaternion, (0.0, x, y, z)), inverse(quaternion))
    return north, east, down
