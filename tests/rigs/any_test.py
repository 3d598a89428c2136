"""Any experiment that columns can hold, for round trips through files, and how two of them are compared."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.from_arrays import perturbation_test
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.kinds.displacement_test import DisplacementTest

NAMES = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=12)
PLAIN_NAMES = st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=12)
SIZES = st.floats(1e-9, 1e9)
PHASES = st.floats(-3.1, 3.1)


def _phasors(draw: st.DrawFn, n: int) -> NDArray[np.complex128]:
    sizes = draw(st.lists(SIZES, min_size=n, max_size=n))
    return np.array(sizes) * np.exp(1j * np.array(draw(st.lists(PHASES, min_size=n, max_size=n))))


@st.composite
def rigs(draw: st.DrawFn, names: st.SearchStrategy[str] = NAMES, *, text_attributes: bool = True) -> PerturbationTest:
    """A perturbation test of one to six readings, speeds far apart, names of any characters."""
    n = draw(st.integers(1, 6))
    planes = draw(st.lists(names, min_size=1, max_size=3, unique=True))

    def column(elements: st.SearchStrategy[Any]) -> list[Any]:
        return draw(st.lists(elements, min_size=n, max_size=n))

    kinds = [SIZES, *([names.map(lambda name: "t" + name)] if text_attributes else [])]
    attributes = draw(st.dictionaries(names, st.sampled_from(kinds), max_size=2))
    values = {f"-{name}": column(kind) for name, kind in attributes.items()}
    known = draw(st.booleans())
    return perturbation_test(
        run=column(names),
        speed=column(st.integers(1, 9).map(lambda i: 100.0 * i)),
        frequency=column(st.one_of(SIZES, SIZES.map(lambda w: -w))),
        force_plane=column(st.just(planes[0])),
        force=_phasors(draw, n),
        plane=column(st.sampled_from(planes)),
        direction=column(st.sampled_from(["x", "y", "z", "rx", "ry", "rz"])),
        response=_phasors(draw, n),
        sigma=column(st.one_of(SIZES, st.just(np.nan))) if known else np.nan,
        attributes=values,
    )


@st.composite
def imposed_orbits(draw: st.DrawFn) -> DisplacementTest:
    """A displacement-in test of one to six readings."""
    n = draw(st.integers(1, 6))
    text = draw(st.lists(NAMES, min_size=2 * n, max_size=2 * n))
    return DisplacementTest(
        run=np.array(text[:n]),
        plane=np.array(text[n:]),
        speed=100.0 * np.array(draw(st.lists(st.integers(1, 9), min_size=n, max_size=n))),
        frequency=np.array(draw(st.lists(SIZES, min_size=n, max_size=n))) * draw(st.sampled_from([-1, 1])),
        displacement=_phasors(draw, n),
        force_x=_phasors(draw, n),
        force_y=_phasors(draw, n),
        sigma=np.full(n, draw(st.one_of(SIZES, st.just(np.nan)))),
    )


def same(again: Experiment, test: Experiment, rtol: float) -> None:
    """Every column and attribute is the same: text to the letter, numbers to ``rtol``, all bits if that is 0."""
    assert type(again) is type(test)
    for name in test._columns():
        _same(getattr(again, name), getattr(test, name), rtol)
    assert list(again.attributes) == list(test.attributes)
    for name, values in test.attributes.items():
        _same(again.attributes[name], values, rtol)


def _same(again: NDArray[Any], values: NDArray[Any], rtol: float) -> None:
    if values.dtype.kind in "UO":
        assert again.tolist() == values.tolist()
    elif rtol == 0:
        np.testing.assert_array_equal(again, values)
    else:
        np.testing.assert_allclose(again, values, rtol=rtol, atol=0)
