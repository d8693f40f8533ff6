"""States of the machine that a block sets and that last, such as the spindle."""

from __future__ import annotations

from typing import NamedTuple

from cnc.model.blocks import (
    AnalogOutput,
    Block,
    Coolant,
    DigitalOutput,
    Overrides,
    PathMode,
    Spindle,
)


class Diverted(NamedTuple):
    """What a buffer had before its blocks were kept back."""

    ready: list[Block]
    in_effect: dict[tuple[str, int], tuple[object, ...]]
    turning: str


def lasting_state(block: Block) -> tuple[tuple[str, int], tuple[object, ...]] | None:
    """Return what a block sets, and its values; None for a block that sets nothing lasting."""
    match block:
        case Spindle(state=state, rpm=rpm, surface_speed=speed):
            return ("spindle", 0), (state, rpm, speed)
        case Coolant(mist=mist, flood=flood):
            return ("coolant", 0), (mist, flood)
        case Overrides(feed=feed, spindle=spindle, adaptive_feed=adaptive, feed_stop=stop):
            return ("overrides", 0), (feed, spindle, adaptive, stop)
        case PathMode(control=control, tolerance=tolerance):
            return ("path", 0), (control, tolerance)
        case DigitalOutput(number=number, on=on):
            return ("digital", number), (on,)
        case AnalogOutput(number=number, value=value):
            return ("analog", number), (value,)
    return None
