# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion between results of the monitor and ROS messages, as :mod:`.sensor_messages` for sensors."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import LogError, VehicleError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.messages.cdr import Codec, Field, header_stamps
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.frame_ids import TF_TYPE
from quadpi_core.messages.one_by_one import OutgoingMessage
from quadpi_core.messages.payloads import PREDICTION_VALUES, Payloads
from quadpi_core.messages.sensor_messages import (
    ALARM,
    BODY_FRAME,
    EVENT,
    FLU_SIGNS,
    PREDICTION,
    WRENCH,
    header_columns,
    mirrored,
    stamp_columns,
)
from quadpi_core.results import AlarmEvent, AlarmRows, Alarms, PredictionRows, Predictions, ReportedAlarms
from quadpi_core.vehicle import Vehicle


def unpack_predictions(payloads: Payloads | bytes) -> Predictions:
    """Decode quadpi/WrenchPrediction."""
    time_ns, values = codec(PREDICTION).decode_stamped(payloads)
    predicted, one, other, measured, relative_width = np.split(values, 5, axis=1)
    lower, upper = _mirrored_bounds(one, other)
    return Predictions(
        time_ns=time_ns,
        predicted=mirrored(predicted),
        lower=lower,
        upper=upper,
        measured=mirrored(measured),
        relative_width=relative_width.copy(),
    )


class PredictingModel(NamedTuple):
    """Which model a prediction is of.

    Attributes:
        identity: name and the first 12 digits of its hash.
        confidence: nominal coverage of the interval.
        axes: names of the axes that it holds.
    """

    identity: str
    confidence: float
    axes: tuple[str, ...]


def unpack_model(payload: bytes) -> PredictingModel:
    """Which model a quadpi/WrenchPrediction is of."""
    columns = codec(PREDICTION).decode(payload)
    flags = int(columns["axes"][0])
    return PredictingModel(
        identity=columns["model"][0].decode(errors="replace"),
        confidence=float(columns["confidence"][0]),
        axes=tuple(axis for place, axis in enumerate(AXES) if flags & 1 << place),
    )


def pack_predictions(
    predictions: Predictions,
    *,
    model: str,
    confidence: float,
    axes: Sequence[str],
    frame_id: str = BODY_FRAME,
) -> Payloads:
    """Encode N predictions, N and Nm in body axes, as quadpi/WrenchPrediction."""
    values = np.empty((len(predictions.time_ns), PREDICTION_VALUES))
    compiled.prediction_values(PredictionRows.from_predictions(predictions).wrenches, 0, values)
    constants = _prediction_constants(model, confidence, axes, frame_id)
    return codec(PREDICTION).encode_stamped(predictions.time_ns, values, constants)


def prediction_message(
    model: str, confidence: float, axes: Sequence[str], frame_id: str = BODY_FRAME
) -> OutgoingMessage:
    """A message for :func:`write_predictions`; see :func:`pack_predictions`."""
    return OutgoingMessage(codec(PREDICTION), _prediction_constants(model, confidence, axes, frame_id))


def write_predictions(rows: PredictionRows, message: OutgoingMessage) -> list[bytes]:
    """Encode predictions one by one in the buffer of a message: the bytes of :func:`pack_predictions`."""
    written = []
    for row, time_ns in enumerate(rows.time_ns):
        compiled.prediction_values(rows.wrenches, row, message.values)
        written.append(message.stamped(time_ns))
    return written


def _prediction_constants(
    model: str, confidence: float, axes: Sequence[str], frame_id: str
) -> tuple[tuple[str, str | float], ...]:
    return (
        ("header.frame_id", frame_id),
        ("model", model),
        ("confidence", confidence),
        ("axes", _axis_flags(tuple(axes))),
    )


def wrench_message(frame_id: str = BODY_FRAME) -> OutgoingMessage:
    """A geometry_msgs/WrenchStamped whose values (1, 6) :func:`wrenches_of` gives."""
    return OutgoingMessage(codec(WRENCH), (("header.frame_id", frame_id),))


def wrenches_of(predictions: Predictions) -> dict[str, Array]:
    """The wrenches (N, 6) of predictions in FLU: `predicted`, `measured` and `residual`, their difference."""
    predicted, measured = mirrored(predictions.predicted), mirrored(predictions.measured)
    return {"predicted": predicted, "measured": measured, "residual": measured - predicted}


# tf2_msgs/TFMessage with one transform: an array of one message is its length, and then the message.
_ONE_TRANSFORM = Codec(
    TF_TYPE,
    (
        Field("transforms", "<u4"),
        Field("header.stamp.sec", "<i4"),
        Field("header.stamp.nanosec", "<u4"),
        Field("header.frame_id", "string"),
        Field("child_frame_id", "string"),
        Field("transform.translation", "<f8", 3),
        Field("transform.rotation", "<f8", 4),
    ),
)


def transform_message(world_frame: str, body_frame: str) -> OutgoingMessage:
    """A tf2_msgs/TFMessage of the transform from a world, its frame_id, to a body, its child_frame_id.

    Its values (1, 7) are the first ones of an odometry: position in the world ENU [m], and the orientation of
    the body FLU as a quaternion x, y, z, w.
    """
    constants = (("transforms", 1), ("header.frame_id", world_frame), ("child_frame_id", body_frame))
    return OutgoingMessage(_ONE_TRANSFORM, constants)


@cache
def _axis_flags(axes: tuple[str, ...]) -> int:
    return sum(1 << AXES.index(axis) for axis in axes)


_ALARM_NUMBERS = tuple(column.name for column in fields(AlarmRows) if not column.name.endswith("_ns"))


def unpack_alarms(payloads: Payloads | bytes) -> ReportedAlarms:
    """Decode quadpi/ExtrapolationAlarm."""
    columns = codec(ALARM).decode(payloads)
    return ReportedAlarms(
        time_ns=header_stamps(columns),
        **{name: columns[name].copy() for name in _ALARM_NUMBERS},
        change_since_ns=header_stamps(columns, "change_since."),
        envelope_distance=columns["envelope_distance"].copy(),
        inputs_outside=_texts(columns["inputs_outside"]),
        reasons=_texts(columns["reasons"]),
    )


def pack_alarms(alarms: Alarms, reasons: Sequence[tuple[str, ...]], frame_id: str = BODY_FRAME) -> Payloads:
    """Encode as quadpi/ExtrapolationAlarm; the inputs outside the envelope are named farthest first."""
    columns = {
        **header_columns(alarms.time_ns, frame_id),
        **{name: getattr(alarms, name) for name in _ALARM_NUMBERS},
        **stamp_columns(alarms.change_since_ns, "change_since"),
        "envelope_distance": alarms.input_excess.max(axis=1),
    }
    outside = map(_inputs_outside, alarms.input_excess)
    return codec(ALARM).encode_each(columns, list(zip(outside, reasons, strict=True)))


def pack_events(events: Sequence[AlarmEvent], frame_id: str = BODY_FRAME) -> Payloads:
    """Encode as quadpi/AlarmEvent, one message per event."""
    columns = {
        **header_columns(_column(events, "time_ns"), frame_id),
        **stamp_columns(_column(events, "start_ns"), "start"),
        **stamp_columns(_column(events, "end_ns"), "end"),
        **{name: _column(events, name) for name in ("number", "cause", "peak_evidence")},
    }
    return codec(EVENT).encode_each(columns, [(event.reasons,) for event in events])


def _column(events: Sequence[AlarmEvent], name: str) -> npt.NDArray[Any]:
    return np.array([getattr(event, name) for event in events])


def unpack_events(payloads: Payloads | bytes) -> list[AlarmEvent]:
    """Decode quadpi/AlarmEvent."""
    columns = codec(EVENT).decode(payloads)
    reasons = _texts(columns["reasons"])
    times, starts, ends = (header_stamps(columns, prefix) for prefix in ("header.stamp.", "start.", "end."))
    return [
        AlarmEvent(
            number=int(columns["number"][k]),
            cause=int(columns["cause"][k]),
            time_ns=int(times[k]),
            start_ns=int(starts[k]),
            end_ns=int(ends[k]),
            peak_evidence=float(columns["peak_evidence"][k]),
            reasons=words,
        )
        for k, words in enumerate(reasons)
    ]


def _inputs_outside(excess: Array) -> tuple[str, ...]:
    if not excess.any():
        return ()
    return tuple(INPUT_NAMES[k] for k in np.argsort(-excess, kind="stable") if excess[k] > 0.0)


def _texts(column: npt.NDArray[Any]) -> list[tuple[str, ...]]:
    return [tuple(text.decode(errors="replace") for text in texts) for texts in column]


def _mirrored_bounds(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Bounds (N, 6) between FRD and FLU: they swap on an axis that changes sign."""
    one, other = mirrored(lower), mirrored(upper)
    swapped = FLU_SIGNS < 0.0
    return np.where(swapped, other, one), np.where(swapped, one, other)


# As `robot_description` gives every tool the vehicle, `~/description` of a monitor gives it the training
# ranges, and what inputs are computed with, whether or not it can read the model's folder.


@dataclass(frozen=True)
class DescribedModel:
    """What a page has to know of a model.

    Attributes:
        identity: name and hash.
        vehicle: that it was identified for.
        lower: (19,) smallest value of each input on the training flights.
        upper: (19,) largest value.
        cutoff_hz: of its low-pass; None where the monitor does not say it.
    """

    identity: str
    vehicle: str
    lower: Array
    upper: Array
    cutoff_hz: float | None = None


@dataclass(frozen=True)
class MonitorDescription:
    """The models of a monitor, the one that gives the alarm first.

    Attributes:
        models: by identity.
        topics: resolved names, by the names of the topics before remapping.
        vehicle: of all models; None where the monitor does not say it.
    """

    models: dict[str, DescribedModel]
    topics: dict[str, str]
    vehicle: Vehicle | None = None


def pack_description(
    models: Sequence[DescribedModel], topics: Mapping[str, str], vehicle: Vehicle | None = None
) -> str:
    """The JSON of a description."""
    rows = [
        {
            "identity": model.identity,
            "vehicle": model.vehicle,
            "cutoff_hz": model.cutoff_hz,
            "training": {
                name: [float(model.lower[k]), float(model.upper[k])] for k, name in enumerate(INPUT_NAMES)
            },
        }
        for model in models
    ]
    whole: dict[str, Any] = {"models": rows, "topics": dict(topics)}
    if vehicle is not None:
        whole["vehicle"] = {"name": vehicle.name, "file": vehicle.to_file()}
    return json.dumps(whole, allow_nan=False)


def unpack_description(text: str) -> MonitorDescription:
    """The description in its JSON.

    Raises:
        LogError: for a text that is none.
    """
    try:
        given = json.loads(text)
        models = {}
        for model in given["models"]:
            ranges = np.array([model["training"][name] for name in INPUT_NAMES], dtype=float)
            if ranges.shape != (len(INPUT_NAMES), 2) or not np.isfinite(ranges).all():
                raise ValueError("a training range is no pair of numbers")
            identity = str(model["identity"])
            models[identity] = DescribedModel(
                identity, str(model["vehicle"]), ranges[:, 0], ranges[:, 1], _cutoff(model.get("cutoff_hz"))
            )
        topics = {str(name): str(topic) for name, topic in given["topics"].items()}
        vehicle = None
        if (flown := given.get("vehicle")) is not None:
            name = str(flown["name"])
            vehicle = Vehicle.from_content(flown["file"], name, f"vehicle {name}")
    except (
        *(ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError),
        VehicleError,
    ) as error:
        raise LogError(f"not the description of a monitor: {error}") from error
    return MonitorDescription(models, topics, vehicle)


def _cutoff(given: Any) -> float | None:
    if given is None:
        return None
    cutoff_hz = float(given)
    if not 0.0 < cutoff_hz < np.inf:
        raise ValueError(f"the cut-off {cutoff_hz:g} Hz is no frequency")
    return cutoff_hz
