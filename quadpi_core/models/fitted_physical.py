# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The fitted physical model: what it predicts, says and stores."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import NotNegative, Positive, Text, parse_config
from quadpi_core.core import compiled
from quadpi_core.errors import ModelError, named_in
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.fitted_polynomial import RmsSpread
from quadpi_core.models.interval_rules import StoredRule
from quadpi_core.models.model_kind import CompiledFitted, Facts, FittedAxis, RotorDelay, StoredAxes
from quadpi_core.models.physical_fit import (
    AT_BOUND,
    DELAYS_S,
    KEPT,
    Common,
    FitStep,
    PackedPhysical,
    PhysicalFlight,
    Sensing,
    bounded_terms,
    motions,
    worst_pairs,
)
from quadpi_core.models.physical_terms import (
    TERM_INDEX,
    TERM_NAMES,
    TERMS,
    control_signs,
    delay_words,
    missing_flying,
    regressors,
)
from quadpi_core.models.rollout_model import MOVES, RolloutModel, StoredBody, require_arrays, require_known
from quadpi_core.paths import parse_json
from quadpi_core.records import Records, record_dtype
from quadpi_core.vehicle import Vehicle

FIT_FILE, TABLE_FILE = "fit.json", "parameters.csv"
# Floor of the eigenvalues of a correlation matrix: after hover some are 1e-13 of the largest.
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True)
class PhysicalFit:
    """Parameters shared by all axes, their covariance, and remarks on their fit.

    Attributes:
        values: (P,) in the order of TERMS, SI; zero where a term was left out.
        covariance: (P, P) of them; zero where a term was left out.
        vehicle: PHYSICAL_VEHICLE (1,) that the regressors are those of.
        inertia: (3, 3) kg m².
        sensing: delay of the rotor speeds and bandwidth of the measured force.
        delay_range_s: delays of the rotor speeds that the flights do not rule out; None if not searched.
        notes: by parameter, where these flights do not identify it or a bound holds.
        log: what was tried and chosen, step by step.
    """

    values: Array
    covariance: Array
    vehicle: Records
    inertia: Array
    sensing: Sensing
    delay_range_s: tuple[float, float] | None
    notes: dict[str, str]
    log: tuple[FitStep, ...]

    @cached_property
    def standard_errors(self) -> Array:
        """Standard errors (P,) of the parameters, for the effective number of independent errors."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def kept(self) -> npt.NDArray[np.int64]:
        """Numbers of the terms that are in the model."""
        return np.flatnonzero(self.standard_errors > 0.0)

    def thrust_change(self, flight: PhysicalFlight) -> float:
        """By how much the thrust of a flight differs from that of the fit, as a share."""
        error = flight.errors(self.values, self.vehicle, self.sensing)[:, 2]
        predicted = flight.wrench[:, 2] - error
        return float(predicted @ error / (predicted @ predicted))

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps as arrays, by name."""
        return StoredBody(self.values, self.covariance, self.vehicle, self.inertia).arrays("values")

    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps beside the arrays."""
        return {
            "parameters": list(TERM_NAMES),
            "rotor_delay_s": self.sensing.rotor_delay_s,
            "force_bandwidth_hz": self.sensing.force_bandwidth_hz,
            "rotor_delay_range_s": self.delay_range_s,
            "notes": self.notes,
            "worst_pairs": worst_pairs(self.covariance),
            "log": [asdict(step) for step in self.log],
        }

    @classmethod
    def stored(cls, data: Any, arrays: Mapping[str, Array]) -> PhysicalFit:
        """Read what `to_json` and `arrays` gave.

        Raises:
            ModelError: for numbers that no fit gives, and parameters that this version does not know.
        """
        entry = parse_config(_FitEntry, data, "physical", ModelError)
        require_known(list(entry.notes))
        body = StoredBody.read(entry.parameters, arrays, "values")
        sensing = Sensing(entry.rotor_delay_s, entry.force_bandwidth_hz)
        return cls(*body, sensing, entry.rotor_delay_range_s, entry.notes, entry.log)

    def rows(self) -> list[tuple[str, float, float, str, str, str]]:
        """Name, value, standard error, unit, meaning and note of each parameter in the model."""
        return [
            (t.name, float(value), float(error), t.unit, t.meaning, self.notes.get(t.name, ""))
            for t, value, error in zip(TERMS, self.values, self.standard_errors, strict=True)
            if error > 0.0
        ]

    def csv(self) -> str:
        """The parameters as comma-separated values."""
        lines = ["parameter,value,standard_error,unit,meaning,note"]
        lines += [f'{n},{v:.6g},{e:.3g},{u},"{m}","{note}"' for n, v, e, u, m, note in self.rows()]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class _FitEntry:
    """What a stored model keeps of all axes beside the arrays."""

    parameters: tuple[Text, ...]
    rotor_delay_s: NotNegative
    force_bandwidth_hz: Positive | None
    notes: dict[str, str]
    log: tuple[FitStep, ...]
    rotor_delay_range_s: tuple[NotNegative, NotNegative] | None


@dataclass(frozen=True)
class PhysicalAxis(FittedAxis):
    """One axis of the physical model.

    Attributes:
        acting: S terms that act on the axis.
        whitening: (S, S) lower triangular Wᵀ with leverage h = |W z|², of these terms.
        inflation, growth: of the spread, see :class:`.envelope.SpreadShape`.
        rule: gives the interval's factor on the spread.
        rms_spread: root mean square of the spread over the training samples, the unit of relative width.
    """

    acting: tuple[Text, ...]
    whitening: Array
    inflation: NotNegative
    growth: NotNegative
    rule: StoredRule
    rms_spread: RmsSpread

    def __post_init__(self) -> None:
        require_known(self.acting)
        require_arrays({"whitening": self.whitening}, {"whitening": (len(self.acting), len(self.acting))})

    @property
    def terms(self) -> list[str]:
        """Names of the parameters that act on the axis."""
        return list(self.acting)

    @property
    def numbers(self) -> list[int]:
        """Their numbers, (S,)."""
        return [TERM_INDEX[name] for name in self.acting]


@dataclass(frozen=True)
class FittedPhysical(CompiledFitted):
    """The physical model of a vehicle.

    Attributes:
        parameters: of all axes.
    """

    parameters: PhysicalFit

    method = "physical"
    axis_type = PhysicalAxis
    # Rotor speeds act late, and their change has a torque.
    needs_derivatives = True

    @cached_property
    def compiled(self) -> compiled.Physical:
        """See the base class."""
        longest = max(len(axis.acting) for axis in self.axes.values())
        fit = self.parameters
        rotors = int(fit.vehicle["rotors"][0])
        common = np.zeros(1, record_dtype(Common, rotors))
        acting = np.zeros((len(AXES), longest), dtype=np.int64)
        whitening = np.zeros((len(AXES), longest, longest))
        for axis, own in self.axes.items():
            k, size = AXES.index(axis), len(own.acting)
            common["axes"][0, k] = size, own.inflation, own.growth, own.rms_spread
            acting[k, :size], whitening[k, :size, :size] = own.numbers, own.whitening
        common["vehicle"], common["controls"][..., :rotors] = fit.vehicle, control_signs(fit.vehicle)
        common["delay_s"] = fit.sensing.rotor_delay_s
        terms = np.zeros(len(fit.kept), KEPT)
        terms["number"], terms["value"] = fit.kept, fit.values[fit.kept]
        return compiled.Physical(PackedPhysical(common, terms, acting, whitening))

    def store(self) -> StoredAxes:
        """Parameters once, what belongs to an axis by axis, and a table of parameters for people."""
        shared, by_axis = self.parameters, super().store()
        fit = json.dumps(shared.to_json(), indent=1, allow_nan=False) + "\n"
        files = {FIT_FILE: fit.encode(), TABLE_FILE: shared.csv().encode()}
        return StoredAxes(by_axis.entries, {**shared.arrays(), **by_axis.arrays}, files)

    @classmethod
    def read(cls, stored: StoredAxes) -> FittedPhysical:
        """What :meth:`store` gave."""
        if FIT_FILE not in stored.files:
            raise ModelError(f"{FIT_FILE}: missing")
        with named_in(FIT_FILE):
            content = parse_json(stored.files[FIT_FILE].decode(errors="replace"))
            shared = PhysicalFit.stored(content, stored.arrays)
        return cls(cls.read_axes(stored), shared)

    @property
    def force_bandwidth_hz(self) -> float | None:
        """As it was found."""
        return self.parameters.sensing.force_bandwidth_hz

    @property
    def rotor_delay(self) -> RotorDelay:
        """As it was found."""
        return RotorDelay(self.parameters.sensing.rotor_delay_s, self.parameters.delay_range_s)

    def simulation_section(self) -> dict[str, Any]:
        """The parameters; the place of the accelerometer, which moves no body, as an effect on sensors."""
        shared = self.parameters
        values = {TERM_NAMES[k]: float(shared.values[k]) for k in shared.kept}
        lever_arm = {f"{axis}_m": values.pop(f"imu_{axis}", 0.0) for axis in "xyz"}
        flying = [TERM_INDEX[name] for name in values]
        scale = shared.standard_errors[flying]
        correlation = shared.covariance[np.ix_(flying, flying)] / np.outer(scale, scale)
        triangle = scale[:, np.newaxis] * triangular(correlation)
        section: dict[str, Any] = {
            "physical": {
                "reference_thrust_n_s2": float(shared.vehicle["reference_thrust"][0]),
                "parameters": values,
                "deviations": {name: triangle[row, : row + 1].tolist() for row, name in enumerate(values)},
                **asdict(shared.sensing),
            }
        }
        if any(lever_arm.values()):
            section["effects"] = {"imu_lever_arm": lever_arm}
        return section

    def facts(self, rollouts: RolloutModel | None) -> list[Facts]:
        """Parameters, their most correlated pairs, those that predict ahead, and the log of the fit."""
        shared = self.parameters
        return [
            *_parameter_facts(
                "parameters",
                [(name, value, error, unit, note) for name, value, error, unit, _, note in shared.rows()],
                _sensing_words(shared),
                shared.covariance,
            ),
            *([] if rollouts is None else _facts_ahead(rollouts)),
            Facts(
                "log of the fit",
                ("step", "of", "error"),
                [(step.step, step.of, step.error) for step in shared.log],
            ),
        ]

    def standard_error(
        self, axis: str, inputs: Array, derivatives: Records, weights: Array, vehicle: Vehicle
    ) -> float:
        """By the covariance of the parameters, with the thrust that differs from flight to flight."""
        own, column, shared = self.axes[axis], AXES.index(axis), self.parameters
        z = regressors(motions(inputs, derivatives, vehicle), shared.vehicle)[:, own.numbers, column]
        # The whitening is in units of the noise: of the force or moment at rest, both errors are known.
        rest = TERM_INDEX[f"bias_{('x', 'y', 'z', 'roll', 'pitch', 'yaw')[column]}"]
        place = np.flatnonzero(np.array(own.numbers) == rest)
        noise = shared.standard_errors[rest] / np.linalg.norm(own.whitening[place])
        return float(noise * np.linalg.norm(weights @ z @ own.whitening))


def _parameter_facts(
    title: str, rows: Sequence[tuple[str | float, ...]], note: str, covariance: Array
) -> list[Facts]:
    """Parameters, and their most correlated pairs."""
    columns = ("parameter", "value", "standard error", "unit", "note")
    pairs = ("one", "other", "correlation")
    return [
        Facts(title, columns, rows, note),
        Facts(f"most correlated {title}", pairs, worst_pairs(covariance)),
    ]


def _facts_ahead(rollouts: RolloutModel) -> list[Facts]:
    values, errors = rollouts.parameters, np.sqrt(np.diag(rollouts.covariance))
    bounded = bounded_terms(values, errors)
    rows = [
        (term.name, float(values[k]), float(errors[k]), term.unit, AT_BOUND if term.name in bounded else "")
        for k, term in enumerate(TERMS)
        if MOVES[k] and errors[k] > 0.0
    ]
    return _parameter_facts("parameters that predict ahead", rows, rollouts.remark, rollouts.covariance)


def _sensing_words(shared: PhysicalFit) -> str:
    words = delay_words(shared.sensing.rotor_delay_s, shared.delay_range_s, DELAYS_S[-1])
    if (bandwidth := shared.sensing.force_bandwidth_hz) is not None:
        words += (
            f"; measured forces of these flights end at {bandwidth:g} Hz, so predicted forces are judged "
            "smoothed alike"
        )
    untold = [name for name, note in shared.notes.items() if note != AT_BOUND]
    missing = missing_flying(untold, len(shared.kept))
    return f"{words}. {missing}" if missing else words


def triangular(correlation: Array) -> Array:
    """Lower triangular L (s, s) with L Lᵀ the correlation (s, s), which rounding may leave indefinite."""
    values, vectors = np.linalg.eigh(correlation)
    half = vectors * np.sqrt(np.maximum(values, _LEAST_VARIANCE))
    lower: Array = np.transpose(np.linalg.qr(half.T).R)
    return lower * np.where(np.diag(lower) < 0.0, -1.0, 1.0)
