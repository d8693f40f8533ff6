"""The motors of an axis: one, or several that move it together, as in a gantry."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, FiniteFloat, WithJsonSchema

from cnc.model.section import Inconsistency, Section, as_tuple

MOST_MOTORS = 4


class Motor(Section):
    """One motor of an axis."""

    offset: FiniteFloat = Field(
        default=0.0,
        description=(
            "Coordinate at which its limit switch closes less that of the first motor's switch, "
            "while the gantry is square, mm."
        ),
    )
    invert: bool = Field(
        default=False,
        description="Whether its direction pin has the other level than that of the axis.",
    )


def _motors(value: Any) -> Any:
    """Return a number of motors, or a list of tables, as a tuple of tables."""
    if isinstance(value, int) and not isinstance(value, bool):
        if not 1 <= value <= MOST_MOTORS:
            raise ValueError(f"must be 1 to {MOST_MOTORS}")
        return (Motor(),) * value
    return as_tuple(value)


Motors = Annotated[
    tuple[Motor, ...],
    BeforeValidator(_motors),
    Field(min_length=1, max_length=MOST_MOTORS),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "integer", "minimum": 1, "maximum": MOST_MOTORS},
                {
                    "type": "array",
                    "items": {
                        "type": "object",
                        "properties": {
                            "offset": {"type": "number"},
                            "invert": {"type": "boolean"},
                        },
                        "additionalProperties": False,
                    },
                    "minItems": 1,
                    "maxItems": MOST_MOTORS,
                },
            ]
        }
    ),
]
"""The motors of an axis."""


def gantry_inconsistencies(
    key: tuple[str, str], motors: tuple[Motor, ...], pull_off: float
) -> Iterator[Inconsistency]:
    """Yield the contradictions between the motors of an axis and its homing.

    Args:
        key: Table of the axis.
        motors: Its motors.
        pull_off: Distance from the place of rest to the first switch, mm; negative at the low end.
    """
    if motors[0].offset:
        message = "the offset of the first motor is not 0"
        hint = "the offsets of the other motors count from its switch"
        yield Inconsistency((*key, "motors"), message, hint)
    towards = 1 if pull_off > 0 else -1
    for number, motor in enumerate(motors[1:], start=2):
        if (pull_off + motor.offset) * towards <= 0.0:
            message = (
                f"with the offset {motor.offset:g}, the switch of motor {number} is closed "
                f"{abs(pull_off):g} mm off that of motor 1, where homing ends"
            )
            hint = f"raise {'.'.join(key)}.homing.pull_off above {abs(motor.offset):g}"
            yield Inconsistency((*key, "motors"), message, hint)
