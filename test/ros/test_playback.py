# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The position in a bag that is played."""

from __future__ import annotations

import itertools
import threading

import pytest

from quadpi_ros import playback as playing
from quadpi_ros.playback import Playback

SECOND = 1_000_000_000


class Hands:
    """A monotonic clock that the test moves."""

    def __init__(self) -> None:
        self.now_ns = 5 * SECOND

    def monotonic_ns(self) -> int:
        return self.now_ns


@pytest.fixture
def hands(monkeypatch: pytest.MonkeyPatch) -> Hands:
    clock = Hands()
    monkeypatch.setattr(playing, "time", clock)
    return clock


def test_position_moves_at_the_rate_and_stands_still_while_paused(hands: Hands) -> None:
    playback = Playback(position_ns=3 * SECOND)
    hands.now_ns += SECOND
    assert playback.position_ns == 4 * SECOND
    playback.change_rate(0.5)
    hands.now_ns += 2 * SECOND
    assert playback.position_ns == 5 * SECOND
    playback.pause()
    playback.pause()
    hands.now_ns += 60 * SECOND
    playback.change_rate(2.0)
    assert (playback.position_ns, playback.paused, playback.rate) == (5 * SECOND, True, 2.0)
    hands.now_ns += 60 * SECOND
    playback.resume()
    hands.now_ns += SECOND
    playback.resume()
    assert playback.position_ns == 7 * SECOND
    playback.seek(SECOND)
    hands.now_ns += SECOND
    assert playback.position_ns == 3 * SECOND


def test_what_is_due_waits_no_more_and_what_is_not_waits_until_it_is_told_to_stop(hands: Hands) -> None:
    playback = Playback()
    assert playback.wait_until(0, lambda: True)
    assert playback.wait_until(-SECOND, lambda: True)
    assert not playback.wait_until(SECOND, lambda: False)

    def glances() -> bool:
        hands.now_ns += SECOND // 10
        return True

    assert playback.wait_until(SECOND, glances)
    assert playback.position_ns == SECOND


def test_while_paused_messages_pass_one_by_one_when_they_are_asked_for() -> None:
    playback = Playback(paused=True)
    assert playback.step()
    assert playback.step()
    looks = itertools.count()
    passed = [playback.wait_until(due, lambda: next(looks) < 3) for due in (SECOND, 3 * SECOND, 4 * SECOND)]
    assert passed == [True, True, False]
    assert playback.position_ns == 3 * SECOND
    playback.resume()
    assert not playback.step()


def test_a_change_wakes_up_whoever_waits() -> None:
    """The message is due in an hour: only the change lets it through."""
    playback = Playback()
    through: list[bool] = []
    waiting = threading.Thread(
        target=lambda: through.append(playback.wait_until(3600 * SECOND, lambda: True))
    )
    waiting.start()
    playback.change_rate(1e9)
    waiting.join(30.0)
    assert through == [True]
