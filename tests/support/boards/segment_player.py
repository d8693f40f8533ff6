"""A player of segments by docs/explanation/segments.md, in whole numbers and without kernels."""

from __future__ import annotations

Move = tuple[int, int, int]
"""Tick, axes that step, axes that step down."""


def moves(data: bytes) -> list[Move]:
    played: list[Move] = []
    clock, at = 0, 0
    while at < len(data):
        slots, form, down = data[at], data[at + 1] & 3, data[at + 1] >> 4
        if form == 3:
            for k in range(slots):
                word = int.from_bytes(data[at + 2 + 2 * k : at + 4 + 2 * k], "little")
                clock += (word & 0xFFF) << 8
                played.append((clock >> 8, word >> 12, down & word >> 12))
            at += 2 + 2 * slots
            continue
        interval = int.from_bytes(data[at + 2 : at + 5], "little")
        add = int.from_bytes(data[at + 5 : at + 7], "little", signed=True)
        if form == 2:
            masks = [data[at + 7 + k // 2] >> 4 * (k % 2) & 15 for k in range(slots)]
            phases: list[list[int]] = []
            at += 7 + (slots + 1) // 2
        else:
            masks = [data[at + 7] & 15] * slots
            axes = [i for i in range(4) if data[at + 7] >> 4 + i & 1]
            at += 8
            phases = []
            for axis in axes:
                phase, period = (
                    int.from_bytes(data[at + k : at + k + 3], "little") for k in (0, 3)
                )
                phases.append(
                    [
                        1 << axis,
                        phase,
                        period,
                        int.from_bytes(data[at + 6 : at + 8], "little", signed=True),
                    ]
                )
                at += 8
        for mask in masks:
            begin = clock >> 8
            clock += interval
            interval += add
            end = clock >> 8
            steps: dict[int, int] = {}
            for phase in phases:
                if phase[1] < 0x10000:
                    when = begin + (phase[1] * (end - begin) + 0x8000 >> 16) if form == 1 else end
                    when = end if end - when <= 1 else when
                    near = [tick for tick in steps if tick < end and abs(tick - when) <= 1]
                    if near and when < end:
                        both = steps.pop(near[0])
                        when = min(when, near[0])
                        steps[when] = both
                    steps[when] = steps.get(when, 0) | phase[0]
                    phase[1] += phase[2]
                    phase[2] += phase[3]
                phase[1] -= 0x10000
            if mask:
                steps[end] = steps.get(end, 0) | mask
            played += [
                (tick, axes_mask, down & axes_mask) for tick, axes_mask in sorted(steps.items())
            ]
    return played
