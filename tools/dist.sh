#!/bin/sh
# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
#
# Source archive and wheel in dist/, made with the Python given; the wheel, built from the archive and installed
# into an environment of its own without extras, identifies a model and replays a flight.
set -eu
cd "$(dirname "$0")/.."
python=$(realpath -s "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
rm -rf dist
"$python" -c "from setuptools import build_meta as b; b.build_sdist('dist')" >"$work/log" 2>&1 || {
    tail -15 "$work/log" >&2
    exit 1
}
"$python" -m pip --quiet --disable-pip-version-check wheel --no-deps --no-build-isolation \
    --wheel-dir dist dist/*.tar.gz
rm -rf ./*.egg-info/SOURCES.txt
ls dist
"$python" -m venv "$work/environment"
"$work/environment/bin/pip" --quiet --disable-pip-version-check install --constraint constraints.txt dist/*.whl
bags=$(pwd)/bags
cd "$work"
quadpi=environment/bin/quadpi
$quadpi identify "$bags"/train_*.mcap --vehicle bebop2 -o model
$quadpi replay model "$bags/extrapolation.mcap" -o replayed.mcap
$quadpi info replayed.mcap
