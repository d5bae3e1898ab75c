# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether sensors of a recording and numbers of its vehicle agree, and which mistake it is if not."""
