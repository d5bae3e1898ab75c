# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's numerical validation: do intervals hold under noise on inputs and measurements?

Noise-free flights of the simulation get independent realisations of noise (van Beers and de Visser, Sec. IV).

    validation_case      what is validated: models, noise-free flights (simulated or from bags), noise, seed
    realisations         noise on flights, what the models then say, counted in chunks on many workers
    validation_result    coverage and width of all realisations
    published            the paper's two experiments repeated in simulation, and its tables
    model_cache          models that a long computation stores and a later run loads
"""
