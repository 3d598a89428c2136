"""Spectra of a rotor that turbulence shakes: cross-periodograms of ``u = [z(w); conj z(-w)]`` averaged over cells.

The average P of a cell is complex Wishart with nu degrees of freedom about ``S = H S_f H^* + S_n`` (Whittle), with
``-ln L = sum nu (ln det S + tr S^-1 P)``. A residual is ``sqrt(nu) L^-1 (S - P) L^-*`` with ``S = L L^*``, the m^2
numbers of which have unit variance, and its derivative is taken at constant L. Then ``J^T r`` is the exact gradient of
-ln L and ``J^T J`` its expected information, so that Gauss-Newton is Fisher scoring; the likelihood itself follows
from r.

Spectra of force and floor are nuisance of each setting of the machine. They are fitted inside, for every parameter
vector: what a fit sees is the profile of the likelihood, and derivatives that allow for how they follow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.force_spectra import (
    SHAPES,
    ForceShape,
    Spectrum,
    adjoint,
    first_numbers,
    following,
    inverse_root,
    most_likely,
    spectra_of,
)
from rotorfit.estimators.blocks.observations import Observed, Responses
from rotorfit.estimators.blocks.response import dynamic_stiffness, inverse, known_lines
from rotorfit.estimators.blocks.row_keys import rows_by
from rotorfit.models.motion.stability import eigenvalue_gradient, eigenvalues, growing


def packed(matrix: ComplexArray) -> ComplexArray:
    """Hermitian matrices ``(..., C, m, m)`` of even m as complex readings ``(..., C m m/2)``: of a matrix of unit
    variance every part of a reading has unit variance."""
    m = matrix.shape[-1]
    row, column = np.triu_indices(m, 1)
    diagonal = np.einsum("...ii->...i", matrix).real
    pairs = diagonal[..., : m // 2] + 1j * diagonal[..., m // 2 :]
    every = np.concatenate([pairs, np.sqrt(2) * matrix[..., row, column]], axis=-1)
    return np.asarray(every.reshape(*every.shape[:-2], -1))


def unpacked(readings: ComplexArray, m: int) -> ComplexArray:
    """The matrices again, shape ``(..., C, m, m)``."""
    row, column = np.triu_indices(m, 1)
    every = readings.reshape(*readings.shape[:-1], -1, m * m // 2)
    matrix = np.zeros((*every.shape[:-1], m, m), dtype=complex)
    at = np.arange(m)
    matrix[..., at, at] = np.concatenate([every[..., : m // 2].real, every[..., : m // 2].imag], axis=-1)
    beside = every[..., m // 2 :] / np.sqrt(2)
    matrix[..., row, column] = beside
    matrix[..., column, row] = beside.conj()
    return matrix


@dataclass(frozen=True, eq=False, kw_only=True)
class OperatingSpectra(Observed):
    """Averaged cross-periodograms of a rotor in operation, packed as :func:`packed` has them, in m^2/Hz."""

    speed: Float  # of each cell, rad/s, shape ``(C,)``
    frequency: Float  # its middle, rad/s, positive, shape ``(C,)``
    degrees: Float  # degrees of freedom nu of each cell, shape ``(C,)``
    group: Index  # parameter group of each cell, shape ``(C,)``
    setting: Index  # cells of one number share the spectra of force and floor, shape ``(C,)``
    coordinate: Index  # of the model, that were read, shape ``(n,)``
    shape: ForceShape = field(default_factory=ForceShape)
    untied: bool = False  # whether forces, and floors, are taken for independent, for starts
    weight: ComplexArray | None = None  # inverse of L, by predictions, shape ``(..., C, m, m)``
    found: dict[int, _Found] = field(default_factory=dict)  # spectra found last, where a search for them begins

    @property
    def m(self) -> int:
        """Rows of a cell's matrix."""
        return 2 * self.coordinate.size

    @property
    def line(self) -> Index:
        """Cell of each reading."""
        return np.repeat(np.arange(self.speed.size), self.m**2 // 2)

    @property
    def reading_group(self) -> Index:
        """Group of each reading."""
        return np.repeat(self.group, self.m**2 // 2)

    @property
    def of_motion(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return False

    @property
    def normal(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return False

    @property
    def force_spectra(self) -> tuple[str, ...]:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`: one slope for all planes where there is one."""
        others = (one for one in SHAPES if one.slope != "planes" or len(self.model.planes) > 1)
        return tuple(dict.fromkeys(map(str, (self.shape, *others))))

    def with_force_spectrum(self, name: str) -> OperatingSpectra:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        if not name:
            return self
        return replace(self, shape=next(one for one in SHAPES if str(one) == name), found={})

    @property
    def own_unknowns(self) -> int:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return sum(part.size for cells in self._cells for part in self._spectra(cells))

    @property
    def own_believable(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`: probes' noise is white or falls with frequency.
        Where the floor hardly shows, an exponent that is fitted becomes any number."""
        if not self.shape.floor:
            return True
        steepest, found = 3.0, self.found.items()
        places = [self._spectra(self._cells[number])[0].size + self.coordinate.size for number, _ in found]
        exponents = [one.numbers[place] for (_, one), place in zip(found, places, strict=True)]
        return len(exponents) == len(self._cells) and all(0 <= exponent <= steepest for exponent in exponents)

    @property
    def remarks(self) -> tuple[str, ...]:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return (
            f"the spectrum of the force was not measured: {self.shape} was taken, by BIC",
            "errors of single parameters from operating vibration were tried on few rigs yet",
        )

    def doubts(self, theta: Float, predicted: ComplexArray) -> Iterator[tuple[str, str]]:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`: residuals of bands, and what motion forward and
        backward has in common."""
        inside = unpacked(self.weighed(predicted).unmixed(predicted - self.measured), self.m)  # sqrt(nu) (1 - ratio)
        neighbours, large, beyond = 20, 1.4, 4.0  # cells of a band; mean square; standard deviations
        unlikely = 1e-3  # probability of what chance leaves
        n = self.m // 2
        for number, cells in enumerate(self._cells):
            own = -np.einsum("cii->c", inside[cells]).real / np.sqrt(self.m)
            bands = own[: own.size // neighbours * neighbours].reshape(-1, neighbours).sum(axis=1)
            size = float(np.mean(bands**2) / neighbours) if bands.size else 1.0
            most = max(large, 1 + beyond * np.sqrt(2 / max(bands.size, 1)))
            rpm = self.speed[cells[0]] * RPM_PER_RAD_S
            if number not in self.found:
                yield (
                    "floor-unseen",
                    f"at {rpm:.0f} rpm the floor of the readings, or the force on a plane, does not show: none was "
                    "taken, and errors hold only if there is none. Take a band that reaches higher (band_hz=)",
                )
            if size > most:
                worst = int(np.argmax(np.abs(bands))) * neighbours
                low, high = self.frequency[cells[[worst, worst + neighbours - 1]]] / (2 * np.pi)
                yield (
                    "band-residual",
                    f"at {rpm:.0f} rpm the spectra miss the measured ones over whole bands (mean square "
                    f"{significant(size, 2)}, noise leaves 1), most from {low:.1f} to {high:.1f} Hz: the force, the "
                    "floor or the rotor is not as assumed, and decrements and threshold may be off by more than their "
                    "errors. Leave that band out (band_hz=), or fit a model with more modes",
                )
            coherence = float(np.mean(np.abs(inside[cells][:, :n, n:]) ** 2))
            spread = np.sqrt(1 / (n * n * cells.size))
            if coherence > 1 + beyond * spread:
                yield (
                    "rotary-coherence",
                    f"at {rpm:.0f} rpm forward and backward motion have something in common "
                    f"({significant(coherence, 3)} times what chance leaves, 1 +- {significant(spread, 1)}): the rotor "
                    "or the force is not the same in x and y, and decrements of sharp modes are too small then. See "
                    "whether the sensitivities of x and y are right, then the supports",
                )
                continue
            stiffness, chance = self._uneven(theta, cells, predicted, inside[cells][:, :n, n:])
            plane = int(np.argmin(chance))
            if chance[plane] * n < unlikely:
                yield (
                    "rotary-coherence",
                    f"at {rpm:.0f} rpm forward and backward motion go together as if the stiffness at "
                    f"{self.model.read_planes[plane]} differed by {significant(2 * abs(stiffness[plane]), 2)} N/m in x "
                    "and y, which chance does not leave: decrements of sharp modes are too small then. See whether the "
                    "sensitivities of x and y are right, then the supports",
                )

    def _uneven(
        self, theta: Float, cells: Index, predicted: ComplexArray, common: ComplexArray
    ) -> tuple[ComplexArray, Float]:
        """Half the difference of the stiffness in x and y at each plane that is read, N/m, which explains best what
        motion both ways has in common, whitened, ``(C, n, n)``, and the probability that chance leaves as much.

        Such a stiffness dK adds ``dK conj z(-w)`` to the forces at w, and so ``-(H dK S_b + S_f dK H_b^*)`` to the
        cross-spectra: a matched filter of all cells sees what their mean coherence does not.
        """
        n = self.coordinate.size
        H = self._motion(theta, slopes=False, lines=np.concatenate([cells, cells + self.frequency.size]))[0]
        H = H[:, self.coordinate][:, :, self.coordinate]
        ahead, back = H[: cells.size], H[cells.size :].conj()
        S = unpacked(predicted, self.m)[cells]
        forward, backward = S[:, :n, :n], S[:, n:, n:]
        roots = inverse_root(forward), adjoint(inverse_root(backward))
        stiffness, chance = np.zeros(n, dtype=complex), np.ones(n)
        for k in range(n):
            added = ahead[:, :, k, None] * backward[:, None, k] + forward[:, :, k, None] * back[:, :, k, None].conj().mT
            shown = np.sqrt(self.nu[cells])[:, None, None] * (roots[0] @ added @ roots[1])
            power = float(np.sum(np.abs(shown) ** 2))
            stiffness[k] = np.sum(shown.conj() * common) / power
            chance[k] = np.exp(-(np.abs(stiffness[k]) ** 2) * power)
        return stiffness, chance

    @property
    def independent(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`: entries of a cell's matrix err together."""
        return False

    def drawn(self, noise: ComplexArray) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`: complex Wishart, by Bartlett's factor, about
        the spectra that it was weighed by."""
        from scipy.special import gammaincinv, ndtr  # late: loading it takes longer than a fit

        weight = inverse_root(unpacked(self.measured, self.m)) if self.weight is None else self.weight
        factor = np.tril(unpacked(noise, self.m))
        at = np.arange(self.m)
        normal = factor[..., at, at].real
        factor[..., at, at] = np.sqrt(gammaincinv(self.nu[:, None] - at, ndtr(normal)))
        average = factor @ adjoint(factor) / self.nu[:, None, None]
        root: ComplexArray = np.asarray(np.linalg.inv(weight), dtype=complex)
        return packed(root @ (average - np.eye(self.m)) @ adjoint(root)) / self.sigma

    def with_measured(self, measured: ComplexArray) -> Self:
        """See :class:`~rotorfit.estimators.blocks.observations.Block`: spectra found for these are not those of
        others."""
        found = super().with_measured(measured)
        object.__setattr__(found, "found", dict(self.found))
        return found

    # ---- likelihood --------------------------------------------------------------------------------------------------

    @property
    def nu(self) -> Float:
        """Degrees of freedom of each cell, fewer where the noise of its readings was widened."""
        return np.asarray(self.degrees / self.sigma[:: self.m**2 // 2] ** 2)

    def weighed(self, predicted: ComplexArray) -> OperatingSpectra:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`: by Cholesky's factor of predicted spectra."""
        return replace(self, weight=inverse_root(unpacked(predicted, self.m)))

    def unmixed(self, scaled: ComplexArray) -> ComplexArray:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        weight = inverse_root(unpacked(self.measured, self.m)) if self.weight is None else self.weight
        if scaled.ndim > weight.ndim - 2 and weight.ndim > 3:  # rows of many vectors
            weight = weight[..., None, :, :, :]
        return self._whitened(unpacked(scaled, self.m), weight)

    def _whitened(self, matrix: ComplexArray, weight: ComplexArray) -> ComplexArray:
        return packed(np.sqrt(self.degrees)[:, None, None] * (weight @ matrix @ adjoint(weight)))

    def losses(self, residuals: ComplexArray) -> Float:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`: the deviance of a cell, less what chance adds to
        it beyond its m^2 numbers, in equal parts."""
        ratio = np.eye(self.m) - unpacked(residuals, self.m) / np.sqrt(self.nu)[:, None, None]
        with np.errstate(all="ignore"):
            sign, size = np.linalg.slogdet(ratio)
            trace = np.einsum("...ii->...", ratio).real
            cell = 2 * self.nu * np.where(sign.real > 0, trace - self.m - size, np.inf) - self._excess
        share = self.m**2 // 2
        return np.repeat(cell / share, share, axis=-1)

    @property
    def _excess(self) -> Float:
        """Mean deviance of a Wishart matrix about its own mean, less its m^2 numbers, of each cell."""
        from scipy.special import digamma  # late: loading it takes longer than a fit

        steps = self.nu[:, None] - np.arange(self.m)
        return np.asarray(2 * self.nu * (self.m * np.log(self.nu) - digamma(steps).sum(axis=1)) - self.m**2)

    @property
    def cells(self) -> list[tuple[Index, Float, ComplexArray]]:
        """Of each setting the numbers of its cells, their frequencies, Hz, and their matrices."""
        matrix = unpacked(self.measured, self.m)
        return [(own, self.frequency[own] / (2 * np.pi), matrix[own]) for own in self._cells]

    @property
    def rougher(self) -> OperatingSpectra:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`: wider cells, some tens of each setting, and
        forces independent."""
        fewest = 80
        parts = [cells[:: max(1, cells.size // fewest)] for cells in self._cells]
        order, first = np.concatenate(self._cells), np.concatenate(parts)
        at = np.flatnonzero(np.isin(order, first))
        nu = np.add.reduceat(self.nu[order], at)
        power = unpacked(self.measured, self.m)[order] * self.nu[order, None, None]
        readings = (first[:, None] * (self.m**2 // 2) + np.arange(self.m**2 // 2)).reshape(-1)
        return replace(
            self,
            measured=packed(np.asarray(np.add.reduceat(power, at) / nu[:, None, None], dtype=complex)),
            sigma=np.ones(readings.size),
            label=self.label[readings],
            run=self.run[readings],
            speed=self.speed[first],
            frequency=np.add.reduceat(self.frequency[order] * self.nu[order], at) / nu,
            degrees=nu,
            group=self.group[first],
            setting=self.setting[first],
            shape=ForceShape("power", turning=True),
            untied=True,
            found={},
        )

    # ---- predictions -------------------------------------------------------------------------------------------------

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`; NaN of rotors that are not stable."""
        if theta.ndim > 2:
            return np.array([self.predict(one) for one in theta])
        return self._predicted(theta, slopes=False)[0]

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        if theta.ndim > 2:
            some = [self.predict_jacobian(one) for one in theta]
            return np.array([one for one, _ in some]), np.array([one for _, one in some])
        return self._predicted(theta, slopes=True)

    def stable(self, theta: Float) -> bool:
        """True if a rotor is stable at every speed: it and its unstable mirror image have the same spectra."""
        pairs = np.unique(self.group + 1j * self.speed)
        with np.errstate(all="ignore"):
            rates, _ = growing(self.model, theta[pairs.real.astype(np.intp)], pairs.imag.copy(), np.inf)
        return bool((rates < 0).all())

    def _predicted(self, theta: Float, *, slopes: bool) -> tuple[ComplexArray, ComplexArray]:
        readings, count = self.measured.size, theta.shape[-1]
        matrix = np.full((self.frequency.size, self.m, self.m), complex(np.nan))
        by_theta = np.zeros((count if slopes else 0, *matrix.shape), dtype=complex)
        if np.isfinite(theta).all() and self.stable(theta):
            for number, cells in enumerate(self._cells):
                lines = np.concatenate([cells, cells + self.frequency.size])
                motion = self._motion(theta, slopes=slopes, lines=lines)
                matrix[cells], by_theta[:, cells] = self._with_spectra(number, cells, theta, *motion)
        rows = packed(by_theta) if slopes else np.zeros((0, readings), dtype=complex)
        return packed(matrix), rows.T

    @cached_property
    def _cells(self) -> list[Index]:
        """Cells of each setting."""
        return rows_by(self.setting)

    @cached_property
    def _lines(self) -> Responses:
        """All cells at +w, then at -w, as lines of responses."""
        both = 2 * self.frequency.size
        none = np.zeros(0, dtype=np.intp)
        return Responses(
            model=self.model,
            measured=np.zeros(0, dtype=complex),
            sigma=np.zeros(0),
            label=none,
            labels=(),
            run=np.zeros(0, dtype=str),
            speed=np.tile(self.speed, 2),
            frequency=np.concatenate([self.frequency, -self.frequency]),
            force=np.zeros((both, len(self.model.coordinates)), dtype=complex),
            group=np.tile(self.group, 2),
            line=none,
            coordinate=none,
        )

    def _motion(
        self, theta: Float, *, slopes: bool, lines: Index
    ) -> tuple[ComplexArray, Sequence[tuple[int, ComplexArray]]]:
        """Receptance of some lines ``(L, N, N)``, and terms of the derivative of the dynamic stiffness: parameters and
        matrices ``(L, N, N)``."""
        block = self._lines.lines(np.isin(np.arange(2 * self.frequency.size), lines))
        H = inverse(dynamic_stiffness(block, theta))
        if not slopes:
            return H, ()
        index, group, speed = block.condition
        own = self.model.functions.jacobian(theta[group], speed)
        values = np.broadcast_to(own.values, (speed.size, own.inputs.size))[index]
        terms: dict[int, ComplexArray] = {}
        for e in np.flatnonzero(own.inputs < theta.shape[-1]).tolist():
            term = terms.setdefault(int(own.inputs[e]), np.zeros(H.shape, dtype=complex))
            term[:, own.rows[e], own.columns[e]] += values[:, e] * block.s ** own.powers[e]
        known = known_lines(block, theta)
        if known is not None:
            for place, slope in zip(known.inputs.tolist(), known.slopes, strict=True):
                term = terms.setdefault(place, np.zeros(H.shape, dtype=complex))
                term += np.moveaxis(slope, -1, 0)
        return H, tuple(terms.items())

    # ---- spectra of force and floor ----------------------------------------------------------------------------------

    def _spectra(self, cells: Index) -> tuple[Spectrum, Spectrum]:
        """Spectra of force and floor of a setting."""
        forced = len(self.model.planes)
        return spectra_of(self.shape, self.frequency[cells], forced, self.coordinate.size, apart=self.untied)

    def _with_spectra(
        self, number: int, cells: Index, theta: Float, H: ComplexArray, terms: Sequence[tuple[int, ComplexArray]]
    ) -> tuple[ComplexArray, ComplexArray]:
        """Spectra of a setting with the force and the floor that fit best, and their derivatives by the parameters, to
        which force and floor are fitted again."""
        force, floor = self._spectra(cells)
        forced = np.array([self.model.coordinate(plane, "z") for plane in self.model.planes])
        read = H[:, self.coordinate][:, :, forced]
        n = self.coordinate.size
        whole = unpacked(self.measured, self.m)[cells]
        measured = np.concatenate([whole[:, :n, :n], whole[:, n:, n:].conj()])
        nu = np.tile(self.nu[cells], 2)

        def spectra(numbers: Float) -> ComplexArray:
            own, rest = read @ force.root(numbers[: force.size]), floor.root(numbers[force.size :])
            return own @ adjoint(own) + rest @ adjoint(rest)

        def slopes(numbers: Float, weight: ComplexArray) -> ComplexArray:
            own = force.slopes(numbers[: force.size], weight @ read)
            return np.concatenate([own, floor.slopes(numbers[force.size :], weight)], axis=1)

        first, bounds = first_numbers(measured, read, force, floor)
        starts = [first]
        if number in self.found:
            starts.append(self.found[number].at(theta[self.group[cells[0]]]))
        found = most_likely(spectra, slopes, starts, bounds, measured, nu)
        if found is None:
            return np.full(whole.shape, complex(np.nan)), np.zeros((0, *whole.shape), dtype=complex)
        fitted, free = found
        S = spectra(fitted)
        by_theta = np.zeros((theta.shape[-1] if terms else 0, *S.shape), dtype=complex)
        follow = np.zeros((fitted.size, theta.shape[-1]))
        if terms:
            own = force.root(fitted[: force.size])
            R = H[:, :, forced] @ own @ adjoint(read @ own)
            weight = inverse_root(S)
            for place, slope in terms:
                change = -(H[:, self.coordinate] @ slope @ R)
                by_theta[place] = change + adjoint(change)
            whitened = np.swapaxes(weight @ by_theta @ adjoint(weight), 0, 1)
            follow = following(whitened, slopes(fitted, weight), free, nu)
            by_numbers = slopes(fitted, np.broadcast_to(np.eye(n), S.shape))
            by_theta -= np.tensordot(follow.T, by_numbers, (1, 1))
        self.found.pop(number, None)
        if free.all():  # from a bound a search may not come back
            self.found[number] = _Found(theta=theta[self.group[cells[0]]].copy(), numbers=fitted, follow=follow)
        return _both_ways(S), _both_ways(by_theta)


@dataclass(frozen=True, eq=False)
class _Found:
    """Numbers of force and floor that were found at a parameter vector, and how they follow it."""

    theta: Float
    numbers: Float
    follow: Float  # less what a unit of a parameter changes the numbers by, shape ``(K, P)``

    def at(self, theta: Float) -> Float:
        """What they are about at another vector."""
        return np.asarray(self.numbers - np.clip(self.follow @ (theta - self.theta), -1.0, 1.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class ModesSeen(Observed):
    """Poles of a rotor in complex coordinates, each compared with the nearest eigenvalue of the model."""

    speed: Float  # rad/s, shape ``(R,)``
    reading_group: Index  # parameter group, shape ``(R,)``

    @property
    def of_motion(self) -> bool:
        """See :class:`~rotorfit.estimators.blocks.observations.Asked`."""
        return False

    def predict(self, theta: Float) -> ComplexArray:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict`."""
        found = eigenvalues(self.model, theta[..., self.reading_group, :], self.speed)
        nearest = np.argmin(np.nan_to_num(np.abs(found - self.measured[:, None]), nan=np.inf), axis=-1)
        return np.asarray(np.take_along_axis(found, nearest[..., None], axis=-1)[..., 0])

    def predict_jacobian(self, theta: Float) -> tuple[ComplexArray, ComplexArray]:
        """See :meth:`~rotorfit.estimators.blocks.observations.Block.predict_jacobian`."""
        s = self.predict(theta)
        return s, eigenvalue_gradient(self.model, theta[..., self.reading_group, :], self.speed, s)[1]


def _both_ways(lines: ComplexArray) -> ComplexArray:
    """Matrices of lines at +w, then -w, ``(..., 2C, n, n)``, as those of ``[z(w); conj z(-w)]``."""
    cells, n = lines.shape[-3] // 2, lines.shape[-1]
    matrix = np.zeros((*lines.shape[:-3], cells, 2 * n, 2 * n), dtype=complex)
    matrix[..., :n, :n] = lines[..., :cells, :, :]
    matrix[..., n:, n:] = lines[..., cells:, :, :].conj()
    return matrix
