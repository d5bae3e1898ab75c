# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Ensembles of small neural networks with intervals: PyTorch trains them, compiled kernels fly them."""
