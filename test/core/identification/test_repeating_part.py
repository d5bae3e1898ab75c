# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.change_calibration import evidence
from quadpi_core.identification.repeating_part import input_changes, learn_repeating
from quadpi_core.models.alarm_limits import CHANGE_AXES, INPUT_CHANGES, RepeatingPart
from quadpi_core.records import Records
from quadpi_core.vehicle import Vehicle
from test.core.monitor.sound_flights_of_blocks import limits_of, sound_blocks, weight

VEHICLE = Vehicle.load("crazyflie_rpm")
U, Q, FZ = 0, 5, AXES.index("Fz")


def flight(seed: int, of_u: float = 0.05) -> Records:
    """Sound blocks that leave shares of the weight where u has changed 0.1 s before, and where q changes."""
    random = np.random.default_rng(seed)
    blocks = sound_blocks(VEHICLE, 10.0, random)
    blocks["inputs"] = random.normal(size=blocks["inputs"].shape)
    changes = input_changes(blocks)
    blocks["residual"][:, FZ] += weight(VEHICLE) * (of_u * changes[:, 1, U] + 0.02 * changes[:, 0, Q])
    return blocks


def taken(part: RepeatingPart, blocks: Records) -> Records:
    """Blocks less what is known to repeat."""
    rest, ends = blocks.copy(), [np.array(list(of.values())) for of in (part.lower, part.upper)]
    changes = np.clip(input_changes(blocks), *ends)
    for axis in part.slopes:
        rest["residual"][:, AXES.index(axis)] -= np.tensordot(changes, part.of_axis(axis), 2)
    return rest


def gathered(part: RepeatingPart | None, blocks: Records) -> Array:
    return evidence(replace(limits_of(VEHICLE), repeating=part), VEHICLE, blocks)


@pytest.fixture(scope="module")
def part() -> RepeatingPart:
    learned = learn_repeating([flight(seed) for seed in range(12)], CHANGE_AXES)
    assert learned.part is not None
    return learned.part


def test_what_repeats_is_learned_by_its_input_and_change(part: RepeatingPart) -> None:
    newton = weight(VEHICLE)
    assert part.slopes["Fz"]["u"] == pytest.approx((0.0, 0.05 * newton), abs=0.004 * newton)
    assert part.slopes["Fz"]["q"] == pytest.approx((0.02 * newton, 0.0), abs=0.004 * newton)


def test_of_flights_left_out_little_but_their_noise_is_left() -> None:
    flights, sound = ([flight(seed, of_u) for seed in range(12)] for of_u in (0.1, 0.0))
    for one, own, other in zip(learn_repeating(flights, ("Fz",)).blocks, flights, sound, strict=True):
        size = np.std(one["residual"][:, FZ])
        assert size < 0.5 * np.std(own["residual"][:, FZ])
        assert size < 1.3 * np.std(other["residual"][:, FZ])


def test_what_does_not_repeat_is_hardly_taken() -> None:
    learned = learn_repeating([flight(seed, of_u=0.1 * (-1) ** seed) for seed in range(8)], ("Fz",))
    slopes = learned.part.slopes["Fz"]["u"] if learned.part else (0.0,)
    assert np.max(np.abs(slopes)) < 0.03 * weight(VEHICLE)


def test_the_core_takes_away_what_was_learned(part: RepeatingPart) -> None:
    # Three blocks are missing, and one is far from all that was seen.
    blocks = np.delete(flight(99), [40, 60, 61])
    blocks["inputs"][20] = 50.0
    assert gathered(part, blocks) == pytest.approx(gathered(None, taken(part, blocks)), rel=1e-9)
    assert gathered(part, blocks) != pytest.approx(gathered(None, blocks), rel=1e-3)


def test_a_lasting_change_of_the_inputs_hides_nothing(part: RepeatingPart) -> None:
    blocks, steady = flight(98), flight(98)
    steady["inputs"] += 10.0
    assert gathered(part, steady) == pytest.approx(gathered(part, blocks), rel=1e-9)


def test_without_slopes_the_evidence_is_what_it_was_to_the_bit(part: RepeatingPart) -> None:
    blocks = flight(97)
    nothing = replace(part, slopes={})
    assert (gathered(nothing, blocks) == gathered(None, blocks)).all()


def test_to_a_missing_block_nothing_has_changed() -> None:
    blocks = np.delete(flight(1), [3])
    changes, inputs = input_changes(blocks), blocks["inputs"]
    assert (changes[0] == 0.0).all()
    assert (changes[2, :2] == [inputs[2] - inputs[1], inputs[1] - inputs[0]]).all()
    # The block before that one, of number 3, is missing.
    assert (changes[3, 0] == 0.0).all()
    assert (changes[3, 1] == inputs[3] - inputs[2]).all()
    assert changes.shape == (len(blocks), INPUT_CHANGES, 19)
