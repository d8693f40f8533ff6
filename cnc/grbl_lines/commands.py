"""Lines of GRBL 1.1 for blocks without motion; GcodeError for blocks that GRBL does not support.

GRBL supports G4, M0 to M5, M7 if it was built with mist, M8 and M9 (GRBL 1.1 wiki, "Supported
G-codes"). A tool change becomes a pause with a message, or M6 where the board waits at it for the
operator (grblHAL). Blocks that change offsets (G10, G43.1, G92) do not reach this module, because
positions are machine coordinates.
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
from cnc.model.line_effects import MODES, REST, LineEffect, LineKind
from cnc.model.streams import GcodeLine

LONGEST_DWELL = 3000.0
"""s. GRBL counts a dwell in steps of 50 ms by 16 bits, at most 3276 s (``delay_sec`` of
nuts_bolts.c).
"""
Command = tuple[str, LineEffect]


class CommandLines:
    """Writes the lines of blocks without motion, and keeps the state of spindle and coolant.

    Both are unknown at first: an entered line may have started them, and they stay on after it.

    Attributes:
        moved: Whether anything has moved yet.
    """

    def __init__(self, codes: frozenset[str] = frozenset()) -> None:
        """``codes``: M6 and M7, if the board has them; it waits for the operator at M6."""
        self._codes = codes
        self._spindle: str | None = None
        self._rpm = 0.0
        self._coolant: tuple[bool, bool] | None = None
        self.moved = False

    def lines(self, block: Block) -> Iterator[GcodeLine]:
        """Yield the lines of a block; GcodeError for a block that the board does not support."""
        if isinstance(block, BoardCommand):
            # The effect of a command of the board's own is not known.
            yield GcodeLine(self._board_command(block), block.line)
            return
        for text, effect in self._commands(block):
            yield GcodeLine(text, block.line, effect)

    def power(self, block: Block) -> str | None:
        """Return the S word of a command that changes a laser's power in motion.

        Returns:
            None for another block; "" where the power stays.
        """
        if not isinstance(block, Spindle) or not block.with_motion or block.state != self._spindle:
            return None
        changed, self._rpm = block.rpm != self._rpm, block.rpm
        return f"S{number(block.rpm, 3)}" if changed else ""

    def _commands(self, block: Block) -> Iterator[Command]:
        match block:
            case Message(text=text):
                yield from ((line, MODES) for line in message_lines(text))
            case Dwell(seconds=seconds):
                yield from _dwell(seconds)
            case Spindle():
                yield from self._spindle_commands(block)
            case Coolant():
                yield from self._coolant_commands(block)
            case Tool(change=True) | Stop() | End():
                yield from self._pause_commands(block)
            case SpindleSync(pitch=0.0) | Abort() | Tool() | Overrides() | PathMode() | Held():
                return
            case _:
                raise _unsupported(block)

    def _pause_commands(self, block: Tool | Stop | End) -> Iterator[Command]:
        if isinstance(block, End):
            self._spindle, self._coolant = "off", (False, False)
            yield "M2", REST
        elif isinstance(block, Tool):
            if self._spindle != "off":
                self._spindle = "off"
                yield "M5", REST
            command = f"T{block.number} M6" if "M6" in self._codes else "M0"
            yield f"{command} (MSG, put in tool {block.number}, then resume)", REST
        elif block.optional:
            yield "M1", REST
        else:
            yield "M0 (MSG, change the pallet, then resume)" if block.pallet else "M0", REST

    def _spindle_commands(self, block: Spindle) -> Iterator[Command]:
        if block.surface_speed:
            raise refused(
                block, "constant surface speed (G96)", "program the spindle speed with G97"
            )
        if block.state == "off":
            if self._spindle != "off":
                yield "M5", REST
        elif block.state != self._spindle:
            yield f"{'M3' if block.state == 'cw' else 'M4'} S{number(block.rpm, 3)}", REST
        elif block.rpm != self._rpm:
            # GRBL comes to rest for a new speed, and with an S that stands alone for a new power.
            yield f"S{number(block.rpm, 3)}", REST
        self._spindle, self._rpm = block.state, block.rpm

    def _coolant_commands(self, block: Coolant) -> Iterator[Command]:
        if block.mist and "M7" not in self._codes:
            raise refused(block, "mist (M7)", "use M8; GRBL has M7 only if it was built with it")
        wanted = (block.mist, block.flood)
        now = self._coolant
        if now is None:
            now = (False, False) if any(wanted) else (True, True)
        if any(has and not wants for wants, has in zip(wanted, now, strict=True)):
            yield "M9", REST
            now = (False, False)
        if block.mist and not now[0]:
            yield "M7", REST
        if block.flood and not now[1]:
            yield "M8", REST
        self._coolant = wanted

    def _board_command(self, block: BoardCommand) -> str:
        """Return the text of a command of the board's own; GcodeError if it may not be sent."""
        text = block.text
        command = text.replace(" ", "").upper()
        homes = command.startswith("$H")
        if command.startswith("$J") or (homes and self.moved):
            hint = (
                "home before the program starts, and move with G0"
                if homes
                else "move with G0 or G1"
            )
            message = f"{text} moves the board to a position that the program does not know"
            raise GcodeError(
                Diagnostic("board-command-moves", message, block.file, block.line, hint=hint)
            )
        if not text.isascii() or any(c in text for c in "?!~") or len(text) > LONGEST:
            message = (
                f"{text[:LONGEST]} can't be sent: a line has at most {LONGEST} ASCII characters, "
                "without ? ! ~"
            )
            raise GcodeError(Diagnostic("board-command", message, block.file, block.line))
        return text


def _dwell(seconds: float) -> Iterator[Command]:
    while seconds > LONGEST_DWELL:
        yield _dwell_line(LONGEST_DWELL)
        seconds -= LONGEST_DWELL
    yield _dwell_line(seconds)


def _dwell_line(seconds: float) -> Command:
    text = number(seconds, 3)
    return f"G4 P{text}", LineEffect(LineKind.DWELL, seconds=float(text))


def _unsupported(block: Block) -> GcodeError:
    match block:
        case SpindleSync():
            return refused(
                block,
                "motion that follows the spindle (G33, G76)",
                "use a board with a spindle encoder",
            )
        case Orient():
            return refused(block, "spindle orientation (M19)")
        case DigitalOutput() | AnalogOutput():
            return refused(
                block,
                "outputs (M62 to M68)",
                "use coolant (M8) or spindle speed (S) to switch the device",
            )
        case WaitInput():
            return refused(block, "inputs (M66)")
        case _:
            return refused(block, "command for this line")


def refused(block: Block, feature: str, hint: str = "") -> GcodeError:
    """Return the error for a block that GRBL does not support."""
    return GcodeError(
        Diagnostic(
            "not-on-board", f"a GRBL board has no {feature}", block.file, block.line, hint=hint
        )
    )


def probe_word(probe: Probe) -> str:
    """Return G38.2 to G38.5."""
    return f"G38.{(2 if probe.must else 3) if probe.towards else (4 if probe.must else 5)}"
