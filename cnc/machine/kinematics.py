"""The table [kinematics]: how the joints move the tool tip."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import Annotated, Literal, get_args

from pydantic import BeforeValidator, Field, FiniteFloat

from cnc.kinematics.base import Kinematics, Table
from cnc.kinematics.delta import Delta, RotaryDelta
from cnc.kinematics.five_axis import FiveAxis
from cnc.kinematics.planar import CoreXY, CoreXZ, Cylinder, Polar, Scara
from cnc.model.blocks import AxisLetter
from cnc.model.diagnostics import Diagnostic, MachineFileError
from cnc.model.section import as_tuple

OF_TIP = ("travel", "homing")
"""Keys of an axis that joints move: they are about the place of the tip."""
GROUP = "cnc.kinematics"
"""Group of the entry points of kinematics."""


class Cartesian(Table):
    """Each axis is a joint."""

    type: Literal["cartesian"] = Field(default="cartesian", description="Each axis has its motor.")


class OfJoints(Table):
    """The machine behind the kinematics: its axes are the joints. No file can name it."""

    type: Literal["joints"] = "joints"


class Custom(Table):
    """A kinematics of the user: a class that an installed package registers."""

    type: Literal["custom"] = Field(
        description="A class of the entry point group cnc.kinematics, of an installed package."
    )
    name: str = Field(description="Name of the entry point.")
    of_axes: Annotated[tuple[AxisLetter, ...], BeforeValidator(as_tuple), Field(min_length=1)] = (
        Field(description="Axes that the kinematics moves, in the order of its formulas.")
    )
    of_joints: Annotated[tuple[str, ...], BeforeValidator(as_tuple), Field(min_length=1)] = Field(
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
        lists = (table.get("of_axes"), table.get("of_joints"))
        axes, joints = (
            tuple(map(str, names)) if isinstance(names, list) else () for names in lists
        )
        return axes, joints

    def formulas(self) -> Kinematics:
        """Return the formulas of the class that an installed package registers.

        Raises:
            MachineFileError: ``kinematics-unknown``, ``kinematics-parameters``.
        """
        entries = {point.name: point for point in entry_points(group=GROUP)}
        entry = entries.get(self.name)
        if entry is None:
            names = ", ".join(sorted(entries)) or "none"
            message = f"no installed package has the kinematics {self.name!r}"
            hint = f"registered in the entry point group {GROUP}: {names}"
            raise MachineFileError(Diagnostic("kinematics-unknown", message, hint=hint))
        try:
            kinematics = entry.load()(**self.parameters)
        except Exception as error:  # the code of a user may raise anything
            message = f"the kinematics {self.name!r} does not take its parameters: {error}"
            hint = "correct [kinematics] parameters in the machine file, or the class"
            raise MachineFileError(
                Diagnostic("kinematics-parameters", message, hint=hint)
            ) from None
        if not isinstance(kinematics, Kinematics) or len(kinematics.turning) != len(self.of_joints):
            message = f"{self.name!r} is not a Kinematics with {len(self.of_joints)} joints"
            hint = "derive the class from cnc.kinematics.base.Kinematics, with its own turning"
            raise MachineFileError(Diagnostic("kinematics-parameters", message, hint=hint))
        return kinematics


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
KINEMATICS: tuple[type[Table], ...] = get_args(get_args(KinematicsTable)[0])
