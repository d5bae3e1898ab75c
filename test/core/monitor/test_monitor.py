# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from copy import deepcopy
from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError, SignalError
from quadpi_core.flight import MAX_GAP_NS
from quadpi_core.frames import rotate_world_to_body
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.model_kind import Evaluation
from quadpi_core.monitor.alarm import MonitorSettings
from quadpi_core.monitor.monitor import Judged, Monitor, Monitors
from quadpi_core.monitor.pairing import NOTHING, PairedSamples, Pairing
from quadpi_core.monitor.preparation import Preparation
from quadpi_core.results import BAD_DATA, EXTRAPOLATION, LEVEL_ALARM, LEVEL_OK, Alarms, Predictions

RATE_HZ = 500.0
FX, MY = 0, 4
ADAPTIVE = MonitorSettings(adaptive=True)


def cut(samples: PairedSamples, keep) -> PairedSamples:
    return PairedSamples(*(column[keep] for column in samples))


def changed(samples: PairedSamples, **columns) -> PairedSamples:
    copy = PairedSamples(columns.pop("time_ns", samples.time_ns), samples.values.copy())
    for name, values in columns.items():
        getattr(copy, name)[:] = values
    return copy


def run(monitor: Monitor, samples: PairedSamples, block: int | None = None) -> tuple[Predictions, Alarms]:
    block = block or len(samples.time_ns)
    outputs = [
        monitor.step(*cut(samples, slice(start, start + block)))
        for start in range(0, len(samples.time_ns), block)
    ]
    predictions, alarms, _ = zip(*outputs, strict=True)
    return joined(Predictions, predictions), joined(Alarms, alarms)


def joined(kind, parts):
    return kind(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(kind)))


def assert_same(left, right):
    for field in fields(left):
        np.testing.assert_array_equal(getattr(left, field.name), getattr(right, field.name))


def assert_finite(predictions: Predictions, alarms: Alarms):
    for output in (predictions, alarms):
        for field in fields(output):
            assert np.all(np.isfinite(getattr(output, field.name))), field.name


@pytest.fixture
def monitor(model, vehicle) -> Monitor:
    return Monitor(model, vehicle, RATE_HZ)


def test_flight_inside_the_envelope_is_predicted_without_alarm(monitor, samples, vehicle):
    predictions, alarms, _ = monitor.step(*samples)
    np.testing.assert_array_equal(predictions.time_ns, samples.time_ns)
    assert np.all(alarms.level == LEVEL_OK)
    for axis in (FX, MY):
        assert np.all(predictions.lower[:, axis] < predictions.predicted[:, axis])
        assert np.all(predictions.predicted[:, axis] < predictions.upper[:, axis])
    assert np.all(predictions.upper[:, 1] == 0.0)
    # Hover on average: thrust carries the weight, up being negative.
    assert predictions.measured[:, 2].mean() == pytest.approx(
        -vehicle.mass_kg * vehicle.gravity_m_s2, rel=0.02
    )


@pytest.mark.parametrize("settings", [MonitorSettings(), ADAPTIVE], ids=["static", "adaptive"])
@pytest.mark.parametrize("block", [1, 13, 500])
def test_blocks_give_the_same_rows_bit_for_bit(each_model, vehicle, samples, block, settings):
    rng = np.random.default_rng(2)
    samples = cut(samples, slice(0, 1500))
    time_ns = samples.time_ns.copy()
    time_ns[700:] += 2 * MAX_GAP_NS
    rates = samples.rates.copy()
    rates[rng.random(len(rates)) < 0.02, 1] = np.nan
    samples = changed(samples, time_ns=time_ns, rates=rates)
    whole = run(Monitor(each_model, vehicle, RATE_HZ, settings=settings), samples)
    parts = run(Monitor(each_model, vehicle, RATE_HZ, settings=settings), samples, block)
    for left, right in zip(whole, parts, strict=True):
        assert_same(left, right)


def test_leaving_the_envelope_raises_names_and_clears(monitor, samples):
    velocity = samples.velocity.copy()
    velocity[2000:3000, 0] += 12.0
    predictions, alarms, _ = monitor.step(*changed(samples, velocity=velocity))
    seconds = (alarms.time_ns - samples.time_ns[0]) * 1e-9
    raised = np.flatnonzero(alarms.level == LEVEL_ALARM)
    # Within persistence plus the delay of the low-pass; until release after it.
    assert 4.1 < seconds[raised[0]] < 4.25
    assert 6.4 < seconds[raised[-1]] < 6.8
    assert np.all(np.diff(raised) == 1)
    assert np.all(alarms.causes[raised] == EXTRAPOLATION)
    assert alarms.level[-1] == LEVEL_OK
    outside = {INPUT_NAMES[k] for k in np.flatnonzero(alarms.input_excess[raised[5]])}
    assert {"u", "mu_x"} <= outside
    assert not outside & {"p", "q", "r", "omega_avg", "U_p"}
    assert alarms.leverage[raised[5], FX] > 1.0
    assert predictions.relative_width[2500, FX] > predictions.relative_width[1000, FX]


@pytest.mark.parametrize("each_model", ["bootstrap", "quality-driven"], indirect=True)
def test_ensemble_raises_the_alarm_by_inputs_and_width_without_leverage(each_model, vehicle, samples):
    assert np.all(each_model.envelope.leverage_limit == 1.0)
    monitor = Monitor(each_model, vehicle, RATE_HZ)
    _, calm, _ = monitor.step(*samples)
    assert np.all(calm.level == LEVEL_OK)
    assert np.all(calm.leverage == 0.0)
    assert np.all(calm.width[:, [FX, MY]] > 0.0)
    velocity = samples.velocity.copy()
    velocity[2000:3000, 0] += 12.0
    monitor.reset()
    _, alarms, _ = monitor.step(*changed(samples, velocity=velocity))
    raised = alarms.level == LEVEL_ALARM
    assert raised.any()
    assert np.all(alarms.leverage == 0.0)
    assert np.all(np.isfinite(alarms.width))
    assert alarms.width[raised, FX].max() > 1.0 > calm.width[:, FX].max()


def test_wind_counts_as_airspeed(monitor, samples):
    wind = np.tile([-12.0, 0.0, 0.0], (len(samples.time_ns), 1))
    _, alarms, _ = monitor.step(*changed(samples, wind=wind))
    assert alarms.level[-1] == LEVEL_ALARM
    assert np.any(alarms.input_excess[:, INPUT_INDEX["u"]] > 0.5)


def test_flying_with_the_wind_is_like_hovering(model, vehicle, samples):
    wind = np.tile([8.0, -5.0, 1.0], (len(samples.time_ns), 1))
    drifting = changed(
        samples, velocity=samples.velocity + rotate_world_to_body(samples.attitude, wind), wind=wind
    )
    still, _, _ = Monitor(model, vehicle, RATE_HZ).step(*samples)
    moving, alarms, _ = Monitor(model, vehicle, RATE_HZ).step(*drifting)
    # The low-pass acts on body velocity and on attitude apart, so they agree only closely.
    np.testing.assert_allclose(moving.predicted, still.predicted, atol=2e-3)
    assert np.all(alarms.level == LEVEL_OK)


BROKEN = {
    "NaN rate": ("rates", np.nan),
    "infinite specific force": ("specific_force", np.inf),
    "velocity of a lost estimator": ("velocity", 1e6),
    "rates in deg/s": ("rates", 400.0),
    "zero quaternion": ("attitude", 0.0),
    "negative rotor speed": ("rotor_speeds", -5.0),
    "rotor speed in eRPM": ("rotor_speeds", 70_000.0),
    "NaN wind": ("wind", np.nan),
}


@pytest.mark.parametrize(("column", "value"), BROKEN.values(), ids=BROKEN.keys())
def test_broken_samples_are_bad_data_and_disturb_nothing_else(model, vehicle, samples, column, value):
    broken = getattr(samples, column).copy()
    broken[1000:1200] = value
    predictions, alarms, _ = Monitor(model, vehicle, RATE_HZ).step(*changed(samples, **{column: broken}))
    assert_finite(predictions, alarms)
    assert len(predictions.time_ns) == len(samples.time_ns) - 200
    assert alarms.causes[np.flatnonzero(alarms.level == LEVEL_ALARM)].tolist() == [
        BAD_DATA
    ] * np.count_nonzero(alarms.level == LEVEL_ALARM)
    assert np.count_nonzero(alarms.level == LEVEL_ALARM) > 5
    assert alarms.level[-1] == LEVEL_OK

    undisturbed, _, _ = Monitor(model, vehicle, RATE_HZ).step(*samples)
    np.testing.assert_array_equal(predictions.predicted[:1000], undisturbed.predicted[:1000])
    # After the gap the low-pass starts anew: it agrees again once it has settled.
    np.testing.assert_allclose(predictions.predicted[-2000:], undisturbed.predicted[-2000:], atol=1e-9)


def test_repeated_stamps_give_no_second_prediction(monitor, samples):
    twice = cut(samples, np.repeat(np.arange(100), 2))
    predictions, alarms, _ = monitor.step(*twice)
    np.testing.assert_array_equal(predictions.time_ns, samples.time_ns[:100])
    assert alarms.causes[-1] == BAD_DATA


def test_clock_that_jumps_is_followed(monitor, samples):
    time_ns = samples.time_ns.copy()
    time_ns[1000:] -= 3_000_000_000
    time_ns[2000] += 365 * 86_400 * 1_000_000_000
    predictions, alarms, _ = monitor.step(*changed(samples, time_ns=time_ns))
    assert len(predictions.time_ns) == len(time_ns)
    assert_finite(predictions, alarms)
    # Each jump is told once.
    assert np.count_nonzero(alarms.faults) == 3
    assert LEVEL_ALARM not in alarms.level
    assert alarms.level[-1] == LEVEL_OK


def test_all_samples_broken_give_alarms_and_no_predictions(monitor, samples):
    rates = np.full_like(samples.rates, np.nan)
    predictions, alarms, _ = monitor.step(*changed(samples, rates=rates))
    assert len(predictions.time_ns) == 0
    assert predictions.predicted.shape == (0, 6)
    assert alarms.level[-1] == LEVEL_ALARM


@pytest.mark.parametrize("settings", [MonitorSettings(), ADAPTIVE], ids=["static", "adaptive"])
@pytest.mark.parametrize("block", [1, 7, 100, 256, None])
def test_a_model_that_python_evaluates_gives_the_same(model, vehicle, samples, settings, block):
    class InPython(type(model.fitted)):
        def evaluate(self, inputs, factors, derivatives=None) -> Evaluation:
            return super().evaluate(inputs, factors, derivatives)

    few = cut(samples, slice(0, 2000))
    in_python = replace(model, fitted=InPython(model.fitted.axes))
    expected = run(Monitor(model, vehicle, RATE_HZ, settings=settings), few)
    found = run(Monitor(in_python, vehicle, RATE_HZ, settings=settings), few, block)
    for left, right in zip(found, expected, strict=True):
        assert_same(left, right)


def test_prediction_that_overflows_is_bad_data(model, vehicle, samples):
    class Overflowing(type(model.fitted)):
        def evaluate(self, inputs, factors, derivatives=None) -> Evaluation:
            evaluation = super().evaluate(inputs, factors, derivatives)
            far = inputs[:, INPUT_INDEX["u"]] > 2.0
            return evaluation._replace(upper=np.where(far[:, None], np.inf, evaluation.upper))

    overflowing = replace(model, fitted=Overflowing(model.fitted.axes))
    predictions, alarms, _ = Monitor(overflowing, vehicle, RATE_HZ).step(*samples)
    assert 0 < len(predictions.time_ns) < len(samples.time_ns)
    assert_finite(predictions, alarms)
    assert BAD_DATA in alarms.causes
    prepared = Preparation(vehicle, RATE_HZ, model.cutoff_hz).step(*samples)
    kept = prepared.inputs[:, INPUT_INDEX["u"]] <= 2.0
    np.testing.assert_array_equal(predictions.time_ns, prepared.usable_ns[kept])
    np.testing.assert_array_equal(predictions.measured, prepared.measured[kept])
    said = model.evaluate(prepared.inputs[kept], derivatives=prepared.derivatives[kept])
    np.testing.assert_array_equal(predictions.predicted, said.predicted)
    for block in (1, 7, 256):
        parts = run(Monitor(overflowing, vehicle, RATE_HZ), samples, block)
        assert_same(predictions, parts[0])
        assert_same(alarms, parts[1])


@pytest.mark.parametrize("settings", [MonitorSettings(), ADAPTIVE], ids=["static", "adaptive"])
def test_reset_gives_the_same_again(model, vehicle, samples, settings):
    monitor = Monitor(model, vehicle, RATE_HZ, settings=settings)
    first = monitor.step(*samples)
    monitor.reset()
    again = monitor.step(*samples)
    for left, right in zip(first[:2], again[:2], strict=True):
        assert_same(left, right)
    assert first[2] == again[2]


def test_confidence_widens_the_interval(model, vehicle, samples):
    narrow, _, _ = Monitor(model, vehicle, RATE_HZ, confidence=0.8).step(*samples)
    wide, _, _ = Monitor(model, vehicle, RATE_HZ, confidence=0.99).step(*samples)
    assert np.all(wide.upper[:, FX] > narrow.upper[:, FX])


def test_adaptive_intervals_cover_where_the_models_own_do_not(model, vehicle, samples):
    """A steady force that the model does not know."""
    pushed = changed(samples, specific_force=samples.specific_force + np.array([0.5, 0.0, 0.0]))
    own, alarms, _ = Monitor(model, vehicle, RATE_HZ).step(*pushed)
    adapted, adapted_alarms, _ = Monitor(model, vehicle, RATE_HZ, settings=ADAPTIVE).step(*pushed)

    def covered(predictions):
        inside = (predictions.lower <= predictions.measured) & (predictions.measured <= predictions.upper)
        return inside[:, FX].mean()

    assert covered(own) < 0.6
    assert covered(adapted) == pytest.approx(0.95, abs=0.03)
    assert adapted.upper[0, FX] == pytest.approx(own.upper[0, FX], rel=1e-12)
    np.testing.assert_array_equal(adapted.relative_width, own.relative_width)
    np.testing.assert_array_equal(adapted.predicted, own.predicted)
    assert np.all(adapted.upper[:, 1] == 0.0)
    assert_same(alarms, adapted_alarms)


def test_model_of_another_vehicle_is_refused(model, vehicle):
    with pytest.raises(ModelError, match="is of vehicle bebop2, not neurobem"):
        Monitor(replace(model, vehicle="bebop2"), vehicle, RATE_HZ)


def test_impossible_confidence_or_rate_is_refused_at_once(model, vehicle):
    with pytest.raises(ModelError, match="confidence"):
        Monitor(model, vehicle, RATE_HZ, confidence=1.2)
    with pytest.raises(SignalError, match="half the sample rate"):
        Monitor(model, vehicle, 20.0)


@pytest.mark.parametrize("seed", range(10))
def test_garbage_never_comes_out(model, vehicle, samples, seed):
    rng = np.random.default_rng(seed)
    garbage = np.array([np.nan, np.inf, -np.inf, 1e300, -1.0, 0.0, 60.0])
    values = samples.values[:400].copy()
    hit = rng.random(values.shape) < 0.02
    values[hit] = rng.choice(garbage, np.count_nonzero(hit))
    time_ns = samples.time_ns[:400].copy()
    hit = rng.random(len(time_ns)) < 0.05
    time_ns[hit] += rng.choice([-(10**18), -5_000_000, 0, 10**9, 10**18], np.count_nonzero(hit))
    monitor = Monitor(model, vehicle, RATE_HZ, settings=MonitorSettings(adaptive=seed % 2 == 0))
    predictions, alarms, _ = monitor.step(time_ns, values)
    assert_finite(predictions, alarms)
    assert 0 < len(predictions.time_ns) < 400
    assert BAD_DATA in alarms.causes


def test_each_model_says_what_it_says_alone(model, vehicle, samples):
    slower = replace(model, cutoff_hz=20.0)
    models = {"first": model, "same": model, "slower": slower}
    together = Monitors({name: Monitor(item, vehicle, RATE_HZ) for name, item in models.items()})
    (predictions, alarms, _), others = together.step(samples)
    alone = Monitor(model, vehicle, RATE_HZ).step(*samples)
    assert_same(predictions, alone[0])
    assert_same(alarms, alone[1])
    assert_same(others[0], alone[0])
    assert_same(others[1], Monitor(slower, vehicle, RATE_HZ).step(*samples)[0])


def arrive(pairing: Pairing, samples: PairedSamples, monitors: Monitors | None = None) -> list[Judged]:
    """What monitors say as all comes that completes samples, the rotor speeds last, one for three of them."""
    found = []
    by = None if monitors is None else monitors.paired(pairing)
    last = len(samples.time_ns) - 1
    for row, time_ns in enumerate(samples.time_ns.tolist()):
        pairing.add_imu(time_ns, samples.specific_force[row], by)
        state = samples.velocity[row], samples.attitude[row], samples.rates[row]
        pairing.add_state(time_ns, *state, by)
        if row % 3 == 0 or row == last:
            completed = pairing.add_rotor_speeds(time_ns, samples.rotor_speeds[row], by)
            if monitors is not None and isinstance(completed, tuple):
                # The next ones overwrite them.
                found.append(deepcopy(monitors.judged(completed)))
    return found


def begun(samples: PairedSamples) -> Pairing:
    """A pairing that was given a sample and has said that its rate is not known yet."""
    pairing = Pairing()
    arrive(pairing, cut(samples, slice(1)))
    assert pairing.take()
    return pairing


def test_samples_of_a_pairing_give_what_they_give_as_arrays(model, vehicle, samples):
    spoiled = changed(samples)
    spoiled.specific_force[100:140] = np.nan
    parts = [cut(spoiled, slice(start, start + 200)) for start in range(1, 400, 200)]
    pairings, steps = (begun(samples), begun(samples)), Monitor(model, vehicle, RATE_HZ)
    monitors = Monitors({"first": Monitor(model, vehicle, RATE_HZ)})
    for part in parts:
        arrive(pairings[0], part)
        judged = arrive(pairings[1], part, monitors)
        predictions, alarms, events = steps.step(*pairings[0].take())
        assert {one.samples for one in judged} == {1, 3}
        assert sum(one.samples for one in judged) == len(part.time_ns)
        assert_same(predictions, joined(Predictions, [one.predictions[0].predictions for one in judged]))
        assert_same(alarms, joined(Alarms, [one.alarms for one in judged]))
        assert events == [event for one in judged for event in one.events]
        assert len(alarms.time_ns) > 1
    assert pairings[0].counts == pairings[1].counts


def test_a_pairing_is_asked_for_samples_where_the_core_cannot_go_on(model, vehicle, samples):
    monitor = Monitor(model, vehicle, RATE_HZ)
    pairing = begun(samples)
    assert Monitors({"first": monitor, "second": Monitor(model, vehicle, RATE_HZ)}).paired(pairing) is None
    monitors = Monitors({"first": monitor})
    assert sum(judged.samples for judged in arrive(pairing, cut(samples, slice(1, 11)), monitors)) == 10
    assert pairing.completed != NOTHING
    assert pairing.take() is None
    # After a second the rate is known, and filters are designed for it before anything is judged.
    assert arrive(pairing, cut(samples, slice(11, 500)), monitors)
    assert not arrive(pairing, cut(samples, slice(500, 520)), monitors)
    paired = pairing.take()
    assert pairing.rate.filter_hz == pytest.approx(RATE_HZ)
    assert not monitors.retune(pairing.rate)
    assert monitors.judge(paired).samples == len(paired.time_ns)
    assert arrive(pairing, cut(samples, slice(520, 530)), monitors)
    # A monitor that is replaced is no longer asked.
    before = monitors["first"].preparation
    monitors.replace("first", Monitor(replace(model, cutoff_hz=20.0), vehicle, RATE_HZ))
    quiet = before.memory.tobytes()
    assert sum(judged.samples for judged in arrive(pairing, cut(samples, slice(530, 540)), monitors)) == 10
    assert before.memory.tobytes() == quiet


def test_models_of_one_cutoff_share_the_low_pass(model, vehicle):
    slower = replace(model, cutoff_hz=20.0)
    models = {"first": model, "slower": slower, "same": model}
    monitors = Monitors({name: Monitor(item, vehicle, RATE_HZ) for name, item in models.items()})
    assert monitors["first"].preparation is monitors["same"].preparation
    assert monitors["first"].preparation is not monitors["slower"].preparation


def test_the_low_pass_goes_on_when_a_model_is_replaced(model, vehicle, samples):
    half = len(samples.time_ns) // 2
    monitors = Monitors({"first": Monitor(model, vehicle, RATE_HZ)})
    monitors.step(cut(samples, slice(None, half)))
    monitors.replace("first", Monitor(model, vehicle, RATE_HZ))
    (predictions, _, _), _ = monitors.step(cut(samples, slice(half, None)))
    whole, *_ = Monitor(model, vehicle, RATE_HZ).step(*samples)
    np.testing.assert_array_equal(predictions.predicted, whole.predicted[-len(predictions.time_ns) :])
    assert monitors.names == ["first"]


def test_what_does_not_fly_cannot_be_replaced(model, vehicle):
    monitors = Monitors({"first": Monitor(model, vehicle, RATE_HZ)})
    with pytest.raises(ModelError, match="no model flies as `second`; those that fly: first"):
        monitors.replace("second", Monitor(model, vehicle, RATE_HZ))
