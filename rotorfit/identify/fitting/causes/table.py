"""The causes of a fit as a table: what each is, how large it may be and why, and what the data tell of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.base.digits import significant, two_digits
from rotorfit.base.equality import ByValue
from rotorfit.base.names import unknown_name
from rotorfit.base.significance import OPEN_ERRORS
from rotorfit.base.text_table import Table, Tabled
from rotorfit.estimators.inference.causes import Cause
from rotorfit.identify.fitting.causes.sizes import NOUNS
from rotorfit.identify.fitting.causes.solution import SolvedCauses

if TYPE_CHECKING:
    from pandas import DataFrame

FOUND = 4.0
"""Score from which a cause is named: 25 tests give one false name in 600 fits. Chosen."""


@dataclass(frozen=True, kw_only=True)
class CauseRow:
    """One cause of a fit.

    Attributes:
        name: by which ``rf.fit(..., causes=)`` sets its size.
        meaning: in words.
        unit: of its sizes.
        size: standard uncertainty before the data.
        sign: "either", or "never negative".
        reason: of the size.
        source: "c" arithmetic or convention, "m" measured, "j" judgement, "" given.
        determined: share of the size that the data tell, 0 on trust, 1 told by the data.
        value, stderr: what was found.
        z: score against none; NaN where the data do not tell.
        pull: what was found over what it scatters by if the size is right; NaN likewise.
        remedy: what would tell it, or take it out.
        parameter: of the model that is the same thing, known unless freed.
        alone: value, standard error and score of the gain of the probes at one plane if it is the only one that is off,
            where no other explains the data better; the data tell gains from each other, but not all from the common
            one, which hides which of them is off.
        rivals: names of those that explain the data as well.
    """

    name: str
    meaning: str
    unit: str
    size: float
    sign: str
    reason: str
    source: str
    determined: float
    value: float
    stderr: float
    z: float
    pull: float
    remedy: str
    parameter: str = ""
    alone: tuple[float, float, float] | None = None
    rivals: tuple[str, ...] = ()

    @property
    def score(self) -> float:
        """The larger of its scores, beside all others and alone."""
        alone = math.nan if self.alone is None else self.alone[2]
        return alone if math.isnan(self.z) or abs(alone) > abs(self.z) else self.z

    @property
    def found(self) -> bool:
        """True if the data show it."""
        return abs(self.score) > FOUND

    @property
    def way_out(self) -> str:
        """What to do about one that the data show."""
        return f'free it (known={{"{self.parameter}": None}}), or {self.remedy}' if self.parameter else self.remedy

    @property
    def words(self) -> str:
        """What was found, in words."""
        value, error = (self.value, self.stderr) if self.alone is None else self.alone[:2]
        size = f"{two_digits(value, '+')} +- {two_digits(error)} {'' if self.unit == '1' else self.unit}".rstrip()
        others = f" (or {' or '.join(self.rivals)} the other way: the data tell their ratio)" if self.rivals else ""
        return f"{self.name}: {self.meaning}, {size}{others}"


@dataclass(frozen=True, repr=False)
class Causes(ByValue, Tabled):
    """Causes of a fit: iterating gives :class:`CauseRow`, indexing by name one of them."""

    rows: tuple[CauseRow, ...]
    raised: tuple[str, ...] = ()  # names of those whose sizes were too small for what the data show
    factor: float = 1.0  # on all sizes, which were too small as a whole
    unexplained: bool = False  # no listed cause explains the misfit: nothing that was found is one

    def __iter__(self) -> Iterator[CauseRow]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> CauseRow:
        for row in self.rows:
            if row.name == name:
                return row
        raise KeyError(unknown_name("cause", name, [row.name for row in self.rows]))

    @property
    def found(self) -> tuple[CauseRow, ...]:
        """Those that the data show, the clearest first; they are in the estimate and in its error already."""
        found = () if self.unexplained else (row for row in self.rows if row.found)
        return tuple(sorted(found, key=lambda row: -abs(row.score)))

    def to_dataframe(self) -> DataFrame:
        """A row each; pandas is imported for it."""
        from pandas import DataFrame

        return DataFrame([asdict(row) for row in self.rows])

    def parts(self) -> list[str | Table]:
        """What is printed."""
        head = ["cause", "size", "found", "+-", "told", "z", "pull", "unit", "reason"]
        rows = [head]
        for row in self.rows:
            z, pull = ("" if math.isnan(number) else significant(number, 2) for number in (row.z, row.pull))
            told = f"{100 * row.determined:.0f} %"
            sizes = (significant(row.size, 2), two_digits(row.value), two_digits(row.stderr))
            rows.append([row.name, *sizes, told, z, pull, "" if row.unit == "1" else row.unit, row.reason])
        return [Table(rows, "<22 >10 >10 >10 >6 >6 >6 <8 <1")]


def size_warnings(solved: SolvedCauses | None) -> tuple[str, ...]:
    """What the sizes of causes ask a reader to know."""
    if solved is None:
        return ()
    told = []
    if solved.raised and solved.errors.widened == 1:
        raised = ", ".join(solved.raised)
        told.append(f"the size of {raised} was too small for what the data show, and was raised to it")
    if solved.factor > 1:
        told.append(f"the sizes of causes were too small as a whole; all were raised {solved.factor:.2g} times")
    return tuple(told)


def noun_of(row: CauseRow) -> str:
    """What a cause is, and its size, as a reader knows them: ``gain of the probes at disk, 2 %``."""
    stem, _, place = row.name.partition("[")
    where = place.rstrip("]")
    noun = NOUNS.get(f"{stem}[]" if where else stem, f"known {row.name}")
    of = " " if stem in ("speed", "mass") else " at "
    size = size_of(row)
    if row.unit == "1":
        size = f"{significant(100 * row.size, 2)} %"
    elif row.unit == "rad":
        size = f"{significant(math.degrees(row.size), 2)} deg"
    elif row.unit == "s":
        size = f"{significant(1e3 * row.size, 2)} ms"
    return f"{noun}{of + where if where else ''}, {size}"


def size_of(row: CauseRow | Cause) -> str:
    """The size of a cause with its unit."""
    return f"{two_digits(row.size)} {'' if row.unit == '1' else row.unit}".rstrip()


def table_of(solved: SolvedCauses | None) -> Causes:
    """The table of the causes of a fit, empty without any."""
    if solved is None:
        return Causes(())
    errors = solved.errors
    numbers = zip(solved.causes, errors.determined.tolist(), errors.value.tolist(), errors.deviation.tolist(),
                  errors.z.tolist(), errors.pull.tolist(), strict=True)  # fmt: skip
    off = _plane_off(solved)
    return Causes(
        tuple(
            CauseRow(
                name=cause.name,
                meaning=cause.meaning,
                unit=cause.unit,
                size=cause.size,
                sign="never negative" if cause.one_sided else "either",
                reason=cause.reason,
                source=cause.source,
                determined=determined,
                value=value,
                stderr=deviation,
                z=z,
                pull=pull,
                remedy=cause.remedy,
                parameter=cause.parameter,
                **off.get(cause.name, {}),
            )
            for cause, determined, value, deviation, z, pull in numbers
        ),
        raised=solved.raised,
        factor=solved.factor,
        unexplained=errors.widened > 1,
    )


def _plane_off(solved: SolvedCauses) -> dict[str, dict[str, Any]]:
    """Fields of the one plane whose gain explains the data best alone, by the name of its cause; of none without."""
    names = [cause.name for cause in solved.causes]
    gains = np.array([i for i, name in enumerate(names) if name.startswith("gain[")], dtype=np.intp)
    if gains.size < 2:
        return {}
    value, deviation, z = solved.errors.each_alone(gains)
    z = np.nan_to_num(z)
    best = int(np.argmax(np.abs(z)))
    if abs(z[best]) <= FOUND:
        return {}
    rivals = [names[gains[i]] for i in range(gains.size) if i != best and z[i] ** 2 > z[best] ** 2 - OPEN_ERRORS**2]
    found = (float(value[best]), float(deviation[best]), float(z[best]))
    return {names[gains[best]]: {"alone": found, "rivals": tuple(rivals)}}
