"""Observations of spectral lines of a shaft that is not round, and of its twist."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index, Text
from rotorfit.estimators.blocks.observations import Observed, OnResponses, Responses
from rotorfit.models import AnisotropicShaft, RotorModel
from rotorfit.models.shafts.combination_lines import Order, line_order
from rotorfit.models.shafts.turning_on_supports import LINES


@dataclass(frozen=True, eq=False, kw_only=True)
class LineResponses(Observed):
    """Lines under rotating forces, or without a force, one a reading, all of shape ``(R,)``."""

    model: AnisotropicShaft  # the shaft
    speed: Float  # Om, rad/s
    frequency: Float  # w, rad/s
    force: ComplexArray  # complex amplitude of the force at w, N
    direction: Text  # ``z`` or ``twist``
    line: Text  # name of the line
    reading_group: Index  # parameter group

    @cached_property
    def kinds(self) -> tuple[tuple[str, Order, Index], ...]:
        """Direction and orders of each kind of line, with its readings."""
        kinds = dict.fromkeys(zip(self.direction.tolist(), self.line.tolist(), strict=True))
        return tuple(
            (
                direction,
                line_order(direction, line),
                np.flatnonzero((self.direction == direction) & (self.line == line)),
            )
            for direction, line in kinds
        )

    @cached_property
    def _conditions(self) -> tuple[Index, Index]:
        """A reading of each group, frequency, speed and force, and the number of that of every reading."""
        parts = (self.reading_group, self.frequency, self.speed, self.force.real, self.force.imag)
        _, first, number = np.unique(np.stack(parts, axis=1), axis=0, return_index=True, return_inverse=True)
        return first, number.reshape(-1)

    @property
    def shaft_lines(self) -> frozenset[str]:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return frozenset(self.line.tolist())

    @property
    def reads_twist(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return bool((self.direction == "twist").any())

    @property
    def forced_lines(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return bool(self.force.any())

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        return np.asarray(self._lines(theta, derivatives=False)[0])

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        found = self._lines(theta, derivatives=True)
        return found[0], np.moveaxis(found[1:], 0, -1)

    def _lines(self, theta: Float, *, derivatives: bool) -> ComplexArray:
        """Every reading, and behind them all their derivatives where wanted, shape ``(1 or 1 + P, ..., R)``."""
        first, number = self._conditions
        found = self.model.several_lines(
            theta if theta.shape[-2] == 1 else theta[..., self.reading_group[first], :],
            [(direction, order) for direction, order, _ in self.kinds],
            self.frequency[first],
            self.speed[first],
            self.force[first],
            derivatives=derivatives,
        )
        whole = np.empty((len(found), *theta.shape[:-2], self.measured.size), dtype=complex)
        for k, (_, _, rows) in enumerate(self.kinds):
            whole[..., rows] = found[:, k][..., number[rows]]
        return whole


def is_image_line(line: Text) -> Bool:
    """True if lines are images, whose frequency falls as w rises: ``2Om-w``, ``-w``."""
    return np.isin(line, [name for name, (_, image) in LINES.items() if image])


@dataclass(frozen=True, eq=False, kw_only=True)
class PairResponses(OnResponses):
    """Lines of a rotor with a turning element, such as w and the image 2 Om - w, one a reading, all of shape ``(R,)``.
    In turning coordinates they are ordinary responses: the vector (A, conj(B), ...) at w - Om."""

    speed: Float  # Om, rad/s
    frequency: Float  # w, rad/s
    force: ComplexArray  # complex amplitude of the force at w, N
    direction: Text  # ``z``
    line: Text  # ``w``, ``2Om-w``, on supports that differ in two directions ``-w`` and others

    @property
    def responses(self) -> None:
        """None: those of the base are in turning coordinates."""
        return None

    @property
    def forced_lines(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return bool(self.force.any())

    @property
    def measured(self) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Block`."""
        return self._turned_back(self.base.measured)

    def cut_off(self, theta: Float) -> Float:
        """Change by lines that the model leaves out, m, shape ``(R,)``: with two more on either side."""
        frame = self.base.model
        finer = frame.with_more_lines(2)
        if finer is None:
            return np.zeros(self.measured.size)
        lacking = len(finer.coordinates) - len(frame.coordinates)
        force = np.pad(self.base.force, ((0, 0), (0, lacking)))
        more = replace(self.base, model=finer, force=force).predict(theta)
        return np.asarray(np.abs(more - self.base.predict(theta)))

    def as_if_round(self, rotor: RotorModel) -> Responses | None:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        base, rows = self.base, np.flatnonzero(self.line == "w")
        if not rows.size:
            return None
        lines, line = np.unique(base.line[rows], return_inverse=True)
        return replace(
            base,
            model=rotor,
            speed=base.speed[lines],
            frequency=(base.frequency + base.speed)[lines],
            force=base.force[lines, : len(rotor.coordinates)],
            group=base.group[lines],
            line=line.reshape(-1).astype(np.intp),
            **{name: getattr(base, name)[rows] for name in ("coordinate", "measured", "sigma", "label", "run")},
        )

    def _turned_back(self, values: ComplexArray) -> ComplexArray:
        """Values of readings, along the last axis."""
        return np.where(is_image_line(self.line), values.conj(), values)

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        return self._turned_back(self.base.predict(theta))

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        predicted, jacobian = self.base.predict_jacobian(theta)
        rows = self._turned_back(np.swapaxes(jacobian, -1, -2))
        return self._turned_back(predicted), np.swapaxes(rows, -1, -2)
