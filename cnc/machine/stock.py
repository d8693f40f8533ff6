"""The raw part as a command-line argument: ``X0:100,Y0:60,Z-12:0``."""

from __future__ import annotations

import re
from collections.abc import Mapping

from pydantic import ValidationError

from cnc.machine.consistency import inconsistencies
from cnc.machine.models import Machine, Stock
from cnc.model.diagnostics import Diagnostic, UsageError

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
_SPAN = re.compile(rf"\s*([xyz])\s*({_NUMBER})\s*:\s*({_NUMBER})\s*", re.IGNORECASE)


def with_stock(machine: Machine, text: str, zero: Mapping[str, float] | None = None) -> Machine:
    """Return the machine with the raw part that ``text`` describes.

    Args:
        machine: The machine.
        text: The raw part.
        zero: Machine position of the zero of its coordinates by axis, mm; None for machine zero.

    Raises:
        UsageError: ``stock-malformed``.
    """
    stock = _stock(text)
    if zero is not None:
        spans = {"x": stock.x, "y": stock.y, "z": stock.z}
        moved = {
            letter: (low + zero.get(letter, 0.0), high + zero.get(letter, 0.0))
            for letter, (low, high) in spans.items()
        }
        stock = stock.model_copy(update=moved)
    found = machine.model_copy(update={"stock": stock})
    for wrong in inconsistencies(found):
        raise UsageError(Diagnostic("stock-malformed", wrong.message, hint=wrong.hint))
    return found


def _stock(text: str) -> Stock:
    spans = [_SPAN.fullmatch(part) for part in text.split(",")]
    named = {span[1].lower(): (float(span[2]), float(span[3])) for span in spans if span}
    if all(spans) and len(named) == len(spans):
        try:
            return Stock.model_validate(named)
        except ValidationError:
            pass
    hint = (
        "give the lowest and highest machine coordinate of each axis in mm, "
        "such as X0:100,Y0:60,Z-12:0"
    )
    raise UsageError(
        Diagnostic("stock-malformed", f"{text!r} does not describe a cuboid", hint=hint)
    )
