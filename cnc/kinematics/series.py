r"""Taylor series along a path, cut off at an order: every formula with all its derivatives.

A kinematics is written once, as a formula of the tip's coordinates. Given the series of the
coordinates in the parameter u of the path,

    x(u0 + h) = x_0 + x_1 h + x_2 h^2 + ..,      x_k = (d^k x / du^k) / k!

the formula gives the series of the joints. The product is a convolution; the others follow from it
(Griewank, Walther, Evaluating Derivatives, 2nd edition 2008, table 13.2):

    q = f / g        g_0 q_k = f_k - sum_{i=1..k} g_i q_{k-i}
    s = sqrt(f)      2 s_0 s_k = f_k - sum_{i=1..k-1} s_i s_{k-i}
    a = atan2(y, x)  (x^2 + y^2) a' = x y' - y x'
    sin a, cos a     s' = c a',  c' = -s a'

A term is an array of numbers, or of intervals. With the series of the tip over a whole piece of
path in intervals, the last term bounds the error of the polynomial that is left of the series.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from cnc.kinematics import interval
from cnc.kinematics.interval import Floats, Interval

Term: TypeAlias = Any
"""An array (m,) or an :class:`Interval`: both have the same operators. Beside intervals a term
behind the first may be the number 0.0: it is 0 everywhere.
"""


class Series:
    """The terms of a Taylor series, x_0 to x_n.

    Attributes:
        terms: each an array (m,), or intervals (m,).
    """

    __slots__ = ("terms",)

    def __init__(self, terms: Sequence[Term]) -> None:
        self.terms = tuple(terms)

    def __add__(self, other: Series | Floats | float) -> Series:
        if isinstance(other, Series):
            return Series([a + b for a, b in zip(self.terms, other.terms, strict=True)])
        return Series([self.terms[0] + other, *self.terms[1:]])

    __radd__ = __add__

    def __neg__(self) -> Series:
        return Series([-a for a in self.terms])

    def __sub__(self, other: Series | Floats | float) -> Series:
        return self + -other

    def __rsub__(self, other: float) -> Series:
        return -self + other

    def __mul__(self, other: Series | Floats | float) -> Series:
        if not isinstance(other, Series):
            return Series([a if _is_none(a) else a * other for a in self.terms])
        return Series(
            [_convolved(self.terms, other.terms, 0, k, k) for k in range(len(self.terms))]
        )

    __rmul__ = __mul__

    def __truediv__(self, other: Series | float) -> Series:
        if not isinstance(other, Series):
            return self * (1.0 / other)
        quotient: list[Term] = [_quotient(self.terms[0], other.terms[0])]
        for k in range(1, len(self.terms)):
            rest = self.terms[k] - _convolved(other.terms, quotient, 1, k, k)
            quotient.append(_quotient(rest, other.terms[0]))
        return Series(quotient)

    def square(self) -> Series:
        """Return the square; its first term is not negative, in intervals too."""
        first = self.terms[0]
        product = (self * self).terms
        return Series([first.square(), *product[1:]] if isinstance(first, Interval) else product)


def sqrt(value: Series) -> Series:
    """Return the square root; not a number, or unbounded, where the value is negative."""
    first = value.terms[0]
    if isinstance(first, Interval):
        root: list[Term] = [first.sqrt()]
    else:
        with np.errstate(invalid="ignore"):
            root = [np.sqrt(first)]
    with np.errstate(divide="ignore", invalid="ignore"):
        for k in range(1, len(value.terms)):
            rest = value.terms[k]
            if k > 1:
                rest = rest - _convolved(root, root, 1, k - 1, k)
            root.append(_quotient(rest, root[0] * 2.0))
    return Series(root)


def atan2(y: Series, x: Series) -> Series:
    """Return the angle of the point (x, y), rad, from -pi to pi in the first term."""
    bounds = isinstance(y.terms[0], Interval)
    angle = (interval.atan2 if bounds else np.arctan2)(y.terms[0], x.terms[0])
    order = len(y.terms) - 1
    if order == 0:
        return Series([angle])
    square = x.square() + y.square()
    moment = _head(x, order) * _slope(y) - _head(y, order) * _slope(x)
    with np.errstate(divide="ignore", invalid="ignore"):
        rate = moment / _head(square, order)
    return Series([angle, *(term * (1.0 / (k + 1)) for k, term in enumerate(rate.terms))])


def sine_cosine(angle: Series) -> tuple[Series, Series]:
    """Return the sine and the cosine of an angle in rad.

    From s' = c a' and c' = -s a', k s_k is the sum of i a_i c_{k-i}, k c_k that of -i a_i s_{k-i}.
    """
    first = angle.terms[0]
    if isinstance(first, Interval):
        sines: list[Term] = [interval.cosine(first - 0.5 * np.pi)]
        cosines: list[Term] = [interval.cosine(first)]
    else:
        sines, cosines = [np.sin(first)], [np.cos(first)]
    slope = [term * float(k) for k, term in enumerate(angle.terms)]
    # Most angles are linear in the parameter: their higher terms are 0.
    last = max((k for k, term in enumerate(slope) if k and _is_present(term)), default=0)
    for k in range(1, len(angle.terms)):
        sine = cosine = slope[0] * 0.0
        for i in range(1, min(k, last) + 1):
            sine = sine + slope[i] * cosines[k - i]
            cosine = cosine - slope[i] * sines[k - i]
        sines.append(sine * (1.0 / k))
        cosines.append(cosine * (1.0 / k))
    return Series(sines), Series(cosines)


def _is_present(term: Term) -> bool:
    """Return whether a term is not 0 everywhere."""
    if isinstance(term, Interval):
        return bool(np.any(term.lo) or np.any(term.hi))
    return bool(np.any(term))


def _convolved(a: Sequence[Term], b: Sequence[Term], first: int, last: int, k: int) -> Term:
    """Return the sum of a_i b_{k-i} over i from ``first`` to ``last``."""
    total: Term = 0.0
    for i in range(first, last + 1):
        x, y = a[i], b[k - i]
        # Most terms of a straight move are 0.
        if not (_is_none(x) or _is_none(y)):
            total = x * y if _is_none(total) else total + x * y
    return total


def _quotient(term: Term, divisor: Term) -> Term:
    """Return a quotient; that of the number 0, which stands for a constant, is 0 again."""
    return term if isinstance(divisor, Interval) and _is_none(term) else term / divisor


def _is_none(term: Term) -> bool:
    """Return whether a term is the number 0."""
    return isinstance(term, float) and term == 0.0


def _head(value: Series, terms: int) -> Series:
    return Series(value.terms[:terms])


def _slope(value: Series) -> Series:
    """Return the derivative, one term shorter."""
    return Series([term * float(k) for k, term in enumerate(value.terms)][1:])
