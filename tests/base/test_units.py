import math

import pytest
from sentences import refuses

from rotorfit.base.units import UNITS, si_factor, units_of


@pytest.mark.parametrize(
    ("quantity", "unit", "factor"),
    [
        ("frequency", "rpm", 2 * math.pi / 60),
        ("frequency", "cpm", 2 * math.pi / 60),
        ("frequency", "Hz", 2 * math.pi),
        ("frequency", "rad_s", 1.0),
        ("displacement", "um", 1e-6),
        ("displacement", "mil", 25.4e-6),
        ("displacement", "mil_pp", 12.7e-6),
        ("displacement", "um_rms", 1e-6 * math.sqrt(2)),
        ("displacement", "mm_pk", 1e-3),
        ("tilt", "urad", 1e-6),
        ("tilt", "deg_pp", math.pi / 360),
        ("force", "lbf", 0.45359237 * 9.80665),
        ("force", "kN", 1e3),
        ("unbalance", "g_mm", 1e-6),
        ("unbalance", "oz_in", 0.45359237 / 16 * 0.0254),
        ("phase", "deg", math.pi / 180),
        ("phase", "lag_deg", -math.pi / 180),
    ],
)
def test_factors_agree_with_the_definitions_of_the_units(quantity, unit, factor):
    assert si_factor(quantity, unit) == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize(("unit", "factor"), [("MN", 1e6), ("mN", 1e-3), ("KN", 1e3), ("n", 1.0), ("µm_pp", 0.5e-6)])
def test_mega_is_not_milli_and_other_cases_do_not_matter(unit, factor):
    assert si_factor("displacement" if "m_pp" in unit else "force", unit) == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize(
    ("quantity", "unit"), [("force", "mn"), ("force", "Mn"), ("displacement", "Mm"), ("tilt", "Mrad")]
)
def test_a_unit_that_its_case_leaves_open_is_refused(quantity, unit):
    with refuses(ValueError):
        si_factor(quantity, unit)


def test_an_unknown_unit_lists_those_there_are():
    with refuses(ValueError):
        si_factor("frequency", "rpn")


def test_an_unknown_quantity_lists_those_there_are():
    with refuses(ValueError):
        si_factor("colour", "um")


def test_lengths_and_angles_can_be_told_apart_by_their_unit():
    assert not set(UNITS["displacement"]) & set(UNITS["tilt"])
    assert units_of("displacement", "tilt") == UNITS["displacement"] | UNITS["tilt"]
