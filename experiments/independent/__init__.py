# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The independent benchmark of `quadpi discrepancy`: flights of RotorPy; see README.md."""
