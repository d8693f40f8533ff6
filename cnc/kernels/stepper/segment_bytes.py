"""Bytes of a segment, written by the encoder."""

from __future__ import annotations

from typing import NamedTuple

from cnc.kernels.jit import njit
from cnc.kernels.stepper.segments import MASKS_AT, Bytes, Ints


class Head(NamedTuple):
    """The fields of the eight bytes at the start of all forms with slots."""

    slots: int
    form: int
    backward: int
    roles: int
    interval: int
    add: int


@njit
def write_head(out: Bytes, at: int, head: Head) -> None:
    """Write the eight bytes at the start of all forms with slots."""
    out[at] = head.slots
    out[at + 1] = head.form | head.backward << 4
    write24(out, at + 2, head.interval)
    out[at + 5] = head.add & 0xFF
    out[at + 6] = head.add >> 8 & 0xFF
    out[at + 7] = head.roles


@njit
def write_masks(masks: Ints, out: Bytes) -> None:
    """Write the masks of a packed segment, two in a byte."""
    for k in range(len(masks)):
        if k & 1:
            out[MASKS_AT + k // 2] |= masks[k] << 4
        else:
            out[MASKS_AT + k // 2] = masks[k]


@njit
def write24(out: Bytes, at: int, value: int) -> None:
    """Write three bytes, the lowest first."""
    out[at] = value & 0xFF
    out[at + 1] = value >> 8 & 0xFF
    out[at + 2] = value >> 16 & 0xFF
