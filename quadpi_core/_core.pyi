# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled core, see :mod:`quadpi_core.core`; what each function does stands in core/include/quadpi.

Arrays must be contiguous, and those that are changed in place writable; one of length one is a record.
"""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from quadpi_core.estimator.filter_run import Arrivals, Inputs, Tape, Trace
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.messages.adapters.rotor_messages import EscReports
from quadpi_core.messages.payloads import Bytes, Indices
from quadpi_core.models.physical_rollout import Disturbances, Rolled, Track
from quadpi_core.models.tubes import Uncertainty
from quadpi_core.monitor.pairing import Completed
from quadpi_core.records import Records
from quadpi_core.simulation.state_records import AddedEffect, Controls, Demand

SOURCES: str

# elementary functions, over arrays
def sine(angles: Array, values: Array, /) -> None: ...
def cosine(angles: Array, values: Array, /) -> None: ...
def arctangent(y: Array, x: Array, values: Array, /) -> None: ...
def exponential(exponents: Array, values: Array, /) -> None: ...
def hyperbolic_tangent(arguments: Array, values: Array, /) -> None: ...

# estimator
ANGULAR_ACCELERATION: float
BUFFER_NS: int
HELD: int

# The filter as it runs live, with the sample at hand and the estimate after it.
class LiveFilter:
    def __init__(self, arrays: object, /) -> None: ...
    @property
    def arrays(self) -> tuple[object, ...]: ...

# Given back are an Outcome and an EstimatorStatus.
def step(live: LiveFilter, time_ns: int, rates: Array, specific_force: Array, /) -> tuple[int, int]: ...
def catch_up(filter: Records, ring: Records, samples: Records, /) -> None: ...
def hold(filter: Records, ring: Records, measurement: Records, /) -> int: ...
def usable_measurement(measurement: Records, /) -> bool: ...
def fill_newest(filter: Records, ring: Records, fused: Records, /) -> None: ...
def run(filter: Records, ring: Records, arrivals: Arrivals, trace: Trace, /) -> None: ...
def record(filter: Records, ring: Records, trace: Trace, sample: int, /) -> None: ...
def forward(inputs: Inputs, estimate: Records, first: int, last: int, applied: int, tape: Tape, /) -> int: ...
def backward(tape: Tape, adjoint: Array, information: Array, smoothed: Records, /) -> None: ...
def relative_attitudes(imu: Records, last_ns: int, attitude: Array, /) -> None: ...
def pose_information(steps: Array, noise: Records, limits: Array, poses: float, found: Array, /) -> None: ...

# logs
BLACKBOX_ENCODINGS: list[int]
BLACKBOX_FIELDS_MAX: int
BLACKBOX_KINDS: str
BLACKBOX_NOTHING: int
BLACKBOX_PREDICTORS: list[int]
BLACKBOX_TAG8_4S16: int

def decode_blackbox(
    flight: bytes, start: int, rules: Records, chosen: Indices, table: Array, /
) -> tuple[int, bool, int, int]: ...

# How many messages were found, and where the first record begins that is not whole.
def mcap_messages(chunk: Bytes, found: Records, /) -> tuple[int, int]: ...

# messages
FIRST_MOTOR: int
LAST_MOTOR: int
MOUNTING_LAG_S: float
NORM_TOLERANCE: float
ODOMETRY_VALUES: int
PREDICTION_VALUES: int

def copy_spans(
    source: Bytes, source_starts: Indices, target: Bytes, target_starts: Indices, lengths: Indices, /
) -> None: ...
def move_mounted(imu: Records, time_ns: Stamps, rates: Array, force: Array, /) -> None: ...
def take_numbered_escs(
    counts: Indices, rpm: Array, marks: Indices, wanted: Indices, reports: EscReports, /
) -> None: ...
def take_escs_of_motors(
    functions: Indices,
    rpm: Array,
    marks: Indices,
    online: Indices,
    wanted: Indices,
    reports: EscReports,
    /,
) -> None: ...
def judge_esc_news(reports: EscReports, memory: Records, /) -> None: ...

# Numbers (N, K) of messages, and samples; returned is the first that is no rotation, else -1.
def imu_values(values: Array, rates: Array, force: Array, /) -> None: ...
def pose_values(values: Array, position: Array, attitude: Array, /) -> int: ...
def state_values(
    values: Array, position: Array, attitude: Array, velocity: Array, rates: Array, deviation: Array, /
) -> int: ...
def wind_values(values: Array, velocity: Array, /) -> None: ...
def twist_values(values: Array, in_body: bool, velocity: Array, /) -> None: ...
def odometry_values(
    position: Array,
    attitude: Array,
    velocity: Array,
    rates: Array,
    pose_covariance: Array,
    twist_covariance: Array,
    values: Array,
    /,
) -> None: ...
def fill_odometry(samples: Records, values: Array, /) -> None: ...
def prediction_values(wrenches: Array, first: int, values: Array, /) -> None: ...

# screening
AIRSPEED_MAX_M_S: float
ALONE: int
FLIGHT_MAX_NS: int
LATE: int
MAX_GAP_NS: int
MAX_JUMP_BACK_NS: int
MEASURED_SPEED_MAX_M_S: float
NO_STAMP: int
POSITION_MAX_M: float
QUATERNION_NORM_TOLERANCE: float
RATE_MAX_RAD_S: float
RISES: int
SPECIFIC_FORCE_MAX_M_S2: float
STANDARD_GRAVITY: float
UNKNOWN_VARIANCE: float

def scan_order(
    time_ns: Stamps, hole_ns: float, rising: Stamps, kinds: npt.NDArray[np.int8], run_of: Indices, /
) -> None: ...
def usable_imu(rates: Array, specific_force: Array, /) -> bool: ...

# signals, inputs and the rate of the IMU
METER_ROOM: int
ROTORS_MAX: int
RATE_SPAN: int

def settle(design: Records, state: Array, sample: Array, /) -> None: ...
def low_pass(design: Records, state: Array, samples: Array, value: Array, derivative: Array, /) -> None: ...
def make_continuous(attitudes: Array, last: Array, /) -> None: ...
def newton_euler(
    specific_force: Array, rates: Array, acceleration: Array, mass_kg: float, inertia: Array, wrench: Array, /
) -> None: ...
def turn_by_rates(time: Array, rates: Array, attitudes: Array, /) -> None: ...
def relative_to_air(velocity: Array, attitude: Array, wind: Array, out: Array, /) -> None: ...
def fill_inputs(
    velocity_air: Array, attitude: Array, rates: Array, rotor_speeds: Array, vehicle: Records, out: Array, /
) -> None: ...
def follow_rate(meter: Records, time_ns: int, /) -> None: ...

# models
BASE_ROWS: int
ENSEMBLE_BLOCK: int
GRAM_BLOCK: int
MOST_OUTPUTS: int
TILE_ROWS: int

def evaluate_regressors(
    inputs: Array, operations: Records, outputs: Indices, rows: Array, values: Array, /
) -> None: ...

# Fitted models, which hold their arrays; see models/model_kind.py.
class Model:
    @property
    def arrays(self) -> tuple[object, ...]: ...

TERMS_TOGETHER: int

class Polynomials(Model):
    def __init__(self, arrays: object, /) -> None: ...

class Ensembles(Model):
    def __init__(self, arrays: object, /) -> None: ...

def evaluate(model: Model, inputs: Array, derivatives: Records, factors: Array, out: Array, /) -> None: ...
def add_to_gram(
    inputs: Array, target: Array, operations: Records, factors: Indices, rows: Array, sums: Array, /
) -> None: ...
def distances_outside(inputs: Array, lower: Array, upper: Array, width: Array, out: Array, /) -> None: ...

# monitor
ACCELEROMETER_FROZEN: int
GAP: int
GYRO_FROZEN: int
NOT_FINITE: int
NOT_PLAUSIBLE: int
RATE_DIFFERS: int
RATE_LOW: int
RATE_UNKNOWN: int
ROTORS_MISSING: int
ROTOR_DIFFERS: int
ROTOR_FROZEN: int
ROTOR_HALF: int
ROTOR_JUMPS: int
ROTOR_ZERO: int
SETTLE_NS: int
ERRORS_KEPT: int
BLOCK_S: float
BLOCK_FILLED_S: float
LOAD_EVIDENCE: float
LOUDNESS_LEAST: float
ONSETS: int
DIRECTIONS: int
SIZES: int
NOTHING: int
OF_THRUST: int
LESS_1: int
STAMP_BACKWARD: int
STAMP_REPEATED: int
STATE_MISSING: int
FINE_STEP: float
GONE_M: float
LARGEST_CHANGE: float
LIFTED: float
LOST_MOST: float
LOST_S: float
LOST_SHARE: float
MOVES_G: float
MOVES_M_S: float
MOVES_RAD_S: float
OTHERS_STEPS: float
RESTING: float
ROUNDING: float
SILENT_LOST_S: float
STEADY_SHARE: float
STEP_MAX_S: float
STUCK_RAD_S: float
STUCK_S: float
SUPPORTED_G: float
SUPPORTED_S: float
TOGETHER_SHARE: float
TURNING: float
UNDECIDED_S: float
WARNING_CHARGE: float

class Pairing:
    def __init__(self, arrays: object, /) -> None: ...
    @property
    def arrays(self) -> tuple[object, ...]: ...

# A pairing, and a monitor that judges what each sample completes.
class PairedMonitor(Pairing): ...

def add_imu(pairing: Pairing, time_ns: int, specific_force: Array, /) -> Completed: ...
def add_state(
    pairing: Pairing, time_ns: int, velocity: Array, attitude: Array, rates: Array, /
) -> Completed: ...
def add_estimate(pairing: Pairing, time_ns: int, motion: Array, /) -> Completed: ...
def add_sample(pairing: Pairing, topic: int, time_ns: int, values: Array, /) -> Completed: ...
def take_samples(pairing: Pairing, taken_ns: Stamps, taken: Array, /) -> tuple[int, bool]: ...
def take_stretch(
    pairing: Pairing, arriving: object, start: int, taken_ns: Stamps, taken: Array, /
) -> tuple[int, int, int]: ...
def prepare(
    memory: Records,
    time_ns: Stamps,
    samples: Array,
    verdicts: Records,
    inputs: Array,
    measured: Array,
    derivatives: Records,
    filtered: Array,
    /,
) -> int: ...
def take_conditions(
    memory: Records,
    conditions: Records,
    verdicts: Records,
    filtered: Array,
    derivatives: Records,
    erring: Array,
    /,
) -> None: ...
def scale_by_density(derivatives: Records, evaluation: Array, /) -> None: ...
def adapt(
    memory: Records, measured: Array, own_lower: Array, own_upper: Array, lower: Array, upper: Array, /
) -> None: ...
def advance_alarm(
    limits: Records,
    state: Records,
    verdicts: Records,
    inputs: Array,
    measured: Array,
    lower: Array,
    upper: Array,
    leverage: Array,
    relative_width: Array,
    rows: Records,
    /,
) -> int: ...

class Monitor:
    def __init__(self, arrays: object, /) -> None: ...
    @property
    def arrays(self) -> tuple[object, ...]: ...

def step_monitor(
    monitor: Monitor,
    preparation: Records,
    time_ns: Stamps,
    samples: Array,
    predicted_ns: Stamps,
    wrenches: Array,
    alarms: Records,
    /,
) -> tuple[int, int]: ...
def judge_prepared(
    monitor: Monitor,
    prepared: object,
    added: Array,
    said: Array,
    predicted_ns: Stamps,
    wrenches: Array,
    alarms: Records,
    /,
) -> tuple[int, int]: ...
def whiten_blocks(
    noise: Records,
    residuals: Array,
    numbers: npt.NDArray[np.int64],
    errors: Array,
    spreads: Array,
    ones: Array,
    loudness: Array,
    /,
) -> None: ...
def gather_evidence(
    limits: Records, rotors: Records, blocks: Records, memory: Records, evidence: Array, /
) -> None: ...
def lasts(values: Array, steps: Array, level: float, persistence_s: float, release_s: float, /) -> bool: ...
def sum_misses(steps: Array, miss: Array, allowed: float, sums: Array, /) -> None: ...

# physical model
def fill_regressors(motion: Records, vehicle: Records, rows: Array, /) -> None: ...
def physical_wrenches(motion: Records, vehicle: Records, parameters: Array, out: Array, /) -> None: ...
def read_motions(inputs: Array, derivatives: Records, vehicle: Records, motion: Records, /) -> None: ...

class Physical(Model):
    def __init__(self, arrays: object, /) -> None: ...

def roll_out(
    track: Track,
    starts: Indices,
    horizons: Indices,
    parameters: Array,
    disturbances: Disturbances,
    rolled: Rolled,
    /,
) -> None: ...
def error_covariance(
    track: Track,
    starts: Indices,
    horizons: Indices,
    path: Records,
    parameters: Array,
    uncertainty: Uncertainty,
    covariance: Array,
    /,
) -> None: ...

# simulation
ADVANCE_RATIO_MAX: float
FLOWN_RATE_MAX_RAD_S: float
NEAREST_SURFACE: float
NOT_SIX: str
OWN_STATE_CHANGE_MAX: float
POSITION_ERROR_MAX_M: float
SHAPE_MAX: float
SHORTEST_CABLE_M: float
SPECIFIC_FORCE_MIN: float
STEP_HZ: int
TILT_COSINE_MIN: float
TILT_MAX_DEG: float
WRENCH_EFFECTS: tuple[str, ...]

def fly(
    vehicle: Records,
    aerodynamics: str | Callable[[], object],
    numbers: Array,
    effects: Sequence[AddedEffect],
    controls: Controls,
    demand: Demand,
    motions: Records,
    state: Records,
    log: Records,
    done: Stamps,
    /,
) -> None: ...
def fill_aerodynamics(states: Records, vehicle: Records, law: str, numbers: Array, /) -> None: ...
def effect_wrenches(
    effect: str, states: Records, vehicle: Records, parameters: Array, shape: Array, wrenches: Array, /
) -> None: ...
def remember(effect: str, states: Records, vehicle: Records, parameters: Array, step_s: float, /) -> None: ...
def remembered_wrenches(
    effect: str,
    states: Records,
    vehicle: Records,
    parameters: Array,
    memory: Array,
    step_s: float,
    added: Array,
    /,
) -> None: ...
def wave_jets(
    time: Array,
    amplitude: float,
    frequencies: Array,
    phases: Array,
    sweep: float,
    window: Array,
    jets: Array,
    /,
) -> None: ...
def edge_jets(time: Array, instants: Array, heights: Array, rise: float, jets: Array, /) -> None: ...
def orbit_jets(
    time: Array, radius: float, turn_rate: float, bearing: float, window: Array, jets: Array, /
) -> None: ...
def quaternions_of(vectors: Array, quaternions: Array, /) -> None: ...
def rotation_vectors_of(quaternions: Array, vectors: Array, /) -> None: ...
