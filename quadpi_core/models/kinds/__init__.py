# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The kinds of model, one file each; see :mod:`quadpi_core.models.kind_registry`."""

# What a model is identified with where nobody names a method: the first of these that has all the options
# given. The first has the least errors on flights that it has not seen (experiments/results/models.md), the
# second chooses terms from candidates and has the settings of the paper. Ensembles train for minutes and are
# asked for.
DEFAULTS = ("physical", "polynomial")
