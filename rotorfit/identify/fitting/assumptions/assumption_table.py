"""Assumptions of a fit, as records and a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from rotorfit.base.digits import two_digits
from rotorfit.base.significance import SIGNIFICANT_ERRORS
from rotorfit.base.text_table import Printed, text_table
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.inference.score_tests import Term
from rotorfit.identify.fitting.quantities import is_left_open, shown_unit

THRESHOLD_COLUMN = "threshold speed"


@dataclass(frozen=True, kw_only=True)
class Assumption:
    """A term that the model leaves out, or a value that it takes as known."""

    name: str  # symbol and planes, or the known parameter
    meaning: str  # in words
    unit: str  # of its size
    estimate: float  # size that the residuals ask for
    stderr: float  # its standard error, infinite where parameters take it up
    plausible: float  # a size that it may well have
    shifts: Mapping[str, float]
    errors: Mapping[str, float]  # standard errors of the results that the table shows
    implied: bool = False  # something that was fitted says that the term is there, though not how large it is
    prior: float = math.nan  # standard uncertainty that was given for it in place of the plausible size
    acts: Term | None = None  # what of it acts on the rotor, no matter of forces and readings

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty before the data: what was given, else the plausible size."""
        return self.plausible if math.isnan(self.prior) else self.prior

    @property
    def narrowed(self) -> bool:
        """True if the data tell its size clearly better than its uncertainty does."""
        narrowed_ratio = 3.0  # uncertainty over standard error from which data narrow it; curvature gives less as well
        return self.stderr * narrowed_ratio <= self.uncertainty

    @property
    def left(self) -> float:
        """Root mean square size that it may have by its uncertainty and the data together; the results assume none."""
        if not self.narrowed:
            return self.uncertainty
        weight = 1 / (1 + (self.stderr / self.uncertainty) ** 2)  # weight of the data in the mean of a normal posterior
        return math.hypot(math.sqrt(weight) * self.stderr, weight * self.estimate)

    @property
    def tested(self) -> bool:
        """True if the data determine the term better than its plausible size does."""
        return self.stderr < self.plausible

    @property
    def z(self) -> float:
        """Score test: size over standard error, normal with unit variance if the term is not there; NaN untested."""
        return self.estimate / self.stderr if self.tested else math.nan

    @property
    def size(self) -> float:
        """Size by which the table's shifts go: what the residuals ask for where they tell, else the plausible one."""
        return self.estimate if self.tested else self.uncertainty

    @property
    def missing(self) -> bool:
        """True if the data ask for the term, or for something like it."""
        return self.tested and abs(self.z) > SIGNIFICANT_ERRORS

    @property
    def bears(self) -> bool:
        """True if a result rests on it: the size that the data leave possible moves one by more than its error."""
        return self._largest(self.left) > 1

    @property
    def weight(self) -> float:
        """Largest shift of a result by :attr:`size`, in standard errors of that result."""
        return self._largest(self.size)

    def _largest(self, size: float) -> float:
        return max((abs(self.shifts[n] * size) / e for n, e in self.errors.items() if 0 < e < math.inf), default=0.0)

    @property
    def words(self) -> str:
        """The assumption with what the data leave of its size, and what that does."""
        shift = {name: self.shifts[name] * self.left for name in self.errors}
        moved = [name for name, error in self.errors.items() if abs(shift[name]) > error]
        words = [f"{name} by {_shown(name, shift[name], self.errors[name])}" for name in moved]
        if THRESHOLD_COLUMN in moved:
            words[moved.index(THRESHOLD_COLUMN)] += " rpm"
        unmoved = f"; {THRESHOLD_COLUMN} unchanged" if THRESHOLD_COLUMN in {*self.errors} - {*moved} else ""
        size = f"{two_digits(self.left, '+')} {shown_unit(self.unit)}".rstrip()
        return f"{self.name} {size} ({self.meaning}) shifts {', '.join(words)}{unmoved}"


@dataclass(frozen=True, repr=False)
class Assumptions(Printed):
    """Assumptions of a fit, those first that the data refuse, then by how much they would move results."""

    entries: tuple[Assumption, ...]  # one for each term that is left out or taken as known

    @property
    def missing(self) -> tuple[Assumption, ...]:
        """Terms that the data ask for; several like each other may stand for one that is missing."""
        return tuple(entry for entry in self.entries if entry.missing)

    def __getitem__(self, name: str) -> Assumption:
        named = {entry.name: entry for entry in self.entries}
        if name not in named:
            raise KeyError(f"no assumption {name!r}; there are {', '.join(named)}")
        return named[name]

    @property
    def foundations(self) -> tuple[str, ...]:
        """Terms that the data do not determine well enough, each in words with how far it moves results."""
        return tuple(entry.words for entry in self.entries if entry.bears)

    @property
    def main_foundations(self) -> tuple[str, ...]:
        """Those of :attr:`foundations` that an error notably rests on, and how many others there are."""
        bearing = [entry for entry in self.entries if entry.bears]
        whole = {name: self.combined(name) for name in self.entries[0].errors} if bearing else {}
        notable_fall = 0.95  # of a combined error without one entry, above which that entry is not named by itself
        # Share of a result's variance without which the combined error falls notably.
        least = 1 - notable_fall**2
        main = [
            entry
            for entry in bearing
            if any((entry.shifts[n] * entry.left / e) ** 2 > least for n, e in whole.items() if 0 < e < math.inf)
        ]
        others = len(bearing) - len(main)
        more = (f"{others} more of less weight: see fit.assumptions()",) if others else ()
        return (*(entry.words for entry in main), *more)

    def with_priors(self, priors: Mapping[str, float]) -> Assumptions:
        """With standard uncertainties given for some terms, by name in the table."""
        for name, size in priors.items():
            entry = self[name]
            if not 0 <= size < math.inf:
                raise ValueError(f"the uncertainty of {entry.name} is {size}; it is positive, or zero for none")
        return Assumptions(tuple(replace(e, prior=priors.get(e.name, math.nan)) for e in self.entries))

    def systematic(self, result: str) -> float:
        """Standard uncertainty, SI, of a column of the table by all entries, each on its own; zero for what is none."""
        return math.hypot(*(entry.shifts.get(result, 0.0) * entry.left for entry in self.entries))

    def systematic_along(self, slopes: Mapping[str, float]) -> float:
        """The same of a quantity, by its derivatives by parameters; a known one moves with its own entry."""

        def moved(entry: Assumption) -> float:
            own = {**entry.shifts, entry.name: entry.shifts.get(entry.name, 1.0)}
            return entry.left * sum(slope * own.get(name, 0.0) for name, slope in slopes.items())

        return math.hypot(*map(moved, self.entries))

    def moves(self, result: str, value: float, unit: str) -> str:
        """The weightiest entry, where all together may well move a result by more than its value; else empty."""
        error = self.entries[0].errors.get(result, 0.0) if self.entries else 0.0
        if not is_left_open(value, error, self.systematic(result)):
            return ""
        entry = max(self.entries, key=lambda e: abs(e.shifts.get(result, 0.0) * e.left))
        factor, unit = (RPM_PER_RAD_S, "rpm") if result == THRESHOLD_COLUMN else (1.0, shown_unit(unit))
        return f"{entry.name} moves it by {two_digits(factor * entry.shifts[result] * entry.left, '+')} {unit}".rstrip()

    def combined(self, result: str) -> float:
        """Standard error of a result by the fit and :meth:`systematic` together."""
        return math.hypot(self.entries[0].errors[result], self.systematic(result))

    def rows(self, least: float = 0.0) -> list[list[str]]:
        """The table, head first: term, score test, size, and the shift of each result by that size; without entries
        that the data do not ask for and that move no result by so many standard errors."""
        results = list(self.entries[0].errors) if self.entries else []
        rows = [["left out or taken as known", "z", "size", *(_titled(name) for name in results), "s.e."]]
        for entry in self.entries:
            if entry.weight < least and not entry.missing:
                continue
            shifts = [_shown(name, entry.shifts[name] * entry.size, entry.errors[name]) for name in results]
            test = f"{entry.z:+.1f}" if entry.tested else "not determined"
            size = f"{two_digits(entry.size)} {shown_unit(entry.unit)}".rstrip()
            rows.append([f"{entry.name}, {entry.meaning}", test, size, *shifts, two_digits(entry.weight)])
        return rows

    @property
    def words(self) -> tuple[str, ...]:
        """How to read the table, and what structure is missing."""
        words = [
            "z is the size that the residuals ask for, divided by its standard error. The columns after it show by how "
            "much the results change if the term has the size shown: the size asked for, or a plausible one where the "
            "data do not determine it. The last column is the largest of these changes in standard errors."
        ]
        if self.missing:
            names = ", ".join(f"{entry.name} ({entry.meaning}; z {entry.z:+.1f})" for entry in self.missing[:3])
            words.append(f"The data ask for structure that the model lacks: {names}, or something like it.")
        words += [
            "There is coupling damping, so a damper acts somewhere, perhaps at the journal too and as strongly. These "
            f"data cannot separate {entry.name} from D and lam; see its row."
            for entry in self.entries
            if entry.implied and not entry.narrowed
        ]
        shares = []
        for name in self.entries[0].errors if self.entries else ():
            factor = RPM_PER_RAD_S if name == THRESHOLD_COLUMN else 1.0
            whole, share = factor * self.combined(name), factor * self.systematic(name)
            if math.isfinite(whole):
                shares.append(f"{_titled(name)} {two_digits(whole)} ({two_digits(share)})")
        if shares:
            words.append(f"Standard errors with the systematic share (the share alone): {', '.join(shares)}.")
        return tuple(words)

    def __str__(self) -> str:
        if not self.entries:
            return "nothing is known of what this model leaves out"
        rows = self.rows()
        lines = text_table(rows, "<58 >15 >14 " + " ".join([">12"] * (len(rows[0]) - 4)) + " >7")
        return "\n".join([*lines, *self.words])


def _titled(name: str) -> str:
    return "threshold, rpm" if name == THRESHOLD_COLUMN else name


def _shown(name: str, shift: float, error: float) -> str:
    if not math.isfinite(error):
        return "open"
    least_shown = 1e-3  # of a standard error: a shift below it is shown as none
    if abs(shift) < least_shown * error:
        return "0"
    return two_digits(shift * (RPM_PER_RAD_S if name == THRESHOLD_COLUMN else 1.0), "+")
