"""Polynomials of degree 7 on [0, 1]: Hermite interpolation, values, derivatives, and zeros.

A polynomial is a row of POLYNOMIAL coefficients, each from the constant on: the polynomial (8), its
first (7), second (6) and third derivative (5).
"""

from __future__ import annotations

import math

from cnc.compiled.jit import njit
from cnc.path.kernels.curve import Floats

POLYNOMIAL = 26
GENTLE = 1.0 / 256.0
"""With second and third derivatives so much smaller than the first, the inverse series of the cubic
is exact to 1e-9 of a step.
"""


@njit
def interpolate(
    poly: Floats,
    row: int,
    p0: float,
    p1: float,
    p2: float,
    p3: float,
    q0: float,
    q1: float,
    q2: float,
    q3: float,
) -> None:
    """Write the Hermite interpolant into row ``row`` of ``poly``.

    p0 to p3 are the value, the slope, half of the second derivative and a sixth of the third at 0;
    q0 to q3 are the same at 1.
    """
    e0 = q0 - p0 - (p1 + p2 + p3)
    e1 = q1 - (p1 + 2.0 * p2 + 3.0 * p3)
    e2 = q2 - (p2 + 3.0 * p3)
    e3 = q3 - p3
    c = poly[row]
    c[0] = p0
    c[1] = p1
    c[2] = p2
    c[3] = p3
    c[4] = 35.0 * e0 - 15.0 * e1 + 5.0 * e2 - e3
    c[5] = -84.0 * e0 + 39.0 * e1 - 14.0 * e2 + 3.0 * e3
    c[6] = 70.0 * e0 - 34.0 * e1 + 13.0 * e2 - 3.0 * e3
    c[7] = -20.0 * e0 + 10.0 * e1 - 4.0 * e2 + e3
    for k in range(7):
        c[8 + k] = (k + 1) * c[1 + k]
    for k in range(6):
        c[15 + k] = (k + 1) * c[9 + k]
    for k in range(5):
        c[21 + k] = (k + 1) * c[16 + k]


@njit
def estrin(
    c0: float, c1: float, c2: float, c3: float, c4: float, c5: float, c6: float, c7: float, x: float
) -> float:
    """Return the value at x of the polynomial with these coefficients; c0 is added last."""
    x2 = x * x
    return c0 + (c1 * x + (c2 + c3 * x) * x2 + ((c4 + c5 * x) + (c6 + c7 * x) * x2) * (x2 * x2))


@njit
def value_less(c: Floats, base: float, x: float) -> float:
    """Return the value at x of the polynomial c (POLYNOMIAL,) less ``base``.

    ``base`` is taken from the constant term, which is added last: next to ``base`` no digits are
    lost.
    """
    return estrin(c[0] - base, c[1], c[2], c[3], c[4], c[5], c[6], c[7], x)


@njit
def value(c: Floats, x: float) -> float:
    """Return the value at x of the polynomial c (POLYNOMIAL,)."""
    return estrin(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], x)


@njit
def is_constant(c: Floats) -> bool:
    """Return whether the polynomial c (POLYNOMIAL,) has the same value everywhere."""
    constant = True
    for k in range(1, 8):
        constant = constant and c[k] == 0.0
    return constant


@njit
def slope(c: Floats, x: float) -> float:
    """Return the first derivative at x of the polynomial c (POLYNOMIAL,)."""
    x2 = x * x
    x4 = x2 * x2
    return (c[8] + c[9] * x) + (c[10] + c[11] * x) * x2 + ((c[12] + c[13] * x) + c[14] * x2) * x4


@njit
def bends(c: Floats, x: float) -> tuple[float, float]:
    """Return the second and the third derivative at x of the polynomial c (POLYNOMIAL,)."""
    x2 = x * x
    x4 = x2 * x2
    f2 = (c[15] + c[16] * x) + (c[17] + c[18] * x) * x2 + (c[19] + c[20] * x) * x4
    f3 = (c[21] + c[22] * x) + (c[23] + c[24] * x) * x2 + c[25] * x4
    return f2, f3


@njit
def derivatives(c: Floats, x: float) -> tuple[float, float, float]:
    """Return the first three derivatives at x of the polynomial c (POLYNOMIAL,)."""
    f2, f3 = bends(c, x)
    return slope(c, x), f2, f3


@njit
def approach(f: float, f1: float, f2: float, f3: float) -> float:
    """Return the step towards the zero of the cubic with value f <= 0 and these derivatives.

    It is infinite where the cubic has no zero ahead.
    """
    step = math.inf
    square = GENTLE * f1 * f1
    if f1 > 0.0 and abs(f * f2) <= square and abs(f * f * f3) <= square * f1:
        inverse = 1.0 / f1
        w = -f * inverse
        a = 0.5 * f2 * inverse * w
        b = f3 * inverse * w * w / 6.0
        step = w * (1.0 - a + 2.0 * a * a - b - 5.0 * a * (a * a - b))
    else:
        # Euler's irrational method: the osculating parabola also gives a crossing beside a turning
        # point.
        under = f1 * f1 - 2.0 * f * f2
        rise = f1 + math.sqrt(max(under, 0.0))
        if under >= 0.0 and f1 >= 0.0 and rise > 0.0:
            step = -2.0 * f / rise
            # The cubic term moves the parabola's root by one Newton step.
            rise = f1 + step * (f2 + 0.5 * step * f3)
            if rise > 0.0:
                step -= step * step * step * f3 / (6.0 * rise)
    return step
