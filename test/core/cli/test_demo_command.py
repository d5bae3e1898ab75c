# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi demo`: what it refuses before it starts; test/ros/test_demo.py runs it."""

from __future__ import annotations

import sys

import pytest


def test_demo_without_ros_says_what_is_missing(quadpi, monkeypatch):
    monkeypatch.setitem(sys.modules, "quadpi_ros.demo", None)
    result = quadpi("demo")
    assert result.status == 2
    assert "needs ROS 2" in result.errors


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf"])
def test_demo_refuses_a_rate_before_it_starts(quadpi, tmp_path, rate):
    pytest.importorskip("rclpy")
    result = quadpi("demo", "--rate", rate, "-o", tmp_path / "out")
    assert result.status == 2
    assert "--rate must be positive" in result.errors
    assert list(tmp_path.iterdir()) == []


def test_demo_without_data_says_what_to_provide(quadpi, tmp_path):
    pytest.importorskip("rclpy")
    result = quadpi("demo", "--data", tmp_path, "-o", tmp_path / "out")
    assert result.status == 2
    assert "NeuroBEM" in result.errors
    assert list(tmp_path.iterdir()) == []
