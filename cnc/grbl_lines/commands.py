"""Blocks that don't move, as GRBL 1.1 says them; what it can't do is a GcodeError at the block's
line.

Of the codes that GRBL knows these are G4, M0 to M5, M7 where it was built with mist, M8 and M9
(GRBL 1.1 wiki, "Supported G-codes"). A tool change becomes a pause with a message. What changes
offsets (G10, G43.1, G92) never comes here: positions are those of the machine.
"""

from __future__ import annotations

from collections.abc import Iterator

from cnc.grbl_lines.number_format import LONGEST, message_lines, number
from cnc.model.blocks import (
    Abort,
    AnalogOutput,
    Block,
    BoardCommand,
    Coolant,
    DigitalOutput,
    Dwell,
    End,
    Held,
    Message,
    Orient,
    Overrides,
    PathMode,
    Probe,
    Spindle,
    SpindleSync,
    Stop,
    Tool,
    WaitInput,
)
from cnc.model.diagnostics import Diagnostic, GcodeError

LONGEST_DWELL = 3000.0
"""s: GRBL counts a dwell in steps of 50 ms by 16 bits, 3276 s at most (``delay_sec`` of
nuts_bolts.c).
"""


class CommandLines:
    """The lines of one block after another; it remembers spindle and coolant.

    mist: whether the board has M7. moved: whether anything has moved yet.
    """

    def __init__(self, *, mist: bool = False) -> None:
        self._mist = mist
        self._spindle = "off"
        self._rpm = 0.0
        self._coolant = (False, False)
        self.moved = False

    def lines(self, block: Block) -> Iterator[str]:
        """Lines for a block that is neither motion nor a probe; GcodeError for what the board can't
        do.
        """
        match block:
            case Message(text=text):
                yield from message_lines(text)
            case Dwell(seconds=seconds):
                yield from _dwell(seconds)
            case Spindle():
                yield from self._turn(block)
            case Coolant(mist=mist, flood=flood):
                yield from self._cool(block, mist, flood)
            case Tool(number=tool, change=True):
                if self._spindle != "off":
                    self._spindle = "off"
                    yield "M5"
                yield f"M0 (MSG, put in tool {tool}, then resume)"
            case Stop(optional=optional, pallet=pallet):
                yield (
                    "M1"
                    if optional
                    else "M0 (MSG, change the pallet, then resume)"
                    if pallet
                    else "M0"
                )
            case End():
                self._spindle, self._coolant = "off", (False, False)
                yield "M2"
            case BoardCommand(text=text):
                yield self._own(block, text)
            case SpindleSync(pitch=pitch):
                if pitch:
                    raise refused(
                        block,
                        "motion that follows the spindle (G33, G76)",
                        "use a board with an encoder",
                    )
            case Abort() | Tool() | Overrides() | PathMode() | Held():
                pass
            case Orient():
                raise refused(block, "M19, to orient the spindle")
            case DigitalOutput() | AnalogOutput():
                raise refused(
                    block,
                    "outputs (M62 to M68)",
                    "use coolant (M8) or spindle (S) for what they switch",
                )
            case WaitInput():
                raise refused(block, "M66, to read an input")
            case _:
                raise refused(block, f"{type(block).__name__} blocks")

    def _turn(self, block: Spindle) -> Iterator[str]:
        if block.surface_speed:
            raise refused(
                block, "constant surface speed (G96)", "program the spindle speed with G97"
            )
        if block.state == "off":
            if self._spindle != "off":
                yield "M5"
        elif block.state != self._spindle:
            yield f"{'M3' if block.state == 'cw' else 'M4'} S{number(block.rpm, 3)}"
        elif block.rpm != self._rpm:
            yield f"S{number(block.rpm, 3)}"
        self._spindle, self._rpm = block.state, block.rpm

    def _cool(self, block: Block, mist: bool, flood: bool) -> Iterator[str]:
        if mist and not self._mist:
            raise refused(block, "mist (M7)", "use M8; GRBL has M7 only if it was built with it")
        wanted, now = (mist, flood), self._coolant
        if any(has and not wants for wants, has in zip(wanted, now, strict=True)):
            yield "M9"
            now = (False, False)
        if mist and not now[0]:
            yield "M7"
        if flood and not now[1]:
            yield "M8"
        self._coolant = wanted

    def _own(self, block: Block, text: str) -> str:
        """A command of the board's own."""
        said = text.replace(" ", "").upper()
        if said.startswith("$J") or (said.startswith("$H") and self.moved):
            hint = (
                "home before the program; move with G0"
                if said.startswith("$H")
                else "move with G0 or G1"
            )
            message = f"after {text} the board is elsewhere than the program"
            raise GcodeError(
                Diagnostic("board-command-moves", message, block.file, block.line, hint=hint)
            )
        if not text.isascii() or any(c in text for c in "?!~") or len(text) > LONGEST:
            raise GcodeError(
                Diagnostic(
                    "board-command",
                    f"{text[:LONGEST]} can't be sent as a line",
                    block.file,
                    block.line,
                )
            )
        return text


def _dwell(seconds: float) -> Iterator[str]:
    while seconds > LONGEST_DWELL:
        yield f"G4 P{number(LONGEST_DWELL, 3)}"
        seconds -= LONGEST_DWELL
    yield f"G4 P{number(seconds, 3)}"


def refused(block: Block, what: str, hint: str = "") -> GcodeError:
    """The error for a block that GRBL has no words for."""
    return GcodeError(
        Diagnostic("not-on-board", f"a GRBL board has no {what}", block.file, block.line, hint=hint)
    )


def probe_word(probe: Probe) -> str:
    """G38.2 to G38.5."""
    return f"G38.{(2 if probe.must else 3) if probe.towards else (4 if probe.must else 5)}"
