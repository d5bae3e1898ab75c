# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Prediction intervals judged: metrics, autocorrelation, coverage and its confidence interval."""
