# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where simulation and flights disagree: find it, name the missing effect, add it, show that the gap shrinks.

1. The residual of a flight is its measured wrench less the simulated one (`simulations`, `effect_response`).
2. Candidates are the effects of the simulation's registry. They and the tolerances of the simulation become
   columns in frequency (`candidates`), where noise is white within bands (`whitening`); what single flights
   have of their own is a part of that noise.
3. The evidence of sets of effects (`effect_regression`, `evidence`) and named tests (`acceptance`) choose
   (`search`).
4. Generic functions predict the part of the residual that no effect explains (`unexplained`). That and other
   tests of the whole result say whether it is believed (`result_verdicts`).
5. Flights left out in turn show how far the gap closes (`closure`), where it was (`by_condition`), and how
   the simulation with the effects flies (`augmented_simulation`, `reflight`).
"""
