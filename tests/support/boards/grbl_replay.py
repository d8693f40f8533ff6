"""Execution of lines in the arithmetic of GRBL 1.1, and the comparison of two motions.

The facts are those of GRBL's documentation and of the behaviour of its sources (gcode.c,
motion_control.c, nuts_bolts.c), all in 32-bit floats. Numbers are read as integers and scaled by
powers of ten. Offsets are added when a line is read. An arc starts at the machine's position with
the radius that I J K give. It is cut into chords by ``$12``, turned by an approximation that is
corrected at every twelfth chord, and its last chord ends at the end point as read.

The motions are compared by their Frechet distance (Alt, Godau 1995): the shortest leash with which
two walkers who never turn back can follow both. Unlike a distance of sets it detects parts that
come in another order, twice, or never.
"""

import math
import re
from dataclasses import dataclass, field

import numpy as np
from numba import njit

F = np.float32
WORD = re.compile(r"([A-Z])([-+]?[0-9]*\.?[0-9]*)")
PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
CORRECTION = 12
TENTH, HUNDREDTH = F(0.1), F(0.01)


class Refused(Exception):
    """The board would answer error or alarm."""


def read_number(text: str) -> np.float32:
    """Return a number as GRBL reads it: with eight digits."""
    whole, _, part = text.lstrip("+-").partition(".")
    digits = (whole + part).lstrip("0")
    exponent = -len(part)
    if len(digits) > 8:
        exponent += max(len(digits) - 8, 0)
        digits = digits[:8]
    value = F(int(digits or "0"))
    while exponent <= -2:
        value = F(value * HUNDREDTH)
        exponent += 2
    if exponent < 0:
        value = F(value * TENTH)
    for _ in range(exponent):
        value = F(value * F(10.0))
    return F(-value) if text.startswith("-") else value


def hypot(x: np.float32, y: np.float32) -> np.float32:
    return F(math.sqrt(F(F(x * x) + F(y * y))))


@dataclass
class Replay:
    """A board at ``at`` (machine mm) with the work offset ``offset``.

    arc_tolerance: ``$12``. travel: lowest and highest position of each axis, or None. points: the
    motion so far; sources: the line of each point; feeds: mm/min to each point (NaN: traverse).
    arcs: line, plane and radius of each arc.
    """

    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    arc_tolerance: float = 0.002
    travel: tuple[tuple[float, float], ...] | None = None
    motion: int = 0
    plane: int = 17
    feed: float = 0.0
    lines: int = 0
    points: list[tuple[float, ...]] = field(default_factory=list)
    sources: list[int] = field(default_factory=list)
    feeds: list[float] = field(default_factory=list)
    rests: list[int] = field(default_factory=list)
    arcs: list[tuple[int, int, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.here = [F(value) for value in self.at]
        self.points.append(tuple(float(value) for value in self.here))
        self.sources.append(0)
        self.feeds.append(math.nan)

    def read(self, text: str) -> None:
        """Execute a line."""
        self.lines += 1
        if len(text) + 1 > 80:
            raise Refused(f"overflow: {text}")
        bare = re.sub(r"\([^)]*\)", "", text).replace(" ", "")
        words = WORD.findall(bare)
        if "".join(letter + value for letter, value in words) != bare or any(
            value in ("", "-", ".") for _, value in words
        ):
            raise Refused(f"error:1 or 2: {text}")
        given: dict[str, np.float32] = {}
        for letter, value in words:
            number = read_number(value)
            if letter == "G":
                code = float(value)
                if code in (0, 1, 2, 3):
                    self.motion = int(code)
                elif code in PLANES:
                    self.plane = int(code)
                elif code == 4:
                    self.rests.append(len(self.points) - 1)
                    return
                elif code not in (21, 90, 94, 54):
                    raise Refused(f"not expected here: {text}")
            elif letter == "M":
                self.rests.append(len(self.points) - 1)
            elif letter in given:
                raise Refused(f"error:25: {text}")
            else:
                given[letter] = number
        if "F" in given:
            self.feed = float(given["F"])
        if set("XYZIJK") & set(given):
            self.move(text, given)

    def move(self, text: str, given: dict[str, np.float32]) -> None:
        target = [
            F(given[axis] + F(shift)) if axis in given else here
            for axis, shift, here in zip("XYZ", self.offset, self.here, strict=True)
        ]
        if self.motion != 0 and not self.feed > 0.0:
            raise Refused(f"error:22: {text}")
        if self.motion in (0, 1):
            if set("IJK") & set(given):
                raise Refused(f"error:36: {text}")
            self.go(target, text)
        else:
            self.arc(text, given, target)
        self.here = target

    def arc(self, text: str, given: dict[str, np.float32], target: list[np.float32]) -> None:
        i, j, across = PLANES[self.plane]
        letters = "IJK"
        if not {"XYZ"[i], "XYZ"[j]} & set(given):
            raise Refused(f"error:26: {text}")
        if not {letters[i], letters[j]} & set(given):
            raise Refused(f"error:35: {text}")
        if letters[across] in given:
            raise Refused(f"error:36: {text}")
        oi, oj = given.get(letters[i], F(0)), given.get(letters[j], F(0))
        x, y = F(F(target[i] - self.here[i]) - oi), F(F(target[j] - self.here[j]) - oj)
        radius, ends = hypot(oi, oj), hypot(x, y)
        self.arcs.append((self.lines, self.plane, float(radius)))
        off = abs(float(ends) - float(radius))
        if off > 0.005 and (off > 0.5 or off > 0.001 * float(radius)):
            raise Refused(f"error:33: {text}")
        ci, cj = F(self.here[i] + oi), F(self.here[j] + oj)
        ri, rj = F(-oi), F(-oj)
        ti, tj = F(target[i] - ci), F(target[j] - cj)
        angle = F(math.atan2(F(F(ri * tj) - F(rj * ti)), F(F(ri * ti) + F(rj * tj))))
        if self.motion == 2 and angle >= -5e-7:
            angle = F(angle - F(2.0 * math.pi))
        elif self.motion == 3 and angle <= 5e-7:
            angle = F(angle + F(2.0 * math.pi))
        tolerance = F(self.arc_tolerance)
        half = float(tolerance) * (2.0 * float(radius) - float(tolerance))
        count = (
            math.floor(abs(0.5 * float(angle) * float(radius)) / math.sqrt(half))
            if half > 0.0
            else 0
        )
        if count:
            theta = F(angle / F(count))
            rise = F(F(target[across] - self.here[across]) / F(count))
            cos = F(F(2.0) - F(theta * theta))
            sin = F(F(theta * F(0.16666667)) * F(cos + F(4.0)))
            cos = F(cos * F(0.5))
            now, since = list(self.here), 0
            for k in range(1, count):
                if since < CORRECTION:
                    ri, rj = F(F(ri * cos) - F(rj * sin)), F(F(ri * sin) + F(rj * cos))
                    since += 1
                else:
                    c, s = F(math.cos(k * float(theta))), F(math.sin(k * float(theta)))
                    ri, rj = F(F(-oi * c) + F(oj * s)), F(F(-oi * s) - F(oj * c))
                    since = 0
                now[i], now[j] = F(ci + ri), F(cj + rj)
                now[across] = F(now[across] + rise)
                self.go(now, text)
        self.go(target, text)

    def go(self, target: list[np.float32], text: str) -> None:
        if self.travel is not None:
            for axis, value, (low, high) in zip("XYZ", target, self.travel, strict=True):
                if value > F(high) or value < F(low):
                    raise Refused(f"ALARM:2 at {axis}{value}: {text}")
        self.points.append(tuple(float(value) for value in target))
        self.sources.append(self.lines)
        self.feeds.append(math.nan if self.motion == 0 else self.feed)


def replayed(texts: list[str], **board: object) -> Replay:
    """Return the board after all lines."""
    replay = Replay(**board)  # type: ignore[arg-type]
    for text in texts:
        replay.read(text)
    return replay


@njit(cache=True)
def _free(p, a, b, eps):  # type: ignore[no-untyped-def]
    """Return the part [low, high] of the segment a b within eps of p; low > high: none."""
    dd = da = aa = 0.0
    for k in range(3):
        d = b[k] - a[k]
        e = a[k] - p[k]
        dd += d * d
        da += d * e
        aa += e * e
    if dd == 0.0:
        return (0.0, 1.0) if aa <= eps * eps else (1.0, 0.0)
    root = da * da - dd * (aa - eps * eps)
    if root < 0.0:
        return 1.0, 0.0
    root = math.sqrt(root)
    return max((-da - root) / dd, 0.0), min((-da + root) / dd, 1.0)


@njit(cache=True)
def _reaches(p, q, eps):  # type: ignore[no-untyped-def]
    """Return how far along p walkers on a leash ``eps`` come; len(p) when both reach the end."""
    n, m = len(p), len(q)
    low, high = np.ones(m), np.zeros(m)
    first, last = 0, 0
    # along q with p at its start
    reach = True
    for j in range(m - 1):
        a, b = _free(p[0], q[j], q[j + 1], eps)
        if not reach or a > 0.0 or a > b:
            break
        low[j], high[j] = a, b
        last = j
        reach = b >= 1.0
    if low[0] > high[0]:
        return 0
    start_free = True
    for i in range(n - 1):
        new_first, new_last = m, -1
        below_low, below_high = 1.0, 0.0
        if first == 0 and start_free:
            a, b = _free(q[0], p[i], p[i + 1], eps)
            if a <= 0.0 and a <= b:
                below_low, below_high = a, b
                start_free = b >= 1.0
            else:
                start_free = False
        j = first
        while j < m - 1 and (j <= last or below_low <= below_high):
            left = j <= last and low[j] <= high[j]
            left_low = low[j]
            below = below_low <= below_high
            ra, rb = 1.0, 0.0
            ta, tb = 1.0, 0.0
            if left or below:
                ra, rb = _free(p[i + 1], q[j], q[j + 1], eps)
                ta, tb = _free(q[j + 1], p[i], p[i + 1], eps)
                if not below:
                    ra = max(ra, left_low)
                if not left:
                    ta = max(ta, below_low)
            low[j], high[j] = ra, rb
            if ra <= rb:
                new_first = min(new_first, j)
                new_last = j
            below_low, below_high = ta, tb
            j += 1
        if new_last < 0:
            return i + 1
        for k in range(first, min(new_first, m)):
            low[k], high[k] = 1.0, 0.0
        first, last = new_first, new_last
    if last == m - 2 and high[m - 2] >= 1.0 and low[m - 2] <= high[m - 2]:
        return n
    return n - 1


def _ended(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, np.float64)
    return np.concatenate((points, points[-1:])) if len(points) == 1 else points


def same_motion(one: np.ndarray, other: np.ndarray, leash: float) -> bool:
    """Return whether the Frechet distance of two polylines (k, 3) is at most ``leash``."""
    p, q = _ended(one), _ended(other)
    return bool(np.linalg.norm(p[-1] - q[-1]) <= leash and _reaches(p, q, leash) == len(p))


def parted_at(one: np.ndarray, other: np.ndarray, leash: float) -> np.ndarray:
    """Return the first point of ``one`` that can't be passed."""
    p = _ended(one)
    return p[min(_reaches(p, _ended(other), leash), len(p) - 1)]


def leash_of(one: np.ndarray, other: np.ndarray, most: float = 10.0) -> float:
    """Return the Frechet distance, rounded up to a hundredth of a micrometre."""
    low, high = 0.0, most
    if not same_motion(one, other, most):
        return math.inf
    while high - low > 1e-5:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if same_motion(one, other, middle) else (middle, high)
    return high
