# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The blind benchmark's flights: effects by formulas other than the library's, their names sealed."""
