# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How flights shape the laws of the effects that they name: what is added closes the gap, not what is named.

To the search, what a law leaves is noise, and most of that is slow: a fit in units of it hardly sees what is
left of a law in steady flight. So the shape is found by least squares, all frequencies alike, with the
parameters of the effects as they were found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from quadpi_core.discrepancy.effect_regression import Design
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.frames import Array


@dataclass(frozen=True)
class Closing:
    """What closes the gap: the effects, their laws shaped, and the tolerances; see :meth:`fits`.

    Attributes:
        design: the regression.
        chosen: indices of the candidates that were named.
        shaped: those of them whose laws flights shape, as the laws alone leave flights that are left out
            farther away; none where they do not.
        grams: (F, K, K) Gram matrices by which what is left counts: all frequencies alike with shapes, in
            units of the noise without.
    """

    design: Design
    chosen: tuple[int, ...]
    shaped: tuple[int, ...]
    grams: Array

    @classmethod
    def by_laws(cls, design: Design, chosen: Sequence[int]) -> Closing:
        """By the laws alone."""
        return cls(design, tuple(chosen), (), design.per_flight)

    @classmethod
    def of(cls, design: Design, chosen: Sequence[int]) -> Closing:
        """With laws shaped where that helps."""
        bare = cls.by_laws(design, chosen)
        laws = [design.candidates[index] for index in chosen]
        # What is not in proportion to its parameters is shaped by them.
        shaped = tuple(i for i, law in zip(chosen, laws, strict=True) if law.effect.shape and law.linear)
        if not shaped:
            return bare
        whole = cls(design, tuple(chosen), shaped, design.even_grams(chosen))
        return whole if whole._leaves(whole.grams) < bare._leaves(whole.grams) else bare

    def fits(self, without: int | None = None) -> tuple[Fit, Fit]:
        """Of the parameters, by the laws alone, and of all that is added: tolerances and shapes too.

        Args:
            without: index of a flight that nothing shall come from, so that both can be judged on it.
        """
        design = self.design
        gram = design.gram if without is None else design.gram - design.per_flight[without]
        law = design.fit(self.chosen, gram, form=False)
        if law is None or not self.shaped:
            law = law or design.fit((), gram)
            assert law is not None  # without effects there is always a fit
            return law, law
        even = self.grams.sum(axis=0)
        if without is not None:
            even -= self.grams[without]
        return law, design.fit_shapes(self.chosen, self.shaped, law, even)

    @cached_property
    def left_out(self) -> list[Fit]:
        """Per flight all that the others would add."""
        return [self.fits(place)[1] for place in range(len(self.design.flights))]

    def _leaves(self, grams: Array) -> float:
        """Squares that flights are left with when they are left out, by Gram matrices (F, K, K)."""
        return sum(float(fit.left @ own @ fit.left) for own, fit in zip(grams, self.left_out, strict=True))
