"""Orders of measurements: what is measured and how, for the terminal and for the console.

An order makes its procedure from the axes where they stand. It is plain data, so it can be sent to
the process that operates the machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cnc.measure import probing, procedures, ringing
from cnc.measure.probing import Face
from cnc.measure.procedures import Procedure, Scale, wrong_option
from cnc.model.diagnostics import Diagnostic, UsageError, printable

PAIRS = ("xy", "xz", "yz")


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchProbe:
    """The touch probe in place of a gauge.

    Attributes:
        touch: The axis and the direction of the touches, such as ``Y-``; "" where the lengths of
            a square say so.
        reach: Longest way to a face, mm.
        contacts: Contacts of a place.
    """

    touch: str = ""
    reach: float = 10.0
    contacts: int = 5

    def face(self, example: str = "") -> tuple[str, Face]:
        """Return the axis of the touches, and how they are made.

        Args:
            example: An example for the direction; "" where there is none to give.

        Raises:
            UsageError: ``measure-option``.
        """
        text = self.touch
        if not example:
            return "", Face(1, self.reach, self.contacts)
        if len(text) != 2 or text[1] not in "+-":
            message = f"{printable(text)!r} is no direction of a touch"
            hint = f"name the axis and its direction, such as --touch {example}"
            raise wrong_option(message, hint)
        return text[0].lower(), Face(1 if text[1] == "+" else -1, self.reach, self.contacts)


@dataclass(frozen=True, slots=True, kw_only=True)
class Backlash:
    """Order of the play of a nut.

    Attributes:
        axis: The axis.
        reverse: The way back beside a gauge, mm.
        repeats: Reversals.
        probe: The probe at a slanted face; None for a gauge.
    """

    axis: str
    reverse: float = 0.5
    repeats: int = 3
    probe: TouchProbe | None = None
    needs_home = False

    @property
    def letters(self) -> tuple[str, ...]:
        """The axes that move, that which is measured first. UsageError ``measure-option``."""
        if self.probe is None:
            return (self.axis.lower(),)
        return self.axis.lower(), self.probe.face("Y-")[0]

    def begin(self, scales: Sequence[Scale]) -> Procedure:
        """Return the procedure for the axes ``letters``."""
        if self.probe is None:
            return procedures.backlash(scales[0], reverse=self.reverse, repeats=self.repeats)
        face = self.probe.face("Y-")[1]
        return probing.backlash(scales[0], scales[1], face, repeats=self.repeats)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pitch:
    """Order of the errors of a screw.

    Attributes:
        axis: The axis.
        first: The lowest place of a scale, mm.
        last: The highest place, mm.
        places: Number of the places.
        both: Whether the axis comes to each place from above too.
        faces: Distances of the faces for the probe from the first one, mm.
        lift: Way of the probe over a face, mm.
        blocks: Whether the probe waits at each face until the row of blocks is changed.
        probe: The probe at faces; None for a scale.
    """

    axis: str
    first: float | None = None
    last: float | None = None
    places: int = 11
    both: bool = False
    faces: tuple[float, ...] = ()
    lift: float = 20.0
    blocks: bool = False
    probe: TouchProbe | None = None
    needs_home = True

    @property
    def letters(self) -> tuple[str, ...]:
        """The axes that move, that which is measured first. UsageError ``measure-option``."""
        letter, name = self.axis.lower(), self.axis.upper()
        if self.probe is None:
            if self.first is None or self.last is None:
                raise wrong_option(
                    "the places are not given", "such as --first 0 --last 300 --places 31"
                )
            return (letter,)
        touching = self.probe.face(f"{name}-")[0]
        if touching != letter:
            message = f"the faces are touched along {name}, not along {touching.upper()}"
            raise wrong_option(message, f"--touch {name}- or {name}+")
        return letter, "y" if letter == "z" else "z"

    def begin(self, scales: Sequence[Scale]) -> Procedure:
        """Return the procedure for the axes ``letters``."""
        if self.probe is None:
            assert self.first is not None
            assert self.last is not None
            return procedures.pitch(
                scales[0], first=self.first, last=self.last, places=self.places, both=self.both
            )
        face = self.probe.face("X-")[1]
        return probing.pitch(
            scales[0], scales[1], face, faces=self.faces, lift=self.lift, blocks=self.blocks
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Square:
    """Order of the angle between two axes.

    Attributes:
        axes: The axes, such as XY.
        lengths: Ways along the legs of the square, mm, with their signs.
        points_to_plus: Whether the plunger of the gauge points to plus.
        turned: Whether the square is turned over.
        outside: Whether the probe touches the outer faces.
        probe: The probe; None for a gauge.
    """

    axes: str
    lengths: tuple[float, float]
    points_to_plus: bool = True
    turned: bool = True
    outside: bool = False
    probe: TouchProbe | None = None
    needs_home = False

    @property
    def letters(self) -> tuple[str, ...]:
        """The two axes. UsageError ``measure-axis``."""
        if self.axes.lower() not in PAIRS:
            message = f"{printable(self.axes)} is no pair of axes"
            raise UsageError(Diagnostic("measure-axis", message, hint="the pairs are XY, XZ, YZ"))
        return tuple(self.axes.lower())

    def begin(self, scales: Sequence[Scale]) -> Procedure:
        """Return the procedure for the axes ``letters``."""
        pair = scales[0], scales[1]
        if self.probe is None:
            return procedures.square(
                pair,
                lengths=self.lengths,
                points_to_plus=self.points_to_plus,
                turned=self.turned,
            )
        return probing.square(
            pair,
            self.probe.face()[1],
            lengths=self.lengths,
            outside=self.outside,
            turned=self.turned,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Ringing:
    """Order of the modes that short quick moves of an axis excite.

    Attributes:
        axis: The axis.
    """

    axis: str
    needs_home = False
    probe: None = None

    @property
    def letters(self) -> tuple[str, ...]:
        """The axis."""
        return (self.axis.lower(),)

    def begin(self, scales: Sequence[Scale]) -> Procedure:
        """Return the procedure for the axis."""
        return ringing.shaken(scales[0])


Order = Backlash | Pitch | Ringing | Square
