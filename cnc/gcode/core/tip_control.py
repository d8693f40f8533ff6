"""Tool-tip control: programs move the tip on the part while the rotary axes turn.

FANUC's G43.4 H, Haas' G234 H and SINUMERIK's TRAORI switch it on with the length of a tool; G49 and
TRAFOOF end it. Under G43.5 I, J and K of a move are the direction of the tool, under TRAORI A3=,
B3= and C3=. It turns there on a great circle, or with ORIAXES linearly. LinuxCNC's M428 and
M429 select the kinematics with the tool offset in effect. The joints do not move at the switch: the
position gets other coordinates. Source: FANUC, "Tool center point control"; LinuxCNC, "Switchable
Kinematics"; Siemens, "Job Planning", TRAORI.
"""

from __future__ import annotations

import numpy as np

from cnc.gcode.core.modal_groups import Code
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.core.tool_table import Floats, Offset
from cnc.gcode.reader.words import LineWords, M, Word, fault, under_compensation
from cnc.model.blocks import NurbsFeed, TipControl

DIRECTIONS = ("A3", "B3", "C3")
"""Words of SINUMERIK for the direction of the tool."""
DEGREE = 7
"""Of the curves of the angles along a great circle."""
POLE = 1e-4
"""Degrees from the axis of C within which a great circle is refused."""


class TipControlCodes(MotionCodes):
    """Switches tool-tip control."""

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)
        self._machine = machine = motion.context.policy.tool_tip
        self._points_missing = machine.points_missing if machine is not None else ()

    @property
    def active(self) -> bool:
        """Whether tool-tip control is on."""
        return self._motion.tip_controlled

    def kinematics(self, code: Code) -> None:
        """Execute M428 (tool-tip control), M429 (bare axes) or M430, which is not there."""
        if code.number == M.M430:
            message = f"{code.word.written} selects a kinematics that this machine does not have"
            raise fault("tip-control-missing", message, code.word, "give M428 or M429")
        if self._motion.compensated:
            raise under_compensation(code.word)
        offset = self._motion.coordinates.tool_offset
        self.set_offset(offset, code.word, on=code.number == M.M428)

    def set_offset(self, offset: list[float], at: Word, *, on: bool, vectors: bool = False) -> None:
        """Take a tool offset into effect, and switch tool-tip control.

        Args:
            offset: of the axes (axes,), mm or degrees.
            at: word at which errors are reported.
            on: whether tool-tip control is on from here.
            vectors: whether I, J and K of a straight move are the direction of the tool (G43.5).

        Raises:
            GcodeError: ``tip-control-missing``, ``tip-control-offset``.
        """
        motion, coordinates, machine = self._motion, self._motion.coordinates, self._machine
        if on and machine is None:
            raise fault(
                "tip-control-missing",
                f"{at.written} needs a machine with tool-tip control",
                at,
                'write a five-axis [kinematics] into the machine file, such as type = "xyzac"',
            )
        if on:
            self._report_points(at)
        if machine is not None and (on or self.active):
            joints = motion.position
            if self.active:
                joints = machine.joints(joints, self._of_tool(coordinates.tool_offset))
            vector = self._of_tool(offset)
            motion.position = machine.tip(joints, vector) if on else joints
            place = np.array(motion.position)
            self._out.add(
                TipControl(self._here.file, self._here.line, vector if on else None, place)
            )
        motion.tip_controlled = on
        letters: tuple[str, ...] = ()
        if on and motion.has_direction_words:
            letters = DIRECTIONS
        elif on and vectors:
            letters = ("I", "J", "K")
        motion.vector_letters = letters
        motion.move_with_vector = self._move_with_vector if letters else None
        motion.turn_with_vector = self._turn_with_vector if letters else None
        coordinates.tool_offset = offset

    def _report_points(self, at: Word) -> None:
        """Report once that points of the rotary axes are taken as 0, 0, 0."""
        if self._points_missing:
            names = " and ".join(self._points_missing)
            message = f"[kinematics] has no {names}: taken as X0 Y0 Z0"
            hint = "measure where the rotary axes are, and write it into the machine file"
            self._here.report_warning("rotary-axis-place", message, at, hint)
        self._points_missing = ()

    def _move_with_vector(self, words: LineWords, code: Word | None, *, rapid: bool) -> None:
        """Make a straight move of the tip; the tool turns to its direction on a great circle.

        A traverse turns linearly in the joints, and so does each move with ORIAXES.
        """
        motion, machine = self._motion, self._machine
        assert machine is not None
        direction, at = self._taken(words, (code or words.first()).written)
        linear = rapid or motion.turns_linearly
        if linear:
            angles = machine.angles(motion.position, direction)
            self._move_linearly(words, angles, at, rapid=rapid)
            return
        swing = machine.swing(motion.position, direction)
        if swing is None:
            hint = "give a direction between both"
            raise fault("tool-direction", "the tool would turn by 180 degrees", at, hint)
        end = motion.target(words, "G1", motion.position)
        if swing.nearest <= POLE:
            message = f"the tool passes {swing.nearest:.2g} degrees from the axis of C"
            hint = "there C has no bounded speed: go round it, or give angles under G43.4"
            raise fault("singular-pose", message, at, hint)
        for column, value in zip(machine.rotary, swing.end, strict=True):
            end[column] = value
        length = motion.distance(end)
        feed = motion.feed(words, end, length, at)
        if not len(swing.parameters):
            motion.feed_to(end, feed)
            return
        here, there = np.array(motion.position), np.array(end)
        points = here + swing.parameters[:, None] * (there - here)
        points[:, list(machine.rotary)] = swing.angles
        file, line = self._here.file, self._here.line
        weights = np.ones(len(points))
        motion.spline(NurbsFeed(file, line, DEGREE, swing.knots, points, weights, feed))

    def _move_linearly(
        self, words: LineWords, angles: tuple[float, float], at: Word, *, rapid: bool
    ) -> None:
        """Make a straight move to two angles, in which the rotary axes turn linearly."""
        motion, machine = self._motion, self._machine
        assert machine is not None
        end = motion.target(words, "G0" if rapid else "G1", motion.position)
        for column, value in zip(machine.rotary, angles, strict=True):
            end[column] = value
        if rapid:
            motion.traverse(end)
        else:
            motion.feed_to(end, motion.feed(words, end, motion.distance(end), at))

    def _turn_with_vector(self, words: LineWords, point: list[float], at: str) -> None:
        """Set the angles of a control point to the direction in its line, if it has one."""
        machine = self._machine
        assert machine is not None
        if words.rest.keys().isdisjoint(self._motion.vector_letters):
            return
        direction, _ = self._taken(words, at)
        angles = machine.angles(point, direction)
        for column, value in zip(machine.rotary, angles, strict=True):
            point[column] = value

    def _taken(self, words: LineWords, user: str) -> tuple[Floats, Word]:
        """Take the direction of the tool on the part; return it, and its first word.

        A word that is left out is 0.
        """
        motion, machine = self._motion, self._machine
        assert machine is not None
        for column in machine.rotary:
            if clash := words.rest.get(motion.axes[column].upper()):
                message = f"{clash.written} beside the direction of the tool"
                raise fault("tool-direction", message, clash, "give angles, or the direction")
        taken = [words.take(letter, user) for letter in motion.vector_letters]
        at = next(filter(None, taken))
        return self._direction(taken, at), at

    def _direction(self, taken: list[Word | None], at: Word) -> Floats:
        """Return the direction of the tool on the part from its three words."""
        coordinates, column = self._motion.coordinates, self._motion.column
        vector = [0.0] * len(self._motion.axes)
        columns = [column[letter] for letter in "XYZ"]
        for index, word in zip(columns, taken, strict=True):
            vector[index] = 0.0 if word is None else word.number
        turned = coordinates.rotated(vector) if coordinates.turned else vector
        direction = np.array([turned[index] for index in columns])
        if not direction.any():
            names = ", ".join(self._motion.vector_letters)
            raise fault("tool-direction", f"{names} are 0", at, "give the direction of the tool")
        return direction

    def _of_tool(self, offset: list[float]) -> Offset:
        """Return the offset along X, Y and Z."""
        column = self._motion.column
        return offset[column["X"]], offset[column["Y"]], offset[column["Z"]]


def refuse_under_tip_control(motion: Motion, at: Word, what: str = "") -> None:
    """Raise GcodeError ``tip-control-active`` for a code that moves joints to stored places."""
    if motion.tip_controlled:
        message = f"{what or at.written} under tool-tip control"
        raise fault("tip-control-active", message, at, "end it before, with G49 or M429")
