# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a user says of a log: options, or a mapping file alone."""

from quadpi_core.reading_options import ReadingOptions, reading_options


def test_a_mapping_alone_stands_for_options_with_it():
    assert reading_options("mavros") == ReadingOptions("mavros")
    assert reading_options(None) == ReadingOptions()
    chosen = ReadingOptions(None, {"imu": "/uav1/imu"}, "/uav1")
    assert reading_options(chosen) is chosen
