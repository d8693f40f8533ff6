"""The motors of an axis: one, or several that move it together, as in a gantry."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, FiniteFloat, WithJsonSchema

from cnc.machine.section import Section, as_tuple

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
