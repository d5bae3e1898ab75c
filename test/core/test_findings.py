# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Problems found in a flight's data, as sentences and as JSON."""

import json

from quadpi_core.findings import NOTHING_TO_SAY, DataQuality, Finding, LeftOut

LEFT_OUT = LeftOut("imu", "beyond 70 rad/s", samples=2, of=500, first=17, first_s=0.0344)
FINDING = Finding("units_of_rates", "imu", "looks like deg/s: multiply by 0.0175", certain=True)


def test_sentences_name_the_topic_first_and_what_was_left_out_before_what_contradicts():
    assert list(DataQuality((LEFT_OUT,), (FINDING,)).sentences()) == [
        "topic imu: left out 2 of 500 samples beyond 70 rad/s; the first is sample 17, at 0.034 s",
        "topic imu: looks like deg/s: multiply by 0.0175",
    ]
    assert list(NOTHING_TO_SAY.sentences()) == []


def test_json_holds_every_number():
    data = json.loads(json.dumps(DataQuality((LEFT_OUT,), (FINDING,)).to_json()))
    assert data["left_out"] == [
        {
            "topic": "imu",
            "limit": "beyond 70 rad/s",
            "samples": 2,
            "of": 500,
            "first": 17,
            "first_s": 0.0344,
        }
    ]
    assert data["findings"] == [
        {
            "mistake": "units_of_rates",
            "topic": "imu",
            "text": "looks like deg/s: multiply by 0.0175",
            "certain": True,
            "leave_out": False,
        }
    ]
    assert set(map(str, NOTHING_TO_SAY.to_json().values())) == {"[]"}
