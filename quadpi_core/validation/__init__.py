# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Validation under noise: do intervals hold when inputs and measurements have other noise each time?

Noise-free flights get independent realisations of noise, as van Beers and de Visser did (Sec. IV).

    validation_case      what is validated: models, noise-free flights from bags, noise, seed
    realisations         noise on flights, what the models then say, counted in chunks on many workers
    validation_result    coverage and width of all realisations
"""
