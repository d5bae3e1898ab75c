# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain for child processes, which no other session on this machine has at the same time."""

from __future__ import annotations

import os
import random
from collections.abc import Iterable

import pytest

from quadpi_ros.processes import ChildError, isolated_domain


def sampled(monkeypatch: pytest.MonkeyPatch, domains: Iterable[int]) -> None:
    """Let the domains be tried in that order."""
    monkeypatch.setattr(random, "sample", lambda *_: list(domains))


def test_a_domain_is_of_one_session_alone(ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    free = ros_domain % 100 + 1
    sampled(monkeypatch, (ros_domain, free))
    with isolated_domain():
        assert os.environ["ROS_DOMAIN_ID"] == str(free)
        with pytest.raises(ChildError, match="every ROS domain"), isolated_domain():
            pass
    assert os.environ["ROS_DOMAIN_ID"] == str(ros_domain)
