#!/bin/sh
# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
# What action.yml runs: `quadpi report` by the variables that it sets, ending with its status.
set -u
: "${QUADPI_LOGS:?names no log}"
folder=${QUADPI_OUTPUT:-quadpi-report}
set -- -o "$folder"
[ -z "${QUADPI_MASS:-}" ] || set -- "$@" --mass "$QUADPI_MASS"
[ -z "${QUADPI_FAIL_ON:-}" ] || set -- "$@" --fail-on "$QUADPI_FAIL_ON"
# Unquoted, so that several names and patterns become as many arguments.
quadpi report "$@" -- $QUADPI_LOGS
status=$?
# Of a call that is refused, what lies there is of an earlier one.
if [ -n "${GITHUB_STEP_SUMMARY:-}" ] && [ "$status" -ne 2 ]; then
    sed -n 's/^ *"verdict": "\(.*\)",$/\1/p' "$folder/report.json" >> "$GITHUB_STEP_SUMMARY"
fi
exit "$status"
