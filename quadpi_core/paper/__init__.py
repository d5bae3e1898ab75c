# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's numerical validation: do intervals hold under noise on inputs and measurements?

Noise-free flights of the simulation get independent realisations of noise (van Beers and de Visser, Sec. IV).

    validation_case      what is validated: models, flights, noise, seed
    realisations         noise on flights, and what the models then say, counted
    realisation_chunks   realisations in chunks, on many workers, kept in files so that a later run goes on
    validation_result    coverage and width of all realisations, as JSON
    clean_flights        noise-free flights, simulated or from bags
    published            the paper's own setting, and its two tables
    windtunnel           its wind tunnel simulated, and its table of the HDBeetle
    model_cache          models that a long computation keeps and takes up again
"""
