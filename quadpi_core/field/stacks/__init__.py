# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One file per flight stack: what its logs tell, and by which of its settings they tell more."""
