# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Calls of the room of the library: flights, tables, models by the protocol of scikit-learn, the monitor."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

import quadpi_core as quadpi
from benchmarks.fuzzing.argument_changes import (
    Argument,
    Call,
    Must,
    Number,
    Rows,
    confidence_level,
    figure,
    named,
    no_value,
    of_kinds,
    output,
    short,
    thing,
)
from quadpi_core.flight import AXES
from quadpi_core.library.flights import Flights
from quadpi_core.library.live_monitor import Monitor
from quadpi_core.library.wrench_model import WrenchModel
from quadpi_core.logs.flight_table import columns_of
from quadpi_core.monitor.alarm import MonitorSettings
from quadpi_core.vehicle import Vehicle

_BAGS = Path(__file__).parents[2] / "bags"
_GOLDEN_MODEL = Path(__file__).parents[2] / "test" / "golden" / "model"
_STATES = columns_of(4)
# Samples of each flight: 1.2 s, of which a raw one needs the first to measure its rate.
_ROWS = 600
_MOVING = 2000
_DERIVED = "angular_acceleration"
# What another unit multiplies a quantity by: rpm, g, mm/s, deg/s; and attitudes that are no rotations.
_OTHER_UNITS = {
    "rotor_speeds": 9.55,
    "specific_force": 0.102,
    "velocity": 1000.0,
    "rates": 57.3,
    "attitude": 2.0,
}


# Clean arguments.


@cache
def _table() -> pd.DataFrame:
    """Two flights of 1.2 s that move, low-passed."""
    flights = quadpi.load_flights([_BAGS / "train_1.mcap", _BAGS / "train_2.mcap"], "bebop2")
    whole = flights.to_pandas()
    parts = [rows.iloc[_MOVING : _MOVING + _ROWS] for _, rows in whole.groupby("flight")]
    table: pd.DataFrame = pd.concat(parts, ignore_index=True)
    for name in table.columns:
        if table[name].dtype.kind == "f":
            table[name] = short(table[name])
    table.attrs = {"cutoff_hz": 30.0}
    return table


@cache
def _raw() -> pd.DataFrame:
    return _table().drop(columns=list(_STATES[_DERIVED]))


@cache
def _flights() -> Flights:
    return Flights.from_pandas(_table(), vehicle="bebop2", filtered=True)


@cache
def _model() -> WrenchModel:
    return WrenchModel("polynomial", axes=["Fx", "Fz"]).fit(_flights())


def _held(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The columns of the axes that the model holds: the others are NaN."""
    return values[:, np.isin(AXES, _model().axes_)]


class _Regressor:
    """Predicts what it is told to, once fitted to as many samples as it takes."""

    def __init__(self, predicted: Callable[[npt.NDArray[Any]], Any], most: float = np.inf) -> None:
        self.predicted = predicted
        self.most = most

    def fit(self, X: npt.NDArray[Any], y: npt.NDArray[Any]) -> None:
        """Refuse what are too many.

        Raises:
            ValueError: as other libraries do.
        """
        if not len(X) == len(y) <= self.most:
            raise ValueError(f"found {len(y)} samples,\nexpected {self.most}")

    def predict(self, X: npt.NDArray[Any]) -> Any:
        """See the class."""
        return self.predicted(X)


def _raise(error: Exception) -> Any:
    raise error


_STRANGE_REGRESSORS = (
    _Regressor(lambda X: np.full(len(X), np.nan)),
    _Regressor(lambda X: np.zeros((len(X), 2))),
    _Regressor(lambda _: None),
    _Regressor(lambda _: 0.0),
    _Regressor(lambda X: np.full(len(X), 1j)),
    _Regressor(lambda X: ["a"] * len(X)),
    _Regressor(lambda X: [[0.0], [0.0, 1.0]] * (len(X) // 2)),
    _Regressor(lambda X: _raise(IndexError(f"list index {len(X)} out of range"))),
    _Regressor(lambda X: np.zeros(len(X)), most=10),
)


# Parameters.


@dataclass(frozen=True)
class _Units(Rows):
    """Changes to an array (N, …) that may be in another unit.

    Attributes:
        factor: of all its numbers; None where none is noticed.
        integrated: whether None stands for what other arrays give.
    """

    factor: float | None = None
    integrated: bool = False

    def _numbers(self, rng: random.Random, array: npt.NDArray[Any]) -> tuple[Any, Must]:
        if self.factor is not None and rng.random() < 0.5:
            return self.factor * array, Must.REFUSE
        return super()._numbers(rng, array)

    def _values(self, rng: random.Random, array: npt.NDArray[Any]) -> tuple[Any, Must]:
        changed, must = super()._values(rng, array)
        return changed, Must.END_WELL if changed is None and self.integrated else must


def _with(table: pd.DataFrame, name: str, values: Any) -> pd.DataFrame:
    return table.assign(**{name: values})


def _of_a_column(change: Callable[[pd.Series], Any]) -> Callable[[random.Random, pd.DataFrame], pd.DataFrame]:
    """A change to one of the columns that are needed."""

    def changed(rng: random.Random, table: pd.DataFrame) -> pd.DataFrame:
        name = rng.choice([name for quantity in _OTHER_UNITS for name in _STATES[quantity]])
        return _with(table, name, change(table[name].copy()))

    return changed


def _one(value: Any) -> Callable[[pd.Series], Any]:
    """A change to one row of a column."""

    def changed(column: pd.Series) -> Any:
        column.iloc[7] = value
        return column

    return changed


def _in_another_unit(rng: random.Random, table: pd.DataFrame) -> pd.DataFrame:
    quantity, factor = rng.choice(list(_OTHER_UNITS.items()))
    columns = list(_STATES[quantity])
    return table.assign(**dict(zip(columns, (factor * table[columns].to_numpy()).T, strict=True)))


_Changes = tuple[Callable[[random.Random, pd.DataFrame], Any], ...]
_SAME_TABLES: _Changes = (
    lambda _, table: table[table.columns[::-1]],
    lambda _, table: table.set_index(table.index[::-1]),
    lambda _, table: table.set_index(pd.Index(np.zeros(len(table), int))),
    lambda _, table: table.convert_dtypes(),
    lambda _, table: _with(table, "time_ns", pd.to_datetime(table["time_ns"])),
    lambda _, table: _with(table, "time_ns", pd.to_datetime(table["time_ns"], utc=True)),
    lambda _, table: _with(table, "flight", table["flight"].astype("category")),
    lambda _, table: _with(table, "of my own", "text"),
    _of_a_column(lambda column: column.astype("float32")),
    _of_a_column(lambda column: column.astype("Float64")),
)
_REFUSED_TABLES: _Changes = (
    lambda _, table: table.iloc[:0],
    lambda _, table: table.iloc[:1],
    lambda _, table: table.iloc[::-1],
    lambda _, table: pd.concat((table, table)),
    lambda _, table: pd.concat((table, table[["u_m_s", "time_ns", "flight"]]), axis=1),
    lambda _, table: pd.concat({"a": table}, axis=1),
    lambda _, table: table.set_axis(range(len(table.columns)), axis=1),
    lambda _, table: table.set_index(["flight", "time_ns"]),
    lambda _, table: table.drop(columns="qw"),
    lambda _, table: table["u_m_s"],
    lambda _, table: table.to_numpy(),
    lambda _, table: table.to_dict(),
    lambda _, table: pd.DataFrame(index=table.index),
    lambda _, table: _with(table, "time_ns", 1e-9 * table["time_ns"]),
    lambda _, table: _with(table, "time_ns", table["time_ns"].astype(str)),
    lambda _, table: _with(table, "time_ns", pd.to_timedelta(table["time_ns"])),
    lambda _, table: _with(table, "time_ns", _one(pd.NA)(table["time_ns"].astype("Int64"))),
    lambda _, table: _with(table, "time_ns", _one(pd.NaT)(pd.to_datetime(table["time_ns"]))),
    lambda _, table: _with(table, "flight", _one(None)(table["flight"].copy())),
    _of_a_column(_one(np.nan)),
    _of_a_column(_one(np.inf)),
    _of_a_column(lambda column: column.astype(str)),
    _of_a_column(lambda column: column.astype(object)),
    _of_a_column(lambda column: column.astype(complex)),
    _of_a_column(lambda column: column > 0.0),
    _of_a_column(lambda column: _one(pd.NA)(column.astype("Float64"))),
    _of_a_column(lambda column: [[value] for value in column]),
    _in_another_unit,
)
_STRANGE_TABLES: _Changes = (
    _of_a_column(_one(1e300)),
    _of_a_column(_one(-1e30)),
    _of_a_column(lambda column: 0.0 * column),
    lambda _, table: table.iloc[:2],
    lambda _, table: table.sample(frac=0.5, random_state=0).sort_index(),
    lambda _, table: _with(table, "flight", range(len(table))),
    lambda _, table: _with(table, "time_ns", table["time_ns"] - table["time_ns"].iloc[0]),
    lambda _, table: _with(table, "time_ns", 1000 * (table["time_ns"] - table["time_ns"].iloc[0])),
    lambda _, table: _attrs(table, {"cutoff_hz": "30", "rows": 5}),
    lambda _, table: _attrs(table, {"cutoff_hz": 30.0, "rows": [1]}),
    lambda _, table: _attrs(table, {"cutoff_hz": 1e9, "rows": {"train_1": None}}),
)


def _attrs(table: pd.DataFrame, attrs: dict[str, Any]) -> pd.DataFrame:
    table = table.copy()
    table.attrs = attrs
    return table


def _another_table(rng: random.Random, table: pd.DataFrame) -> tuple[Any, Must]:
    """Changes to a table."""
    changes, must = rng.choice(
        (
            (_SAME_TABLES, Must.GIVE_THE_SAME),
            (_REFUSED_TABLES, Must.REFUSE),
            (_STRANGE_TABLES, Must.END_WELL),
        )
    )
    return rng.choice(changes)(rng, table), must


def _of_flights(**how: Any) -> Argument:
    wrong = (_flights().inputs, list(_flights().prepared), _table(), _flights().prepared[0])
    return thing(_flights(), refused=wrong, **how)


def _list_of_flights() -> Argument:
    """Flights, or the list that cross-validation makes of them."""
    return _of_flights(same=([_flights()[0], _flights()[1]], tuple(_flights())))


def _vehicle(**how: Any) -> Argument:
    return named("bebop2", Vehicle.load("bebop2"), refused=("no such", Path("no.yaml"), "config"), **how)


def _flag(clean: bool) -> Argument:
    return thing(clean, "flag", required=False, same=(clean,), allowed=lambda value: isinstance(value, bool))


def _optional(clean: Any = None, *kinds: type, **how: Any) -> Argument:
    """What may be left out."""
    how.setdefault("same", (clean,))
    kind = "none" if clean is None else type(clean).__name__
    return thing(clean, kind, required=False, allowed=of_kinds(type(None), *kinds), **how)


def _arrays(table: pd.DataFrame) -> dict[str, Argument]:
    """Quantities of the first flight."""
    arrays = {}
    for quantity, columns in _STATES.items():
        if quantity != _DERIVED:
            clean = np.ascontiguousarray(table[list(columns)].to_numpy()[:_ROWS])
            optional = quantity in {"position", "wind"}
            arrays[quantity] = Argument(
                clean,
                _Units(
                    optional=quantity == "wind",
                    factor=_OTHER_UNITS.get(quantity),
                    integrated=quantity == "position",
                ),
                f"array {clean.shape[1:]}",
                required=not optional,
            )
    return arrays


@cache
def library_calls() -> dict[str, Call]:
    """Every public call of the room, by its name."""
    model, flights = _model(), _flights()
    stamps = _table()["time_ns"].to_numpy()[:_ROWS].copy()
    confidence = confidence_level()
    cutoff = figure(30.0, 50.0, 1e9, 1e-9, refused=(0.0, -1.0))
    by = _optional("speed", same=("speed",), refused=("fast", "Fx", ["speed"]))
    bins = Argument(5, Number((1, 7, 1000), (0, -1, 1001, 2.5, float("nan"))), "number", required=False)
    flight_arrays = {
        "time_ns": Argument(stamps, Rows(), "stamps"),
        "vehicle": _vehicle(),
        **_arrays(_raw()),
    }
    names = {quantity: _STATES[quantity] for quantity in ("rates", "wind")}
    strange_names = (
        *({"rates": wrong} for wrong in (5, None, "pqr", ["p"], ["p_rad_s", "q_rad_s", None])),
        *({"rates": [[name] for name in _STATES["rates"]]}, {"speeds": ["u_m_s"]}, {5: ["a"]}),
    )
    table_arguments = {
        "vehicle": _vehicle(),
        "flight": _optional("flight", same=("flight",), refused=("no such", ["flight"], ("flight", "b"))),
        "time": thing("time_ns", "name", required=False, same=("time_ns",), refused=("flight", ["time_ns"])),
        "columns": _optional(
            names, dict, same=(None, {}, names, {"rates": np.array(_STATES["rates"])}), refused=strange_names
        ),
        "cutoff_hz": replace(cutoff, change=Number((30.0, 50.0), (0.0, -1.0, float("nan")), optional=True)),
    }
    return {
        "Flights": Call(
            Flights,
            {
                "prepared": thing(
                    flights.prepared,
                    same=(list(flights.prepared),),
                    refused=(flights.prepared[:1] * 2, [*flights.prepared, None], flights, flights.inputs),
                ),
                "vehicle": thing(flights.vehicle, refused=("bebop2",)),
                "cutoff_hz": cutoff,
            },
        ),
        "Flights.from_arrays": Call(
            Flights.from_arrays,
            {**flight_arrays, "flight": _optional(None), "cutoff_hz": cutoff},
            slow=True,
            share=10.0,
        ),
        "Flights.from_arrays, labels": Call(
            lambda flight: Flights.from_arrays(
                **{name: argument.clean for name, argument in flight_arrays.items()}, flight=flight
            ),
            {
                "flight": thing(
                    np.repeat(["a"], _ROWS),
                    same=(["a"] * _ROWS, np.array(["a"] * _ROWS, object)),
                    refused=(np.repeat(["a"], _ROWS - 1), np.full(_ROWS, np.nan), [None] * _ROWS, [["a"]]),
                    allowed=no_value,
                )
            },
            slow=True,
        ),
        "Flights.from_pandas": Call(
            lambda **given: Flights.from_pandas(**given, filtered=True),
            {"frame": Argument(_table(), _another_table, "table"), **table_arguments},
            share=15.0,
        ),
        "Flights.from_pandas, raw": Call(
            Flights.from_pandas,
            {
                "frame": Argument(_raw(), _another_table, "table"),
                **table_arguments,
                "filtered": thing(False, "flag", required=False, same=(False,)),
            },
            slow=True,
            share=5.0,
        ),
        "Flights.to_pandas": Call(lambda: flights.to_pandas().to_numpy()[:, 1:].astype(float), {}, share=0.1),
        "WrenchModel": Call(
            lambda **given: _held_alone(WrenchModel(**given).fit(flights)),
            {
                "estimator": thing(
                    "polynomial",
                    "name",
                    required=False,
                    same=("polynomial",),
                    refused=(*_STRANGE_REGRESSORS, _Regressor, "physics", "x" * 10_000),
                ),
                "confidence": figure(0.95, 0.9, 0.5, refused=(1.0, 1.5, 95.0, 0.0, -1.0)),
                "candidates": named("quadrotor", required=False, refused=("no such", "config", Path())),
                "axes": _optional(
                    ["Fx", "Fz"],
                    same=(["Fx", "Fz"], ("Fx", "Fz"), np.array(["Fx", "Fz"])),
                    refused=("Fx", [], ["Fq"], [None], {"Fx": 1}, [["Fx"]]),
                ),
                "keep_flawed": _flag(False),
            },
            slow=True,
            share=8.0,
        ),
        "WrenchModel.fit": Call(
            lambda **given: _held_alone(WrenchModel("polynomial", axes=["Fx"]).fit(**given)),
            {
                "flights": _list_of_flights(),
                "y": _optional(None, refused=(flights.wrench, flights.wrench[:, 0])),
            },
            slow=True,
            share=2.0,
        ),
        "WrenchModel.predict": Call(
            lambda **given: _held(model.predict(**given)), {"flights": _of_flights()}, share=2.0
        ),
        "WrenchModel.predict_interval": Call(
            lambda **given: [_held(bound) for bound in model.predict_interval(**given)],
            {"flights": _list_of_flights(), "confidence": confidence},
            share=4.0,
        ),
        "WrenchModel.evaluations": Call(
            model.evaluations,
            {"flights": _list_of_flights(), "confidence": replace(confidence, required=True)},
            share=2.0,
        ),
        "WrenchModel.score": Call(
            model.score,
            {"flights": _list_of_flights(), "y": _optional(None, refused=(flights.wrench,))},
            share=2.0,
        ),
        "WrenchModel.save": Call(lambda folder: repr(model.save(folder)), {"folder": output("wrench")}),
        "WrenchModel.plot": Call(
            _drawn(model.plot),
            {
                "flights": _of_flights_alone(),
                "confidence": confidence,
                "axes": _optional(None, refused=([5, 5], np.zeros(2))),
            },
            slow=True,
            share=2.0,
        ),
        "WrenchModel.get_params": Call(
            lambda: list(model.get_params()),
            {},
            share=0.1,
        ),
        "WrenchModel.set_params": Call(
            lambda name, value: repr(WrenchModel("polynomial").set_params(**{name: value})),
            {
                "name": Argument("confidence", _another_parameter, "name"),
                "value": thing(0.95, "name", allowed=lambda _: True),
            },
            share=0.5,
        ),
        "evaluate": Call(
            lambda **given: quadpi.evaluate(**given).rows,
            {
                "model": thing(model, refused=(model.model_, WrenchModel(), WrenchModel)),
                "flights": _list_of_flights(),
                "by": by,
                "bins": bins,
                "confidence": confidence,
            },
            share=4.0,
        ),
        "evaluate, edges": Call(
            lambda bins: quadpi.evaluate(model, flights, by="height", bins=bins).rows,
            {
                "bins": thing(
                    [-1000.0, 0.0, 1000.0],
                    same=((-1000, 0, 1000), np.array([-1000.0, 0.0, 1000.0], np.float32)),
                    refused=(
                        *([0.0, 0.1], [1000.0, -1000.0], [0.0], [-1000.0, np.nan, 1000.0], "edges"),
                        *([-1000.0, 0.0, 0.0, 1000.0], [[-1000.0, 1000.0]], range(0), [-np.inf, np.inf]),
                    ),
                    allowed=of_kinds(int),
                )
            },
            share=2.0,
        ),
        "find_discrepancy": Call(
            quadpi.find_discrepancy,
            {
                "simulation": thing(
                    "bebop2",
                    "name",
                    same=(Path("bebop2"),),
                    refused=(
                        "no such",
                        "neurobem",
                        "json:dumps",
                        "no.module:function",
                        len,
                        model,
                        Vehicle,
                    ),
                    allowed=lambda value: callable(value) or isinstance(value, str),
                ),
                "flights": _list_of_flights(),
                "effects": _optional(
                    ["body_drag"],
                    *(list, tuple),
                    same=(("body_drag",), "body_drag"),
                    refused=(["no such"], [None], 5, {"body_drag": 1}),
                ),
                "seed": Argument(0, Number((1, 5), (-1, 0.5, float("nan"))), "number", required=False),
            },
            slow=True,
            share=2.0,
        ),
        "load_flights": Call(
            quadpi.load_flights,
            {
                "logs": thing(
                    [_BAGS / "train_1.mcap"],
                    same=(
                        str(_BAGS / "train_1.mcap"),
                        str(_BAGS / "train_[1].mcap"),
                        (_BAGS / "train_1.mcap",),
                    ),
                    refused=(
                        "no_*.mcap",
                        [_BAGS, None],
                        [_BAGS / "train_1.mcap"] * 2,
                        _BAGS / "no.mcap",
                        "**",
                    ),
                ),
                "vehicle": _vehicle(),
                "cutoff_hz": cutoff,
                "mapping": _optional(None, refused=("nanodrone", ["a"])),
                "left_out": _optional(None, list, same=(None,), refused=((), "a")),
                "workers": Argument(
                    1, Number((), (0, -1, 0.5, float("nan")), optional=True), "number", required=False
                ),
            },
            slow=True,
            share=2.0,
        ),
        "load_model": Call(
            lambda **given: repr(quadpi.load_model(**given)),
            {
                "folder": named(
                    str(_GOLDEN_MODEL), refused=("no such", _BAGS, "config", _BAGS / "train_1.mcap")
                )
            },
            slow=True,
        ),
        "Monitor, by name": Call(
            Monitor,
            {
                "model": thing(model, same=(model.model_,), refused=(WrenchModel(), str(_GOLDEN_MODEL))),
                "vehicle": _vehicle(required=False, allowed=of_kinds(str, Path, type(None))),
                "rate_hz": figure(500.0, 100.0, 10.0, 1e9, optional=True, refused=(0.0, -500.0)),
                "confidence": confidence,
                "settings": thing(
                    MonitorSettings(), required=False, same=(MonitorSettings(),), allowed=no_value
                ),
            },
            keeps=True,
        ),
        "Monitor.step, by name": Call(
            lambda **given: [
                _held(np.array([row[1:5]])[0]) for row in Monitor(model, rate_hz=500.0).step(**given)
            ],
            {
                "time_ns": Argument(stamps, Rows(), "stamps"),
                **{
                    name: replace(
                        argument,
                        change=Rows(finite=False, optional=name == "wind"),
                        required=False,
                    )
                    for name, argument in _arrays(_raw()).items()
                    if name != "position"
                },
            },
            share=10.0,
        ),
    }


def _held_alone(model: WrenchModel) -> npt.NDArray[Any]:
    """What a model predicts of its axes."""
    return model.predict(_flights())[:, np.isin(AXES, model.axes_)]


def _drawn(plot: Callable[..., Any]) -> Callable[..., None]:
    """Draws, and forgets the figure."""

    def call(**given: Any) -> None:
        from matplotlib import pyplot

        try:
            plot(**given)
        finally:
            pyplot.close("all")

    return call


def _of_flights_alone() -> Argument:
    """One flight."""
    return thing(_flights()[0], same=([_flights()[0]],), refused=(_flights(), _flights().inputs))


def _another_parameter(rng: random.Random, _value: Any) -> tuple[Any, Must]:
    if rng.random() < 0.5:
        return rng.choice(("axes", "candidates", "keep_flawed")), Must.END_WELL
    return rng.choice(("alpha", "estimator__alpha", "confidence__x", "", "model_")), Must.REFUSE
