"""Responses that are sums of functions of the line, which all probes share, times numbers of each probe's own.

Modes seen by many probes are such a sum. All of a probe's numbers enter its readings linearly and no other's: a fit
finds them by linear least squares, one probe after the other, and is a search for what the functions depend on alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index


@dataclass(frozen=True, eq=False, kw_only=True)
class LineTerms:
    """The functions at lines, terms and derivatives before the lines. A parameter changes one of the terms that a
    coordinate sees at most."""

    values: ComplexArray  # shape ``(..., T, L)``
    inputs: Index  # place of the parameter of each derivative that is not zero, shape ``(E,)``
    terms: Index  # the term that it changes, shape ``(E,)``
    slopes: ComplexArray  # derivatives, shape ``(..., E, L)``


@dataclass(frozen=True, eq=False, kw_only=True)
class Weights:
    """Numbers with which coordinates see the terms: parameters, or constants where there is none; ``(n, T)`` each."""

    real: Index  # place of the parameter that is the real part, -1 where there is none
    imaginary: Index  # likewise of the imaginary part
    constant: Float  # the number where neither is there

    def seen(self, coordinate: int) -> Index:
        """Terms that a coordinate sees."""
        real, imaginary, constant = self.real[coordinate], self.imaginary[coordinate], self.constant[coordinate]
        return np.flatnonzero((real >= 0) | (imaginary >= 0) | (constant != 0))

    def of(self, theta: Float, coordinate: int) -> ComplexArray:
        """Numbers of the terms that a coordinate sees, of parameter vectors ``(..., P)``."""
        seen = self.seen(coordinate)
        real, imaginary = self.real[coordinate, seen], self.imaginary[coordinate, seen]
        found = np.empty((*theta.shape[:-1], seen.size), dtype=complex)
        found.real = np.where(real >= 0, theta[..., real], self.constant[coordinate, seen])
        found.imag = np.where(imaginary >= 0, theta[..., imaginary], 0.0)
        return found
