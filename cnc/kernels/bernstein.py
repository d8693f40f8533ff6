"""Polynomials in Bernstein form on [0, 1]: products, derivatives, sub-intervals, and the places where the sign changes.

Products and derivatives are taken in the homogeneous form f = sum F_i t^i (1-t)^(m-i) with F_i = C(m, i) f_i, where a product is a plain
convolution. Roots: by the variation diminishing property a polynomial changes its sign at most as often as its coefficients do, and the first
and last that are not zero tell the sign just inside the ends; halving by de Casteljau isolates each change (Farouki, The Bernstein polynomial basis:
a centennial retrospective, 2012, sections 5 and 9).
"""

from __future__ import annotations

from cnc.kernels.curve import Floats
from cnc.kernels.jit import njit

DEPTH = 48
"""Halvings after which coefficients that still change sign more than once are taken as one multiple root."""


@njit
def to_homogeneous(f: Floats, m: int) -> None:
    """f_i -> C(m, i) f_i in place."""
    choose = 1.0
    for i in range(m + 1):
        f[i] *= choose
        choose = choose * (m - i) / (i + 1.0)


@njit
def from_homogeneous(f: Floats, m: int) -> None:
    """C(m, i) f_i -> f_i in place."""
    choose = 1.0
    for i in range(m + 1):
        f[i] /= choose
        choose = choose * (m - i) / (i + 1.0)


@njit
def split(f: Floats, m: int, t: float, left: Floats, right: Floats) -> None:
    """Bernstein coefficients over [0, t] and [t, 1] of the polynomial with coefficients f[: m + 1] (de Casteljau). ``right`` may be ``f``."""
    for i in range(m + 1):
        right[i] = f[i]
    for k in range(m):
        left[k] = right[0]
        for i in range(m - k):
            right[i] += t * (right[i + 1] - right[i])
    left[m] = right[0]


@njit
def _changes(f: Floats, m: int) -> int:
    """Sign changes in f[: m + 1], zeros passed over."""
    count = 0
    last = 0.0
    for i in range(m + 1):
        if f[i] != 0.0:
            if f[i] * last < 0.0:
                count += 1
            last = 1.0 if f[i] > 0.0 else -1.0
    return count


@njit
def _single_root(f: Floats, m: int, scratch: Floats) -> float:
    """The t in (0, 1) of the only sign change of f: Newton from the middle, kept inside the bracket."""
    low = 0.0
    high = 1.0
    rises = 0.0
    for i in range(m + 1):
        if f[i] != 0.0:
            rises = 1.0 if f[i] < 0.0 else -1.0
            break
    t = 0.5
    for _ in range(100):
        for i in range(m + 1):
            scratch[i] = f[i]
        for k in range(m - 1):
            for i in range(m - k):
                scratch[i] += t * (scratch[i + 1] - scratch[i])
        slope = m * (scratch[1] - scratch[0])
        value = scratch[0] + t * (scratch[1] - scratch[0])
        if value == 0.0:
            return t
        if value * rises > 0.0:
            high = t
        else:
            low = t
        guess = t - value / slope if slope != 0.0 else -1.0
        if not low < guess < high:
            guess = 0.5 * (low + high)
        if abs(guess - t) <= 1e-16 or high - low <= 1e-16:
            return guess
        t = guess
    return t


@njit
def sign_changes(f: Floats, m: int, stack: Floats, scratch: Floats, roots: Floats) -> int:
    """The t strictly inside (0, 1) where the polynomial f[: m + 1] of degree m changes its sign, in order, into ``roots``; returns how many.

    stack: scratch (DEPTH + 4, at least m + 3), scratch (at least m + 1,). Intervals wait on the stack, the leftmost on top, with their place in
    the last two columns. ``before`` is the sign just left of the interval in hand, so that a change right where two meet isn't missed.
    """
    last = stack.shape[1] - 2
    for i in range(m + 1):
        stack[0, i] = f[i]
    stack[0, last] = 0.0
    stack[0, last + 1] = 1.0
    top = 0
    count = 0
    before = 0.0
    while top >= 0:
        a = stack[top, last]
        width = stack[top, last + 1]
        c = stack[top]
        changes = _changes(c, m)
        if changes > 1 and width > 0.5**DEPTH:
            # the left half goes on top, the right one stays in this place
            split(c, m, 0.5, stack[top + 1], c)
            stack[top, last] = a + 0.5 * width
            stack[top, last + 1] = 0.5 * width
            stack[top + 1, last] = a
            stack[top + 1, last + 1] = 0.5 * width
            top += 1
            continue
        top -= 1
        first_sign = 0.0
        last_sign = 0.0
        for i in range(m + 1):
            if c[i] != 0.0:
                last_sign = 1.0 if c[i] > 0.0 else -1.0
                if first_sign == 0.0:
                    first_sign = last_sign
        if first_sign == 0.0:
            continue
        if before * first_sign < 0.0 and count < roots.shape[0]:
            roots[count] = a
            count += 1
        if first_sign != last_sign and count < roots.shape[0]:
            roots[count] = a + width * (_single_root(c, m, scratch) if changes == 1 else 0.5)
            count += 1
        before = last_sign
    return count
