# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What `report.json` holds of a report."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import pytest

from quadpi_core.field.field_report import report_on
from quadpi_core.field.report_record import FlightRecord, ReportRecord, VehicleRecord
from quadpi_core.reading_options import ReadingOptions


def test_every_part_has_a_key_and_what_is_untold_says_why(shared_data: Path) -> None:
    content = report_on([shared_data / "rrc_propeller" / "hover_good_1.BIN"], ReadingOptions()).to_json()
    for record, entry in (
        (ReportRecord, content),
        (FlightRecord, content["flights"][0]),
        (VehicleRecord, content["vehicles"][0]),
    ):
        assert set(entry) == {one.name for one in fields(record)}
    assert content["flights"][0]["tachometers"] == {
        "reason": "the log has not both commands and rotor speeds"
    }
    assert content["flights"][0]["settings"][0]["parameter"]
    assert content["flights"][0]["topics"]["imu"]["rate_hz"] == pytest.approx(25.0, rel=0.1)
