# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The fitted physical model as a model folder keeps it and as it is packed for evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import NotNegative, Positive, Text, parse_config
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.fitted_polynomial import SpreadEntry, SpreadShape, spread_json
from quadpi_core.models.interval_rules import Rule
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.models.physical_fit import FitStep, worst_pairs
from quadpi_core.models.physical_flight import PhysicalFlight, Sensing
from quadpi_core.models.physical_kernel import COMMON, KEPT, PackedPhysical, evaluate_physical
from quadpi_core.models.physical_regressors import control_signs
from quadpi_core.models.physical_terms import TERM_INDEX, TERM_NAMES, TERMS
from quadpi_core.models.regressors import check_inputs
from quadpi_core.models.stored_body import StoredBody, require_arrays, require_known
from quadpi_core.records import Records


@dataclass(frozen=True)
class PhysicalFit:
    """The parameters, which all axes share, and what there is to say of their fit.

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
        """Standard errors (P,) of the parameters, by as many errors as are independent."""
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
class FittedPhysical:
    """One axis of the physical model.

    Attributes:
        parameters: of all axes.
        whitening: (S, S) lower triangular Wᵀ with leverage h = |W z|², of the terms that act on the axis.
        acting: (S,) numbers of these terms.
        shape: of the spread over the inputs.
        rule: gives the interval's factor on the spread.
        rms_spread: root mean square of the spread over the training samples, the unit of relative width.
    """

    method: ClassVar[str] = "physical"
    parameters: PhysicalFit
    whitening: Array
    acting: npt.NDArray[np.int64]
    shape: SpreadShape
    rule: Rule
    rms_spread: float

    @property
    def terms(self) -> list[str]:
        """Names of the parameters that act on the axis."""
        return [TERM_NAMES[k] for k in self.acting]

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps of the axis alone as arrays, by name."""
        return {"whitening": np.ascontiguousarray(self.whitening)}

    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps of the axis alone beside the arrays."""
        return {"acting": self.terms, **spread_json(self.shape, self.rule, self.rms_spread)}

    @classmethod
    def stored(cls, data: Any, arrays: Mapping[str, Array]) -> FittedPhysical:
        """Read what `to_json` and `arrays` gave, with the `parameters` among the data.

        Raises:
            ModelError: for numbers that no fit gives, and parameters that this version does not know.
        """
        entry = parse_config(_AxisEntry, data, cls.method, ModelError)
        require_known(entry.acting)
        acting = np.array([TERM_INDEX[name] for name in entry.acting], dtype=np.int64)
        require_arrays(arrays, {"whitening": (len(acting), len(acting))})
        return cls(data["parameters"], arrays["whitening"], acting, *entry.spread())


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
class _AxisEntry(SpreadEntry):
    """What a stored model keeps of an axis beside the arrays."""

    acting: tuple[Text, ...]


@dataclass(frozen=True)
class CompiledPhysical:
    """The fitted axes packed for compiled evaluation."""

    fitted: Mapping[str, FittedPhysical]

    @cached_property
    def _packed(self) -> PackedPhysical:
        longest = max(len(own.acting) for own in self.fitted.values())
        common = np.zeros(1, COMMON)
        acting = np.zeros((len(AXES), longest), dtype=np.int64)
        whitening = np.zeros((len(AXES), longest, longest))
        for axis, own in self.fitted.items():
            k, size = AXES.index(axis), len(own.acting)
            common["axes"][0, k] = size, own.shape.inflation, own.shape.growth, own.rms_spread
            acting[k, :size], whitening[k, :size, :size] = own.acting, own.whitening
        fit = next(iter(self.fitted.values())).parameters
        common["vehicle"], common["controls"] = fit.vehicle, control_signs(fit.vehicle)
        common["delay_s"] = fit.sensing.rotor_delay_s
        kept = np.zeros(len(fit.kept), KEPT)
        kept["number"], kept["value"] = fit.kept, fit.values[fit.kept]
        return PackedPhysical(common, kept, acting, whitening)

    def evaluate(self, inputs: Array, factors: Array, derivatives: Records | None = None) -> Evaluation:
        """Evaluate input vectors (N, 19) with half widths from :func:`.model_kind.interval_factors`.

        Raises:
            ModelError: without derivatives (N,): rotor speeds act late, and their change has a torque.
        """
        check_inputs(inputs)
        if derivatives is None:
            raise ModelError("the physical model needs the derivatives of the motion")
        out = np.zeros((5, len(inputs), len(AXES)))
        evaluate_physical(inputs, derivatives, *self._packed, factors, out)
        return Evaluation(out[0], out[1], out[2], out[3], out[4])
