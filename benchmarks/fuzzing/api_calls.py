# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Calls of every public name with changed arguments, and what each must then do.

A call whose arrays do not fit each other, or that is given what it does not take, must raise a QuadpiError;
arguments that say the same in another form must give the same result. Every public name and method has an
entry here: a test looks for those that have none.
"""

from __future__ import annotations

import atexit
import inspect
import random
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import quadpi_core as quadpi
from benchmarks.fuzzing.argument_changes import Argument, Must, Number, Other, Rows
from benchmarks.fuzzing.mutation import Finding
from quadpi_core.errors import QuadpiError
from quadpi_core.estimator.imu_rate import ImuRate
from quadpi_core.flight import Flight, ImuStream, PoseStream, Recording
from quadpi_core.identification.prepared_flights import LiveSamples, PreparedFlight
from quadpi_core.inputs import DERIVATIVES, aerodynamic_inputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.candidate_pool import CandidatePool
from quadpi_core.models.kinds.physical import Physical
from quadpi_core.models.model_kind import IdentifyOptions
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


@dataclass(frozen=True)
class Call:
    """A public call.

    Attributes:
        function: what is called, with `arguments` by keyword.
        arguments: by parameter.
        share: of all calls.
        slow: whether it takes more than some milliseconds to give a result.
        keeps: whether it gives a record that keeps what it is given, finite or not.
    """

    function: Callable[..., Any]
    arguments: Mapping[str, Argument]
    share: float = 1.0
    slow: bool = False
    keeps: bool = False


# Clean arguments: numbers that fit 32 bits, so that arrays of them say the same.


def _short(values: Any) -> npt.NDArray[np.float64]:
    return np.asarray(values, np.float32).astype(np.float64)


@cache
def _vehicle() -> Vehicle:
    return Vehicle.load("bebop2")


@cache
def _inputs() -> npt.NDArray[np.float64]:
    rng = np.random.default_rng(0)
    velocity, rates = rng.normal(size=(_ROWS, 3)), 0.3 * rng.normal(size=(_ROWS, 3))
    speeds = rng.normal(750.0, 40.0, (_ROWS, ROTORS))
    return _short(aerodynamic_inputs(velocity, _attitudes(), rates, speeds, _vehicle()))


@cache
def _attitudes() -> npt.NDArray[np.float64]:
    attitude = np.array([1.0, 0.0, 0.0, 0.0]) + 0.1 * np.random.default_rng(1).normal(size=(_ROWS, 4))
    return _short(attitude / np.linalg.norm(attitude, axis=1)[:, None])


@cache
def _derivatives() -> npt.NDArray[Any]:
    derivatives = np.zeros(_ROWS, DERIVATIVES)
    numbers = derivatives.view(np.float64)
    numbers[:] = _short(np.random.default_rng(2).normal(size=numbers.shape))
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
    return _short(samples)


@cache
def _flight(name: str = "flight", seed: int = 4) -> PreparedFlight:
    rng = np.random.default_rng(seed)
    wrench = _short(0.01 * rng.normal(size=(_ROWS, 6)) + _inputs()[:, :1] * [0.1, 0.0, 0.2, 0.0, 0.0, 0.01])
    time = _short(0.002 * np.arange(_ROWS))
    return PreparedFlight(name, 32 * "ab", time, _inputs(), _derivatives(), wrench, _short(time + 2.0))


@cache
def _polynomial() -> AerodynamicModel:
    return AerodynamicModel.load(GOLDEN_MODEL)


@cache
def _physical() -> AerodynamicModel:
    """Fitted to made-up flights: it is about the call, not about what it says."""
    flights, rows = [], np.arange(1200) % _ROWS
    for seed in (5, 6):
        short = _flight(f"flight {seed}", seed)
        columns = {name: getattr(short, name)[rows] for name in ("inputs", "derivatives", "wrench", "height")}
        flights.append(replace(short, time=_short(0.002 * np.arange(len(rows))), **columns))
    options = IdentifyOptions(method=Physical(multi_step=False))
    return quadpi.identify(flights, _vehicle(), quadpi.load_pools("quadrotor"), options)


@cache
def _pools() -> dict[str, CandidatePool]:
    return {"Fz": CandidatePool.parse(["w"], []), "Fx": CandidatePool.parse(["u"], [])}


@cache
def _prepared() -> Prepared:
    prepared = _monitor().preparation.step(_stamps(), _samples())
    return prepared._replace(
        inputs=_short(prepared.inputs), measured=_short(prepared.measured), derivatives=_derivatives()
    )


@cache
def _folder() -> Path:
    """A folder for what calls write, until this process ends."""
    place = "/dev/shm" if Path("/dev/shm").is_dir() else None
    folder = tempfile.mkdtemp(prefix="quadpi.fuzz.", dir=place)
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


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


def _any(*kinds: type) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, kinds) and not isinstance(value, bool)


def _output(name: str) -> Argument:
    """A path to write to; no other one, as files of the calls would lie about."""
    path = _folder() / name

    def change(rng: random.Random, _value: Any) -> tuple[Any, Must]:
        if rng.random() < 0.5:
            return rng.choice((path, str(path))), Must.GIVE_THE_SAME
        return rng.choice((None, 5, 1.5, b"x", [], [str(path)], 1j, "\0", "")), Must.REFUSE

    return Argument(str(path), change, "name")


def _none(value: Any) -> bool:
    return value is None


def _rows(clean: Any, **how: bool) -> Argument:
    return Argument(clean, Rows(**how), f"array {np.shape(clean)[1:]} {np.asarray(clean).dtype.kind}")


def _a(clean: Any, kind: str = "", *, required: bool = True, **how: Any) -> Argument:
    return Argument(clean, Other(**how), kind or type(clean).__name__, required)


def _number(
    clean: float, *others: float, optional: bool = False, refused: tuple[float, ...] = ()
) -> Argument:
    refused = (*Number.refused, *refused)
    return Argument(clean, Number(others, refused, optional), "number", required=False)


def _name(clean: str, *same: Any, **how: Any) -> Argument:
    how.setdefault("allowed", lambda value: isinstance(value, str | Path))
    return _a(clean, "name", same=(Path(clean), clean, *same), **how)


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


def _confidence() -> Argument:
    return _number(0.95, 0.9, 0.5, 0.99, 0.0, -1.0, 95.0, 1.0, optional=True)


def calls() -> dict[str, Call]:
    """Every public call, by its name."""
    return {**array_calls(), **file_calls()}


@cache
def array_calls() -> dict[str, Call]:
    """Those that take numbers and arrays."""
    vehicle, flight, flown = _a(_vehicle(), refused=(Vehicle.load("neurobem"),)), _flight(), _flown()
    model, confidence = _a(_polynomial()), _confidence()
    evaluated = {"confidence": confidence}
    return {
        "AerodynamicModel.evaluate, physical": Call(
            _physical().evaluate,
            {
                "flight": _rows(_inputs()),
                **evaluated,
                "derivatives": replace(_rows(_derivatives()), required=False),
            },
            share=15.0,
        ),
        "AerodynamicModel.evaluate, polynomial": Call(
            _polynomial().evaluate,
            {
                "flight": _rows(_inputs()),
                **evaluated,
                "derivatives": Argument(_derivatives(), Rows(optional=True), "derivatives", required=False),
            },
            share=15.0,
        ),
        "AerodynamicModel.evaluate": Call(
            _physical().evaluate, {"flight": _a(flight), **evaluated}, share=2.0
        ),
        "AerodynamicModel.load": Call(AerodynamicModel.load, {"folder": _name(str(GOLDEN_MODEL))}, slow=True),
        "AerodynamicModel.save": Call(_saved, {"folder": _output("saved")}, slow=True),
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
            {"given": _name("bebop2", None, required=False, allowed=_any(str, Path, type(None)))},
        ),
        "AerodynamicModel.require": Call(_polynomial().require, {"vehicle": vehicle}),
        **{
            f"AerodynamicModel.{name}": Call(getattr(_polynomial(), name), {}, share=0.1)
            for name in ("described", "calibration")
        },
        "AerodynamicModel.simulation_section": Call(_physical().simulation_section, {}, share=0.1),
        "AerodynamicModel.require_rollouts": Call(_physical().require_rollouts, {}, share=0.1),
        "AerodynamicModel.learned_from": Call(
            _polynomial().learned_from, {"sha256": _a("ab", "name", allowed=_any(str))}, share=0.1
        ),
        "IdentifyOptions": Call(
            IdentifyOptions,
            {
                "cutoff_hz": _number(30.0, 50.0, refused=(0.0, -1.0)),
                "method": _a(
                    "polynomial",
                    "method",
                    required=False,
                    same=("polynomial",),
                    allowed=_any(str, type(None)),
                ),
                "settings": _a("default", "settings", required=False, same=("default",)),
                "confidence": _number(0.95, 0.5, 1.0),
                "false_alarms_per_hour": _number(1.0, 2.0, refused=(0.0, -1.0)),
            },
        ),
        "Monitor": Call(
            Monitor,
            {
                "model": model,
                "vehicle": vehicle,
                "rate_hz": replace(
                    _number(_RATE_HZ, 100.0, 10.0, 1e9, optional=True, refused=(0.0, -500.0)), required=True
                ),
                "confidence": confidence,
                "settings": _a(MonitorSettings(), required=False, same=(MonitorSettings(),), allowed=_none),
            },
            share=2.0,
        ),
        "Monitor.step": Call(
            lambda **given: _monitor().step(**given),
            {"time_ns": _rows(_stamps()), "values": _rows(_samples(), finite=False)},
            share=30.0,
        ),
        **{
            f"Monitor.{name}": Call(
                lambda name=name, **given: getattr(_monitor(), name)(Prepared(**given)),
                {
                    "verdicts": _rows(_prepared().verdicts, finite=False),
                    "inputs": _rows(_prepared().inputs),
                    "measured": _rows(_prepared().measured),
                    "usable_ns": _rows(_prepared().usable_ns),
                    "derivatives": _rows(_prepared().derivatives),
                },
                share=2.0,
            )
            for name in ("judge", "predict")
        },
        "Monitor.reset": Call(lambda: _monitor().reset(), {}, share=0.1),
        "Monitor.retune": Call(lambda **given: _monitor().retune(**given), {"rate": _a(ImuRate(400.0))}),
        "Monitor.change": Call(
            lambda **given: _monitor().change(**given), {"settings": _a(MonitorSettings())}
        ),
        "Monitor.alarm_without_sample": Call(
            lambda **given: _monitor().alarm_without_sample(**given),
            {"time_ns": Argument(_START_NS, Number((0, 5), (2**63, 0.5, float("nan"))), "number")},
        ),
        "MonitorSettings": Call(
            MonitorSettings,
            {
                **{
                    name: _number(1.0, 0.5, refused=(0.0, -1.0))
                    for name in ("persistence_s", "release_s", "alarm_rate_hz")
                },
                "adaptive": _a(True, "flag", required=False, allowed=lambda value: isinstance(value, bool)),
            },
        ),
        "QuadpiError": Call(QuadpiError, {}, share=0.1),
        "Vehicle": Call(
            Vehicle,
            {
                "name": _a("bebop2", "name", allowed=lambda _: True),
                **{
                    name: replace(
                        _number(getattr(_vehicle(), name), 1.0, refused=(0.0, -1.0)),
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
                    name: _rows(_short(getattr(_vehicle(), name)))
                    for name in ("inertia", "rotor_positions", "rotor_spins")
                },
                "pole_pairs": _a(None, "name", allowed=lambda _: True),
                "noise": _a(SensorNoise(), required=False),
            },
            share=4.0,
        ),
        "Vehicle.load": Call(Vehicle.load, {"name_or_path": _name("bebop2")}),
        "Vehicle.of_file": Call(
            Vehicle.of_file,
            {
                "data": _a(_vehicle().to_file()),
                "name": _a("bebop2", "name", allowed=lambda _: True),
                "where": _a("file", "name", allowed=lambda _: True),
            },
        ),
        "Vehicle.to_file": Call(_vehicle().to_file, {}, share=0.1),
        "Vehicle.rotor_speeds_from_erpm": Call(
            replace(_vehicle(), pole_pairs=7).rotor_speeds_from_erpm,
            {"erpm": Argument(np.full((_ROWS, ROTORS), 7000.0), _ByRotor(tied=False, finite=False), "array")},
        ),
        # Records that users make.
        "PreparedFlight": Call(
            PreparedFlight,
            {
                "name": _a("flight", "name", allowed=lambda _: True),
                "sha256": _a("ab", "name", allowed=lambda _: True),
                **{
                    name: _rows(getattr(flight, name), finite=False)
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
                    name: _rows(getattr(flight, name), finite=False)
                    for name in ("inputs", "derivatives", "wrench")
                },
                "known": _rows(np.ones(_ROWS, bool)),
            },
            keeps=True,
            share=3.0,
        ),
        "Flight": Call(
            lambda **given: Flight("flight", "bebop2", "flight.mcap", _START_NS, **given),
            {
                name: _rows(getattr(flown, name), finite=False)
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
                "time_ns": _rows(_stamps(), exact=True),
                "angular_velocity": _rows(_samples()[:, 7:10].copy(), exact=True),
                "specific_force": _rows(_samples()[:, 10:13].copy(), exact=True),
                "position": _rows(np.zeros((_ROWS, 3)), exact=True),
                "attitude": _rows(_attitudes(), exact=True),
            },
            share=4.0,
        ),
    }


@cache
def file_calls() -> dict[str, Call]:
    """Those that read or write files, and those that fit or judge."""
    vehicle, flight, flown = _a(_vehicle(), refused=(Vehicle.load("neurobem"),)), _flight(), _flown()
    model, confidence = _a(_polynomial()), _confidence()
    return {
        "identify": Call(
            quadpi.identify,
            {
                "flights": _a(
                    [_flight("a", 7), _flight("b", 8)],
                    same=((_flight("a", 7), _flight("b", 8)),),
                    refused=(flight, "ab", [flight, None]),
                ),
                "vehicle": _a(_vehicle()),
                "pools": _a(_pools(), refused=({"Fz": None}, {"Fq": _pools()["Fz"]}, ["Fz"])),
                "options": _a(
                    IdentifyOptions(method="polynomial"), refused=("polynomial", MonitorSettings())
                ),
            },
            slow=True,
        ),
        "judge": Call(
            quadpi.judge,
            {
                "model": model,
                "flights": _a(
                    [flight], same=(flight, (flight,)), refused=([flight, flight], [flown], [flight.inputs])
                ),
                "groups": _a(
                    {"all": ["flight"]},
                    same=({"all": "flight"}, {"all": ("flight",)}),
                    refused=({"all": ["other"]}, {"all": []}, {"all": None}),
                    allowed=lambda value: isinstance(value, dict) and not value,
                ),
                "confidence": confidence,
            },
            slow=True,
        ),
        "load_pools": Call(quadpi.load_pools, {"name_or_path": _name("quadrotor")}, slow=True),
        "load_scenario": Call(quadpi.load_scenario, {"name_or_path": _name("bundled")}, slow=True),
        "load_simulation": Call(
            slow=True,
            function=quadpi.load_simulation,
            arguments={
                "text": _name("bebop2"),
                "vehicle": _name("bebop2", None, required=False, allowed=_any(str, Path, type(None))),
                "bags": _a(
                    [],
                    "paths",
                    required=False,
                    same=((), "a.mcap", [Path("a.mcap")]),
                    allowed=_any(str, Path, list, tuple),
                ),
            },
        ),
        "prepare_flights": Call(
            quadpi.prepare_flights,
            {
                "paths": _paths(),
                "vehicle": _a(_vehicle()),
                "cutoff_hz": _number(30.0, 20.0, refused=(0.0, -1.0, 1e9)),
                "workers": _a(Workers(), required=False),
            },
            slow=True,
        ),
        "read_flights": Call(
            quadpi.read_flights,
            {
                "paths": _paths(),
                "simulation": _a(quadpi.load_simulation("bebop2")),
                "workers": _a(Workers(), required=False),
            },
            slow=True,
        ),
        "read_recording": Call(
            quadpi.read_recording,
            {
                "path": _name(str(_bag())),
                "vehicle": _a(_vehicle(), allowed=_none),
                "mapping": _a(None, "name", required=False, refused=("nanodrone",), allowed=_none),
            },
            slow=True,
        ),
        "replay": Call(
            quadpi.replay,
            {
                "model": model,
                "vehicle": vehicle,
                "bag": _name(str(_bag())),
                "output": _output("replayed.mcap"),
                "confidence": confidence,
                "settings": _a(MonitorSettings(), required=False, allowed=_none),
            },
            slow=True,
        ),
        "simulate": Call(
            quadpi.simulate,
            {
                "plans": _a(
                    [_plan()],
                    same=(_plan(), (_plan(),)),
                    refused=("bundled", quadpi.load_scenario("bundled"), [_plan(), "bundled"]),
                    allowed=_any(list, tuple),
                ),
                "output": _output(""),
                "workers": _a(Workers(), required=False),
            },
            slow=True,
        ),
        "study": Call(
            quadpi.study,
            {
                "simulation": _a(quadpi.load_simulation("bebop2")),
                "flights": _a([flown, flown], refused=([flown], flown, [flight, flight])),
                "names": _a(None, "names", required=False, allowed=_any(str, list, tuple, type(None))),
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
    (flown,) = quadpi.simulate([_plan()], _folder())
    return flown.bag


@cache
def _plan() -> Any:
    (plan, *_) = quadpi.load_scenario("bundled").flights
    return plan.overridden(name="short", duration_s=2.5, motion={}, faults=[], effects={})


def _paths() -> Argument:
    bag = _bag()
    return _a(
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
    return array_calls()[name] if name in array_calls() else file_calls()[name]


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
        if isinstance(value, np.ndarray) and value.ndim and len(value) != _ROWS and len(value) in lengths:
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
    """Compile what calls need, before processes are forked that have little time for each."""
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
