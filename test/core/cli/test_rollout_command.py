# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi rollout`: its table, the keys of its JSON, and what it refuses."""

from __future__ import annotations


def test_rollout(read_json, quadpi, predicting, bags, tmp_path) -> None:
    files = "--json", tmp_path / "rollouts.json", "--html", tmp_path / "rollouts.html"
    outcome = quadpi("rollout", predicting, *bags[1:], "--horizon", "0.5", *files)
    assert outcome.status == 0
    assert "split conformal" in " ".join(outcome.output.split())
    result = read_json(tmp_path / "rollouts.json")
    assert set(result["flights"]) == {"flight1", "flight2"}
    for flight in result["flights"].values():
        assert set(flight["horizons"]) == {"0.01", "0.1", "0.5"}
        for horizon in flight["horizons"].values():
            assert set(horizon) == {"position_m", "velocity_m_s", "attitude_deg", "rates_rad_s"}
            for own in horizon.values():
                assert {"rms", "coverage", "width"} <= set(own)
                assert 0.0 <= own["coverage"] <= 1.0
    page = (tmp_path / "rollouts.html").read_text()
    assert all(f'data-flight="{flight}"' in page for flight in result["flights"])
    assert f"flight2.mcap --model {predicting}" in page


def test_a_model_that_is_no_simulation_is_refused(refused, model, bags) -> None:
    refused(
        r"\(polynomial\) predicts the wrench of single samples: it is no simulation",
        "rollout",
        model,
        bags[2],
    )


def test_a_horizon_beyond_the_calibration_is_refused(refused, predicting, bags) -> None:
    refused("a horizon of 5 s", "rollout", predicting, bags[2], "--horizon", "5")
