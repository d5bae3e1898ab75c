# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A flight with its results as a recording of Rerun, on the timeline of its stamps.

Of more samples than the recording is to have, the least and the largest of each quantity are kept.
"""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import QuadpiError, require_library
from quadpi_core.flight import AXES, OdometryStream, RotorSpeedStream, Stamps
from quadpi_core.flight_files import named_files
from quadpi_core.frames import Array, quaternion_frd_ned_to_flu_enu, world_ned_to_enu
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs.mcap_files import is_cut_off, whole_part
from quadpi_core.messages.result_messages import DescribedModel
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.alarm_log import INPUT_WORDS
from quadpi_core.paths import whole_output
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.results import CAUSE_NAMES, AlarmEvent, Predictions, ReportedAlarms
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.flight_parts import Part, Parts, flight_parts, holds_only_results
from quadpi_core.view.trust import NO_MESSAGE, State, Told, states_of
from quadpi_core.view.vehicle_view import BLOCK_NS, VehicleView

TIMELINE = "stamp"
# Rows a second of each series: an hour takes 230 MB, and every sample at 500 Hz 1.6 GB.
RATE_HZ = 50.0
# Two stamps: at any higher rate every sample is kept.
_SHORTEST_STRETCH_NS = 2
# Of the line along which the vehicle flew: a point every 50 ms is as fine as one sees.
_TRAIL_STEP_NS = 50_000_000
# Colours that colour-blind people tell apart (Okabe and Ito).
_COLOURS = {
    "measured": (230, 159, 0),
    "predicted": (0, 114, 178),
    "lower": (86, 180, 233),
    "upper": (86, 180, 233),
}
_LOG_LEVELS = {State.TRUSTED: "INFO", State.WARNING: "WARN", State.ALARM: "ERROR"}
_AXES_LENGTH_M = 0.3


class RerunRecording:
    """Takes what comes of one flight, as `vehicle_view.VehicleView` does, and writes it to a recording.

    Entities: `wrench/AXIS` (measured, predicted, lower, upper; N and Nm, body forward-right-down), of further
    models `wrench/AXIS/MODEL`; `inputs/NAME` with the training range where it is known; `rotor_speeds`;
    `speed`; `flight/vehicle` and `flight/trail` in the world east-north-up; `alarm/level`,
    `alarm/envelope_distance` and `alarm/log`.

    Args:
        path: of the file to write.
        known: models whose training ranges are known, by identity.
        rate_hz: rows a second of each series at most, see :func:`extremes`.

    Attributes:
        missing: topics that the flight lacks, with what is not recorded for that.

    Raises:
        LogError: naming the extra where Rerun is not installed.
    """

    def __init__(self, path: Path, known: Mapping[str, DescribedModel], rate_hz: float = RATE_HZ) -> None:
        self._rr = require_library("rerun", "rerun")
        self._known = dict(known)
        # Two rows of each stretch: where it begins and where it ends.
        self._stretch_ns = max(_SHORTEST_STRETCH_NS, round(2e9 / rate_hz))
        self.missing: list[tuple[str, str]] = []
        self._stream = self._rr.RecordingStream("quadpi")
        self._stream.save(path, default_blueprint=_blueprint(require_library("rerun.blueprint", "rerun")))
        self._named: set[str] = set()
        self._models: list[str] = []
        self._ranges: DescribedModel | None = None
        self._said: tuple[State, tuple[str, ...]] | None = None
        self._trail: list[Array] = []
        self._trail_ns: int | None = None
        self._log("flight", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        self._log(
            "flight/vehicle",
            self._rr.Arrows3D(
                vectors=_AXES_LENGTH_M * np.eye(3), colors=[(213, 94, 0), (0, 158, 115), (0, 114, 178)]
            ),
        )

    def learn(self, models: Mapping[str, DescribedModel]) -> None:
        """Take the training ranges of models, by identity."""
        self._known |= models

    def take_predictions(
        self, model: str, predictions: Predictions, identity: str, confidence: float, axes: Sequence[str]
    ) -> None:
        """Take predictions of a model; the first one's are shown with the measured wrench."""
        if model not in self._models:
            self._models.append(model)
        first = model == self._models[0]
        if first:
            self._ranges = self._known.get(identity)
        names = ("measured", "predicted", "lower", "upper") if first else ("predicted", "lower", "upper")
        shares = f"{confidence:.0%}"
        for axis, name in enumerate(AXES):
            if name in axes:
                entity = f"wrench/{name}" if first else f"wrench/{name}/{model}"
                labels = {one: f"{one} {shares}" if one in ("lower", "upper") else one for one in names}
                self._name(entity, [labels[one] for one in names], [_COLOURS[one] for one in names])
                columns = [getattr(predictions, one)[:, axis] for one in names]
                self._series(entity, predictions.time_ns, np.column_stack(columns))

    def take_inputs(self, time_ns: Stamps, inputs: Array) -> None:
        """Take inputs (K, 19) of the models, low-passed as they see them."""
        for column, name in enumerate(INPUT_NAMES):
            words, values, labels = INPUT_WORDS[name], [inputs[:, column]], [name]
            if self._ranges is not None:
                labels += ["least in training", "largest in training"]
                for bound in (self._ranges.lower[column], self._ranges.upper[column]):
                    values.append(np.full(len(time_ns), bound))
            self._name(f"inputs/{name}", [f"{words.name} ({name})", *labels[1:]])
            self._series(f"inputs/{name}", time_ns, np.column_stack(values))

    def take_states(self, states: OdometryStream) -> None:
        """Take positions, attitudes and velocities."""
        pose = np.concatenate((states.position, states.attitude), axis=1)
        states = states.take(np.flatnonzero(np.isfinite(pose).all(axis=1)))
        if not len(states):
            return
        chosen = states.take(_stretches(states.time_ns, self._stretch_ns // 2)[1])
        time_ns, position = chosen.time_ns, world_ned_to_enu(chosen.position)
        attitude = quaternion_frd_ned_to_flu_enu(chosen.attitude)
        self._columns(
            "flight/vehicle",
            time_ns,
            self._rr.Transform3D.columns(translation=position, quaternion=np.roll(attitude, -1, axis=1)),
        )
        velocity = states.velocity
        self._name("speed", ["speed [m/s]"])
        self._series("speed", states.time_ns, np.sqrt((velocity * velocity).sum(axis=1))[:, None])
        for stamp, point in zip(time_ns.tolist(), position, strict=True):
            if self._trail_ns is None or abs(stamp - self._trail_ns) >= _TRAIL_STEP_NS:
                self._trail_ns = stamp
                self._trail.append(point)

    def take_rotor_speeds(self, rotors: RotorSpeedStream) -> None:
        """Take rotor speeds."""
        count = rotors.speeds.shape[1]
        self._name("rotor_speeds", [f"rotor {number + 1} [rad/s]" for number in range(count)])
        self._series("rotor_speeds", rotors.time_ns, rotors.speeds)

    def take_alarms(self, alarms: ReportedAlarms) -> None:
        """Take what the monitor says: its level, the envelope's distance, and words where they change."""
        if len(alarms) == 0:
            return
        self._name("alarm/level", ["level: 0 ok, 1 warning, 2 alarm"])
        self._name("alarm/envelope_distance", ["farthest input outside its training range [ranges]"])
        self._series("alarm/level", alarms.time_ns, alarms.level.astype(float)[:, None])
        self._series("alarm/envelope_distance", alarms.time_ns, alarms.envelope_distance[:, None])
        texts = []
        for time_ns, state, reasons in zip(
            alarms.time_ns.tolist(), states_of(alarms), alarms.reasons, strict=True
        ):
            if (state, reasons) != self._said:
                self._said = state, reasons
                words = "; ".join(reasons)
                text = state.name.replace("_", " ") + (f": {words}" if words else "")
                texts.append((time_ns, _LOG_LEVELS.get(state, "INFO"), text))
        self._text(texts)

    def take_told(self, told: Sequence[Told]) -> None:
        """Take what battery, autopilot and link say."""
        self._text(
            [(one.time_ns, "INFO", f"{one.name}: {one.words}") for one in told if one.words != NO_MESSAGE]
        )

    def take_missing(self, topics: Sequence[tuple[str, str]]) -> None:
        """Take topics that are missing, which the recording itself does not say."""
        self.missing += topics

    def take_events(self, events: Sequence[AlarmEvent]) -> None:
        """Take alarms that were raised or cleared."""
        lines = []
        for event in events:
            change, level = ("cleared", "INFO") if event.end_ns else ("raised", "ERROR")
            cause = CAUSE_NAMES.get(event.cause, event.cause)
            lines.append((event.time_ns, level, f"alarm {event.number} {change}: {cause}"))
        self._text(lines)

    def close(self) -> None:
        """Finish the file."""
        if len(self._trail) > 1:
            self._log("flight/trail", self._rr.LineStrips3D([np.array(self._trail)]))
        self._stream.flush()
        self._stream.disconnect()

    def _log(self, entity: str, what: Any) -> None:
        self._stream.log(entity, what, static=True)

    def _name(
        self, entity: str, names: Sequence[str], colours: Sequence[tuple[int, int, int]] | None = None
    ) -> None:
        if entity not in self._named:
            self._named.add(entity)
            self._log(entity, self._rr.SeriesLines(names=list(names), colors=colours))

    def _series(self, entity: str, time_ns: Stamps, values: Array) -> None:
        """Add rows (K, series) of numbers."""
        if len(time_ns):
            time_ns, values = extremes(time_ns, values, self._stretch_ns)
            scalars = self._rr.Scalars.columns(scalars=np.ascontiguousarray(values, dtype=float).ravel())
            self._columns(entity, time_ns, scalars.partition(lengths=[values.shape[1]] * len(time_ns)))

    def _text(self, lines: Sequence[tuple[int, str, str]]) -> None:
        if lines:
            times, levels, texts = zip(*lines, strict=True)
            self._columns("alarm/log", np.array(times), self._rr.TextLog.columns(text=texts, level=levels))

    def _columns(self, entity: str, time_ns: Stamps, columns: Any) -> None:
        times = self._rr.TimeColumn(TIMELINE, timestamp=time_ns.astype("datetime64[ns]"))
        self._stream.send_columns(entity, indexes=[times], columns=columns)


def extremes(time_ns: Stamps, values: Array, stretch_ns: int) -> tuple[Stamps, Array]:
    """Rows (K, W) in at most two rows of each stretch of time, with the least and the largest of each column.

    They are at the first and the last stamp of the stretch, in the order in which they were. Stretches of one
    or two rows stay as they are.
    """
    first, last = _stretches(time_ns, stretch_ns)
    if np.all(last - first < 2):
        return time_ns, values
    low, high = np.fmin.reduceat(values, first), np.fmax.reduceat(values, first)
    # Where in its stretch a column first is at its least and at its largest.
    place = np.arange(len(time_ns))[:, None]
    counts = last - first + 1
    lowest, highest = (
        np.minimum.reduceat(np.where(values == np.repeat(one, counts, axis=0), place, len(time_ns)), first)
        for one in (low, high)
    )
    rises = lowest <= highest
    pairs = np.stack((np.where(rises, low, high), np.where(rises, high, low)), axis=1)
    short = last - first < 2
    pairs[short] = np.stack((values[first[short]], values[last[short]]), axis=1)
    rows = np.stack((first, last), axis=1).ravel()
    rising = np.append(True, np.diff(rows) > 0)
    return time_ns[rows[rising]], pairs.reshape(-1, values.shape[1])[rising]


def _stretches(time_ns: Stamps, stretch_ns: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """First and last row of each stretch of time."""
    first = np.flatnonzero(np.diff(time_ns // stretch_ns, prepend=-1))
    return first, np.append(first[1:], len(time_ns)) - 1


def write_rerun_file(
    parts: Iterable[Part], output: Path, known: Mapping[str, DescribedModel], rate_hz: float = RATE_HZ
) -> list[tuple[str, str]]:
    """Write a flight to a recording; the file appears whole or not at all.

    Args:
        parts: of the flight, see :func:`quadpi_core.view.flight_parts.flight_parts`.
        output: a file that ends in .rrd.
        known: see :class:`RerunRecording`.
        rate_hz: see there.

    Returns:
        Topics that the flight lacks, with what is not recorded for that; of a bag that is cut off, itself.

    Raises:
        QuadpiError: for a bag that cannot be read, and where Rerun is not installed.
    """
    with whole_output(output) as temporary:
        recording = RerunRecording(temporary, known, rate_hz)
        try:
            for part in parts:
                part(recording)
        finally:
            recording.close()
    return recording.missing


def _blueprint(rrb: Any) -> Any:
    """The views that the recording opens with."""
    axes = [rrb.TimeSeriesView(origin=f"wrench/{axis}", name=axis) for axis in AXES]
    inputs = [
        rrb.TimeSeriesView(origin=f"inputs/{name}", name=f"{INPUT_WORDS[name].name} ({name})")
        for name in INPUT_NAMES
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(*axes),
            rrb.Vertical(
                rrb.Spatial3DView(origin="flight", name="Flight"),
                rrb.TimeSeriesView(origin="alarm/level", name="Alarm"),
                rrb.TextLogView(origin="alarm/log", name="Why"),
                rrb.Tabs(
                    rrb.TimeSeriesView(origin="alarm/envelope_distance", name="Envelope"),
                    *inputs,
                    rrb.TimeSeriesView(origin="rotor_speeds", name="Rotor speeds"),
                    rrb.TimeSeriesView(origin="speed", name="Speed"),
                ),
            ),
        ),
        collapse_panels=True,
    )


# An hour at 20 blocks a second, 50 MB with one model.
_BLOCKS = 72_000
# Time that a tick may spend on what has been read, so that pages are answered meanwhile.
_TICK_S = 0.03


class Source(Protocol):
    """Where a page's data come from."""

    live: bool
    title: str

    @property
    def vehicles(self) -> Mapping[str, VehicleView]:
        """Every vehicle, by name."""

    def poll(self) -> None:
        """Take what has come since the last call; called at every tick of the server."""

    def close(self) -> None:
        """Stop."""


class BagSource:
    """A flight that is read in a thread while pages look at what has been read.

    Args:
        title: what the page is about.
        name: of the flight.
        parts: what to do with the view, block by block.
        known: see :class:`VehicleView`.

    Raises:
        QuadpiError: for a bag whose first part cannot be read.
    """

    live = False

    def __init__(self, title: str, name: str, parts: Parts, known: Mapping[str, DescribedModel]) -> None:
        self.title = title
        view = VehicleView(name, known, BLOCK_NS, _BLOCKS)
        view.silent(("reading the bag",))
        self.vehicles = {name: view}
        self.error: QuadpiError | None = None
        self.finished = False
        self._view = view
        self._parts = parts
        self._reader = ThreadPoolExecutor(1, "bag reader")
        # What is wrong with a bag is said before a page is opened.
        self._next: Future[Part | None] = Future()
        self._next.set_result(next(parts, None))

    def poll(self) -> None:
        """Take what has been read, for a moment."""
        deadline = time.monotonic() + _TICK_S
        while not self.finished and wait([self._next], max(0.0, deadline - time.monotonic())).done:
            try:
                part = self._next.result()
            except QuadpiError as error:
                part, self.error = None, error
                self._view.silent((f"the bag cannot be read further: {error}",))
                self._view.health.append(("bag", "error", str(error)))
            self.finished = part is None
            if part is not None:
                part(self._view)
                self._next = self._reader.submit(next, self._parts, None)

    def close(self) -> None:
        """End the reader, and close the bag."""
        self._reader.shutdown()
        self._parts.close()


def open_bag(
    bag: Path,
    models: Sequence[AerodynamicModel],
    vehicle: Vehicle | None,
    confidence: float | None = None,
    mapping: MappingOrOptions = None,
) -> BagSource:
    """The source of a flight.

    Args:
        bag: with sensor topics to judge by the models, or with results.
        models: the first gives the alarm; none: those whose results the bag holds. Of a bag with
            results alone their training ranges are shown.
        vehicle: of the models.
        confidence: of the intervals; each model's own unless given.
        mapping: of a flight that models judge, see :func:`quadpi_core.logs.read_recording`.

    Raises:
        QuadpiError: for a bag that cannot be read or holds no results, and models of another vehicle.
    """
    known = {model.identity: model.described() for model in models}
    command = f"quadpi view {shlex.quote(str(bag))}"
    parts = flight_parts(bag, models, vehicle, confidence, command, mapping)
    with whole_part(bag) as readable:
        judges = models and not holds_only_results(readable)
    about = f"judged by {', '.join(model.name for model in models)}" if judges else "results as recorded"
    whole = ", as far as the file goes: it is cut off" if is_cut_off(bag) else ""
    (file,) = named_files(bag)
    return BagSource(f"{bag.name}, {about}{whole}", file.name, parts, known)
