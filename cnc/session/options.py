"""Options of a check or a run, as one record from the command line to the session."""

from __future__ import annotations

from dataclasses import dataclass, field

from cnc.checks.selection import Selection
from cnc.model.choices import (
    Algorithm,
    DialectName,
    Interpolator,
    Pauses,
    ToolLengths,
    UnknownCodes,
)


@dataclass(frozen=True, slots=True)
class Outputs:
    """Files to write: a name, ``-`` for standard output, or None.

    The suffix selects the format. :mod:`cnc.report` and :mod:`cnc.view.writer` list the formats.
    """

    blocks: str | None = None
    trace: str | None = None
    pulses: str | None = None
    lines: str | None = None
    picture: str | None = None
    stl: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Options of a check or a run. The second group applies to runs on a board only.

    Attributes:
        dialect: How to read the program; None for the machine file's choice.
        interpolator: ``sampled`` also samples the motion at the machine's period. A trace output
            does so in any case.
        algorithm: How grid moves follow a curve; None for half steps on lines and arcs, and
            enclosing lines on other curves.
        feed_override: Per cent of the programmed feeds, 1 to 200, at the beginning. A ``Control``
            that is passed along with the options takes its place.
        outputs: Files to write.
        selection: The warnings and notes to report. Errors are always reported.
        portable: Dialects that must read the program in the same way.
        tool_lengths: Without a tool table: refuse lengths and radii of tools, or take them as 0.
            None refuses them where a machine moves or a file for a board is written.
        unknown_codes: Refuse unknown M-codes, or skip them with a warning.
        stock_resolution: Width of a cell of the simulated stock, mm; None for the default.
        height_map: File of the height map that warps the program; None for none.
        default_feed: Feed before the first F word, mm/min; None for none.
        block_delete: Switches of block delete that are on, 1 to 9.
        optional_stop: Stop at M1 as at M0.
        pauses: How M0 and M6 are treated on a board that plans for itself.
        from_line: Source line to begin at, from 1; None for the first line. The state of the lines
            before it is restored at a safe height.
        home: Home the machine after the check and before the program.
        trust_position: Accept the position that a GRBL board reports, although the board has
            restarted or the last run ended elsewhere. Such a run is refused otherwise
            (``position-lost``).
        check_on_board: Let a board that plans for itself read the lines without moving.
    """

    dialect: DialectName | None = None
    interpolator: Interpolator = "reference-pulse"
    algorithm: Algorithm | None = None
    feed_override: float = 100.0
    outputs: Outputs = field(default_factory=Outputs)
    selection: Selection = field(default_factory=Selection)
    portable: tuple[str, ...] = ()
    tool_lengths: ToolLengths | None = None
    unknown_codes: UnknownCodes = "error"
    stock_resolution: float | None = None
    height_map: str | None = None
    default_feed: float | None = None
    block_delete: frozenset[int] = frozenset()
    optional_stop: bool = False

    pauses: Pauses = "wait"
    from_line: int | None = None
    home: bool = False
    trust_position: bool = False
    check_on_board: bool = False

    @property
    def sampled(self) -> bool:
        """Whether the motion is sampled at the machine's period."""
        return self.interpolator == "sampled" or self.outputs.trace is not None
