# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a kind of model is: how it is fitted, stored and evaluated, and how its results are shown.

Each kind is one file of the folder `kinds`, or of a package that someone else installs (see
:mod:`.kind_registry`). Nothing else in the code knows any of them by name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeAlias, TypeVar, get_args

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.config_schema import Section, Within, parse_config
from quadpi_core.core import compiled
from quadpi_core.errors import ArgumentError, ModelError, named_in
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import DERIVATIVES, whole_derivatives
from quadpi_core.models.alarm_limits import RATE_PER_HOUR
from quadpi_core.models.interval_rules import FlightErrors, Rule, StoredRule
from quadpi_core.models.regressors import CandidatePool, check_inputs
from quadpi_core.models.rollout_model import RolloutModel
from quadpi_core.parallel import ReportProgress
from quadpi_core.records import Records, brief_repr
from quadpi_core.vehicle import Vehicle

Settings: TypeAlias = Literal["default", "paper"]
Pools: TypeAlias = Mapping[str, CandidatePool]

# Cut-off of the low-pass over all signals [Hz], by settings. The default keeps the band in which rotor speeds
# and measured moments are coherent (above about 25 Hz they are not, on two data sets).
CUTOFF_HZ: dict[Settings, float] = {"default": 30.0, "paper": 100.0}

_NO_DERIVATIVES = np.empty(0, DERIVATIVES)


class Evaluation(NamedTuple):
    """What a model says of N samples; columns Fx … Mz, zero for axes that the model does not hold.

    Attributes:
        predicted, lower, upper: (N, 6) N and Nm, body forward-right-down.
        leverage: (N, 6) h = z (ZᵀZ)⁻¹ zᵀ; 0 for a kind without it.
        relative_width: (N, 6) interval width over its root mean square on the training flights.
    """

    predicted: Array
    lower: Array
    upper: Array
    leverage: Array
    relative_width: Array

    def __repr__(self) -> str:
        return brief_repr(self)


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """How a model is identified.

    Attributes:
        cutoff_hz: of the low-pass that the flights passed; kept with the model.
        method: the kind of model, such as `Polynomial(stop="pse")`; its name, for its default options; None
            for the first of `kinds.DEFAULTS` that has the settings.
        settings: "paper" for the paper's rules.
        confidence: nominal coverage that the monitor will use.
        false_alarms_per_hour: rate that the limits of the alarm are calibrated to, on held-out flights.
    """

    cutoff_hz: float = CUTOFF_HZ["default"]
    method: str | Kind | None = None
    settings: Settings = "default"
    confidence: float = 0.95
    false_alarms_per_hour: float = RATE_PER_HOUR

    def __post_init__(self) -> None:
        """Refuse what no model takes, in the words of `quadpi_core.array_checks`."""
        for name in ("cutoff_hz", "false_alarms_per_hour"):
            array_checks.number(name, getattr(self, name), above=0.0)
        array_checks.number("confidence", self.confidence)
        if not isinstance(self.settings, str) or self.settings not in get_args(Settings):
            known = " or ".join(get_args(Settings))
            raise ArgumentError(
                f"settings: expected {known}, found {array_checks.description(self.settings)}"
            )
        if not isinstance(self.method, str | Kind | None):
            raise ArgumentError(
                f"method: expected a kind of model or its name, found {array_checks.description(self.method)}"
            )


@dataclass(frozen=True)
class TrainingSamples:
    """Samples of all flights that a model is fitted to.

    Attributes:
        vehicle: that flew.
        time: (N,) s, rises within a flight.
        inputs: (N, 19) input vectors, columns as `quadpi_core.inputs.INPUT_NAMES`.
        derivatives: (N,) what the motion has beside them, see `quadpi_core.inputs.Derivatives`.
        wrench: (N, 6) measured, N and Nm.
        flight: (N,) number of the flight, from 0; samples of a flight lie together.
        names: of the flights.
    """

    vehicle: Vehicle
    time: Array
    inputs: Array
    derivatives: Records
    wrench: Array
    flight: npt.NDArray[np.int64]
    names: Sequence[str]

    def target(self, axis: str) -> Array:
        """Measured force or moment (N,) of one axis."""
        return self.wrench[:, AXES.index(axis)]


@dataclass(frozen=True)
class StoredAxes:
    """What a model folder keeps of the fitted axes.

    Attributes:
        entries: plain numbers and text, by axis.
        arrays: by name, such as "Fx.coefficients".
        files: content of further files of the folder, by name, such as a table for people.
    """

    entries: Mapping[str, Mapping[str, Any]]
    arrays: Mapping[str, Array]
    files: Mapping[str, bytes] = field(default_factory=dict)


class Facts(NamedTuple):
    """A table of what a kind has to say of a fitted model, for commands and pages.

    Attributes:
        title: of the table, and its key in JSON.
        columns: their headings.
        rows: as many cells each as there are columns.
        note: below the table.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str | float]]
    note: str = ""


class RotorDelay(NamedTuple):
    """Seconds that rotor speeds act after they were measured, and those that flights do not rule out."""

    used_s: float
    range_s: tuple[float, float] | None


class FittedAxis(ABC):
    """Base of what is fitted of one axis: a frozen dataclass whose fields a model folder keeps.

    Arrays, and dataclasses of arrays alone, are kept as arrays, all else as JSON. Annotations check what is
    read (see :mod:`quadpi_core.config_schema`); rules between fields raise ValueError in `__post_init__`.

    Attributes:
        rule: gives the factor of the interval centre ± factor · spread (see :mod:`.interval_rules`).
    """

    rule: StoredRule

    @property
    @abstractmethod
    def terms(self) -> Sequence[str]:
        """What the prediction is made of, in words."""

    def arrays(self) -> dict[str, Array]:
        """What a model folder keeps as arrays, by name."""
        stored = {}
        for name, value in _fields(self):
            if isinstance(value, np.ndarray):
                stored[name] = np.ascontiguousarray(value)
            elif _is_of_arrays(value):
                stored |= {f"{name}.{key}": np.ascontiguousarray(own) for key, own in _fields(value)}
        return stored

    def to_json(self) -> dict[str, Any]:
        """What a model folder keeps beside the arrays."""
        return {
            name: _plain(value)
            for name, value in _fields(self)
            if not isinstance(value, np.ndarray) and not _is_of_arrays(value)
        }


def _fields(of: Any) -> list[tuple[str, Any]]:
    return [(column.name, getattr(of, column.name)) for column in fields(of)]


def _is_of_arrays(value: Any) -> bool:
    return is_dataclass(value) and {type(own) for _, own in _fields(value)} == {np.ndarray}


def _plain(value: Any) -> Any:
    """A value as JSON has it: what is not plain in itself, by its text."""
    if hasattr(value, "to_json"):
        return value.to_json()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {name: _plain(own) for name, own in value.items()}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, str | int | float | bool | None):
        return value
    return str(value)


@dataclass(frozen=True)
class Fitted(ABC):
    """A fitted model: it predicts, describes itself in words and numbers, and a model folder keeps it.

    Attributes:
        axes: by name, each of `axis_type`.
        method: name of the kind.
    """

    axes: Mapping[str, Any]
    method: ClassVar[str]
    axis_type: ClassVar[type[FittedAxis]]

    @abstractmethod
    def evaluate(self, inputs: Array, factors: Array, derivatives: Records | None = None) -> Evaluation:
        """Evaluate input vectors (N, 19) with what :meth:`factors` gave.

        The derivatives (N,) are what the motion has beside the input vector, where they are known. The bits
        of a sample must not depend on the samples beside it: live they come one by one.
        """

    def factors(self, confidence: float) -> Array:
        """Half width (6,) of each axis' interval per unit of spread; 0 for axes not held.

        Raises:
            ModelError: for a confidence that the calibration cannot support.
        """
        factors = np.zeros(len(AXES))
        for axis, own in self.axes.items():
            factors[AXES.index(axis)] = own.rule.factor(confidence)
        return factors

    def with_rules(self: FittedSelf, rules: Mapping[str, Rule]) -> FittedSelf:
        """The same with other rules of some axes."""
        changed = {axis: replace(self.axes[axis], rule=rule) for axis, rule in rules.items()}
        return replace(self, axes={**self.axes, **changed})

    def store(self) -> StoredAxes:
        """What a model folder keeps; unless overridden, each axis by itself."""
        return StoredAxes(
            {axis: own.to_json() for axis, own in self.axes.items()},
            {f"{axis}.{name}": a for axis, own in self.axes.items() for name, a in own.arrays().items()},
        )

    @classmethod
    def read(cls: type[FittedSelf], stored: StoredAxes) -> FittedSelf:
        """What :meth:`store` gave.

        Raises:
            ModelError: naming the axis, for numbers that no fit gives.
        """
        return cls(cls.read_axes(stored))

    @classmethod
    def read_axes(cls, stored: StoredAxes) -> dict[str, Any]:
        """The axes of what :meth:`store` gave; raises as :meth:`read` does."""
        axes = {}
        for axis, entry in stored.entries.items():
            data = {**entry, **_nested(named_arrays(stored.arrays, axis))}
            with named_in(axis):
                axes[axis] = parse_config(cls.axis_type, data, cls.method, ModelError)
        return axes

    @property
    def force_bandwidth_hz(self) -> float | None:
        """Bandwidth of the measured forces of the flights, where it ends below that of the other signals.

        Predicted forces are then compared with those of such a flight as it would have recorded them.
        """
        return None

    @property
    def rotor_delay(self) -> RotorDelay | None:
        """The delay of the rotor speeds that was found; None for a kind that looks for none."""
        return None

    def simulation_section(self) -> dict[str, Any]:
        """The key `simulation` of a vehicle file that flies as the model says, its motors apart.

        Raises:
            ModelError: for a kind that is no simulation, saying why.
        """
        raise ModelError(
            f"a model of method {self.method} cannot be simulated: it knows forces and moments where its "
            "flights have been, and nothing that holds in trim and beyond; identify with --method physical"
        )

    def facts(self, rollouts: RolloutModel | None) -> list[Facts]:  # noqa: ARG002 - for kinds that have any
        """What there is to say of the model, and of how it predicts ahead, beside its terms."""
        return []

    def standard_error(
        self,
        axis: str,  # noqa: ARG002 - for kinds that know it
        inputs: Array,  # noqa: ARG002
        derivatives: Records,  # noqa: ARG002
        weights: Array,  # noqa: ARG002
        vehicle: Vehicle,  # noqa: ARG002
    ) -> float | None:
        """Of the sum of predictions with weights (N,) at steady inputs (N, 19); None where not known."""
        return None


class CompiledFitted(Fitted):
    """Base of fitted models whose arrays the core takes once.

    Attributes:
        needs_derivatives: whether its predictions need them.
    """

    needs_derivatives: ClassVar[bool] = False

    @property
    @abstractmethod
    def compiled(self) -> compiled.Model:
        """The model as the core has it; always the same."""

    def evaluate(self, inputs: Array, factors: Array, derivatives: Records | None = None) -> Evaluation:
        """See the base class.

        Raises:
            ModelError: for inputs of another shape, and without derivatives where they are needed.
        """
        check_inputs(inputs)
        if derivatives is None:
            if self.needs_derivatives:
                raise ModelError(f"the {self.method} model needs the derivatives of the motion")
            derivatives = _NO_DERIVATIVES
        out = np.zeros((5, len(inputs), len(AXES)))
        inputs, derivatives = np.ascontiguousarray(inputs), whole_derivatives(derivatives)
        compiled.evaluate(self.compiled, inputs, derivatives, np.ascontiguousarray(factors), out)
        # Faster one by one than by *out.
        return Evaluation(out[0], out[1], out[2], out[3], out[4])


def compiled_model(fitted: Fitted) -> compiled.Model | None:
    """The model as the core evaluates it; None for another kind, or another `evaluate`: Python does that."""
    if isinstance(fitted, CompiledFitted) and type(fitted).evaluate is CompiledFitted.evaluate:
        return fitted.compiled
    return None


FittedSelf = TypeVar("FittedSelf", bound=Fitted)


@dataclass(frozen=True)
class Fit:
    """What a fit gives.

    Attributes:
        fitted: the model.
        held_out: by axis, errors on each flight, in order, of a model fitted without it; empty where the
            intervals are not calibrated on flights. Of a flight they may be every k-th sample.
        log: by axis, the steps of a selection of terms, see `kinds.polynomial`; empty for a kind that selects
            none.
        rollouts: predicts the state ahead; None where the kind, or these flights, give none.
        left_out: the model without each flight in turn, of a kind that is a simulation.
    """

    fitted: Fitted
    held_out: Mapping[str, list[FlightErrors]] = field(default_factory=dict)
    log: Mapping[str, list[dict[str, Any]]] = field(default_factory=dict)
    rollouts: RolloutModel | None = None
    left_out: Sequence[Fitted] = ()


Self = TypeVar("Self", bound="Kind")


def option(default: Any, words: str) -> Any:
    """A field of a kind of model that `quadpi identify` has an option for.

    Args:
        default: of an annotated type that :func:`quadpi_core.config_schema.parse_config` checks, and the
            command line knows: text, a number, true or false, one of some words (Literal), or None.
        words: in the command's help.
    """
    return field(default=default, metadata={"help": words})


@dataclass(frozen=True)
class Kind(Section, ABC):
    """A kind of model, a frozen dataclass: its fields are the options that it is fitted with.

    Attributes:
        name: as in `--method` and in a stored model.
        label: in headings of pages, such as "bootstrap ensemble".
        colour: in figures, #rrggbb; empty for one that is left.
        normal_errors: whether an interval is that of a normal distribution, so that CRPS is defined.
        has_paper_settings: whether it can be fitted by the paper's rules.
        chooses_candidates: whether it is made of what the pools list, which else only say the axes to hold.
        uses_derivatives: whether its predictions need `inputs.Derivatives` beside the input vector.
        is_simulation: whether it holds beyond single samples, so that a vehicle can fly by it.
        shortest_s: least time in the air of a flight that it can be identified on.
        fitted_type: of the models that it fits; only their kind's name is in a model folder.
        seed: of all that is drawn, such as initial weights and the parts that members are trained on.
    """

    seed: Annotated[int, Within(0)] = field(
        default=0, kw_only=True, metadata={"help": "Seed of all draws; methods without draws ignore it."}
    )

    name: ClassVar[str]
    label: ClassVar[str]
    colour: ClassVar[str] = ""
    normal_errors: ClassVar[bool] = False
    has_paper_settings: ClassVar[bool] = False
    chooses_candidates: ClassVar[bool] = True
    is_simulation: ClassVar[bool] = False
    uses_derivatives: ClassVar[bool] = False
    shortest_s: ClassVar[float] = 0.0
    fitted_type: ClassVar[type[Fitted]]

    def having(self: Self, **options: Any) -> Self:
        """This kind with those of some options that it has."""
        names = {option.name for option in fields(self)}
        return replace(self, **{name: value for name, value in options.items() if name in names})

    def check(self, options: IdentifyOptions, pools: Pools) -> None:  # noqa: ARG002 - for kinds that need more of them
        """Refuse options that no flights can satisfy; cheap, so that it can come before flights are read.

        Raises:
            ModelError: saying what this kind does not have, or naming the option that is impossible.
        """
        values = {option.name: getattr(self, option.name) for option in fields(self)}
        parse_config(type(self), values, f"method {self.name}", ModelError)
        if options.settings == "paper" and not self.has_paper_settings:
            raise ModelError(f"the paper knows no {self.name} method: it has no settings paper")

    @abstractmethod
    def fit(
        self, samples: TrainingSamples, pools: Pools, options: IdentifyOptions, progress: ReportProgress
    ) -> Fit:
        """Fit the axes of `pools`, each by itself or all together.

        Raises:
            ModelError: naming the axis, for what cannot be identified.
        """


def named_arrays(arrays: Mapping[str, Array], part: str) -> dict[str, Array]:
    """Those of the arrays of a model folder that belong to a part of it, by their name there."""
    start = f"{part}."
    return {name.removeprefix(start): a for name, a in arrays.items() if name.startswith(start)}


def _nested(arrays: Mapping[str, Array]) -> dict[str, Any]:
    """Arrays by field, those of a dataclass of arrays by its own fields."""
    parts = dict.fromkeys(name.partition(".")[0] for name in arrays)
    return {part: arrays.get(part, named_arrays(arrays, part)) for part in parts}
