"""Modes of a machine that rings: frequency and damping, from an accelerometer's record.

The record has free decays: the machine was tapped, or an axis made short quick moves with rests.
All decays of a machine have the same modes, with other amplitudes:

    a(t) = sum of A_k exp(-d_k w_k t) cos(w_k sqrt(1 - d_k^2) t + p_k)

The samples of a decay obey one linear recursion. Its roots are found by ESPRIT (R. Roy, T. Kailath,
ESPRIT, IEEE Trans. ASSP 37, 1989): windows of all decays span a space that is the same one sample
later, but for a factor exp(s dt) for each root s.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import Accelerations
from cnc.measure.procedures import AxisMode, Measured, Procedure, Scale, Shake
from cnc.model.diagnostics import Diagnostic, UsageError

Floats = NDArray[np.float64]

MOST_DAMPING = 0.5
"""Highest damping ratio that the machine file takes."""
Roots = NDArray[np.complex128]

LOWEST = 5.0
"""Hz; slower motion is that of the axis, not of the frame."""
HIGHEST = 0.4
"""Part of the sample rate; above it a mode has less than 2.5 samples a period."""
MOST_DAMPING = 0.3
"""A mode that decays faster does not ring."""
LEAST_SHARE = 0.02
"""Part of the energy of a record below which a mode is noise."""
WINDOW = 0.04
"""s; the energy of a record is that of windows of this length."""
QUIET = 0.01
"""Part of the largest energy at which a decay ends."""
STRONG = 0.1
"""Part of the largest energy with which a decay begins at least."""
APART = 0.1
"""s; least time between two blows."""
AGAIN = 8.0
"""Rise of the energy that is another blow."""
SHORTEST = 0.08
"""s; a shorter decay is none."""
LONGEST = 0.6
"""s; of a longer decay the rest is noise."""
ITERATIONS, DIFFERENCE = 8, 1e-6
"""Of the last search, and the relative change of a root for its slopes."""
ORDER = 12
"""Roots that are sought: two for a mode, the others take up noise."""
ROWS = 160
"""Most samples of a window of the recursion."""
LEAST_RATE, MOST_SAMPLES = 100.0, 2_000_000
"""Samples a second, and in a record."""
JITTER = 0.5
"""Part of the mean time between two samples by which one may differ."""
WAYS, REST = (0.8, 1.3, 2.1, 3.4, 5.5), 0.7
"""Ways there and back, mm, and the rests between them, s. The ways differ, since a move whose
phases last whole periods of a mode does not excite it."""
ENOUGH = 800.0
"""Samples a second to which a faster record is averaged: less noise."""
_LETTER = re.compile(r"(?:^|[^a-z])(?:a|acc(?:el(?:eration)?)?)?[ _]?([xyz])(?:$|[^a-z])")


class Mode(NamedTuple):
    """A mode.

    Attributes:
        frequency: Hz, undamped.
        damping: Part of the critical damping.
        share: Its part of the energy of the decays.
    """

    frequency: float
    damping: float
    share: float


def read_record(file: Path) -> Accelerations:
    """Return the record of a csv file: a column of times, s, and columns of accelerations.

    Separators may be commas, semicolons or tabs. A heading names the columns (``ax``, ``accel_y``,
    ``Acceleration z (m/s^2)``); a time in ms has ``ms`` in its name.

    Raises:
        UsageError: ``can-not-read``, ``record-form``.
    """
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise UsageError(
            Diagnostic("can-not-read", f"{file} cannot be read: {reason}", hint="check the name")
        ) from error
    return record_of(text, file.name)


def record_of(text: str, name: str) -> Accelerations:
    """Return the record of the text of a csv file, see :func:`read_record`.

    Args:
        text: The text.
        name: Name of the file.

    Raises:
        UsageError: ``record-form``.
    """
    rows: list[list[float]] = []
    heading: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        separator = next((mark for mark in "\t;," if mark in line), ",")
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
        try:
            rows.append([float(cell) for cell in cells if cell])
        except ValueError:
            if rows:
                raise _form(f"line {number} of {name} has no numbers") from None
            heading = [cell.lstrip("#").strip().lower() for cell in cells]
        if len(rows) > MOST_SAMPLES:
            raise _form(f"{name} has more than {MOST_SAMPLES} samples")
    rows = [row for row in rows if row]
    if len(rows) < 2 or len(rows[0]) < 2 or any(len(row) != len(rows[0]) for row in rows):
        raise _form(f"{name} is not a table of times and accelerations")
    table = np.array(rows)
    time = table[:, 0] * (1e-3 if heading and re.search(r"\bms\b", heading[0]) else 1.0)
    steps = np.diff(time)
    if not np.isfinite(table).all() or steps.min() <= 0.0:
        raise _form(f"the times of {name} do not rise")
    mean = float(steps.mean())
    if 1.0 / mean < LEAST_RATE:
        raise _form(f"{name} has {1.0 / mean:.0f} samples a second, fewer than {LEAST_RATE:g}")
    if np.abs(steps - mean).max() > max(JITTER, 2.0 * mean) * mean and steps.max() > 4.0 * mean:
        raise _form(f"{name} has gaps: {steps.max():.4f} s between two samples")
    even = time[0] + mean * np.arange(len(time))
    columns: dict[str, Floats] = {}
    for column in range(1, table.shape[1]):
        match = _LETTER.search(heading[column]) if column < len(heading) else None
        letter = match[1] if match else "xyz"[column - 1] if column < 4 else str(column)
        columns.setdefault(letter, np.interp(even, time, table[:, column]))
    return Accelerations(1.0 / mean, columns)


def shaken(scale: Scale) -> Procedure:
    """Measure the modes that short quick moves of an axis excite, with the board's accelerometer.

    Args:
        scale: The axis.

    Raises:
        UsageError: ``measure-travel``, ``record-form`` where nothing rings out.
    """
    upwards = scale.travel[1] - scale.place >= max(WAYS)
    ways = tuple(scale.whole(way if upwards else -way) for way in WAYS)
    scale.check(*(scale.place + way for way in ways))
    record = yield Shake(scale.letter, ways, REST)
    samples, rate = rests(record, scale.letter)
    method = f"{len(ways)} moves there and back, {record.rate:.0f} samples a second"
    return of_columns({scale.letter: samples}, rate, method)


def of_record(record: Accelerations, name: str) -> Measured:
    """Return the modes of a record. UsageError ``record-form`` where nothing rings out."""
    method = f"{name}, {record.rate:.0f} samples a second"
    return of_columns(record.columns, record.rate, method)


def of_columns(columns: Mapping[str, Floats], rate: float, method: str) -> Measured:
    """Return the modes of the samples of each axis, and the keys of the machine file for them."""
    listed = tuple(
        AxisMode(letter, *mode)
        for letter, samples in columns.items()
        for mode in modes(samples, rate)
    )
    keys: dict[tuple[str, ...], list[dict[str, float]]] = {}
    for mode in listed:
        damping = round(min(mode.damping, MOST_DAMPING), 4)
        row = {"frequency": round(mode.frequency, 2), "damping": damping}
        keys.setdefault(("vibration", mode.axis), []).append(row)
    texts = ", ".join(f"{mode.axis.upper()} {mode.frequency:.2f} Hz" for mode in listed)
    return Measured(f"modes along {texts}", method, (), keys, modes=listed)


def rests(record: Accelerations, letter: str) -> tuple[Floats, float]:
    """Return the samples of an axis while it rests, with silence between rests, and their rate.

    The first rest shows what the sensor reads without motion, such as gravity.
    """
    column, marks = record.columns[letter], record.marks
    count = max(int(record.rate / ENOUGH), 1)
    rate = record.rate / count
    parts = [
        column[begin : end - (end - begin) % count].reshape(-1, count).mean(axis=1)
        for begin, end in zip(marks[::2], marks[1::2], strict=True)
    ]
    silence, still = np.zeros(round(WINDOW * rate)), float(parts[0].mean())
    joined = [half for part in parts[1:] for half in (part - still, silence)]
    return np.concatenate(joined), rate


def decays(samples: Floats, rate: float) -> list[Floats]:
    """Return the parts of a record (n,) in which it rings out."""
    samples = samples - np.median(samples)
    width = max(round(WINDOW * rate), 4)
    if len(samples) < 3 * width:
        return []
    sums = np.concatenate(([0.0], np.cumsum(samples**2)))
    # Of the samples from each one on: it is largest just behind a blow.
    energy = (sums[width:] - sums[:-width]) / width
    largest = float(energy.max())
    if largest == 0.0:
        return []
    floor = max(QUIET * largest, 4.0 * float(np.quantile(energy, 0.1)))
    parts, apart = [], round(APART * rate)
    for k in range(len(energy)):
        near = energy[max(k - apart, 0) : k + apart]
        if energy[k] < STRONG * largest or energy[k] < near.max():
            continue
        # Two modes beat, so the energy may rise again by itself, but not above a blow's.
        behind = energy[k : k + round(LONGEST * rate)]
        lowest = np.minimum.accumulate(behind)
        ended = (behind < floor) | (behind > AGAIN * lowest)
        length = int(np.argmax(ended)) if ended.any() else len(behind)
        if length >= SHORTEST * rate:
            parts.append(samples[k + width // 8 : k + length])
    return parts


def modes(samples: Floats, rate: float, most: int = 2) -> list[Mode]:
    """Return the modes of a record, those with the most energy, by their frequency.

    Args:
        samples: Accelerations at an even rate (n,), in any unit.
        rate: Samples a second.
        most: Number of modes at most.

    Raises:
        UsageError: ``record-form`` where nothing rings out.
    """
    parts = decays(samples, rate)
    if not parts:
        raise _form("nothing rings out in the record")
    rows = min(ROWS, min(map(len, parts)) // 2)
    if rows <= ORDER:
        raise _form("the record has too few samples in each decay")
    total = np.zeros((rows, rows))
    for part in parts:
        windows = np.lib.stride_tricks.sliding_window_view(part / np.abs(part).max(), rows)
        total += windows.T @ windows
    _, vectors = np.linalg.eigh(total)
    space = vectors[:, -ORDER:]
    roots = np.linalg.eigvals(np.linalg.lstsq(space[:-1], space[1:], rcond=None)[0])
    s = np.log(roots[np.abs(roots) > 0.0].astype(complex)) * rate
    frequency, damping = np.abs(s) / (2.0 * math.pi), -s.real / np.abs(s)
    rings = (s.imag > 0.0) & (damping > 0.0) & (damping < MOST_DAMPING)
    rings &= (frequency > LOWEST) & (frequency < HIGHEST * rate)
    s = s[rings]
    if not len(s):
        raise _form("nothing rings in the record")
    shares = _energies(parts, s, rate)
    chosen = sorted(np.flatnonzero(shares >= LEAST_SHARE), key=lambda k: -shares[k])[:most]
    s = _closer(parts, s[chosen], rate)
    return sorted(
        Mode(float(abs(root)) / (2.0 * math.pi), float(-root.real / abs(root)), float(share))
        for root, share in zip(s, _energies(parts, s, rate), strict=True)
    )


def _closer(parts: list[Floats], s: Roots, rate: float) -> Roots:
    """Return the roots with the least squares of what is left of all decays, by Gauss and Newton.

    Only the roots are unknowns: for given roots the amplitudes are a linear problem (variable
    projection, G. Golub, V. Pereyra, SIAM J. Numer. Anal. 10, 1973).
    """
    for _ in range(ITERATIONS):
        left = _left(parts, s, rate)
        columns = []
        for k in range(len(s)):
            for direction in (1.0, 1j):
                moved = s.copy()
                moved[k] += direction * abs(s[k]) * DIFFERENCE
                columns.append((_left(parts, moved, rate) - left) / DIFFERENCE)
        change = np.linalg.lstsq(np.stack(columns, axis=1), -left, rcond=None)[0]
        step = (change[::2] + 1j * change[1::2]) * np.abs(s)
        if not np.all(np.abs(step) < 0.2 * np.abs(s)):
            break
        s = s + step
    return s


def _left(parts: list[Floats], s: Roots, rate: float) -> Floats:
    """Return what is left of all decays without waves of these roots."""
    return np.concatenate([part - sum(_waves(part, s, rate)) for part in parts])


def _waves(part: Floats, s: Roots, rate: float) -> list[Floats]:
    """Return the wave of each root in a decay, by least squares."""
    t = np.arange(len(part)) / rate
    waves = np.exp(np.outer(t, s))
    both = np.concatenate((waves.real, waves.imag), axis=1)
    amplitudes = np.linalg.lstsq(both, part, rcond=None)[0]
    return [both[:, k :: len(s)] @ amplitudes[k :: len(s)] for k in range(len(s))]


def _energies(parts: list[Floats], s: Roots, rate: float) -> Floats:
    """Return the part of each root (m,) in the energy of the decays."""
    energies, total = np.zeros(len(s)), 0.0
    for part in parts:
        energies += [float(wave @ wave) for wave in _waves(part, s, rate)]
        total += float(part @ part)
    shares: Floats = energies / total
    return shares


def _form(message: str) -> UsageError:
    hint = "record taps on the frame, or short quick moves with rests of 0.5 s, at 500 Hz or more"
    return UsageError(Diagnostic("record-form", message, hint=hint))
