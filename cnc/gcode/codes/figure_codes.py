"""Codes that change the figure: G50, G51, G50.1, G51.1, G68, G68.2, G69; and G15, G16.

Sources: FANUC Series 0i operator's manual, "Scaling (G50, G51)", "Programmable mirror image",
"Coordinate system rotation (G68, G69)", "Tilted working plane indexing (G68.2)" and "Polar
coordinate command (G15, G16)"; Haas, "Mill Operator's Manual", G51 (P is the factor itself);
"Using Mach3Mill", G15, G50, G51, G68.
"""

from __future__ import annotations

from dataclasses import replace

from cnc.gcode.codes.motion import Motion, MotionCodes
from cnc.gcode.geometry.figure import Figure
from cnc.gcode.state.modal_groups import Code, Codes
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, under_compensation
from cnc.model.blocks import PLANE_AXES

SMALLEST_FACTOR = 1e-6
_FACTORS = {"I": "X", "J": "Y", "K": "Z"}
_GROUPS = ("figure-polar", "figure-scaling", "figure-mirror", "figure-rotation")


def check_rotary_axes_at_zero(motion: Motion, at: Word) -> None:
    """Refuse a code of the tilted plane while a rotary axis is turned, as it may turn it back."""
    if any(motion.position[column] for column in motion.rotary_columns):
        message = f"{at.written} while a rotary axis is not at 0"
        raise fault("code-not-supported", message, at, "turn the rotary axes to 0 before")


class FigureCodes(MotionCodes):
    """Execution of these codes."""

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)

    def execute(self, words: LineWords, codes: Codes) -> None:
        """Execute the codes of a line, before its move."""
        for group in _GROUPS:
            if code := codes.get(group):
                self._execute(words, code)
        polar, plane = self._motion.polar.plane, codes.get("plane")
        if polar is not None and plane and self._plane(plane.word) != polar:
            message = f"{plane.word.written} under G16 of another plane"
            raise fault("polar-active", message, plane.word, "give G15 before")

    def _execute(self, words: LineWords, code: Code) -> None:
        at, figure = code.word, self._coordinates.figure
        if self._motion.compensated:
            raise under_compensation(at)
        match code.number:
            case G.G15:
                self._motion.polar.end()
            case G.G16:
                program = self._coordinates.to_program(self._motion.position)
                self._motion.polar.begin(
                    self._plane(at), program, at, from_here=self._dialect.figures == "mach3"
                )
            case G.G50:
                if self._state.scaled:
                    self._set(Figure.none(len(figure.factors)))
                self._state.scaled = False
            case G.G51:
                self._scale(words, at)
            case G.G50_1 | G.G51_1:
                self._mirror(words, code)
            case G.G68:
                self._rotate(words, at)
            case G.G68_2:
                self._place(words, at)
            case _:
                if figure.plane is not None:
                    self._set(Figure.none(len(figure.factors)))

    def _set(self, figure: Figure) -> None:
        self._coordinates.figure = figure

    def _plane(self, at: Word) -> tuple[int, int]:
        return self._motion.arcs.plane_columns(at, at.written)

    def _check_alone(self, at: Word) -> None:
        """Refuse a change inside another one: the controllers apply them in different orders."""
        figure = self._coordinates.figure
        if not figure.changes and not self._coordinates.rotation:
            return
        if self._coordinates.rotation:
            message = f"{at.written} in a rotated coordinate system (R of G10 L2)"
            hint = "use a coordinate system without R"
        else:
            now, end = (
                ("G68", "G69")
                if figure.plane is not None
                else ("G51", "G50")
                if self._state.scaled
                else ("G51.1", "G50.1")
            )
            message, hint = f"{at.written} under {now}", f"give {end} before"
        raise fault("figure-active", message, at, hint)

    # Scaling and mirroring

    def _scale(self, words: LineWords, at: Word) -> None:
        """G51 X Y Z P, or I J K for each axis. X Y Z is the centre, the position by default."""
        motion = self._motion
        if self._dialect.figures == "mach3":
            self._scale_axes(words, at)
            return
        self._check_alone(at)
        here = self._coordinates.to_program(motion.position)
        centre = motion.axis_values(words, "G51")
        factors = [1.0] * len(here)
        common = words.take("P", "G51")
        each = {letter: word for letter in _FACTORS if (word := words.take(letter, "G51"))}
        if (common is None) == (not each):
            message = f"{at.written} needs P, or I, J and K: the factor"
            raise fault("scaling-factor", message, at, "such as G51 X0 Y0 Z0 P0.5")
        for letter, axis in _FACTORS.items():
            column = motion.column.get(axis)
            word = common or each.get(letter)
            if column is not None and word is not None:
                factors[column] = self._factor(word)
        fixed = tuple(centre.get(index, value) for index, value in enumerate(here))
        self._set(Figure(tuple(factors), fixed))
        self._state.scaled = True

    def _scale_axes(self, words: LineWords, at: Word) -> None:
        """G51 of Mach3: axis words are factors about the zero; other axes keep theirs."""
        motion, figure = self._motion, self._coordinates.figure
        if not self._state.scaled:
            self._check_alone(at)
        factors = list(figure.factors)
        given = [
            (column, word)
            for letter, column in motion.column.items()
            if (word := words.take(letter, "G51")) is not None
        ]
        if not given:
            message = f"{at.written} needs axis words: the factors"
            raise fault("scaling-factor", message, at, "such as G51 X2 Y2")
        for column, word in given:
            if abs(word.number) < SMALLEST_FACTOR:
                raise fault("scaling-factor", f"{word.written}: the factor must not be 0", word)
            factors[column] = word.number
        self._set(Figure(tuple(factors), Figure.none(len(factors)).fixed))
        self._state.scaled = True

    def _factor(self, word: Word) -> float:
        """Return a factor. Without a decimal point controllers count in different units."""
        unit = 1.0 if "." in word.written else self._dialect.scale_unit
        if unit == 0.0:
            message = f"{word.written} without a decimal point is {word.number / 1000:g} for FANUC"
            hint = f"write {word.written}. or name a --dialect"
            raise fault("scaling-factor", message, word, hint)
        factor = word.number * unit
        if abs(factor) < SMALLEST_FACTOR:
            raise fault("scaling-factor", f"{word.written}: the factor must not be 0", word)
        return factor

    def _mirror(self, words: LineWords, code: Code) -> None:
        """G51.1 X: mirror about the line at X. G50.1 X ends it; without words all of them."""
        motion, figure, at = self._motion, self._coordinates.figure, code.word
        on = code.number == G.G51_1
        if figure.plane is not None or self._state.scaled or self._coordinates.rotation:
            self._check_alone(at)
        values = motion.axis_values(words, at.written)
        if on and not values:
            message = f"{at.written} needs axis words"
            raise fault("axis-words-missing", message, at, "such as G51.1 X0")
        if on and "51" not in at.written and any(values.values()):
            message = f"{at.written} mirrors about the work zero, so its numbers are 0"
            raise fault("code-not-supported", message, at, "use G51.1 for another line")
        factors, fixed = list(figure.factors), list(figure.fixed)
        for index in values or range(len(factors)):
            factors[index] = -1.0 if on else 1.0
            fixed[index] = values.get(index, 0.0) if on else 0.0
        self._set(Figure(tuple(factors), tuple(fixed)))

    # Rotation

    def _rotate(self, words: LineWords, at: Word) -> None:
        """G68: the centre by the two axes of the plane, R degrees."""
        motion, state, coordinates = self._motion, self._state, self._coordinates
        self._check_alone(at)
        if not state.absolute:
            hint = "give G90: the angle and the centre are absolute"
            raise fault("rotation-incremental", f"{at.written} under G91", at, hint)
        word = words.take("R", "G68")
        if word is None:
            if empty := next((each for each in words.vacant if each.letter == "R"), None):
                message = f"{empty.written} gives no angle: the variable is empty"
                raise fault("rotation-angle", message, empty, "set the variable before")
            raise fault("rotation-angle", f"{at.written} needs R, the angle", at, "such as R45.")
        names = PLANE_AXES[state.plane]
        plane = self._plane(at)
        here = coordinates.to_program(motion.position)
        # Mach4 names the centre by X and Y.
        if self._dialect.figures == "mach3" and words.rest.keys().isdisjoint("XY"):
            centre = self._centre_of_mach3(words, plane, at)
        else:
            centre = motion.axis_values(words, "G68")
        if other := next((index for index in centre if index not in plane), None):
            message = f"{motion.axes[other].upper()} is across the plane of the rotation"
            hint = f"its axes are {' '.join(names).upper()}"
            raise fault("axis-not-allowed", message, at, hint)
        none = Figure.none(len(here))
        turned = replace(
            none,
            plane=plane,
            centre=(centre.get(plane[0], here[plane[0]]), centre.get(plane[1], here[plane[1]])),
            angle=word.number,
        )
        self._set(turned)
        coordinates.figure_is_new = True

    def _place(self, words: LineWords, at: Word) -> None:
        """G68.2 without a tilt: X Y Z is the new zero; I and K turn the plane X Y about it.

        I, J and K are Euler angles about Z, X and Z; with J0 both others are about the same Z.
        """
        motion, coordinates = self._motion, self._coordinates
        self._check_alone(at)
        if not self._state.absolute:
            raise fault("rotation-incremental", f"{at.written} under G91", at, "give G90 before")
        first, tilt, last = (words.take(letter, "G68.2") for letter in "IJK")
        if tilt is not None and tilt.number % 360.0:
            message = f"{at.written} with {tilt.written} (a tilted plane) is not supported"
            hint = "let the CAM system write positions without a tilted plane, or G43.4"
            raise fault("code-not-supported", message, at, hint)
        check_rotary_axes_at_zero(motion, at)
        zero = motion.axis_values(words, "G68.2")
        x, y, z = (motion.column.get(axis) for axis in "XYZ")
        if x is None or y is None or not zero.keys() <= {x, y, z}:
            raise fault("axis-not-allowed", f"{at.written} has the words X Y Z I J K", at)
        none = Figure.none(len(motion.axes))
        angle = sum(word.number for word in (first, last) if word is not None)
        shift = tuple(zero.get(column, 0.0) for column in range(len(motion.axes)))
        self._set(replace(none, plane=(x, y), angle=angle, shift=shift))
        coordinates.figure_is_new = True

    def _centre_of_mach3(
        self, words: LineWords, plane: tuple[int, int], at: Word
    ) -> dict[int, float]:
        """A and B: the centre of the rotation in X and Y."""
        found = words.take("A", "G68"), words.take("B", "G68")
        if found[0] is None or found[1] is None or self._state.plane != "XY":
            hint = "such as G17 G68 A0 B0 R45"
            message = f"{at.written} needs A and B, the centre in X and Y, and the plane G17"
            raise fault("axis-words-missing", message, at, hint)
        scale = self._state.scale
        return {plane[0]: found[0].number * scale, plane[1]: found[1].number * scale}
