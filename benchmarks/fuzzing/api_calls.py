# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Calls of every public name with changed arguments, and what each must then do.

A call whose arrays do not fit each other, or that is given what it does not take, must raise a QuadpiError;
arguments that say the same in another form must give the same result. Every public name and method has an
entry here: a test looks for those that have none.
"""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import quadpi_core as quadpi
from benchmarks.fuzzing.argument_changes import (
    Argument,
    Call,
    Must,
    Number,
    Rows,
    confidence_level,
    figure,
    folder,
    named,
    no_value,
    of_kinds,
    output,
    rows_of,
    short,
    thing,
)
from benchmarks.fuzzing.library_calls import library_calls
from benchmarks.fuzzing.mutation import Finding
from quadpi_core.errors import QuadpiError
from quadpi_core.estimator.filter_state import ImuRate
from quadpi_core.flight import Flight, ImuStream, PoseStream, Recording
from quadpi_core.identification.prepared_flights import LiveSamples, PreparedFlight
from quadpi_core.inputs import DERIVATIVES, aerodynamic_inputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.kinds.physical import Physical
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import CandidatePool
from quadpi_core.monitor.alarm import MonitorSettings
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.preparation import Prepared
from quadpi_core.parallel import Workers
from quadpi_core.vehicle import ROTORS, SensorNoise, Vehicle

GOLDEN_MODEL = Path(__file__).parents[2] / "test" / "golden" / "model"
_BAGS = Path(__file__).parents[2] / "bags"
_ROWS = 60
_RATE_HZ = 500.0
_START_NS = 1_700_000_000_000_000_000
# Share of cases with an argument missing, one too many, or two that change places.
_MISCALLED = 0.05
# Share of the slow calls that are made, of those that must give a result.
_SLOW_MADE = 0.02


# Clean arguments.


@cache
def _vehicle() -> Vehicle:
    return Vehicle.load("bebop2")


@cache
def _inputs() -> npt.NDArray[np.float64]:
    rng = np.random.default_rng(0)
    velocity, rates = rng.normal(size=(_ROWS, 3)), 0.3 * rng.normal(size=(_ROWS, 3))
    speeds = rng.normal(750.0, 40.0, (_ROWS, ROTORS))
    return short(aerodynamic_inputs(velocity, _attitudes(), rates, speeds, _vehicle()))


@cache
def _attitudes() -> npt.NDArray[np.float64]:
    attitude = np.array([1.0, 0.0, 0.0, 0.0]) + 0.1 * np.random.default_rng(1).normal(size=(_ROWS, 4))
    return short(attitude / np.linalg.norm(attitude, axis=1)[:, None])


@cache
def _derivatives() -> npt.NDArray[Any]:
    derivatives = np.zeros(_ROWS, DERIVATIVES)
    rng = np.random.default_rng(2)
    for name in DERIVATIVES.names or ():
        derivatives[name] = short(rng.normal(size=derivatives[name].shape))
    return derivatives


@cache
def _stamps() -> npt.NDArray[np.int64]:
    return _START_NS + np.arange(_ROWS, dtype=np.int64) * 2_000_000


@cache
def _samples() -> npt.NDArray[np.float64]:
    rng = np.random.default_rng(3)
    samples = 0.1 * rng.normal(size=(_ROWS, 20))
    samples[:, 3:7], samples[:, 12] = _attitudes(), samples[:, 12] - 9.8
    samples[:, 13:17] = rng.normal(750.0, 5.0, (_ROWS, ROTORS))
    return short(samples)


@cache
def _flight(name: str = "flight", seed: int = 4) -> PreparedFlight:
    rng = np.random.default_rng(seed)
    wrench = short(0.01 * rng.normal(size=(_ROWS, 6)) + _inputs()[:, :1] * [0.1, 0.0, 0.2, 0.0, 0.0, 0.01])
    time = short(0.002 * np.arange(_ROWS))
    return PreparedFlight(name, 32 * "ab", time, _inputs(), _derivatives(), wrench, short(time + 2.0))


@cache
def _polynomial() -> AerodynamicModel:
    return AerodynamicModel.load(GOLDEN_MODEL)


@cache
def _physical() -> AerodynamicModel:
    """Fitted to made-up flights: it is about the call, not about what it says."""
    flights, rows = [], np.arange(1200) % _ROWS
    for seed in (5, 6):
        part = _flight(f"flight {seed}", seed)
        columns = {name: getattr(part, name)[rows] for name in ("inputs", "derivatives", "wrench", "height")}
        flights.append(replace(part, time=short(0.002 * np.arange(len(rows))), **columns))
    options = IdentifyOptions(method=Physical(multi_step=False))
    return quadpi.identify(flights, _vehicle(), quadpi.load_pools("quadrotor"), options)


@cache
def _pools() -> dict[str, CandidatePool]:
    return {"Fz": CandidatePool.parse(["w"], []), "Fx": CandidatePool.parse(["u"], [])}


@cache
def _prepared() -> Prepared:
    prepared = _monitor().preparation.step(_stamps(), _samples())
    return prepared._replace(
        inputs=short(prepared.inputs), measured=short(prepared.measured), derivatives=_derivatives()
    )


def _monitor() -> Monitor:
    return Monitor(_polynomial(), _vehicle(), _RATE_HZ)


# Parameters.


class _ByRotor(Rows):
    """Changes to an array (..., rotors)."""

    def _shape(self, rng: random.Random, array: npt.NDArray[Any]) -> tuple[Any, Must]:
        return rng.choice((array[:, :3], array.T, array[:, 0], array[:, :, None])), Must.REFUSE

    def _values(self, rng: random.Random, array: npt.NDArray[Any]) -> tuple[Any, Must]:
        changed, must = super()._values(rng, array)
        # What is not finite stays so.
        return (array, Must.GIVE_THE_SAME) if must is Must.END_WELL else (changed, must)


@cache
def _flown() -> Flight:
    still = np.zeros((_ROWS, 3))
    return Flight(
        *("flight", "bebop2", "flight.mcap", _START_NS, _flight().time),
        position=still,
        attitude=_attitudes(),
        velocity=still,
        rates=still,
        angular_acceleration=still,
        specific_force=still,
        rotor_speeds=np.full((_ROWS, ROTORS), 700.0),
        wind=still,
    )


def calls() -> dict[str, Call]:
    """Every public call, by its name."""
    return {**array_calls(), **file_calls(), **library_calls()}


@cache
def array_calls() -> dict[str, Call]:
    """Those that take numbers and arrays."""
    vehicle, flight, flown = thing(_vehicle(), refused=(Vehicle.load("neurobem"),)), _flight(), _flown()
    model, confidence = thing(_polynomial()), confidence_level()
    evaluated = {"confidence": confidence}
    return {
        "AerodynamicModel.evaluate, physical": Call(
            _physical().evaluate,
            {
                "flight": rows_of(_inputs()),
                **evaluated,
                "derivatives": replace(rows_of(_derivatives()), required=False),
            },
            share=15.0,
        ),
        "AerodynamicModel.evaluate, polynomial": Call(
            _polynomial().evaluate,
            {
                "flight": rows_of(_inputs()),
                **evaluated,
                "derivatives": Argument(_derivatives(), Rows(optional=True), "derivatives", required=False),
            },
            share=15.0,
        ),
        "AerodynamicModel.evaluate": Call(
            _physical().evaluate, {"flight": thing(flight), **evaluated}, share=2.0
        ),
        "AerodynamicModel.load": Call(AerodynamicModel.load, {"folder": named(str(GOLDEN_MODEL))}, slow=True),
        "AerodynamicModel.save": Call(_saved, {"folder": output("saved")}, slow=True),
        "AerodynamicModel.interval_ratio": Call(
            _polynomial().interval_ratio,
            {"confidence": replace(confidence, required=True, change=Number((0.9, 0.0, 95.0)))},
        ),
        "AerodynamicModel.support": Call(
            _polynomial().support,
            {"confidence": replace(confidence, required=True, change=Number((0.9, 0.5)))},
        ),
        "AerodynamicModel.load_vehicle": Call(
            _polynomial().load_vehicle,
            {"given": named("bebop2", None, required=False, allowed=of_kinds(str, Path, type(None)))},
        ),
        "AerodynamicModel.require": Call(_polynomial().require, {"vehicle": vehicle}),
        **{
            f"AerodynamicModel.{name}": Call(getattr(_polynomial(), name), {}, share=0.1)
            for name in ("described", "calibration", "share_of_air")
        },
        "AerodynamicModel.simulation_section": Call(_physical().simulation_section, {}, share=0.1),
        "AerodynamicModel.require_rollouts": Call(_physical().require_rollouts, {}, share=0.1),
        "AerodynamicModel.learned_from": Call(
            _polynomial().learned_from, {"sha256": thing("ab", "name", allowed=of_kinds(str))}, share=0.1
        ),
        "IdentifyOptions": Call(
            IdentifyOptions,
            {
                "cutoff_hz": figure(30.0, 50.0, refused=(0.0, -1.0)),
                "method": thing(
                    "polynomial",
                    "method",
                    required=False,
                    same=("polynomial",),
                    allowed=of_kinds(str, type(None)),
                ),
                "settings": thing("default", "settings", required=False, same=("default",)),
                "confidence": figure(0.95, 0.5, 1.0),
                "false_alarms_per_hour": figure(1.0, 2.0, refused=(0.0, -1.0)),
            },
        ),
        "Monitor": Call(
            Monitor,
            {
                "model": model,
                "vehicle": vehicle,
                "rate_hz": replace(
                    figure(_RATE_HZ, 100.0, 10.0, 1e9, optional=True, refused=(0.0, -500.0)), required=True
                ),
                "confidence": confidence,
                "settings": thing(
                    MonitorSettings(), required=False, same=(MonitorSettings(),), allowed=no_value
                ),
            },
            share=2.0,
        ),
        "Monitor.step": Call(
            lambda **given: _monitor().step(**given),
            {"time_ns": rows_of(_stamps()), "values": rows_of(_samples(), finite=False)},
            share=30.0,
        ),
        **{
            f"Monitor.{name}": Call(
                lambda name=name, **given: getattr(_monitor(), name)(Prepared(**given)),
                {
                    "verdicts": rows_of(_prepared().verdicts, finite=False),
                    "inputs": rows_of(_prepared().inputs),
                    "measured": rows_of(_prepared().measured),
                    "usable_ns": rows_of(_prepared().usable_ns),
                    "derivatives": rows_of(_prepared().derivatives),
                },
                share=2.0,
            )
            for name in ("judge", "predict")
        },
        "Monitor.reset": Call(lambda: _monitor().reset(), {}, share=0.1),
        "Monitor.retune": Call(lambda **given: _monitor().retune(**given), {"rate": thing(ImuRate(400.0))}),
        "Monitor.change": Call(
            lambda **given: _monitor().change(**given), {"settings": thing(MonitorSettings())}
        ),
        "Monitor.alarm_without_sample": Call(
            lambda **given: _monitor().alarm_without_sample(**given),
            {"time_ns": Argument(_START_NS, Number((0, 5), (2**63, 0.5, float("nan"))), "number")},
        ),
        "MonitorSettings": Call(
            MonitorSettings,
            {
                **{
                    name: figure(1.0, 0.5, refused=(0.0, -1.0))
                    for name in ("persistence_s", "release_s", "alarm_rate_hz")
                },
                **{
                    name: thing(True, "flag", required=False, allowed=lambda value: isinstance(value, bool))
                    for name in ("adaptive", "change")
                },
            },
        ),
        "QuadpiError": Call(QuadpiError, {}, share=0.1),
        "Vehicle": Call(
            Vehicle,
            {
                "name": thing("bebop2", "name", allowed=lambda _: True),
                **{
                    name: replace(
                        figure(getattr(_vehicle(), name), 1.0, refused=(0.0, -1.0)),
                        required=name in {"mass_kg", "rotor_radius_m"},
                    )
                    for name in (
                        "mass_kg",
                        "rotor_radius_m",
                        "rotor_speed_max_rad_s",
                        "air_density_kg_m3",
                        "gravity_m_s2",
                    )
                },
                **{
                    name: rows_of(short(getattr(_vehicle(), name)))
                    for name in ("inertia", "rotor_positions", "rotor_spins")
                },
                "pole_pairs": thing(None, "name", allowed=lambda _: True),
                "noise": thing(SensorNoise(), required=False),
            },
            share=4.0,
        ),
        "Vehicle.load": Call(Vehicle.load, {"name_or_path": named("bebop2")}),
        "Vehicle.from_content": Call(
            Vehicle.from_content,
            {
                "data": thing(_vehicle().to_file()),
                "name": thing("bebop2", "name", allowed=lambda _: True),
                "where": thing("file", "name", allowed=lambda _: True),
            },
        ),
        "Vehicle.require_four": Call(partial(_vehicle().require_four, "this works"), {}, share=0.1),
        "Vehicle.to_file": Call(_vehicle().to_file, {}, share=0.1),
        "Vehicle.rotor_speeds_from_erpm": Call(
            replace(_vehicle(), pole_pairs=7).rotor_speeds_from_erpm,
            {"erpm": Argument(np.full((_ROWS, ROTORS), 7000.0), _ByRotor(tied=False, finite=False), "array")},
        ),
        # Records that users make.
        "PreparedFlight": Call(
            PreparedFlight,
            {
                "name": thing("flight", "name", allowed=lambda _: True),
                "sha256": thing("ab", "name", allowed=lambda _: True),
                **{
                    name: rows_of(getattr(flight, name), finite=False)
                    for name in ("time", "inputs", "derivatives", "wrench", "height")
                },
            },
            keeps=True,
            share=4.0,
        ),
        "LiveSamples": Call(
            lambda **given: replace(flight, live=LiveSamples(**given)),
            {
                **{
                    name: rows_of(getattr(flight, name), finite=False)
                    for name in ("inputs", "derivatives", "wrench")
                },
                "known": rows_of(np.ones(_ROWS, bool)),
            },
            keeps=True,
            share=3.0,
        ),
        "Flight": Call(
            lambda **given: Flight("flight", "bebop2", "flight.mcap", _START_NS, **given),
            {
                name: rows_of(getattr(flown, name), finite=False)
                for name in (
                    "time",
                    "position",
                    "velocity",
                    "rates",
                    "wind",
                    "attitude",
                    "angular_acceleration",
                    "specific_force",
                    "rotor_speeds",
                )
            },
            keeps=True,
            share=4.0,
        ),
        "Recording.check": Call(
            _recorded,
            {
                "time_ns": rows_of(_stamps(), exact=True),
                "angular_velocity": rows_of(_samples()[:, 7:10].copy(), exact=True),
                "specific_force": rows_of(_samples()[:, 10:13].copy(), exact=True),
                "position": rows_of(np.zeros((_ROWS, 3)), exact=True),
                "attitude": rows_of(_attitudes(), exact=True),
            },
            share=4.0,
        ),
    }


@cache
def file_calls() -> dict[str, Call]:
    """Those that read or write files, and those that fit or judge."""
    vehicle, flight, flown = thing(_vehicle(), refused=(Vehicle.load("neurobem"),)), _flight(), _flown()
    model, confidence = thing(_polynomial()), confidence_level()
    return {
        "identify": Call(
            quadpi.identify,
            {
                "flights": thing(
                    [_flight("a", 7), _flight("b", 8)],
                    same=((_flight("a", 7), _flight("b", 8)),),
                    refused=(flight, "ab", [flight, None]),
                ),
                "vehicle": thing(_vehicle()),
                "pools": thing(_pools(), refused=({"Fz": None}, {"Fq": _pools()["Fz"]}, ["Fz"])),
                "options": thing(
                    IdentifyOptions(method="polynomial"), refused=("polynomial", MonitorSettings())
                ),
            },
            slow=True,
        ),
        "judge": Call(
            quadpi.judge,
            {
                "model": model,
                "flights": thing(
                    [flight], same=(flight, (flight,)), refused=([flight, flight], [flown], [flight.inputs])
                ),
                "groups": thing(
                    {"all": ["flight"]},
                    same=({"all": "flight"}, {"all": ("flight",)}),
                    refused=({"all": ["other"]}, {"all": []}, {"all": None}),
                    allowed=lambda value: isinstance(value, dict) and not value,
                ),
                "confidence": confidence,
            },
            slow=True,
        ),
        "load_pools": Call(quadpi.load_pools, {"name_or_path": named("quadrotor")}, slow=True),
        "load_scenario": Call(quadpi.load_scenario, {"name_or_path": named("bundled")}, slow=True),
        "load_simulation": Call(
            slow=True,
            function=quadpi.load_simulation,
            arguments={
                "text": named("bebop2"),
                "vehicle": named("bebop2", None, required=False, allowed=of_kinds(str, Path, type(None))),
                "bags": thing(
                    [],
                    "paths",
                    required=False,
                    same=((), "a.mcap", [Path("a.mcap")]),
                    allowed=of_kinds(str, Path, list, tuple),
                ),
            },
        ),
        "prepare_flights": Call(
            quadpi.prepare_flights,
            {
                "paths": _paths(),
                "vehicle": thing(_vehicle()),
                "cutoff_hz": figure(30.0, 20.0, refused=(0.0, -1.0, 1e9)),
                "workers": thing(Workers(), required=False),
            },
            slow=True,
        ),
        "read_flights": Call(
            quadpi.read_flights,
            {
                "paths": _paths(),
                "simulation": thing(quadpi.load_simulation("bebop2")),
                "workers": thing(Workers(), required=False),
            },
            slow=True,
        ),
        "read_recording": Call(
            quadpi.read_recording,
            {
                "path": named(str(_bag())),
                "vehicle": thing(_vehicle(), allowed=no_value),
                "mapping": thing(None, "name", required=False, refused=("nanodrone",), allowed=no_value),
            },
            slow=True,
        ),
        "replay": Call(
            quadpi.replay,
            {
                "model": model,
                "vehicle": vehicle,
                "bag": named(str(_bag())),
                "output": output("replayed.mcap"),
                "confidence": confidence,
                "settings": thing(MonitorSettings(), required=False, allowed=no_value),
            },
            slow=True,
        ),
        "simulate": Call(
            quadpi.simulate,
            {
                "plans": thing(
                    [_plan()],
                    same=(_plan(), (_plan(),)),
                    refused=("bundled", quadpi.load_scenario("bundled"), [_plan(), "bundled"]),
                    allowed=of_kinds(list, tuple),
                ),
                "output": output(""),
                "workers": thing(Workers(), required=False),
            },
            slow=True,
        ),
        "study": Call(
            quadpi.study,
            {
                "simulation": thing(quadpi.load_simulation("bebop2")),
                "flights": thing([flown, flown], refused=([flown], flown, [flight, flight])),
                "names": thing(None, "names", required=False, allowed=of_kinds(str, list, tuple, type(None))),
                "seed": Argument(0, Number((1, 5), (-1, 0.5, float("nan"))), "number", required=False),
            },
            slow=True,
        ),
    }


def _saved(folder: Any) -> str:
    return _polynomial().save(folder).identity.partition("@")[2]


def _recorded(time_ns: Any, angular_velocity: Any, specific_force: Any, position: Any, attitude: Any) -> None:
    imu = ImuStream(time_ns, angular_velocity, specific_force)
    pose = PoseStream(time_ns, position, attitude)
    Recording("flight", "bebop2", "flight.mcap", imu, pose=pose).check()


@cache
def _bag() -> Path:
    """A simulated flight of a second and a half."""
    (flown,) = quadpi.simulate([_plan()], folder())
    return flown.bag


@cache
def _plan() -> Any:
    (plan, *_) = quadpi.load_scenario("bundled").flights
    return plan.overridden(name="short", duration_s=2.5, motion={}, faults=[], effects={})


def _paths() -> Argument:
    bag = _bag()
    return thing(
        [bag, _BAGS / "train_1.mcap"],
        "paths",
        same=([str(bag), str(_BAGS / "train_1.mcap")], (bag, _BAGS / "train_1.mcap")),
        refused=([bag, bag], [None], [bag, 5], {"a": bag}, bag / "no.mcap"),
        allowed=lambda value: isinstance(value, list | tuple) and not value,
    )


# Cases.


def make_call(rng: random.Random, known_calls: Callable[[], dict[str, Call]] = calls) -> bytes:
    """The bytes of a case: the name of a call, and where its changes begin."""
    known = known_calls()
    (name,) = rng.choices(list(known), [call.share for call in known.values()])
    return f"{name}\n{rng.getrandbits(64)}".encode()


def read_call(path: Path, _number: int) -> None:
    """Make the call of a case.

    Raises:
        Finding: for anything but what the call must do.
        QuadpiError: where it must.
    """
    name, seed = path.read_bytes().decode().split("\n")
    check_call(_named(name), name, random.Random(seed))


def _named(name: str) -> Call:
    """A call, without the others' files and models where it needs none."""
    for known in (array_calls, library_calls, file_calls):
        if name in known():
            return known()[name]
    raise KeyError(name)


def check_call(call: Call, name: str, rng: random.Random) -> None:
    """Make a call with changed arguments, see :func:`read_call`."""
    given, must, changed = _changed(call, rng)
    if call.slow and must < Must.REFUSE and rng.random() > _SLOW_MADE:
        return
    try:
        result = call.function(**given)
    except QuadpiError as error:
        if must is Must.REFUSE_AS_PYTHON or (must is Must.GIVE_THE_SAME and clean_result(name) is not None):
            raise Finding(f"{name}: {changed}: refused, though right: {error}") from error
        raise
    except TypeError as error:
        if must is Must.REFUSE_AS_PYTHON and "argument" in str(error):
            return
        raise
    if must >= Must.REFUSE:
        raise Finding(f"{name}: {changed}: let pass")
    parts = list(_parts(result))
    if must is Must.GIVE_THE_SAME:
        clean = clean_result(name) or []
        if len(parts) != len(clean) or not all(map(_alike, parts, clean)):
            raise Finding(f"{name}: {changed}: another result")
    elif not call.keeps and not all(np.isfinite(part).all() for part in parts if part.dtype.kind == "f"):
        raise Finding(f"{name}: {changed}: a result that is not finite")


def _changed(call: Call, rng: random.Random) -> tuple[dict[str, Any], Must, str]:
    """Arguments, what the call must do, and what was changed."""
    given = {name: argument.clean for name, argument in call.arguments.items()}
    names = list(given)
    if names and rng.random() < _MISCALLED:
        required = [name for name in names if call.arguments[name].required]
        kind = rng.randrange(3)
        if kind == 0 and required:
            name = rng.choice(required)
            del given[name]
            return given, Must.REFUSE_AS_PYTHON, f"without {name}"
        if kind == 1:
            return {**given, "extra": 1}, Must.REFUSE_AS_PYTHON, "one more"
        pairs = [
            (one, two)
            for one in required
            for two in required
            if call.arguments[one].kind != call.arguments[two].kind
        ]
        if pairs:
            one, two = rng.choice(pairs)
            given[one], given[two] = given[two], given[one]
            return given, Must.REFUSE, f"{one} and {two} in each other's place"
    must, words = Must.GIVE_THE_SAME, []
    for name in rng.sample(names, min(len(names), rng.choice((0, 1, 1, 1, 1, 2, 3)))):
        argument = call.arguments[name]
        value, own = argument.change(rng, argument.clean)
        lengths = [len(value) for value in given.values() if isinstance(value, np.ndarray) and value.ndim]
        rows = argument.clean.shape[:1] if isinstance(argument.clean, np.ndarray) else None
        if isinstance(value, np.ndarray) and value.ndim and value.shape[:1] != rows and len(value) in lengths:
            continue  # arrays that were changed alike fit each other
        given[name] = value
        must = max(must, own)
        words.append(f"{name} = {_shown(given[name])}")
    return given, must, ", ".join(words) or "nothing changed"


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype if value.dtype.names is None else 'records'} {value.shape}"
    return repr(value)[:80]


@cache
def clean_result(name: str) -> list[npt.NDArray[Any]] | None:
    """The parts of the result of a call with its clean arguments; what it needs is then compiled.

    None for a call that is refused as it is: flights of hover alone cannot be studied.
    """
    call = _named(name)
    try:
        result = call.function(**{key: argument.clean for key, argument in call.arguments.items()})
    except QuadpiError:
        return None
    return list(_parts(result))


def _parts(result: Any) -> Iterator[npt.NDArray[Any]]:
    """The numbers and words of a result."""
    if isinstance(result, np.ndarray):
        if result.dtype.names is None:
            yield result
        else:
            for name in result.dtype.names:
                yield from _parts(result[name])
    elif isinstance(result, bool | int | float | str | np.generic):
        yield np.asarray(result)
    elif isinstance(result, Mapping):
        for key in result:
            yield from _parts(result[key])
    elif isinstance(result, list | tuple):
        for part in result:
            yield from _parts(part)
    elif is_dataclass(result) and not isinstance(result, type):
        for column in fields(result):
            if column.compare:
                yield from _parts(getattr(result, column.name))


def _alike(one: npt.NDArray[Any], other: npt.NDArray[Any]) -> bool:
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f" and other.dtype.kind == "f")


def warm_up(known: Mapping[str, Call]) -> None:
    """Import what calls need, before processes are forked that have little time for each."""
    for name in known:
        clean_result(name)


def public_calls() -> Iterator[str]:
    """The public names that can be called, and the methods of those that are classes."""
    for name in dir(quadpi):
        public = getattr(quadpi, name)
        if name.startswith("__") or not callable(public):
            continue
        if public is not AerodynamicModel:  # which `identify` and `load` make
            yield name
        if inspect.isclass(public) and not issubclass(public, Exception):
            for method, value in vars(public).items():
                if not method.startswith("_") and isinstance(
                    value, staticmethod | classmethod | type(public_calls)
                ):
                    yield f"{name}.{method}"
