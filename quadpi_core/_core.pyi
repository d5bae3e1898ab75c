# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled core, see :mod:`quadpi_core.core`; what each function does stands in core/include/quadpi.

Arrays of records are changed in place, and must be contiguous and writable; one of length one is a record.
"""

from quadpi_core.estimator.filter_run import Arrivals, Trace
from quadpi_core.estimator.smoother import Inputs, Tape
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.messages.adapters.rotor_messages import EscReports
from quadpi_core.messages.payloads import Bytes, Indices
from quadpi_core.records import Records

SOURCES: str

# estimator
ANGULAR_ACCELERATION: float
BUFFER_NS: int
DEGRADED_NS: int
DELAY_MAX_S: float
HELD: int
HOLD_NS: int
LOST_NS: int
POSE_GATE: float
SCALAR_CORRECTION: int
STEP: int
VELOCITY_GATE: float

def step(filter: Records, ring: Records, sample: Records, journal: Records, fused: Records, /) -> int: ...
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

# Single steps, for tests of them.
def propagate_between(
    estimate: Records, noise: Records, between: Records, to_ns: int, by: Records, /
) -> None: ...
def interpolate_sample(estimate: Records, between: Records, /) -> None: ...
def apply_transposed(by: Records, vectors: Array, /) -> None: ...
def correct_scalar(covariance: Array, error: Array, scalar: Records, /) -> None: ...
def inject(estimate: Records, error: Array, /) -> None: ...
def fuse(estimate: Records, noise: Records, measurement: Records, scalars: Records, /) -> float: ...
def taken_ns(estimate: Records, measurement: Records, /) -> int: ...
def significance(x: float, y: float, z: float, variance: float, /) -> float: ...
def same_motion(pair: Records, estimate: Records, noise: Records, /) -> bool: ...
def motion_shows(estimate: Records, noise: Records, kind: int, elapsed: float, /) -> bool: ...
def status_of(filter: Records, ring: Records, /) -> int: ...
def fill_fused(estimate: Records, gyro_variance: float, fused: Records, /) -> None: ...

# logs
BLACKBOX_BROKEN: int
BLACKBOX_CUT: int
BLACKBOX_ENCODINGS: list[int]
BLACKBOX_FIELDS_MAX: int
BLACKBOX_KINDS: str
BLACKBOX_NOTHING: int
BLACKBOX_PREDICTORS: list[int]
BLACKBOX_TAG8_4S16: int

def decode_blackbox(
    flight: bytes, start: int, rules: Records, chosen: Indices, table: Array, /
) -> tuple[int, bool, int, int]: ...

# A single frame, for tests.
def read_blackbox_fields(data: bytes, position: int, encoding: Indices, values: Indices, /) -> int: ...

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
    values: Array, position: Array, attitude: Array, velocity: Array, rates: Array, /
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
def prediction_values(
    predicted: Array,
    lower: Array,
    upper: Array,
    measured: Array,
    relative_width: Array,
    first: int,
    values: Array,
    /,
) -> None: ...
