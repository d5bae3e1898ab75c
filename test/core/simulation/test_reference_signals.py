# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reference signals: derivatives, rest before and after, sizes, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadpi_core.config_schema import parse_config
from quadpi_core.errors import SimulationError
from quadpi_core.frames import Array
from quadpi_core.simulation.truth import (
    Chirp,
    Multisine,
    Orbit,
    Pulse,
    Signal,
    Sine,
    Step,
)

STEP_S = 1e-4
EXAMPLES: dict[str, Signal] = {
    "sine": Sine(amplitude=2.0, frequency_hz=0.4, phase_deg=30.0, start_s=1.0, duration_s=7.0, fade_s=1.5),
    "chirp": Chirp(amplitude=0.7, from_hz=0.2, to_hz=1.5, start_s=0.5, duration_s=8.0),
    "falling chirp": Chirp(amplitude=0.7, from_hz=1.5, to_hz=0.2, start_s=0.5, duration_s=8.0),
    "multisine": Multisine(amplitude=0.4, frequencies_hz=(0.2, 0.5, 1.1), start_s=1.0, duration_s=6.0),
    "step": Step(amplitude=-3.0, rise_s=1.2, start_s=2.0),
    "pulse": Pulse(amplitude=1.0, width_s=1.0, rise_s=0.6, start_s=1.0),
    "pulses": Pulse(
        amplitude=1.0, width_s=0.8, rise_s=0.5, start_s=1.0, count=4, period_s=1.6, alternate=True
    ),
}
each_signal = pytest.mark.parametrize("signal", EXAMPLES.values(), ids=EXAMPLES.keys())


def grid(until: float) -> Array:
    return np.arange(0.0, until, STEP_S)


def require_derivatives(jets: Array) -> None:
    """Each column is the derivative of the one before, by central differences.

    Their error is h²/6 of the third derivative; where a fade begins that jumps, and the error is h/4 of it.
    """
    for order in range(2):
        slope = (jets[2:, order] - jets[:-2, order]) / (2.0 * STEP_S)
        scale = 1.0 + np.abs(jets[:, order + 1]).max()
        np.testing.assert_allclose(slope, jets[1:-1, order + 1], rtol=0.0, atol=2e-3 * scale)


@each_signal
def test_derivatives_are_exact(signal: Signal):
    require_derivatives(signal.jets(grid(signal.end + 0.5)))


@each_signal
def test_the_second_derivative_is_continuous(signal: Signal):
    """Its steps between neighbours shrink with the grid; a jump would not."""
    coarse = np.abs(np.diff(signal.jets(np.arange(0.0, signal.end + 0.5, 10 * STEP_S))[:, 2])).max()
    fine = np.abs(np.diff(signal.jets(grid(signal.end + 0.5))[:, 2])).max()
    assert fine < 0.15 * coarse


@each_signal
def test_rest_before_and_after(signal: Signal):
    before = signal.jets(np.linspace(0.0, signal.start_s, 50))
    np.testing.assert_array_equal(before, 0.0)
    after = signal.jets(signal.end + np.linspace(1e-9, 5.0, 50))
    np.testing.assert_array_equal(after[:, 1:], 0.0)
    np.testing.assert_allclose(after[:, 0], signal.amplitude if type(signal) is Step else 0.0, atol=1e-12)


@each_signal
def test_doubling_the_amplitude_doubles_everything(signal: Signal):
    time = np.linspace(0.0, signal.end, 200)
    doubled = replace(signal, amplitude=2.0 * signal.amplitude)
    np.testing.assert_allclose(doubled.jets(time), 2.0 * signal.jets(time), rtol=1e-12)


@settings(max_examples=40, deadline=None)
@given(
    frequency=st.floats(0.05, 2.0),
    phase=st.floats(-360.0, 360.0),
    start=st.floats(0.0, 3.0),
    duration=st.floats(2.0, 8.0),
    fade_share=st.floats(0.2, 0.5),
)
def test_any_sine_is_smooth_and_rests(
    frequency: float, phase: float, start: float, duration: float, fade_share: float
):
    sine = Sine(
        amplitude=1.0,
        frequency_hz=frequency,
        phase_deg=phase,
        start_s=start,
        duration_s=duration,
        fade_s=fade_share * duration,
    )
    jets = sine.jets(grid(sine.end + 0.1))
    require_derivatives(jets)
    np.testing.assert_allclose(jets[-1], 0.0, atol=1e-9)
    assert np.abs(jets[:, 0]).max() <= 1.0


def test_a_sine_between_its_fades_is_a_sine():
    sine = Sine(amplitude=2.0, frequency_hz=0.5, phase_deg=90.0, start_s=1.0, duration_s=6.0)
    time = np.linspace(2.0, 6.0, 100)
    np.testing.assert_allclose(sine.jets(time)[:, 0], 2.0 * np.cos(np.pi * (time - 1.0)), atol=1e-12)


def test_a_chirp_runs_from_one_frequency_to_the_other():
    chirp = Chirp(amplitude=1.0, from_hz=0.5, to_hz=2.0, start_s=0.0, duration_s=40.0)
    time = grid(40.0)
    crossings = time[1:][np.diff(np.sign(chirp.jets(time)[:, 0])) != 0]
    frequency = 0.5 / np.diff(crossings)
    middles = 0.5 * (crossings[1:] + crossings[:-1])
    expected = 0.5 + 1.5 * middles / 40.0
    np.testing.assert_allclose(frequency[2:-2], expected[2:-2], rtol=0.01)


def test_schroeder_phases_keep_the_peak_low():
    """Ten sines in phase peak near ten times one of them; with Schroeder's phases below six times."""
    frequencies = tuple(0.1 * (k + 1) for k in range(10))
    multisine = Multisine(amplitude=1.0, frequencies_hz=frequencies, start_s=0.0, duration_s=30.0)
    assert np.abs(multisine.jets(np.linspace(1.0, 29.0, 5000))[:, 0]).max() < 6.0


def test_pulses_alternate_and_hold():
    pulse = EXAMPLES["pulses"]
    # In the middle of what lies between the edges of each pulse, and between two pulses.
    held = pulse.jets(1.0 + 1.6 * np.arange(4) + 0.65)
    np.testing.assert_allclose(held[:, 0], [1.0, -1.0, 1.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(held[:, 1:], 0.0, atol=1e-12)
    between = pulse.jets(1.0 + 1.6 * np.arange(1, 4) - 0.1)
    np.testing.assert_allclose(between, 0.0, atol=1e-12)
    assert pulse.end == pytest.approx(1.0 + 3 * 1.6 + 0.8 + 0.5)


def test_the_steepest_part_of_a_step():
    """15/8 of the mean slope, half way up."""
    step = Step(amplitude=4.0, rise_s=2.0, start_s=1.0)
    np.testing.assert_allclose(step.jets(np.array([2.0]))[0], [2.0, 15.0 / 8.0 * 4.0 / 2.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("nose", ["north", "centre", "ahead"])
@pytest.mark.parametrize("turn", ["clockwise", "counterclockwise"])
class TestOrbit:
    @staticmethod
    def jets(nose: str, turn: str) -> tuple[Array, Array, Array, Array]:
        orbit = Orbit(
            radius_m=3.0, speed_m_s=4.0, start_s=1.0, duration_s=15.0, fade_s=3.0, nose=nose, turn=turn
        )
        time = grid(17.0)
        return time, *orbit.jets(time)

    def test_derivatives_are_exact(self, nose: str, turn: str):
        for jets in self.jets(nose, turn)[1:]:
            require_derivatives(jets)

    def test_stays_on_the_circle_at_its_speed(self, nose: str, turn: str):
        time, north, east, _ = self.jets(nose, turn)
        np.testing.assert_allclose(np.hypot(north[:, 0], east[:, 0]), 3.0, rtol=1e-12)
        speed = np.hypot(north[:, 1], east[:, 1])
        assert speed.max() == pytest.approx(4.0)
        np.testing.assert_allclose(speed[(time > 4.0) & (time < 13.0)], 4.0)
        np.testing.assert_array_equal(speed[(time <= 1.0) | (time > 16.0 + 1e-9)], 0.0)
        sense = 1.0 if turn == "clockwise" else -1.0
        moment = sense * (north[:, 0] * east[:, 1] - east[:, 0] * north[:, 1])
        assert moment.min() >= 0.0

    def test_the_nose_points_where_it_should(self, nose: str, turn: str):
        time, north, east, yaw = self.jets(nose, turn)
        assert yaw[0, 0] == 0.0
        moving = (time > 1.5) & (time < 15.5)
        wanted = {
            "north": (np.ones_like(time), np.zeros_like(time)),
            "centre": (-north[:, 0], -east[:, 0]),
            "ahead": (north[:, 1], east[:, 1]),
        }[nose]
        length = np.hypot(*wanted)[moving]
        np.testing.assert_allclose(np.cos(yaw[moving, 0]), wanted[0][moving] / length, atol=1e-9)
        np.testing.assert_allclose(np.sin(yaw[moving, 0]), wanted[1][moving] / length, atol=1e-9)


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        (Sine, {"frequency_hz": 0.0}, "`frequency_hz` must be a positive number, found 0"),
        (Sine, {"duration_s": -1.0}, "`duration_s` must be a positive number, found -1"),
        (Sine, {"start_s": -0.5}, "`start_s` must be a number not below 0, found -0.5"),
        (Sine, {"fade_s": 0.0}, "`fade_s` must be a number not below 0.001, found 0"),
        (Sine, {"fade_s": 2.5}, "`fade_s` must be at most 2, found 2.5"),
        (Chirp, {"from_hz": -1.0}, "`from_hz` must be a positive number, found -1"),
        (Chirp, {"to_hz": 0.0}, "`to_hz` must be a positive number, found 0"),
        (Multisine, {"frequencies_hz": []}, "`frequencies_hz` must be a list of positive numbers, found []"),
        (Multisine, {"frequencies_hz": [1.0, 0.0]}, "`frequencies_hz` must be a list of positive numbers"),
        (Step, {"rise_s": 0.0}, "`rise_s` must be a number not below 0.001, found 0"),
        (Pulse, {"width_s": 0.5}, "`width_s` must be at least `rise_s`, 1, found 0.5"),
        (Pulse, {"count": 0}, "`count` must be a positive whole number, found 0"),
        (Pulse, {"count": 2, "period_s": 2.5}, "`period_s` must be at least 3, found 2.5"),
        (Orbit, {"radius_m": 0.0}, "`radius_m` must be a positive number, found 0"),
        (Orbit, {"speed_m_s": -2.0}, "`speed_m_s` must be a positive number, found -2"),
        (Orbit, {"nose": "south"}, "`nose` must be one of north, centre, ahead, found 'south'"),
        (Orbit, {"turn": "left"}, "`turn` must be one of clockwise, counterclockwise, found 'left'"),
    ],
)
def test_impossible_signals_are_refused(kind: Any, change: dict[str, Any], message: str):
    window = {"start_s": 1.0, "duration_s": 4.0}
    valid: dict[Any, dict[str, Any]] = {
        Sine: {"amplitude_m": 1.0, "frequency_hz": 1.0} | window,
        Chirp: {"amplitude_m": 1.0, "from_hz": 1.0, "to_hz": 2.0} | window,
        Multisine: {"amplitude_m": 1.0, "frequencies_hz": [1.0, 2.0]} | window,
        Step: {"amplitude_m": 1.0, "rise_s": 1.0, "start_s": 1.0},
        Pulse: {"amplitude_m": 1.0, "width_s": 2.0, "rise_s": 1.0, "start_s": 1.0},
        Orbit: {"radius_m": 3.0, "speed_m_s": 2.0, "fade_s": 1.0} | window,
    }
    parse_config(kind, valid[kind], "file", SimulationError)
    with pytest.raises(SimulationError) as caught:
        parse_config(kind, valid[kind] | change, "file", SimulationError)
    assert str(caught.value).startswith(f"file: {message}")
