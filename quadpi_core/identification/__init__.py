# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From flights to a model: flights prepared, axes fitted, limits of the alarm calibrated."""
