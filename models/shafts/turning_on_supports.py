"""A stiffness that turns with the shaft, on supports that differ in two directions and stand still.

The first couples a line at w with 2 Om - w, the second with -w, so that one force makes the chain of lines::

    ... w + 2 Om  <- turning ->  -w  <- support ->  w  <- turning ->  2 Om - w  <- support ->  w - 2 Om ...

(lines at -w + 2k Om are images: their conjugates are the unknowns). Amplitudes fall off along the chain where nothing
resonates; it is cut some lines to either side of w and 2 Om - w, and what the cut costs is computed with more lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar

import casadi as ca

from rotorfit.models.complexes import Complex, J, Number
from rotorfit.models.model import Coordinate, Matrix
from rotorfit.models.orthotropic import support_parameters, support_planes, support_symbol
from rotorfit.models.shafts.turning import IMAGE, Turning, TurningFrame, shifted

Line = tuple[int, bool]
"""k, and whether the line is an image: frequency w + 2k Om, of an image -w + 2k Om."""

LINES: dict[str, Line] = {
    "w": (0, False),
    "2Om-w": (1, True),
    "-w": (0, True),
    "w-2Om": (-1, False),
    "w+2Om": (1, False),
    "4Om-w": (2, True),
    "-w-2Om": (-1, True),
}
"""Lines of the lateral motion that can be read, by name."""


class TurningOnSupports(Turning):
    """A rotor with a turning element on supports whose stiffness and damping differ in two directions.

    Parameters are those of :class:`Turning`, then those of :class:`~rotorfit.models.orthotropic.Orthotropic`: for each
    support ``dKs = K_1 - K_2`` and ``dDs = D_1 - D_2`` along and across a direction at the angle ``angle_s`` from x,
    known to be 0 unless freed.

    Args:
        base: the rotor with its turning element.
        at: planes with such a support, by default the last of the rotor's.
        terms: lines beyond w and 2 Om - w, to either side of them in the chain, that are taken into account.

    Raises:
        ValueError: a rotor without a turning element, with tilts or a known structure, a plane that it does not have,
            or no terms.
    """

    name: ClassVar[str] = "turning-on-supports"

    def __init__(self, base: Turning, at: str | Sequence[str] = (), terms: int = 4) -> None:
        if not isinstance(base, Turning) or isinstance(base, TurningOnSupports):
            raise ValueError(f"{base.name} has no turning element; use Turning(...), or Orthotropic for supports alone")
        if any(coordinate.axis != "z" for coordinate in base.coordinates):
            raise ValueError(f"{base.name} has tilts, whose supports are not modelled in two directions")
        if terms < 1:
            raise ValueError(f"terms is a number of lines, one or more, got {terms}")
        super().__init__(base.base, base.element)
        self.rotor, self.terms, self.line_count = base, terms, 2 + 2 * terms
        if self.shaft is not None:
            raise ValueError(f"{base.base.name} has a known structure; on supports of two directions use Orthotropic")
        self.at = support_planes(at, base.base)
        self.parameters = (*base.parameters, *support_parameters(self.at))

    def options(self) -> dict[str, Any]:
        """See :meth:`~rotorfit.models.model.RotorModel.options`."""
        return {"base": self.rotor, "at": self.at, "terms": self.terms}

    @cached_property
    def turning(self) -> TurningFrame:
        """The equations of all lines taken into account."""
        return LinesFrame(self)

    @property
    def line_places(self) -> dict[str, int]:
        """See :attr:`Turning.line_places`."""
        present = chain(self.terms)
        return {name: present.index(line) for name, line in LINES.items() if line in present}

    def support_coupling(self, p: Any) -> tuple[Complex, Complex]:
        """Stiffness and damping that stand still, factors of conj(z) and of its rate.

        Args:
            p: parameters by name.
        """
        size = len(self.coordinates)
        found = []
        for kind in ("dKs", "dDs"):
            matrix = Complex(ca.SX(size, size), ca.SX(size, size))
            for i, plane in enumerate(self.at):
                half = 0.5 * getattr(p, support_symbol(kind, i, self.at))
                angle = 2.0 * getattr(p, support_symbol("angle_s", i, self.at))
                place = self.coordinate(plane, "z")
                matrix.re[place, place], matrix.im[place, place] = half * ca.cos(angle), half * ca.sin(angle)
            found.append(matrix)
        return found[0], found[1]


class LinesFrame(TurningFrame):
    """The lines of a rotor with a turning element on orthotropic supports, at the frequency w - Om of one of them.
    Coordinates are the planes at w, then those of the image 2 Om - w, conjugated, then those of the other lines."""

    name: ClassVar[str] = "lines"

    def __init__(self, base: TurningOnSupports) -> None:
        super().__init__(base)
        self.rotor = base
        self.lines = chain(base.terms)
        self.planes = tuple(plane + _suffix(line) for line in self.lines for plane in base.planes)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Those of the model, line after line."""
        own = self.base.coordinates
        return tuple(Coordinate(c.plane + _suffix(line), c.axis) for line in self.lines for c in own)

    def probe_factors(self, p: Any) -> Sequence[Number]:
        """A probe's factor, conjugated for images."""
        own = [Complex.of(factor) for factor in self.base.probe_factors(p)]
        return [factor.conj() if image else factor for _, image in self.lines for factor in own]

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """Powers of ``s = j (w - Om)``: the rotor at each line, and what couples neighbours in the chain."""
        given = self.base.equation(p, speed, eccentricity)
        powers = [m if isinstance(m, Complex) else Complex.matrix(m) for m in given]
        while len(powers) < 2:
            powers.append(powers[0] * 0.0)
        turning = self.base.turning_stiffness(p)
        delta = turning if isinstance(turning, Complex) else Complex.matrix(turning)
        stiffness, damping = self.rotor.support_coupling(p)
        nothing = delta * 0.0
        rows: list[list[list[Complex]]] = [[[nothing] * len(self.lines) for _ in self.lines] for _ in powers]
        for i, (k, image) in enumerate(self.lines):
            turns = 2 * k - 1 if image else 2 * k + 1  # multiple of Om beyond +-(w - Om)
            shift = J * (turns * speed) * (-1.0 if image else 1.0)
            own = [m.conj() for m in powers] if image else powers
            for power, matrix in enumerate(shifted(own, shift)):
                rows[power][i][i] = matrix
            for other, pull in (((1 - k, not image), [delta]), ((-k, not image), [stiffness, damping])):
                if other not in self.lines:
                    continue
                # the rate of a neighbour's conjugate is that of this line itself
                pulls = [m.conj() for m in pull] if image else pull
                for power, matrix in enumerate(shifted(pulls, shift)):
                    rows[power][i][self.lines.index(other)] = matrix
        return [Complex.block(block) for block in rows]


def chain(terms: int) -> tuple[Line, ...]:
    """Lines w and 2 Om - w, then their neighbours to either side in turn."""
    # w is followed on its other side by -w, w + 2 Om, -w - 2 Om, w + 4 Om, ...
    left = [(-(i // 2), True) if i % 2 == 0 else ((i + 1) // 2, False) for i in range(terms)]
    right = [(-(i // 2) - 1, False) if i % 2 == 0 else ((i + 1) // 2 + 1, True) for i in range(terms)]
    return ((0, False), (1, True), *(line for pair in zip(left, right, strict=True) for line in pair))


def _suffix(line: Line) -> str:
    """Suffixes of a plane's name in those of a line's coordinates."""
    if line in ((0, False), (1, True)):
        return IMAGE if line[1] else ""
    return f" {'-' if line[1] else ''}w{2 * line[0]:+d}Om"
