# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations known by their answers alone: a function of a flight, a model, a wrench in the log of a flight.

A recorded wrench was computed from inputs with noise of their own, and the residual, the measured wrench less
the simulated one, holds that noise with a minus. A column in proportion to the simulated wrench, as every
tolerance is, holds the same noise: least squares shrink the simulation to remove it, by half where the noise
of the measured wrench is small, and the lost part is then found as an effect. The remedy is instruments
(two-stage least squares; Wooldridge, Econometric Analysis of Cross Section and Panel Data, chapter 5):
columns are replaced by what functions of the flight's own states, which do not share that noise, explain of
them. With many functions they would share it again, as each explains a little of the noise (the bias of many
instruments): only those are used that explain more than noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.acceptance import FEW_FLIGHTS
from quadpi_core.discrepancy.simulations import (
    Column,
    Margins,
    Simulation,
    Tolerances,
    airspeed,
    attribute_of,
    read_tolerances,
)
from quadpi_core.discrepancy.unmeasured_states import INDEPENDENT_HZ
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES, MAX_GAP_NS, Flight, RotorSpeedStream, WrenchStream
from quadpi_core.flight_files import FlightFile, LeftOutFlights, for_each_flight
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX, flight_derivatives, flight_inputs
from quadpi_core.logs import read_recording
from quadpi_core.models.aerodynamic import AerodynamicModel, unchecked_evaluation
from quadpi_core.models.model_kind import CUTOFF_HZ, Evaluation
from quadpi_core.parallel import Workers
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.records import CONVENTION, Threshold, brief_repr
from quadpi_core.signals import chain
from quadpi_core.signals.chain import zero_phase
from quadpi_core.vehicle import Vehicle

_HOVER_ROUNDS = 10
UNJUDGED_MOST = Threshold(
    "samples that a model cannot judge",
    0.05,
    "of a flight",
    "beyond, what bridges them would be compared rather than the model",
    CONVENTION,
)
TOGETHER = Threshold(
    "variance of a coefficient that all axes of its law share",
    0.5,
    "of its variance",
    "a law may be wrong as a whole or differ by axis, and nothing says which is more likely",
    CONVENTION,
)
# Laws of an unknown simulation: what is in proportion to the motion, such as the drag of rotors; what stays
# when the motion is reversed, such as lift; and what reverses with its square, as drag of the airframe.
OF_ROTORS, LINEAR, EVEN, SQUARED = "rotors", "the motion", "airspeed, even", "airspeed, squared"
# Axes that one force of the rotors acts on: along their axes, and in their plane.
_SHARED = (("Fz", "Mx", "My"), ("Fx", "Fy", "Mz"))
# Ridge in shares of each function's square, for those that a flight alone excites.
_RIDGE = 1e-4
# Share of a function's square below which it is a sum of those that were chosen before.
_NEW = 1e-6
# Instead of a division by zero.
_TINY = float(np.finfo(float).tiny)


class Part(NamedTuple):
    """Part (N, 6) of a wrench that one law causes; parts of the same law may be wrong together."""

    name: str
    wrench: Array
    law: str


def part_columns(parts: Sequence[Part], tolerances: Tolerances) -> list[Column]:
    """Tolerances of a simulation known by its wrench alone: a column by part and axis, and one by law.

    Nobody can say which coefficients such a simulation has. Its wrench is divided into parts that different
    laws cause, and each axis of a part may be wrong by the tolerance of a coefficient. One law acts on
    several axes: a force of the rotors in their plane on Fx, Fy and Mz, one along their axes on Fz, Mx and
    My. So the axes of a part may be wrong together, as its law is, or one by one.

    The part `OF_ROTORS`, of rotors in still air without rotation, is thrust and torque: its Fz is known as
    well as the thrust is, and its Mx and My, to which arms contribute, as well as the inertia. Every flight
    has the same columns, even one in which a part is zero.
    """
    known = {"Fz": tolerances.thrust, "Mx": tolerances.inertia, "My": tolerances.inertia}
    columns: list[Column] = []
    shared: dict[str, Array] = {}
    for part in parts:
        for axis, unit in zip(AXES, np.eye(len(AXES)), strict=True):
            name, law, share = f"{axis} of {part.name}", "", known.get(axis, tolerances.coefficient)
            if part.law != OF_ROTORS:
                axes = next(axes for axes in _SHARED if axis in axes)
                law, share = f"{', '.join(axes[:-1])} and {axes[-1]} of {part.law}", tolerances.coefficient
                whole = share * np.sqrt(TOGETHER.value) * unit * part.wrench
                shared[law] = shared.get(law, np.zeros_like(whole)) + whole
                share *= np.sqrt(1.0 - TOGETHER.value)
            columns.append(Column(name, share * unit * part.wrench, law))
    return columns + [Column(law, whole) for law, whole in shared.items()]


def of_coefficient(own: float, shared: float) -> float:
    """What a coefficient is wrong by, in its tolerances, from the fit of its own column and of its law's."""
    return float(np.sqrt(1.0 - TOGETHER.value) * own + np.sqrt(TOGETHER.value) * shared)


class _Answering(Simulation):
    """A simulation that answers for any flight.

    Its wrench for the same rotor speeds in still air without rotation counts as thrust and torque of the
    rotors. What body rates add, and what the airspeed adds in each order, may be wrong by itself.
    """

    @property
    def _near_hover(self) -> float:
        """Rotor speed [rad/s] from which that of hover is sought."""
        return 0.5 * self.vehicle.rotor_speed_max_rad_s

    @cached_property
    def hover_rotor_speed(self) -> float:  # type: ignore[override]
        """See :class:`Simulation`; found by iteration, as thrust is about quadratic in the speed."""
        weight, speed = self.vehicle.mass_kg * self.vehicle.gravity_m_s2, self._near_hover
        for _ in range(_HOVER_ROUNDS):
            thrust = -float(self.wrench(_hover(self.vehicle, speed))[0, 2])
            if thrust <= 0.0:
                raise DiscrepancyError(f"{self.name}: gives no thrust at rotor speeds of {speed:.0f} rad/s")
            speed *= float(np.sqrt(weight / thrust))
        return speed

    def loads(self, flight: Flight) -> tuple[Array, Array, Array]:
        """See :class:`Simulation`; those of hover, shared among the rotors by their squared speeds."""
        still, squares = self.wrench(_moving(flight, 0.0, 0.0)), np.square(flight.rotor_speeds)
        total, turning = squares.sum(axis=1), squares @ self.vehicle.rotor_spins
        thrust = -(still[:, 2] @ total) / max(float(total @ total), _TINY)
        torque = (still[:, 5] @ turning) / max(float(turning @ turning), _TINY)
        return self.wrench(flight), thrust * squares, torque * squares * self.vehicle.rotor_spins

    def uncertain(self, flight: Flight) -> list[Column]:
        """See :class:`Simulation`; by :func:`part_columns`."""
        still, turning = self.wrench(_moving(flight, 0.0, 0.0)), self.wrench(_moving(flight, 0.0, 1.0))
        parts = [Part(OF_ROTORS, still, OF_ROTORS), Part("rates", turning - still, LINEAR)]
        return part_columns(parts + self._by_airspeed(flight, turning), self.tolerances)

    def _by_airspeed(self, flight: Flight, turning: Array) -> list[Part]:
        """What the airspeed adds to the wrench (N, 6) of a turning body, by order and parity in the motion.

        Drag of rotors is of the first order, lift is even, and drag of the airframe reverses with its square:
        coefficients of different laws, of which one may be wrong alone. As the motion is halved, the first
        order halves and the second quarters; what is of other orders is shared between the two. Rates are
        reversed and halved with the airspeed, as a rotor feels both in the velocity of its hub.
        """

        def added(share: float) -> Array:
            return self.wrench(_moving(flight, share, share)) - self.wrench(_moving(flight, 0.0, share))

        ahead, back = self.wrench(flight) - turning, added(-1.0)
        odd, odd_of_half = 0.5 * (ahead - back), 0.5 * (added(0.5) - added(-0.5))
        return [
            Part("airspeed", 4.0 * odd_of_half - odd, LINEAR),
            Part(EVEN, 0.5 * (ahead + back), EVEN),
            Part(SQUARED, 2.0 * odd - 4.0 * odd_of_half, SQUARED),
        ]


@dataclass(frozen=True)
class CallableSimulation(_Answering):
    """Any function from a flight to its wrench."""

    __repr__ = brief_repr

    name: str
    vehicle: Vehicle
    function: Callable[[Flight], Array]
    tolerances: Tolerances = field(default_factory=Tolerances)
    vehicle_file: str = ""
    code: str = ""

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        try:
            wrench = np.asarray(self.function(flight), dtype=float)
        except Exception as error:  # the user's code may raise anything
            raise DiscrepancyError(
                f"{self.name}: raised {type(error).__name__} for flight {flight.name}: {error}"
            ) from error
        where, shape = f"{self.name}: flight {flight.name}", (len(flight), len(AXES))
        if wrench.shape != shape:
            raise DiscrepancyError(f"{where}: expected a wrench of shape {shape}, found {wrench.shape}")
        finite = np.isfinite(wrench).all(axis=1)
        if not finite.all():
            raise DiscrepancyError(f"{where}: sample {np.argmin(finite)}: not finite")
        return wrench * flight.air_ratio


@dataclass(frozen=True)
class ModelSimulation(_Answering):
    """The predictions of an identified model of all six axes.

    Flights must have passed the low-pass of the model. Samples that it cannot judge are left out: their
    neighbours bridge them.
    """

    __repr__ = brief_repr

    name: str
    vehicle: Vehicle
    model: AerodynamicModel
    tolerances: Tolerances = field(default_factory=Tolerances)
    vehicle_file: str = ""

    goes_with_air = attribute_of("model.goes_with_air")

    @property
    def _near_hover(self) -> float:
        """The middle of the range that the model was identified on."""
        envelope, index = self.model.envelope, INPUT_INDEX["omega_avg"]
        return float(np.mean((envelope.lower[index], envelope.upper[index])))

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        wrench = self._evaluated(flight).predicted
        finite = np.isfinite(wrench).all(axis=1)
        share = 1.0 - float(np.mean(finite))
        if share > UNJUDGED_MOST.value:
            raise DiscrepancyError(
                f"{self.name}: flight {flight.name}: the model gives no finite wrench for {share:.0%} of it, "
                f"first for sample {np.argmin(finite)}"
            )
        rows = np.arange(len(wrench))
        return chain.interpolate_columns(rows[finite], wrench[finite], rows)

    def margins(self, flight: Flight) -> Margins:
        """See :class:`Simulation`; at the confidence of the model."""
        found = self._evaluated(flight)
        return Margins(found.lower - found.predicted, found.upper - found.predicted, self.model.confidence)

    def unjudged(self, flight: Flight) -> int:
        """See :class:`Simulation`; those that the model gives no finite wrench for."""
        return int(np.sum(~np.isfinite(self._evaluated(flight).predicted).all(axis=1)))

    def identified_on(self, flight: Flight) -> bool:
        """See :class:`Simulation`."""
        return self.model.learned_from(flight.sha256)

    def _evaluated(self, flight: Flight) -> Evaluation:
        inputs, derivatives = flight_inputs(flight, self.vehicle), flight_derivatives(flight)
        derivatives["density_excess"] = flight.air_ratio - 1.0
        return unchecked_evaluation(self.model, inputs, derivatives=derivatives)

    def _by_airspeed(self, flight: Flight, turning: Array) -> list[Part]:
        """As a whole, as a model knows nothing of a motion reversed."""
        return [Part("airspeed", self.wrench(flight) - turning, LINEAR)]


def _moving(flight: Flight, airspeed: float, rates: float) -> Flight:
    """The flight with shares, negative ones too, of its airspeed and of its rates."""
    return replace(
        flight,
        name=f"{flight.name} with its airspeed times {airspeed:g} and its rates times {rates:g}",
        velocity=airspeed * flight.velocity,
        wind=airspeed * flight.wind,
        rates=rates * flight.rates,
        angular_acceleration=rates * flight.angular_acceleration,
    )


def _hover(vehicle: Vehicle, rotor_speed: float) -> Flight:
    """A hover of two samples at a height of 10 m."""
    none = np.zeros((2, 3))
    return Flight(
        name="hover",
        vehicle=vehicle.name,
        source="hover",
        start_ns=0,
        time=np.array([0.0, 0.002]),
        position=none - [0.0, 0.0, 10.0],
        attitude=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        velocity=none,
        rates=none,
        angular_acceleration=none,
        specific_force=none - [0.0, 0.0, vehicle.gravity_m_s2],
        rotor_speeds=np.full((2, vehicle.rotor_count), rotor_speed),
        wind=none,
    )


@dataclass(frozen=True)
class RecordedSimulation(Simulation):
    """Wrench of each flight that a simulation of any kind recorded on the topic `simulation/wrench`.

    It cannot be evaluated for other wind or rotor speeds. What those would change follows from
    :func:`instruments`, weighted as flights tell. The part in proportion to the squared rotor speeds counts
    as thrust and torque.

    Attributes:
        wrenches: recorded wrench by the source of the flight, at even stamps and low-passed as flights are.
        thrust_n_s2, torque_nm_s2: thrust and torque of a rotor over its squared speed.
        weights: (J, 6) by the source of the flight, of the instruments in the rest of the wrench; empty
            before `learned`. Those of any other flight are learned from it alone.
    """

    __repr__ = brief_repr

    vehicle: Vehicle
    wrenches: Mapping[str, WrenchStream]
    thrust_n_s2: float
    torque_nm_s2: float
    tolerances: Tolerances = field(default_factory=Tolerances)
    vehicle_file: str = ""
    name: str = "recorded"
    weights: Mapping[str, Array] = field(default_factory=dict)

    own_inputs = True
    reads_accelerations = False

    @classmethod
    def load(
        cls,
        vehicle: str,
        bags: Sequence[Path],
        mapping: MappingOrOptions = None,
        left_out: LeftOutFlights = None,
    ) -> RecordedSimulation:
        """Read the topic from the bags or logs of flights, and low-pass it as flights are.

        Raises:
            DiscrepancyError: for bags without the topic, or without rotor speeds.
            LogError: for bags and samples that cannot be read, and pauses that cannot be bridged.
        """
        flown, wrenches, sums = Vehicle.load(vehicle), {}, np.zeros(4)
        task, shared = "Reading wrenches", (flown, mapping)
        read = for_each_flight(
            _wrench_of_flight, bags, shared=shared, task=task, workers=Workers(1), left_out=left_out
        )
        for _, (source, found, rotors) in read:
            wrenches[source] = found
            squares = np.square(rotors.speeds)
            total, turning = squares.sum(axis=1), squares @ flown.rotor_spins
            wrench = chain.interpolate_columns(found.time_ns, found.wrench, rotors.time_ns)
            sums += [-total @ wrench[:, 2], total @ total, turning @ wrench[:, 5], turning @ turning]
        thrust, torque = sums[[0, 2]] / np.maximum(sums[[1, 3]], _TINY)
        if thrust <= 0.0:
            raise DiscrepancyError(f"topic {WrenchStream.topic}: its Fz gives no thrust as rotors turn")
        return cls(flown, wrenches, float(thrust), float(torque), read_tolerances(vehicle), vehicle)

    @property
    def hover_rotor_speed(self) -> float:  # type: ignore[override]
        """See :class:`Simulation`."""
        weight = self.vehicle.mass_kg * self.vehicle.gravity_m_s2
        return float(np.sqrt(weight / (self.vehicle.rotor_count * self.thrust_n_s2)))

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        where = f"{flight.source}: topic {WrenchStream.topic}"
        if flight.source not in self.wrenches:
            raise DiscrepancyError(f"{where}: was not read")
        recorded, stamps = self.wrenches[flight.source], flight.stamps_ns
        first, last, end = (int(at - stamps[0]) for at in (*recorded.time_ns[[0, -1]], stamps[-1]))
        if first > MAX_GAP_NS or last < end - MAX_GAP_NS:
            raise DiscrepancyError(
                f"{where}: its stamps, {1e-9 * first:.3f} to {1e-9 * last:.3f} s after the start of the "
                f"flight, do not cover it, 0 to {1e-9 * end:.3f} s; they must be on the clock of the sensors"
            )
        return chain.interpolate_columns(recorded.time_ns, recorded.wrench, stamps)

    def loads(self, flight: Flight) -> tuple[Array, Array, Array]:
        """See :class:`Simulation`."""
        return self.wrench(flight), *self._rotors(flight)[1:]

    def learned(self, flights: Sequence[tuple[Flight, Flight]]) -> RecordedSimulation:
        """See :class:`Simulation`; the rest beside the rotors, as functions of the quiet motion."""
        if all(flight.source in self.weights for flight, _ in flights):
            return self
        rest = [self.wrench(flight) - self._rotors(flight)[0] for flight, _ in flights]
        functions = [np.concatenate([*instruments(quiet, self).values()], axis=1) for _, quiet in flights]
        weights = learned_weights(rest, functions, flights[0][0].rate_hz)
        return replace(self, weights={own.source: w for (own, _), w in zip(flights, weights, strict=True)})

    def answering(self, flight: Flight, corrected: Flight) -> RecordedSimulation:
        """See :class:`Simulation`; what it recorded, and what the learned functions say of the difference."""
        known = self.learned([(flight, flight)])
        wrench = known.wrench(flight) + known.explained(corrected) - known.explained(flight)
        answered = WrenchStream(flight.stamps_ns, wrench)
        return replace(known, wrenches={**known.wrenches, flight.source: answered})

    def explained(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        return np.sum([part.wrench for part in self._parts(flight)], axis=0)

    def uncertain(self, flight: Flight) -> list[Column]:
        """See :class:`Simulation`; by :func:`part_columns`."""
        return part_columns(self._parts(flight), self.tolerances)

    def _parts(self, flight: Flight) -> list[Part]:
        """The wrench without its noise, by the law that causes it."""
        left, parts = self.learned([(flight, flight)]).weights[flight.source], []
        for (name, law), functions in instruments(flight, self).items():
            weights, left = np.split(left, [functions.shape[1]])
            parts.append(Part(name, functions @ weights, law))
        return [Part(OF_ROTORS, self._rotors(flight)[0], OF_ROTORS), *parts]

    def _rotors(self, flight: Flight) -> tuple[Array, Array, Array]:
        """Wrench (N, 6), thrusts and torques (N, 4) in proportion to the squared rotor speeds."""
        squares, (x, y, _) = np.square(flight.rotor_speeds), self.vehicle.rotor_positions.T
        thrusts, torques = self.thrust_n_s2 * squares, self.torque_nm_s2 * squares * self.vehicle.rotor_spins
        none, total, turning = np.zeros(len(flight)), thrusts.sum(axis=1), torques.sum(axis=1)
        wrench = np.column_stack((none, none, -total, -thrusts @ y, thrusts @ x, turning))
        return wrench, thrusts, torques


def _wrench_of_flight(
    task: tuple[Vehicle, MappingOrOptions], file: FlightFile
) -> tuple[str, WrenchStream, RotorSpeedStream]:
    """Source of a flight, its recorded wrench at even stamps, low-passed as flights are, and rotor speeds."""
    recording = read_recording(file.path, *task)
    simulated, where = recording.simulated, f"{file.path}: topic"
    if simulated is None:
        raise DiscrepancyError(f"{where} {WrenchStream.topic}: missing: no simulated wrench")
    if recording.rotor_speeds is None:
        raise DiscrepancyError(f"{where} rotor_speeds: missing")
    simulated.check(str(file.path))
    gap = chain.first_gap(simulated.time_ns, MAX_GAP_NS)
    if gap is not None:
        late = f"comes more than {1e-9 * MAX_GAP_NS:g} s after the one before"
        raise DiscrepancyError(f"{where} {simulated.topic}: sample {gap}: {late}")
    grid = chain.uniform_stamps(simulated.time_ns)
    wrench = chain.interpolate(simulated.time_ns, simulated.wrench, grid, MAX_GAP_NS).values
    rate_hz, cutoff_hz = chain.nominal_rate(grid), CUTOFF_HZ["default"]
    if 2.0 * cutoff_hz < rate_hz:
        wrench = zero_phase(wrench, cutoff_hz, rate_hz, slice(0)).value
    return recording.source, WrenchStream(grid, wrench), recording.rotor_speeds


def instruments(flight: Flight, simulation: Simulation) -> dict[tuple[str, str], Array]:
    """Functions (N, ·) that span the terms of aerodynamic models, of the order of 1; by part and law.

    Thrust and torque of each rotor; drag, inflow and lift with the airspeed; damping with the rates; and
    their products with the rotor speeds. None uses the specific force.
    """
    vehicle, speeds = simulation.vehicle, flight.rotor_speeds / simulation.hover_rotor_speed
    velocity, rates = airspeed(flight) / vehicle.hover_induced_velocity, flight.rates / 3.0
    speed, mean = np.linalg.norm(velocity, axis=1)[:, None], speeds.mean(axis=1)[:, None]
    # Shares of the rotors in their mean thrust, rolling and pitching moment and torque. Differences of rotors
    # are small beside what they share: as sums of large functions that nearly cancel they would be chosen
    # late, and shrunk by the ridge.
    x, y, _ = (vehicle.rotor_positions / np.abs(vehicle.rotor_positions[:, :2]).max()).T
    sums = np.stack((np.ones_like(x), y, x, vehicle.rotor_spins), axis=1) / vehicle.rotor_count
    summed = speeds @ sums
    even = np.concatenate((_products(velocity, velocity), _products(velocity, rates)), axis=1)
    groups = {
        ("rates", LINEAR): (np.ones_like(mean), summed, speeds**2 @ sums, rates, _products(summed, rates),
                            _products(rates, rates), speed * rates),
        ("airspeed", LINEAR): (velocity, _products(summed, velocity)),
        (EVEN, EVEN): (even, mean * even),
        (SQUARED, SQUARED): (speed * velocity, speed**2 * velocity),
    }  # fmt: skip
    return {of: np.concatenate(functions, axis=1) for of, functions in groups.items()}


def _products(one: Array, other: Array) -> Array:
    """Products (N, K L) of the columns (N, K) of one with those (N, L) of another."""
    return (one[:, :, None] * other[:, None, :]).reshape(len(one), -1)


def learned_weights(wrenches: Sequence[Array], functions: Sequence[Array], rate_hz: float) -> list[Array]:
    """Per flight weights (J, 6) of those functions (N, J) that explain more of a wrench (N, 6) than noise.

    Functions are taken one after the other, the one that explains most first, as long as Schwarz's criterion
    improves (Schwarz, Estimating the Dimension of a Model, 1978), with as many samples as are independent.
    The weights of a flight are those of all other flights, so that they hold nothing of its own noise
    (jackknife instruments; Angrist, Imbens and Krueger, 1999); of few flights, those of all.
    """
    squares = np.sum([np.square(own).sum(axis=0) for own in functions], axis=0)
    scale = np.sqrt(np.maximum(squares, _TINY))
    grams = np.stack([(own / scale).T @ (own / scale) for own in functions])
    aims = np.stack([(own / scale).T @ wrench for own, wrench in zip(functions, wrenches, strict=True)])
    samples = sum(map(len, functions)) * min(1.0, INDEPENDENT_HZ.value / rate_hz)
    total = np.sum([np.square(wrench).sum(axis=0) for wrench in wrenches], axis=0)
    weights, few = np.zeros_like(aims), len(functions) < FEW_FLIGHTS.value
    for axis, left in enumerate(total):
        chosen = _chosen(grams.sum(axis=0), aims[:, :, axis].sum(axis=0), float(left), samples)
        for place in range(len(functions)):
            others = [flight for flight in range(len(functions)) if few or flight != place]
            gram = grams[others].sum(axis=0)[np.ix_(chosen, chosen)] + _RIDGE * np.eye(len(chosen))
            aim = aims[others, :, axis].sum(axis=0)[chosen]
            weights[place, chosen, axis] = np.linalg.solve(gram, aim) / scale[chosen]
    return list(weights)


def _chosen(gram: Array, aim: Array, left: float, samples: float) -> list[int]:
    """Functions of unit squares whose part of squares `left` is more than noise, best first."""
    chosen = list[int]()
    while left > 0.0:
        squares = np.diag(gram)
        new = squares > _NEW
        gains = np.where(new, aim**2 / np.where(new, squares, 1.0), 0.0)
        best = int(np.argmax(gains))
        after = max(left - float(gains[best]), _TINY)
        if gains[best] <= 0.0 or samples * (np.log(left) - np.log(after)) < np.log(samples):
            break
        chosen.append(best)
        # What is left of the others, orthogonal to the chosen.
        share, left = gram[best] / gram[best, best], after
        aim, gram = aim - share * aim[best], gram - np.outer(share, gram[best])
    return chosen
