# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What GPS and motor commands alone tell: windy flights of RotorPy, each by a vehicle of its own.

Every flight is logged as an autopilot logs it: IMU and commands at 100 Hz, the state at 5 Hz with errors of
1 m, 0.1 m/s and 2°. A report on each gives drag, thrust and inertia with intervals of 95 %, or says that they
are not identified; counted is how often the truth is inside. RotorPy flies them together by PyTorch, roma
and torchdiffeq.

    python experiments/gps_flights.py [--flights 100] [--seconds 60 150] [--first 2000] [--store FOLDER]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from independent.airframes import GRAVITY_M_S2, Airframe, Array, airframes
from independent.flying import Path as Path1
from independent.flying import Path4
from independent.hidden_effects import Flown
from page_tables import renew, stamp
from scipy.spatial.transform import Rotation

from quadpi_core.field.airborne import flown
from quadpi_core.field.drag import drag_samples, identify_drag, piece_lengths_s
from quadpi_core.field.estimates import Estimate
from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.field.inertia import identify_body
from quadpi_core.report.table import Column, Row, Table, markdown_table
from quadpi_core.vehicle import Vehicle

PAGE = Path(__file__).parent / "results" / "slow-states.md"

RATE_HZ, STATE_HZ = 100.0, 5.0
# Errors of a state by GPS: position m, velocity m/s, attitude rad.
STATE_ERRORS = (1.0, 0.1, np.deg2rad(2.0))
_HEIGHT_M = 20.0


class Logged(NamedTuple):
    """One flight, in RotorPy's axes: body forward-left-up, world with z up.

    Attributes:
        time: (N,) s.
        rates, felt: (N, 3) as the IMU reads them, rad/s and m/s².
        commands: (N, 4) share of the largest rotor speed.
        state_time: (M,) s.
        position, velocity: (M, 3) as the state has them; attitude (M, 4) x y z w.
        wind: (2,) m/s, mean.
        drag: (2,) 1/s, over mass along x and y, that fits best at the airspeeds flown.
        thrust: N of one rotor at full command.
        inertia: (3,) kg m².
        mass: kg.
    """

    time: Array
    rates: Array
    felt: Array
    commands: Array
    state_time: Array
    position: Array
    velocity: Array
    attitude: Array
    wind: Array
    drag: Array
    thrust: Array
    inertia: Array
    mass: Array


def vehicle_of(airframe: Airframe, rng: np.random.Generator) -> Flown:
    """A vehicle with its own motors, drag and inertia."""
    factors = {"k_eta": 0.15, "k_m": 0.2, "k_d": 0.3, "k_z": 0.3, "c_Dx": 0.3, "c_Dy": 0.3}
    factors |= {"Ixx": 0.2, "Iyy": 0.2, "Izz": 0.2}
    drawn = Flown(airframe, airframe.parameters).with_parameters(
        **{name: float(np.exp(share * rng.uniform(-1.0, 1.0))) for name, share in factors.items()}
    )
    return Flown(airframe, {**drawn.parameters, "tau_m": float(rng.uniform(0.02, 0.05))})


def path_of(rng: np.random.Generator, speed: float) -> Path4:
    """To and fro in x and y with turns, climbs, and quick steps of attitude for a third of the flight."""

    def swing(fastest: float, low_hz: float, high_hz: float) -> Path1:
        hz, phase = rng.uniform(low_hz, high_hz), rng.uniform(0.0, 2.0 * np.pi)
        size = rng.uniform(0.6, 1.0) * fastest / (2.0 * np.pi * hz)
        return lambda t: size * (np.sin(2.0 * np.pi * hz * t + phase) - np.sin(phase))

    def faded(path: Path1) -> Path1:
        def slowly(t: Array) -> Array:
            share = np.clip(t / 8.0, 0.0, 1.0)
            slow: Array = share**3 * (10.0 - 15.0 * share + 6.0 * share**2) * path(t)
            return slow

        return slowly

    def shaken(begin: float, size: float) -> Path1:
        hz = rng.uniform(0.9, 1.4)
        gain = size / (2.0 * np.pi * hz) ** 2
        return lambda t: (
            gain
            * np.sin(2.0 * np.pi * hz * t)
            * (np.clip(t - begin, 0.0, 1.0) * np.clip(begin + 10.0 - t, 0.0, 1.0))
        )

    slow = [faded(swing(speed, 0.05, 0.12)) for _ in range(2)]
    shakes = [shaken(20.0, 2.5), shaken(30.0, 2.5)]
    climb, turn = faded(swing(1.5, 0.1, 0.2)), faded(swing(np.deg2rad(30.0), 0.05, 0.12))
    quick = faded(swing(0.8, 0.7, 1.0))
    return Path4(
        "gps",
        lambda t: slow[0](t) + shakes[0](t),
        lambda t: slow[1](t) + shakes[1](t),
        lambda t: _HEIGHT_M + climb(t),
        lambda t: turn(t) + quick(t) * (t > 40.0) * np.clip((t - 40.0) / 2.0, 0.0, 1.0),
    )


def _gusts(rng: np.random.Generator, samples: int) -> Array:
    deviation, constant = rng.uniform(0.5, 1.5), rng.uniform(1.0, 4.0)
    keep = np.exp(-1.0 / (RATE_HZ * constant))
    gusts: Array = deviation * rng.standard_normal((samples, 3))
    for k in range(1, samples):
        gusts[k] = keep * gusts[k - 1] + np.sqrt(1.0 - keep**2) * gusts[k]
    gusts *= [1.0, 1.0, 0.5]
    return gusts


def fly(seeds: Sequence[int], seconds: int) -> list[Logged]:
    """One flight for each seed, of a vehicle drawn for it; all at once, as RotorPy can by PyTorch.

    Raises:
        RuntimeError: where RotorPy loses its path.
    """
    import torch
    from rotorpy.controllers.quadrotor_control import BatchedSE3Control
    from rotorpy.vehicles.multirotor import BatchedMultirotor, BatchedMultirotorParams

    torch.set_num_threads(1)
    device, count = torch.device("cpu"), len(seeds)
    draws = [np.random.default_rng(seed) for seed in seeds]
    vehicles = [vehicle_of(airframes()[0], rng) for rng in draws]
    parameters = [dict(one.parameters) for one in vehicles]
    samples = int(seconds * RATE_HZ)
    time = np.arange(samples) / RATE_HZ
    names = ("x", "x_dot", "x_ddot", "yaw", "yaw_dot")
    sampled = [path_of(rng, 5.0).sampled(time) for rng in draws]
    wanted = {
        name: torch.tensor(np.stack(own, axis=1))
        for name, own in zip(names, zip(*sampled, strict=True), strict=True)
    }
    wind = np.empty((samples, count, 3))
    for place, rng in enumerate(draws):
        heading, blows = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 5.0)
        steady = blows * np.array([np.cos(heading), np.sin(heading), 0.0])
        wind[:, place] = steady + _gusts(rng, samples)
    s = np.zeros((count, 20))
    s[:, :3], s[:, 3:6] = wanted["x"][0], wanted["x_dot"][0]
    s[:, 8], s[:, 9] = np.sin(0.5 * wanted["yaw"][0]), np.cos(0.5 * wanted["yaw"][0])
    s[:, 16:] = [[np.sqrt(p["mass"] * GRAVITY_M_S2 / 4.0 / p["k_eta"])] * 4 for p in parameters]
    state, everyone = torch.tensor(s), torch.arange(count)
    vehicle = BatchedMultirotor(
        BatchedMultirotorParams(parameters, count, device),
        count,
        {"x": state[:, :3]},
        device,
    )
    # Slower than the motors allow, as an autopilot is; it knows the vehicle of the file alone.
    known = {**vehicles[0].airframe.parameters, "kp_att": 60.0, "kd_att": 12.0}
    controller = BatchedSE3Control(BatchedMultirotorParams([known] * count, count, device), count, device)
    rows, slopes = np.empty((samples, count, 20)), np.empty((samples, count, 20))
    commands, integral, step = np.empty((samples, count, 4)), torch.zeros(count, 3), 1.0 / RATE_HZ
    for k in range(samples):
        state[:, 13:16] = torch.tensor(wind[k])
        now = BatchedMultirotor._unpack_state(state, everyone, count)
        now = {name: value.double() for name, value in now.items()}
        away = now["x"] - wanted["x"][k]
        integral = integral + away.clamp(-0.3, 0.3) * step
        asked = {name: wanted[name][k] for name in names}
        asked["x_ddot"] = asked["x_ddot"] - 3.0 * integral
        command = controller.update(time[k], now, asked, everyone)["cmd_motor_speeds"]
        command = command.clamp(min=0.0, max=float(known["rotor_speed_max"]))

        def slope(at: torch.Tensor, command: torch.Tensor = command) -> torch.Tensor:
            return vehicle._s_dot_fn(0.0, at, command, everyone).double()

        rows[k], commands[k] = state, command
        first = slope(state)
        second = slope(state + 0.5 * step * first)
        third = slope(state + 0.5 * step * second)
        fourth = slope(state + step * third)
        slopes[k] = first
        state = state + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        state[:, 6:10] = state[:, 6:10] / torch.norm(state[:, 6:10], dim=1, keepdim=True)
        if not bool((torch.norm(away, dim=1) < 10.0).all()):
            raise RuntimeError(f"RotorPy loses a path after {time[k]:.2f} s")
    return [
        _logged(own, time, rows[:, place], slopes[:, place], commands[:, place], wind[:, place], rng)
        for place, (own, rng) in enumerate(zip(vehicles, draws, strict=True))
    ]


def _logged(
    own: Flown,
    time: Array,
    rows: Array,
    slopes: Array,
    commands: Array,
    wind: Array,
    rng: np.random.Generator,
) -> Logged:
    p, count = own.parameters, len(time)
    attitude = Rotation.from_quat(rows[:, 6:10])
    force = attitude.inv().apply(slopes[:, 3:6] + np.array([0.0, 0.0, GRAVITY_M_S2]))
    air = attitude.inv().apply(rows[:, 3:6] - wind)[:, :2]
    felt = force + rng.normal(0.0, 0.1, 3) + 0.5 * rng.standard_normal((count, 3))
    felt[:, :2] += rng.normal(0.0, 0.01, 2) * (force[:, 2:] - GRAVITY_M_S2)
    rates = rows[:, 10:13] + rng.normal(0.0, 0.005, 3) + 0.01 * rng.standard_normal((count, 3))
    step = round(RATE_HZ / STATE_HZ)
    chosen = slice(None, None, step)
    seen = attitude[chosen] * Rotation.from_rotvec(
        STATE_ERRORS[2] * rng.standard_normal((len(time[chosen]), 3))
    )
    return Logged(
        time,
        rates,
        felt,
        commands / p["rotor_speed_max"],
        time[chosen],
        rows[chosen, :3] + STATE_ERRORS[0] * rng.standard_normal((len(time[chosen]), 3)),
        rows[chosen, 3:6] + STATE_ERRORS[1] * rng.standard_normal((len(time[chosen]), 3)),
        seen.as_quat(),
        wind.mean(axis=0)[:2],
        -np.sum(air * force[:, :2], axis=0) / np.sum(air**2, axis=0),
        np.array(p["k_eta"] * p["rotor_speed_max"] ** 2),
        np.array([p["Ixx"], p["Iyy"], p["Izz"]]),
        np.array(p["mass"]),
    )


def stored(seeds: Sequence[int], seconds: int, store: Path) -> list[Logged]:
    """Flights, flown where the store does not hold them."""
    store.mkdir(parents=True, exist_ok=True)
    files = {seed: store / f"gps-{seconds}-{seed}.npz" for seed in seeds}
    lacking = [seed for seed, file in files.items() if not file.exists()]
    for seed, one in zip(lacking, fly(lacking, seconds) if lacking else [], strict=True):
        np.savez_compressed(files[seed], **one._asdict())
    flights = []
    for path in files.values():
        with np.load(path) as file:
            flights.append(Logged(**{name: file[name] for name in Logged._fields}))
    return flights


# From RotorPy's axes to forward-right-down and north-east-down.
_FLIP = np.array([1.0, -1.0, -1.0])
_FIGURES = ("drag along x", "drag along y", "thrust", "inertia about x", "inertia about y")


def field_log(flight: Logged) -> FieldLog:
    """A flight as `quadpi report` reads a log."""
    attitude = flight.attitude[:, [3, 0, 1, 2]] * np.array([1.0, 1.0, -1.0, -1.0])
    for row in range(1, len(attitude)):
        attitude[row] *= 1.0 if attitude[row] @ attitude[row - 1] > 0.0 else -1.0
    return FieldLog(
        name="gps",
        source="gps",
        stack="simulation",
        imu=Series(flight.time, np.hstack([flight.rates * _FLIP, flight.felt * _FLIP])),
        attitude=Series(flight.state_time, attitude),
        velocity=Series(flight.state_time, flight.velocity * _FLIP),
        position=Series(flight.state_time, flight.position * _FLIP),
        commands=Series(flight.time, flight.commands),
    )


def vehicle_file() -> Vehicle:
    """What the owner of the vehicles knows: mass and places of the rotors; inertia is a guess."""
    return Vehicle.load(str(airframes()[0].file))


def judged(flight: Logged, vehicle: Vehicle) -> list[tuple[float, Estimate]]:
    """The truth, and what is told of it, of each of `_FIGURES`."""
    log = field_log(flight)
    aloft = flown(log)
    samples = drag_samples(log, aloft, piece_lengths_s([aloft.airborne_s])[0])
    if isinstance(samples, str):
        raise RuntimeError(samples)
    drag = identify_drag([samples])
    body = identify_body([(log, aloft)], vehicle, [drag.likely_wind(0)])
    inside = np.zeros(len(flight.time), dtype=bool)
    for one in aloft.stretches:
        inside |= (flight.time >= one.begin) & (flight.time <= one.end)
    hover = float(flight.commands[inside].mean())
    return [
        *zip(flight.drag.tolist(), drag.per_mass, strict=True),
        (float(flight.thrust) * hover**2, body.thrust),
        *zip(flight.inertia[:2].tolist(), body.inertia, strict=True),
    ]


def table(told: Sequence[Sequence[tuple[float, Estimate]]]) -> Table:
    """How often the truth is inside, half widths, and how often nothing is told, of each figure."""
    rows: list[Row] = []
    for place, name in enumerate(_FIGURES):
        own = [flight[place] for flight in told]
        known = [(true, one) for true, one in own if one.value is not None]
        ends = [(true, one.low, one.high) for true, one in own if one.low is not None]
        held = [low <= true <= high for true, low, high in ends if high is not None]
        widths = [one.half_width / true for true, one in known if one.half_width is not None]
        errors = [one.value / true - 1.0 for true, one in known if one.value is not None]
        rows.append(
            [
                name,
                f"{sum(held)} of {len(held)}",
                f"{100.0 * np.median(widths):.1f} %" if widths else "–",
                f"{100.0 * np.median(errors):+.1f} %" if errors else "–",
                f"{100.0 * (1.0 - len(known) / len(own)):.0f} %",
            ]
        )
    headings = ("truth inside", "half width, median", "error, median", "not identified")
    return Table([Column("of each flight", is_text=True), *map(Column, headings)], rows)


def main() -> None:
    """Fly, judge, and renew the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--seconds", type=int, nargs="+", default=[60, 150], help="length of the flights")
    parser.add_argument("--first", type=int, default=3000, help="seed; those below were looked at")
    parser.add_argument("--store", type=Path, default=Path("out") / "gps-flights")
    parser.add_argument("--page", type=Path, default=PAGE)
    given = parser.parse_args()
    vehicle = vehicle_file()
    seeds = range(given.first, given.first + given.flights)
    tables = {}
    for seconds in given.seconds:
        told = [judged(flight, vehicle) for flight in stored(seeds, seconds, given.store)]
        tables[f"gps {seconds}"] = f"{markdown_table(table(told))}\n\n*{stamp()}*"
        print(tables[f"gps {seconds}"], flush=True)
    renew(given.page, tables)


if __name__ == "__main__":
    main()
