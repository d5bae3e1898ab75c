# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.core import compiled
from quadpi_core.errors import LogError, VehicleError
from quadpi_core.messages.adapters import AdapterSettings, known_adapters
from quadpi_core.messages.adapters.adapter_settings import RotorSettings
from quadpi_core.messages.adapters.rotor_messages import EscReports
from quadpi_core.messages.payloads import Payloads
from quadpi_core.vehicle import Vehicle

from .vendor_messages import mavros_status, mavros_telemetry, px4_status

START_NS = 1_700_000_000_123_000_000
STEP_NS = 10_000_000
RPM = 2.0 * np.pi / 60.0
RPMS = np.array([[1000, 2000, 3000, 4000], [1001, 2001, 3001, 4001], [1002, -2002, 3002, 4002]])
# Rotor 1 of the vehicle file is driven by ESC 3, and so on.
ROTORS = (3, 1, 4, 2)
STATUS, TELEMETRY, PX4 = "mavros_status", "mavros_telemetry", "px4_status"


def opened(vendor, name, rotors=ROTORS, unit="rpm", vehicle=None):
    adapter = known_adapters()[name]
    settings = AdapterSettings(rotor_speeds=RotorSettings(rotors, unit))
    return adapter.open(vendor.definition(adapter.type_name), settings, vehicle)


def make(vendor, name, sample, rpm):
    time_ns = START_NS + sample * STEP_NS
    if name == TELEMETRY:
        return mavros_telemetry(vendor, time_ns, rpm, [sample + 1] * len(rpm))
    return {STATUS: mavros_status, PX4: px4_status}[name](vendor, time_ns, rpm)


@pytest.mark.parametrize("name", [STATUS, TELEMETRY, PX4])
def test_speeds_are_mechanical_positive_and_in_the_order_of_the_vehicle(vendor, name):
    payloads = Payloads.join([make(vendor.px4_1_14, name, *sample) for sample in enumerate(RPMS)])
    together, single = opened(vendor.px4_1_14, name), opened(vendor.px4_1_14, name)
    stream = together.unpack(payloads)
    assert stream.time_ns.tolist() == [START_NS + sample * STEP_NS for sample in range(3)]
    np.testing.assert_allclose(stream.speeds, np.abs(RPMS)[:, [2, 0, 3, 1]] * RPM)
    for index, payload in enumerate(payloads):
        one = single.unpack(payload)
        assert one.time_ns.tolist() == [stream.time_ns[index]]
        np.testing.assert_array_equal(one.speeds[0], stream.speeds[index])
    assert not together.dropped


def test_electrical_speeds_need_the_pole_pairs(vendor):
    vehicle = replace(Vehicle.load("hdbeetle"), pole_pairs=7)
    payload = make(vendor.px4_1_14, STATUS, 0, RPMS[0])
    stream = opened(vendor.px4_1_14, STATUS, unit="erpm", vehicle=vehicle).unpack(payload)
    np.testing.assert_allclose(stream.speeds[0], RPMS[0][[2, 0, 3, 1]] * RPM / 7)
    with pytest.raises(VehicleError, match="pole_pairs"):
        opened(vendor.px4_1_14, STATUS, unit="erpm", vehicle=replace(vehicle, pole_pairs=None))
    with pytest.raises(LogError, match="need the vehicle"):
        opened(vendor.px4_1_14, STATUS, unit="erpm")


def test_a_layout_follows_the_corners_of_the_vehicle(vendor):
    """PX4 numbers front right, rear left, front left, rear right."""
    vehicle = Vehicle.load("hdbeetle")
    stream = opened(vendor.px4_1_14, PX4, "quad-x", vehicle=vehicle).unpack(
        make(vendor.px4_1_14, PX4, 0, RPMS[0])
    )
    corner = {(1, 1): 1000, (-1, -1): 2000, (1, -1): 3000, (-1, 1): 4000}
    expected = [corner[tuple(np.sign(position[:2]).astype(int))] for position in vehicle.rotor_positions]
    np.testing.assert_allclose(stream.speeds[0] / RPM, expected)


@pytest.mark.parametrize("version", ["px4_1_14", "px4_1_18"])
def test_px4_motors_are_found_by_function_in_any_place_of_either_version(vendor, version):
    messages = getattr(vendor, version)
    payload = px4_status(messages, START_NS, [30, 10, 40, 20], (103, 101, 104, 102), places=(7, 0, 2, 5))
    np.testing.assert_allclose(opened(messages, PX4).unpack(payload).speeds[0] / RPM, [30, 10, 40, 20])


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("no report is of a motor", {"functions": (101, 102, 0, 104)}),
        ("two reports are of one motor", {"functions": (101, 102, 103, 104, 102), "rpm": [1, 2, 3, 4, 5]}),
        ("offline", {"online": 0b0111}),
        ("has not reported yet", {"times_ns": [START_NS, 0, START_NS, START_NS]}),
    ],
)
def test_px4_reports_that_are_no_sample(vendor, reason, changes):
    if len(changes.get("rpm", ())) == 5:
        changes = {**changes, "places": (0, 1, 2, 3, 4), "times_ns": [START_NS] * 5}
    arguments = {"rpm": RPMS[0], **changes}
    unpacker = opened(vendor.px4_1_14, PX4)
    assert len(unpacker.unpack(px4_status(vendor.px4_1_14, START_NS, **arguments))) == 0
    assert [reason in found for found in unpacker.dropped] == [True]


@pytest.mark.parametrize("name", [STATUS, TELEMETRY, PX4])
@pytest.mark.parametrize("fifth", [0.0, 5000.0])
def test_a_fifth_rotor_that_turns_is_not_of_a_quadrotor(vendor, name, fifth):
    rpm = np.array([*RPMS[0], fifth])
    if name == PX4:
        functions, places = (101, 102, 103, 104, 105), (0, 1, 2, 3, 4)
        payload = px4_status(
            vendor.px4_1_14, START_NS, rpm, functions, places=places, times_ns=[START_NS] * 5, online=0b11111
        )
    else:
        payload = make(vendor.px4_1_14, name, 0, rpm)
    unpacker = opened(vendor.px4_1_14, name)
    assert len(unpacker.unpack(payload)) == (fifth == 0.0)
    assert ["more ESCs turn than the vehicle has rotors" in found for found in unpacker.dropped] == [True] * (
        fifth != 0.0
    )


def repeated(vendor, name):
    """Ten new reports, then 30 messages that repeat them, stamped anew, then new ones."""
    payloads = []
    for sample in range(50):
        time_ns = START_NS + sample * STEP_NS
        news = min(sample, 9) if sample < 40 else sample
        then_ns = START_NS + news * STEP_NS
        rpm = RPMS[0] + news
        if name == TELEMETRY:
            payloads.append(mavros_telemetry(vendor, time_ns, rpm, [65530 + news & 0xFFFF] * 4))
        elif name == STATUS:
            payloads.append(mavros_status(vendor, time_ns, rpm, [then_ns] * 4))
        else:
            payloads.append(px4_status(vendor, time_ns, rpm, times_ns=[then_ns] * 4))
    return payloads


@pytest.mark.parametrize("name", [STATUS, TELEMETRY, PX4])
def test_repeated_reports_are_no_samples_whatever_their_stamp(vendor, name):
    payloads = repeated(vendor.px4_1_14, name)
    together, single = opened(vendor.px4_1_14, name), opened(vendor.px4_1_14, name)
    kept = [START_NS + sample * STEP_NS for sample in (*range(10), *range(40, 50))]
    assert together.unpack(Payloads.join(payloads)).time_ns.tolist() == kept
    assert together.dropped == {"no report is new": 30}
    assert [time for payload in payloads for time in single.unpack(payload).time_ns.tolist()] == kept
    assert single.dropped == together.dropped


def test_one_esc_that_falls_silent_leaves_no_samples_after_a_tenth_of_a_second(vendor):
    unpacker = opened(vendor.px4_1_14, PX4)
    payloads = [
        px4_status(
            vendor.px4_1_14,
            START_NS + sample * STEP_NS,
            RPMS[0],
            times_ns=[START_NS + (min(sample, 5) if motor == 2 else sample) * STEP_NS for motor in range(4)],
        )
        for sample in range(30)
    ]
    stream = unpacker.unpack(Payloads.join(payloads))
    assert stream.time_ns[-1] - START_NS == 15 * STEP_NS
    assert unpacker.dropped == {"an ESC has fallen silent": 14}


@pytest.mark.parametrize("counts", [[4, 5], [-1, 5], [2**62, 2**62]])
def test_more_reports_than_there_are_are_not_read(counts):
    reports = EscReports.none(np.zeros(2, np.int64), 4)
    wanted, marks = np.arange(4), np.zeros(8, np.int64)
    with pytest.raises(ValueError, match="reports of other numbers than their messages count"):
        compiled.take_numbered_escs(np.array(counts), np.zeros(8), marks, wanted, reports)
    with pytest.raises(ValueError, match="a negative number"):
        compiled.take_numbered_escs(np.array([4, 4]), np.zeros(8), marks, wanted - 1, reports)
