"""A model's dynamic stiffness in symbols, read off its CasADi graph, in MathML for reports."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from types import SimpleNamespace

import casadi as ca

from rotorfit.models import RotorModel
from rotorfit.models.complexes import Complex

Monomial = tuple[tuple[str, int], ...]
Polynomial = dict[Monomial, float]

SPEED, ECCENTRICITY = "Omega", "epsilon"

_GREEK = {"lam": "λ", "lambda": "λ", "sigma": "σ", "beta": "β", "alpha": "α", "zeta": "ζ", "phi": "φ", "eps": "ε"}
_GREEK |= {"epsilon": "ε", "Omega": "Ω", "omega": "ω", "kappa": "κ", "mu": "μ", "nu": "ν", "tau": "τ", "gamma": "γ"}


@dataclass(frozen=True)
class Entry:
    """One entry of the dynamic stiffness matrix, ``direct(w) + j quadrature(w)``."""

    # coefficient of each power of the perturbation frequency w, as a polynomial in the parameters and the rotative
    # speed; powers without a term are left out
    direct: Mapping[int, Polynomial]
    quadrature: Mapping[int, Polynomial]


def stiffness_entries(model: RotorModel) -> list[list[Entry]]:
    """Entries of the dynamic stiffness matrix, row by row; what a known shaft adds is not in them."""
    p = SimpleNamespace(**{name: ca.SX.sym(name) for name in model.parameter_names})
    equation = model.equation(p, ca.SX.sym(SPEED), ca.SX.sym(ECCENTRICITY))
    matrices = [Complex.matrix(m) for m in equation]
    size = range(len(model.coordinates) - len(model.probes))
    return [[_entry(matrices, row, column) for column in size] for row in size]


def _entry(matrices: Sequence[Complex], row: int, column: int) -> Entry:
    direct: dict[int, Polynomial] = {}
    quadrature: dict[int, Polynomial] = {}
    for power, matrix in enumerate(matrices):
        re_, im = _polynomial(matrix.re[row, column]), _polynomial(matrix.im[row, column])
        # s^k = j^k w^k turns the coefficient by a quarter for each power.
        turned = ((re_, im), (_scaled(im, -1), re_), (_scaled(re_, -1), _scaled(im, -1)), (im, _scaled(re_, -1)))
        for store, value in zip((direct, quadrature), turned[power % 4], strict=True):
            if value:
                store[power] = value
    return Entry(direct, quadrature)


def _scaled(a: Polynomial, factor: float) -> Polynomial:
    return {monomial: factor * value for monomial, value in a.items()}


def _added(a: Polynomial, b: Polynomial) -> Polynomial:
    total = {m: a.get(m, 0.0) + b.get(m, 0.0) for m in {**a, **b}}
    return {m: value for m, value in total.items() if value}


def _multiplied(a: Polynomial, b: Polynomial) -> Polynomial:
    total: Polynomial = {}
    for first, x in a.items():
        for second, y in b.items():
            powers = dict(first)
            for name, power in second:
                powers[name] = powers.get(name, 0) + power
            total = _added(total, {tuple(sorted(powers.items())): x * y})
    return total


def _polynomial(expression: ca.SX) -> Polynomial:  # noqa: PLR0911  one return an operation
    """Expand an expression into monomials; what is no polynomial (a quotient, a root) stays whole as an atom."""
    if expression.is_constant():
        value = float(expression)
        return {(): value} if value else {}
    if expression.is_symbolic():
        return {((str(expression.name()), 1),): 1.0}
    parts = [_polynomial(expression.dep(i)) for i in range(expression.n_dep())]
    operation = expression.op()
    if operation == ca.OP_ADD:
        return _added(*parts)
    if operation == ca.OP_SUB:
        return _added(parts[0], _scaled(parts[1], -1))
    if operation == ca.OP_NEG:
        return _scaled(parts[0], -1)
    if operation == ca.OP_MUL:
        return _multiplied(*parts)
    if operation == ca.OP_SQ:
        return _multiplied(parts[0], parts[0])
    if operation == ca.OP_TWICE:
        return _scaled(parts[0], 2)
    return {((str(expression), 1),): 1.0}


# ---- writing ---------------------------------------------------------------------------------


def symbol_mathml(name: str) -> str:
    """A parameter's symbol in MathML: ``lam_D`` is λ and D, ``K12`` is K and 12, ``Kxy_1`` is K and xy,1."""
    if not name.isidentifier():
        return f"<mtext>{escape(name)}</mtext>"
    stem, _, index = name.partition("_")
    greek = re.fullmatch(rf"({'|'.join(sorted(_GREEK, key=len, reverse=True))})(\d*)", stem)
    letter, rest = (_GREEK[greek[1]], greek[2]) if greek else (stem[:1], stem[1:])
    index = ",".join(part for part in (rest, *index.split("_")) if part)
    mi = f"<mi>{escape(letter)}</mi>"
    return mi if not index else f"<msub>{mi}<mtext>{escape(index)}</mtext></msub>"


_MINUS, _PLUS, _TIMES = "<mo>−</mo>", "<mo>+</mo>", "<mo>&#x2062;</mo><mspace width='0.12em'/>"


def _power(base: str, exponent: int) -> str:
    return base if exponent == 1 else f"<msup>{base}<mn>{exponent}</mn></msup>"


def to_mathml(part: Mapping[int, Polynomial], order: Sequence[str]) -> str:
    """Polynomial in the frequency as a row of MathML elements."""
    most_terms = 60  # terms beyond which an entry is not written out
    if sum(len(polynomial) for polynomial in part.values()) > most_terms:
        return symbol_mathml("f")
    text = ""
    for negative, body in _pieces(part, order):
        sign = _MINUS if negative else _PLUS if text else ""
        text += sign + body
    return text or "<mn>0</mn>"


def _pieces(part: Mapping[int, Polynomial], order: Sequence[str]) -> Iterator[tuple[bool, str]]:

    def rank(term: tuple[Monomial, float]) -> tuple[int, int, list[int]]:
        powers = dict(term[0])
        places = [order.index(name) if name in order else len(order) for name in powers]
        return powers.get(SPEED, 0), sum(powers.values()), sorted(places)

    for power in sorted(part):
        terms = sorted(part[power].items(), key=rank)
        if power == 0:
            for monomial, value in terms:
                yield value < 0, _term(monomial, abs(value))
        elif len(terms) == 1:
            yield terms[0][1] < 0, _term(terms[0][0], abs(terms[0][1]), (("omega", power),))
        else:
            negative = terms[0][1] < 0
            inner = ""
            for monomial, value in terms:
                opposite = (value < 0) != negative
                inner += (_MINUS if opposite else _PLUS if inner else "") + _term(monomial, abs(value))
            yield negative, f"<mo>(</mo>{inner}<mo>)</mo>" + _TIMES + _power(symbol_mathml("omega"), power)


def _term(monomial: Monomial, value: float, more: Monomial = ()) -> str:
    # Omega comes last among the symbols, then the frequency.
    names = sorted(monomial, key=lambda item: item[0] == SPEED)
    factors = [_power(symbol_mathml(name), power) for name, power in (*names, *more)]
    if value != 1 or not factors:
        factors.insert(0, f"<mn>{value:g}</mn>")
    return _TIMES.join(factors)
