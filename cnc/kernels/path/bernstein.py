"""Polynomials in Bernstein form on [0, 1]: values, sub-intervals, and sign changes.

By the variation diminishing property a polynomial changes its sign at most as often as its
coefficients do. The first and the last coefficient that are not zero give the sign just inside the
ends. Halving by de Casteljau isolates each change; where only one is left Newton's iteration, kept
inside its bracket, finds it (Farouki, The Bernstein polynomial basis: a centennial retrospective,
2012, sections 5 and 9).

Coefficients lie in flat arrays from an index on: slices of arrays cost more than the arithmetic.
"""

from __future__ import annotations

from cnc.kernels.jit import njit
from cnc.kernels.path.curve import Floats

DEPTH = 48
"""Number of halvings after which coefficients that still change sign more than once are taken as
one multiple root.
"""
STRIDE = 64
"""Numbers reserved for one set of coefficients: more than the degree of any polynomial here, 5 p -
5 for a span of degree p <= 9, and two more.
"""


@njit
def unscale(f: Floats, m: int) -> None:
    """Turn the homogeneous form f = sum F_i t^i (1-t)^(m-i) into f_i = F_i / C(m, i), in place.

    In the homogeneous form products are convolutions.
    """
    choose = 1.0
    for i in range(m + 1):
        f[i] /= choose
        choose *= (m - i) / (i + 1.0)


@njit
def split(f: Floats, at: int, m: int, t: float, left: Floats, left_at: int) -> None:
    """Divide f[at : at + m + 1] at t (de Casteljau).

    The coefficients over [0, t] go to ``left``; those over [t, 1] replace f.
    """
    for k in range(m + 1):
        left[left_at + k] = f[at]
        for i in range(at, at + m - k):
            f[i] += t * (f[i + 1] - f[i])


@njit
def value_slope(f: Floats, at: int, m: int, t: float, scratch: Floats) -> tuple[float, float]:
    """Return value and derivative at t of the polynomial f[at : at + m + 1], m >= 1."""
    for i in range(m + 1):
        scratch[i] = f[at + i]
    for k in range(m - 1):
        for i in range(m - k):
            scratch[i] += t * (scratch[i + 1] - scratch[i])
    rise = scratch[1] - scratch[0]
    return scratch[0] + t * rise, m * rise


@njit
def sign_changes(f: Floats, m: int, stack: Floats, scratch: Floats, roots: Floats) -> int:
    """Write the t inside (0, 1) where the polynomial f[: m + 1] changes its sign into ``roots``.

    stack ((DEPTH + 4) STRIDE,) and scratch (STRIDE,) are work space. The stack holds intervals, the
    leftmost on top, with their start and width behind the coefficients. ``before`` is the sign just
    left of the current interval, so that a change between two intervals is not missed.

    Returns:
        Their number.
    """
    for i in range(m + 1):
        stack[i] = f[i]
    stack[STRIDE - 2] = 0.0
    stack[STRIDE - 1] = 1.0
    waiting = 1
    count = 0
    before = 0.0
    while waiting > 0:
        top = (waiting - 1) * STRIDE
        a = stack[top + STRIDE - 2]
        width = stack[top + STRIDE - 1]
        changes = 0
        first = 0.0
        last = 0.0
        for i in range(top, top + m + 1):
            if stack[i] != 0.0:
                sign = 1.0 if stack[i] > 0.0 else -1.0
                if last == 0.0:
                    first = sign
                elif sign != last:
                    changes += 1
                last = sign
        if changes > 1 and width > 0.5**DEPTH:
            width *= 0.5
            split(stack, top, m, 0.5, stack, top + STRIDE)
            stack[top + STRIDE - 2] = a + width
            stack[top + STRIDE - 1] = width
            stack[top + 2 * STRIDE - 2] = a
            stack[top + 2 * STRIDE - 1] = width
            waiting += 1
            continue
        if before * first < 0.0 and count < roots.shape[0]:
            roots[count] = a
            count += 1
        if first != last and count < roots.shape[0]:
            low = 0.0
            high = 1.0
            t = 0.5
            for _ in range(100):
                if changes > 1 or high - low <= 1e-16:
                    break
                value, slope = value_slope(stack, top, m, t, scratch)
                if value * first > 0.0:
                    low = t
                else:
                    high = t
                change = value / slope if slope != 0.0 else 2.0
                if not low < t - change < high:
                    change = t - 0.5 * (low + high)
                t -= change
                if abs(change) <= 1e-16:
                    break
            roots[count] = a + width * t
            count += 1
        if last != 0.0:
            before = last
        waiting -= 1
    return count
