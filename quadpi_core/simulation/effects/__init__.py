# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Physical effects that simulations lack, one file per family; `simulation.applied_effects` finds them."""
