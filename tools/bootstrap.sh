#!/bin/sh
# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
#
# Run bootstrap.py, with its options, by $PYTHON, or with the first Python on PATH that the ROS 2 Jazzy wheels exist for.
here=$(dirname "$0")
candidates=${PYTHON:-python3 python3.13 python3.12 python3.11 python3.10}
for python in $candidates; do
    if "$python" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; then
        exec "$python" "$here/bootstrap.py" "$@"
    fi
done
echo "error: quadpi needs Python 3.10 to 3.13; tried: $candidates (choose one with PYTHON=...)" >&2
exit 1
