# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The two experiments of van Beers and de Visser in simulation, and what they state.

numbers        the paper's tables
published      the validation under noise and the wind tunnel, flown, identified and judged
model_cache    models that a long run stores and a later one loads
result_tables  ours above the paper's
"""
