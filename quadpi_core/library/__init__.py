# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What researchers import: flights, models by the protocol of scikit-learn, tables, figures."""
