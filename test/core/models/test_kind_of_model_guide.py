# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""docs/add-a-kind-of-model.md: its example works as it stands, in the folder and in another package."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.synthetic_inputs import smooth_inputs
from quadpi_core.cli import app
from quadpi_core.errors import ModelError
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs.bags import read_outputs
from quadpi_core.models import kinds
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.models.kind_registry import KINDS, kind_named
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle

GUIDE = (Path(__file__).parents[3] / "docs" / "add-a-kind-of-model.md").read_text()
KIND = (Path(__file__).parents[3] / "examples" / "ridge.py").read_text()
GROUP, ENTRY = re.search(
    r"```toml\n# pyproject.toml\n\[project\.entry-points\.\"(.*?)\"\]\n(.*?)```", GUIDE, flags=re.DOTALL
).groups()


pytestmark = pytest.mark.usefixtures("package_of_ones_own")


@pytest.fixture(autouse=True)
def forget_kind() -> Iterator[None]:
    yield
    sys.modules.pop(f"{kinds.__name__}.ridge", None)


@pytest.fixture
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kind of the guide beside the others."""
    folder = tmp_path / "kinds"
    folder.mkdir()
    (folder / "ridge.py").write_text(KIND)
    monkeypatch.setattr(kinds, "__path__", [*kinds.__path__, str(folder)])


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of the kind in an installed package; what it holds can be changed."""
    installed = tmp_path / "site-packages"
    for folder in ("my_package", "my_package-1.0.dist-info"):
        (installed / folder).mkdir(parents=True)
    (installed / "my_package" / "__init__.py").write_text("")
    (installed / "my_package-1.0.dist-info" / "METADATA").write_text("Name: my_package\nVersion: 1.0\n")
    (installed / "my_package-1.0.dist-info" / "entry_points.txt").write_text(
        f"[{GROUP}]\n" + ENTRY.replace('"', "")
    )
    (installed / "my_package" / "ridge.py").write_text(KIND)
    monkeypatch.syspath_prepend(installed)
    return installed / "my_package" / "ridge.py"


@pytest.mark.slow
@pytest.mark.usefixtures("in_folder")
def test_commands_run_as_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for bag in bags_directory().glob("*.mcap"):
        (tmp_path / bag.name).symlink_to(bag)
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^    quadpi (.*)$", GUIDE, flags=re.MULTILINE)
    assert len(commands) == 4
    for command in commands:
        result = CliRunner().invoke(app, command.split())
        assert result.exit_code == 0, result.output
    assert "ridge regression" in (tmp_path / "report.html").read_text()

    model = AerodynamicModel.load("model")
    assert (model.method, model.axes) == ("ridge", ("Fx", "Fy", "Fz", "Mx", "My", "Mz"))
    assert all(len(coverage) == 3 for coverage in model.held_out_coverage.values())
    predictions, _ = read_outputs(tmp_path / "replayed.mcap")
    assert np.mean(inside_interval(predictions.measured, predictions.lower, predictions.upper)) > 0.95

    # In flight samples come one by one.
    X = smooth_inputs(100, seed=1, vehicle_name="bebop2")
    together = model.evaluate(X)
    for i in range(len(X)):
        for alone, block in zip(model.evaluate(X[i : i + 1]), together, strict=True):
            np.testing.assert_array_equal(alone[0], block[i])


@pytest.mark.usefixtures("package")
def test_a_package_may_declare_a_kind(quadpi: Callable[..., Any]) -> None:
    assert KINDS.names()[-1] == "ridge"
    assert kind_named("ridge").label == "ridge regression"
    assert "--penalty" in quadpi("identify", "--method", "ridge", "--help").output


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("import not_there", r": cannot be imported: .*ridge.py, line 1: .*: No module named 'not_there'"),
        (KIND.replace('method = "ridge"', 'method = "edge"'), ": nothing there has that name"),
        ("KIND = 1", ": there is no Kind"),
    ],
)
def test_a_package_with_a_kind_that_cannot_be_used(package: Path, content: str, message: str) -> None:
    package.write_text(content)
    with pytest.raises(
        ModelError, match=rf"^method `ridge` of my_package 1.0 \(my_package.ridge:KIND\){message}"
    ):
        kind_named("ridge")


@pytest.mark.usefixtures("in_folder")
def test_options_that_the_kind_does_not_have_are_refused(quadpi: Callable[..., Any]) -> None:
    with pytest.raises(ModelError, match="ridge method"):
        kind_named("ridge").check(IdentifyOptions(settings="paper"), {})
    arguments = ("identify", "absent", "--vehicle", "bebop2", "-o", "model", "--stop", "pse")
    outcome = quadpi(*arguments, "--method", "ridge")
    assert outcome.errors == "quadpi: --stop: an option of --method polynomial, not of ridge\n"


@pytest.mark.usefixtures("in_folder")
def test_its_option_is_one_of_the_command_and_of_python(quadpi: Callable[..., Any], tmp_path: Path) -> None:
    shown = quadpi("identify", "--method", "ridge", "--help").output
    assert "Options of --method ridge" in shown
    assert "--penalty" in shown
    bags = [bags_directory() / f"train_{number}.mcap" for number in (1, 2)]
    arguments = ("identify", *bags, "--vehicle", "bebop2", "--axes", "Fz", "--method", "ridge")
    outcome = quadpi(*arguments, "--penalty", "-1", "-o", tmp_path / "refused")
    assert outcome.status == 2
    assert outcome.errors == "quadpi: method ridge: `penalty` must be a positive number, found -1.0\n"

    vehicle, kind = Vehicle.load("bebop2"), type(kind_named("ridge"))
    pools = {"Fz": load_pools("quadrotor")["Fz"]}
    flights = prepare_flights(bags, vehicle)
    quadpi(*arguments, "--penalty", "0.5", "-o", tmp_path / "model")
    for penalty, same in ((0.5, True), (0.6, False)):
        model = identify(flights, vehicle, pools, IdentifyOptions(method=kind(penalty=penalty)))
        stored = AerodynamicModel.load(tmp_path / "model").fitted.axes["Fz"]
        assert np.array_equal(model.fitted.axes["Fz"].coefficients, stored.coefficients) == same


def test_a_kind_that_is_not_installed_is_refused_with_those_known() -> None:
    with pytest.raises(
        ModelError, match=r"method 'ridge' is not known .*\(bootstrap, physical, polynomial, "
    ):
        kind_named("ridge")
