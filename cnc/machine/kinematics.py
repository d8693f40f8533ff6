"""The table [kinematics]: how the joints move the tool tip."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, Field, FiniteFloat, field_validator
from pydantic import ValidationInfo as Info

from cnc.machine.section import Section
from cnc.model.blocks import AxisLetter

OF_TIP = ("travel", "homing")
"""Keys of an axis that joints move: they are about the place of the tip."""

LONGEST = 1e6
"""mm; longer than any machine: such a length is a mistake of the unit."""
APART = 1.0
"""Degrees; towers that are nearer to each other leave the tip free to tip over."""

Length = Annotated[FiniteFloat, Field(gt=0, le=LONGEST)]
Coordinate = Annotated[FiniteFloat, Field(ge=-LONGEST, le=LONGEST)]


def _tuple(value: object) -> object:
    """Return a TOML array as a tuple, because the frozen models hold tuples."""
    return tuple(value) if isinstance(value, list) else value


Pair = Annotated[tuple[Length, Length], BeforeValidator(_tuple)]


def _different(angles: tuple[float, float, float]) -> tuple[float, float, float]:
    """Refuse angles of which two are the same direction."""
    for k, angle in enumerate(angles):
        between = (angle - angles[k - 1]) % 360.0
        if min(between, 360.0 - between) < APART:
            raise ValueError("must be three different directions")
    return angles


Angles = Annotated[
    tuple[FiniteFloat, FiniteFloat, FiniteFloat],
    BeforeValidator(_tuple),
    AfterValidator(_different),
]
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], BeforeValidator(_tuple)]


class _Kinematics(Section):
    """A kinematics; its joints have tables [joints.NAME] in place of some axes' limits."""

    moved: ClassVar[tuple[AxisLetter, ...]] = ()
    """Axes that no motor moves alone."""
    movers: ClassVar[tuple[str, ...]] = ()
    """The joints that move them."""
    with_tip_control: ClassVar[bool] = False
    """Whether the axes are the joints until a program switches tool-tip control on."""

    @property
    def axes(self) -> tuple[AxisLetter, ...]:
        """Axes that no motor moves alone."""
        return self.moved

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that move them."""
        return self.movers

    @classmethod
    def moved_in(cls, table: Mapping[str, object]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the axes and the joints of a table that is not validated yet."""
        return cls.moved, cls.movers

    @classmethod
    def kinds(cls) -> tuple[str, ...]:
        """Return the values of ``type`` for this kinematics."""
        return get_args(cls.model_fields["type"].annotation)


class Cartesian(_Kinematics):
    """Each axis is a joint."""

    type: Literal["cartesian"] = Field(default="cartesian", description="Each axis has its motor.")


class OfJoints(_Kinematics):
    """The machine behind the kinematics: its axes are the joints. No file can name it."""

    type: Literal["joints"] = "joints"


class CoreXY(_Kinematics):
    """Two motors move X and Y through belts."""

    moved = ("x", "y")
    movers = ("a", "b")

    type: Literal["corexy", "hbot"] = Field(description="Joints a = X + Y and b = X - Y.")


class CoreXZ(_Kinematics):
    """Two motors move X and Z through belts."""

    moved = ("x", "z")
    movers = ("a", "b")

    type: Literal["corexz"] = Field(description="Joints a = X + Z and b = X - Z.")


class Polar(_Kinematics):
    """A turntable under a radial axis."""

    moved = ("x", "y")
    movers = ("r", "c")

    type: Literal["polar"] = Field(description="Joints r (radius, mm) and c (angle, degrees).")


class Scara(_Kinematics):
    """Two arms that turn in a plane."""

    moved = ("x", "y")
    movers = ("a", "b")

    type: Literal["scara"] = Field(description="Joints a (shoulder) and b (elbow), degrees.")
    arms: Pair = Field(description="Lengths of the first and of the second arm, mm.")
    elbow: Literal["left", "right"] = Field(
        default="left", description="Side of the first arm on which the tip lies."
    )


class Delta(_Kinematics):
    """Three carriages on vertical towers hold the tip by rods."""

    moved = ("x", "y", "z")
    movers = ("a", "b", "c")

    type: Literal["delta"] = Field(description="Joints a, b and c: heights of the carriages, mm.")
    radius: Length = Field(
        description=(
            "Distance of the towers from the centre, less that of the rods' ends from the tip, mm."
        )
    )
    rod: Length = Field(description="Length of the rods, mm.")
    angles: Angles = Field(
        default=(210.0, 330.0, 90.0), description="Angles of the towers, degrees from X."
    )

    @field_validator("rod")
    @classmethod
    def _reaches_the_centre(cls, rod: float, info: Info) -> float:
        """Refuse rods that reach no tip at all: the centre is nearest to all towers."""
        if rod <= info.data.get("radius", 0.0):
            raise ValueError("must be longer than radius: the rods do not reach the centre")
        return rod


class RotaryDelta(_Kinematics):
    """Three arms that turn hold the tip by rods."""

    moved = ("x", "y", "z")
    movers = ("a", "b", "c")

    type: Literal["rotary-delta"] = Field(
        description="Joints a, b and c: angles of the arms below the level, degrees."
    )
    base: Length = Field(description="Distance of the arms' axes from the centre, mm.")
    platform: Length = Field(description="Distance of the rods' ends from the tip, mm.")
    arm: Length = Field(description="Length of the upper arms, mm.")
    rod: Length = Field(description="Length of the rods, mm.")
    angles: Angles = Field(
        default=(210.0, 330.0, 90.0), description="Angles of the arms, degrees from X."
    )

    @field_validator("rod")
    @classmethod
    def _reaches_the_centre(cls, rod: float, info: Info) -> float:
        """Refuse rods that no position of the arms brings to the centre."""
        known = info.data
        if {"base", "platform", "arm"} <= known.keys():
            least = abs(known["base"] - known["platform"]) - known["arm"]
            if rod <= least:
                raise ValueError(f"must be longer than {least:g}: the rods do not reach the centre")
        return rod


class FiveAxis(_Kinematics):
    """Three linear axes, an axis that tilts (A or B) and one that turns (C)."""

    with_tip_control = True

    type: Literal[
        "xyzac", "xyzbc", "xyzac-head", "xyzbc-head", "xyzac-head-table", "xyzbc-head-table"
    ] = Field(
        description=(
            "A or B, and C: both on the table (a trunnion), both in the head, or A or B in the "
            "head and C on the table."
        )
    )
    tilt_point: Point = Field(
        default=(0.0, 0.0, 0.0),
        description=(
            "A point of the axis of A or B, mm: machine coordinates on a table, from the gauge "
            "point of the spindle in a head."
        ),
    )
    turn_point: Point = Field(
        default=(0.0, 0.0, 0.0),
        description="A point of the axis of C, mm, as for tilt_point; at zero angles.",
    )
    reverse: Annotated[tuple[Literal["a", "b", "c"], ...], BeforeValidator(_tuple)] = Field(
        default=(),
        description="Rotary axes that turn against the direction of ISO 841.",
    )

    @property
    def tilting(self) -> AxisLetter:
        """The axis that tilts."""
        return "a" if self.type.startswith("xyzac") else "b"

    @property
    def tip_axes(self) -> tuple[AxisLetter, ...]:
        """The axes of tool-tip control."""
        return ("x", "y", "z", self.tilting, "c")


class Cylinder(_Kinematics):
    """A rotary axis in the place of X or Y: the drawing is wrapped on a cylinder."""

    movers = ("a",)

    type: Literal["cylinder"] = Field(
        description="Joint a (degrees) moves X or Y along the circumference of a cylinder."
    )
    wrapped: Literal["x", "y"] = Field(
        default="y", description="Axis that becomes the circumference."
    )
    radius: Annotated[Length, Field(gt=0.01)] = Field(
        description="Radius of the cylinder on which Z is 0, mm."
    )

    @property
    def axes(self) -> tuple[AxisLetter, ...]:
        """Axes that no motor moves alone."""
        return (self.wrapped,)

    @classmethod
    def moved_in(cls, table: Mapping[str, object]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the axes and the joints of a table that is not validated yet."""
        return (str(table.get("wrapped", "y")),), cls.movers


class Custom(_Kinematics):
    """A kinematics of the user: a class that an installed package registers."""

    type: Literal["custom"] = Field(
        description="A class of the entry point group cnc.kinematics, of an installed package."
    )
    name: str = Field(description="Name of the entry point.")
    of_axes: Annotated[tuple[AxisLetter, ...], BeforeValidator(_tuple), Field(min_length=1)] = (
        Field(description="Axes that the kinematics moves, in the order of its formulas.")
    )
    of_joints: Annotated[tuple[str, ...], BeforeValidator(_tuple), Field(min_length=1)] = Field(
        description="Names of its joints, each with a table [joints.NAME]."
    )
    parameters: dict[str, FiniteFloat] = Field(
        default={}, description="Numbers that the class takes by name, such as lengths."
    )

    @property
    def axes(self) -> tuple[AxisLetter, ...]:
        """Axes that no motor moves alone."""
        return self.of_axes

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that move them."""
        return self.of_joints

    @classmethod
    def moved_in(cls, table: Mapping[str, object]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the axes and the joints of a table that is not validated yet."""
        each = (table.get("of_axes"), table.get("of_joints"))
        axes, joints = (tuple(map(str, names)) if isinstance(names, list) else () for names in each)
        return axes, joints


KinematicsTable = Annotated[
    Cartesian
    | CoreXY
    | CoreXZ
    | Polar
    | Scara
    | Delta
    | RotaryDelta
    | FiveAxis
    | Cylinder
    | Custom,
    Field(discriminator="type"),
]
KINEMATICS: tuple[type[_Kinematics], ...] = get_args(get_args(KinematicsTable)[0])
