# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A ROS domain for child processes, which no other session on this machine has at the same time."""

from __future__ import annotations

import os
import random

import pytest

from quadpi_ros.live_session import ChildError, isolated_domain


def test_a_domain_is_of_one_session_alone(ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    every = range(1, 101)
    monkeypatch.setattr(random, "sample", lambda *_: [ros_domain, *every])
    with isolated_domain():
        assert int(os.environ["ROS_DOMAIN_ID"]) in {*every} - {ros_domain}
    assert os.environ["ROS_DOMAIN_ID"] == str(ros_domain)
    monkeypatch.setattr(random, "sample", lambda *_: [ros_domain])
    with pytest.raises(ChildError, match="every ROS domain"), isolated_domain():
        pass
