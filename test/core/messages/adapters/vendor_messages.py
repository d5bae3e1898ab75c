# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of other packages, serialized by rosbags from their definitions; the layouts are facts of:

mavros_msgs 2.12.0; px4_msgs v1.14.0 to v1.17.0 and, for the larger EscStatus, release/1.18; mocap4r2_msgs
0.0.5; motion_capture_tracking_interfaces 1.0.5; crazyflie_interfaces 1.0.
"""

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quadpi_core.messages.adapters import AdapterSettings
from quadpi_core.messages.adapters.adapter_settings import (
    BodySettings,
    CommandSettings,
    RotorSettings,
    StateSettings,
)
from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.frame_ids import TF_TYPE

HEADER = "std_msgs/Header header\n"
DEFINITIONS = {
    "mavros_msgs/msg/ESCStatus": HEADER + "mavros_msgs/ESCStatusItem[] esc_status\n",
    "mavros_msgs/msg/ESCStatusItem": HEADER + "int32 rpm\nfloat32 voltage\nfloat32 current\n",
    "mavros_msgs/msg/ESCTelemetry": HEADER + "mavros_msgs/ESCTelemetryItem[] esc_telemetry\n",
    "mavros_msgs/msg/ESCTelemetryItem": HEADER
    + "float32 temperature\nfloat32 voltage\nfloat32 current\nfloat32 totalcurrent\n"
    + "int32 rpm\nuint16 count\n",
    "px4_msgs/msg/EscStatus": """uint64 timestamp
uint8 CONNECTED_ESC_MAX = 8
uint16 counter
uint8 esc_count
uint8 esc_connectiontype
uint8 esc_online_flags
uint8 esc_armed_flags
EscReport[8] esc
""",
    "px4_msgs/msg/EscReport": """uint64 timestamp
uint32 esc_errorcount
int32 esc_rpm
float32 esc_voltage
float32 esc_current
float32 esc_temperature
uint8 esc_address
uint8 esc_cmdcount
uint8 esc_state
uint8 actuator_function
uint16 failures
int8 esc_power
""",
    "px4_msgs/msg/VehicleOdometry": """uint32 MESSAGE_VERSION = 0
uint64 timestamp
uint64 timestamp_sample
uint8 pose_frame
float32[3] position
float32[4] q
uint8 velocity_frame
float32[3] velocity
float32[3] angular_velocity
float32[3] position_variance
float32[3] orientation_variance
float32[3] velocity_variance
uint8 reset_counter
int8 quality
""",
    "px4_msgs/msg/SensorCombined": """uint64 timestamp
float32[3] gyro_rad
uint32 gyro_integral_dt
int32 accelerometer_timestamp_relative
float32[3] accelerometer_m_s2
uint32 accelerometer_integral_dt
uint8 accelerometer_clipping
uint8 gyro_clipping
uint8 accel_calibration_count
uint8 gyro_calibration_count
""",
    "quadpi/msg/MotorCommands": HEADER + "float64[] commands\n",
    "mavros_msgs/msg/RCOut": HEADER + "uint16[] channels\n",
    "px4_msgs/msg/ActuatorMotors": """uint64 timestamp
uint64 timestamp_sample
uint16 reversible_flags
uint8 ACTUATOR_FUNCTION_MOTOR1 = 101
uint8 NUM_CONTROLS = 12
float32[12] control
""",
    "px4_msgs/msg/ActuatorOutputs": """uint64 timestamp
uint8 NUM_ACTUATOR_OUTPUTS = 16
uint32 noutputs
float32[16] output
""",
    # The first fields of a message of many, which the adapter does not look at.
    "px4_msgs/msg/BatteryStatus": "uint64 timestamp\nbool connected\nfloat32 voltage_v\nfloat32 current_a\n",
    "px4_msgs/msg/VehicleAirData": "uint64 timestamp\nfloat32 baro_pressure_pa\nfloat32 rho\n",
    "crazyflie_interfaces/msg/LogDataGeneric": HEADER + "float32[] values\n",
    "crazyflie_interfaces/msg/Status": HEADER
    + "uint16 supervisor_info\nfloat32 battery_voltage\nuint8 pm_state\n",
    "mocap4r2_msgs/msg/RigidBodies": HEADER + "uint32 frame_number\nmocap4r2_msgs/RigidBody[] rigidbodies\n",
    "mocap4r2_msgs/msg/RigidBody": "string rigid_body_name\nMarker[] markers\ngeometry_msgs/Pose pose\n",
    "mocap4r2_msgs/msg/Marker": """int8 USE_NAME=0
int8 id_type
int32 marker_index
string marker_name
geometry_msgs/Point translation
""",
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": HEADER + "NamedPose[] poses\n",
    "motion_capture_tracking_interfaces/msg/NamedPose": "string name\ngeometry_msgs/Pose pose\n",
}
PX4_1_18 = {
    **DEFINITIONS,
    "px4_msgs/msg/EscStatus": """uint64 timestamp
uint8 CONNECTED_ESC_MAX = 12
uint16 counter
uint8 esc_count
uint8 esc_connectiontype
uint16 esc_online_flags
uint16 esc_armed_flags
EscReport[12] esc
""",
    "px4_msgs/msg/EscReport": DEFINITIONS["px4_msgs/msg/EscReport"].replace(
        "uint8 esc_address\nuint8 esc_cmdcount\n", "int16 motor_temperature\n"
    ),
}


class Messages:
    """Makes messages of a set of definitions: `make(type name, field=…)`, absent numbers zero."""

    def __init__(self, definitions):
        self.definitions = definitions
        self.store = get_typestore(Stores.ROS2_JAZZY)
        types = {}
        for name, text in definitions.items():
            types |= get_types_from_msg(text, name)
        self.store.register(types)

    def definition(self, type_name):
        """The definition as a bag embeds it."""
        return self.store.generate_msgdef(type_name, ros_version=2)[0]

    def header(self, time_ns, frame_id="map"):
        sec, nanosec = divmod(int(time_ns), 10**9)
        types = self.store.types
        stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)

    def pose(self, position, orientation_xyzw):
        types = self.store.types
        return types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](*map(float, position)),
            orientation=types["geometry_msgs/msg/Quaternion"](*map(float, orientation_xyzw)),
        )

    def make(self, type_name, **fields):
        kind = self.store.types[type_name]
        names = [name for name, _ in self.store.fielddefs[type_name][1]]
        return kind(**{name: fields.get(name, 0) for name in names})

    def bytes(self, message):
        return bytes(self.store.serialize_cdr(message, message.__msgtype__))


START_NS = 1_700_000_000_123_456_000


def frame(vendor, name, time_ns, bodies):
    """One message with the bodies given as (name, position, orientation x y z w)."""
    header = vendor.header(time_ns)
    if name == "named_poses":
        kind = "motion_capture_tracking_interfaces/msg/NamedPose"
        poses = [vendor.make(kind, name=body, pose=vendor.pose(*pose)) for body, *pose in bodies]
        return vendor.bytes(vendor.make(f"{kind}Array", header=header, poses=poses))
    point = vendor.store.types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
    rigid = []
    for index, (body, *pose) in enumerate(bodies):
        marker = vendor.make("mocap4r2_msgs/msg/Marker", marker_name="m" * index, translation=point)
        rigid.append(
            vendor.make(
                "mocap4r2_msgs/msg/RigidBody",
                rigid_body_name=body,
                markers=[marker] * index,
                pose=vendor.pose(*pose),
            )
        )
    message = vendor.make("mocap4r2_msgs/msg/RigidBodies", header=header, frame_number=7, rigidbodies=rigid)
    return vendor.bytes(message)


def px4_odometry(vendor, **changes):
    fields = {
        "timestamp": START_NS // 1000 + 500,
        "timestamp_sample": START_NS // 1000,
        "pose_frame": 1,
        "position": [1, 2, -3],
        "q": np.sqrt([0.5, 0, 0, 0.5]),
        "velocity_frame": 1,
        "velocity": [4, 5, 6],
        "angular_velocity": [0.1, 0.2, 0.3],
        "position_variance": [0, 0, 0],
        "orientation_variance": [0, 0, 0],
        "velocity_variance": [0, 0, 0],
        **changes,
    }
    arrays = {
        name: np.array(value, np.float32) if isinstance(value, list | np.ndarray) else value
        for name, value in fields.items()
    }
    return vendor.bytes(vendor.make("px4_msgs/msg/VehicleOdometry", **arrays))


def mavros_status(vendor, time_ns, rpm, item_times_ns=None):
    items = [
        vendor.make("mavros_msgs/msg/ESCStatusItem", header=vendor.header(item_ns, "esc"), rpm=int(value))
        for value, item_ns in zip(rpm, item_times_ns or [time_ns] * len(rpm), strict=True)
    ]
    header = vendor.header(time_ns, "")
    return vendor.bytes(vendor.make("mavros_msgs/msg/ESCStatus", header=header, esc_status=items))


def mavros_telemetry(vendor, time_ns, rpm, counts):
    items = [
        vendor.make(
            "mavros_msgs/msg/ESCTelemetryItem",
            header=vendor.header(time_ns),
            rpm=int(value),
            count=int(count),
        )
        for value, count in zip(rpm, counts, strict=True)
    ]
    header = vendor.header(time_ns)
    return vendor.bytes(vendor.make("mavros_msgs/msg/ESCTelemetry", header=header, esc_telemetry=items))


def px4_status(
    vendor, time_ns, rpm, functions=(101, 102, 103, 104), times_ns=None, online=0xFF, places=(0, 1, 2, 3)
):
    size = dict(vendor.store.fielddefs["px4_msgs/msg/EscStatus"][1])["esc"][1][1]
    reports = [vendor.make("px4_msgs/msg/EscReport")] * size
    for place, value, function, at_ns in zip(places, rpm, functions, times_ns or [time_ns] * 4, strict=True):
        reports[place] = vendor.make(
            "px4_msgs/msg/EscReport", timestamp=at_ns // 1000, esc_rpm=int(value), actuator_function=function
        )
    message = vendor.make(
        "px4_msgs/msg/EscStatus", timestamp=time_ns // 1000, esc_count=4, esc_online_flags=online, esc=reports
    )
    return vendor.bytes(message)


def tf(*transforms, parent="world"):
    """A TFMessage of (child frame, seconds, position x, y, z, quaternion x, y, z, w)."""
    types = typestore().types
    made = []
    for child, second, position, orientation in transforms:
        stamp = types["builtin_interfaces/msg/Time"](sec=second, nanosec=5)
        made.append(
            types["geometry_msgs/msg/TransformStamped"](
                header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=parent),
                child_frame_id=child,
                transform=types["geometry_msgs/msg/Transform"](
                    translation=types["geometry_msgs/msg/Vector3"](*position),
                    rotation=types["geometry_msgs/msg/Quaternion"](*orientation),
                ),
            )
        )
    return bytes(typestore().serialize_cdr(types[TF_TYPE](transforms=made), TF_TYPE))


def px4_imu(vendor, gyro=(0.1, 0.2, 0.3), accelerometer=(1.0, 2.0, -9.8)):
    vectors = {"gyro_rad": gyro, "accelerometer_m_s2": accelerometer}
    arrays = {name: np.array(vector, np.float32) for name, vector in vectors.items()}
    return vendor.bytes(vendor.make("px4_msgs/msg/SensorCombined", timestamp=START_NS // 1000, **arrays))


def motor_commands(vendor, name, time_ns, values):
    """A message of an adapter of motor commands: shares, pulses in µs, or values of 16 bits."""
    stamps = {"timestamp": time_ns // 1000, "header": vendor.header(time_ns)}
    kind, field, size, number = {
        "px4_motors": ("px4_msgs/msg/ActuatorMotors", "control", 12, np.float32),
        "px4_outputs": ("px4_msgs/msg/ActuatorOutputs", "output", 16, np.float32),
        "mavros_rc_out": ("mavros_msgs/msg/RCOut", "channels", 0, np.uint16),
        "motor_commands": ("quadpi/msg/MotorCommands", "commands", 0, np.float64),
        "crazyflie_log": ("crazyflie_interfaces/msg/LogDataGeneric", "values", 0, np.float32),
    }[name]
    array = np.zeros(max(size, len(values)), number)
    array[: len(values)] = values
    return vendor.bytes(vendor.make(kind, **stamps, **{field: array}))


def voltage(vendor, name, time_ns, volts):
    """A message of an adapter of battery voltage."""
    stamps = {"timestamp": time_ns // 1000, "header": vendor.header(time_ns)}
    kind, field = {
        "px4_battery": ("px4_msgs/msg/BatteryStatus", "voltage_v"),
        "crazyflie_status": ("crazyflie_interfaces/msg/Status", "battery_voltage"),
        "battery_state": ("sensor_msgs/msg/BatteryState", "voltage"),
    }[name]
    no_cells = np.zeros(0, np.float32)
    texts = {"cell_voltage": no_cells, "cell_temperature": no_cells, "location": "", "serial_number": ""}
    return vendor.bytes(vendor.make(kind, **stamps, **texts, **{field: volts}))


def of_the_air(vendor, kind, time_ns, **values):
    """A message of pressure [Pa], temperature [°C] or density [kg/m³]."""
    stamps = {"timestamp": time_ns // 1000, "header": vendor.header(time_ns)}
    return vendor.bytes(vendor.make(kind, **stamps, **values))


def satellite_fix(vendor, time_ns, latitude, longitude, altitude, status=0, variance=4.0, kind=2):
    """A position by satellites; kind 0: its covariance is not known."""
    return vendor.bytes(
        vendor.make(
            "sensor_msgs/msg/NavSatFix",
            header=vendor.header(time_ns),
            status=vendor.make("sensor_msgs/msg/NavSatStatus", status=status),
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
            position_covariance=np.diag([variance] * 3).ravel(),
            position_covariance_type=kind,
        )
    )


SETTINGS = AdapterSettings(
    rotor_speeds=RotorSettings((3, 1, 4, 2), "rpm"),
    mocap=BodySettings("quad", "flu-enu"),
    odometry=StateSettings(),
    imu=StateSettings(),
    motor_commands=CommandSettings((3, 1, 4, 2)),
    battery=StateSettings(),
    pressure=StateSettings(),
    temperature=StateSettings(),
)
RPM, BODIES = [1, 2, 3, 4], [("wand", [0, 0, 0], [0, 0, 0, 1]), ("quad", [1, 2, 3], [0, 0, 0, 1])]
# By the name of the adapter: a message that holds a sample by these settings.
EXAMPLES = {
    "mavros_status": lambda vendor: mavros_status(vendor, START_NS, RPM),
    "mavros_telemetry": lambda vendor: mavros_telemetry(vendor, START_NS, RPM, [1, 2, 3, 4]),
    "px4_status": lambda vendor: px4_status(vendor, START_NS, RPM),
    "px4_odometry": px4_odometry,
    "px4_imu": px4_imu,
    "px4_motors": lambda vendor: motor_commands(vendor, "px4_motors", START_NS, [0.1, 0.2, 0.3, 0.4]),
    "px4_outputs": lambda vendor: motor_commands(vendor, "px4_outputs", START_NS, [100, 200, 300, 400]),
    "mavros_rc_out": lambda vendor: motor_commands(
        vendor, "mavros_rc_out", START_NS, [1100, 1200, 1300, 1400]
    ),
    "crazyflie_log": lambda vendor: motor_commands(vendor, "crazyflie_log", START_NS, [1, 2, 3, 4]),
    "px4_battery": lambda vendor: voltage(vendor, "px4_battery", START_NS, 15.5),
    "crazyflie_status": lambda vendor: voltage(vendor, "crazyflie_status", START_NS, 3.7),
    "battery_state": lambda vendor: voltage(vendor, "battery_state", START_NS, 15.5),
    "motor_commands": lambda vendor: motor_commands(vendor, "motor_commands", START_NS, [0.1, 0.2, 0.3, 0.4]),
    "fluid_pressure": lambda vendor: of_the_air(
        vendor, "sensor_msgs/msg/FluidPressure", START_NS, fluid_pressure=95000.0
    ),
    "temperature": lambda vendor: of_the_air(
        vendor, "sensor_msgs/msg/Temperature", START_NS, temperature=20.0
    ),
    "fix": lambda vendor: satellite_fix(vendor, START_NS, 47.0, 8.0, 500.0),
    "px4_air": lambda vendor: of_the_air(
        vendor, "px4_msgs/msg/VehicleAirData", START_NS, baro_pressure_pa=95000.0, rho=1.129
    ),
    "mocap4r2": lambda vendor: frame(vendor, "mocap4r2", START_NS, BODIES),
    "named_poses": lambda vendor: frame(vendor, "named_poses", START_NS, BODIES),
    "tf": lambda _: tf(*((name, START_NS // 10**9, *pose) for name, *pose in BODIES)),
}
