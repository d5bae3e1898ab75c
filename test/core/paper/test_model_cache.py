# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import shutil
from pathlib import Path

import pytest

import quadpi_core
from quadpi_core.paper.model_cache import code_fingerprint

PACKAGE = Path(quadpi_core.__file__).parent


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    """The sources of the package, to change."""
    ignored = shutil.ignore_patterns("__pycache__")
    return shutil.copytree(PACKAGE, tmp_path_factory.mktemp("copy") / "quadpi_core", ignore=ignored)


def fingerprint_with_a_comment_in(file):
    original = file.read_text()
    file.write_text(f"{original}# changed\n")
    try:
        return code_fingerprint.__wrapped__(file.parents[1])
    finally:
        file.write_text(original)


@pytest.mark.parametrize("name", ["cli/options.py", "report/style.py"])
def test_models_are_kept_when_only_the_presentation_changes(name, copied):
    assert fingerprint_with_a_comment_in(copied / name) == code_fingerprint()


@pytest.mark.parametrize("name", ["models/kinds/polynomial.py", "identification/identify.py"])
def test_models_are_identified_again_when_the_mathematics_change(name, copied):
    assert fingerprint_with_a_comment_in(copied / name) != code_fingerprint()
