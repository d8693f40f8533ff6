"""``$`` commands (commands.md): settings, reports, jogs, homing, check mode, sleep.

Each handler returns an error code, 0 for ok.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace

from cnc.boards.grbl.simulator import report
from cnc.boards.grbl.simulator.core import BUSY, Core, Wait
from cnc.boards.grbl.simulator.eeprom import LONGEST_TEXT, STARTUP_LINES
from cnc.boards.grbl.simulator.firmware_profile import TOOL_CHANGE_MODE
from cnc.boards.grbl.simulator.line_check import check_line
from cnc.boards.grbl.simulator.modal import NUMBER, Modes, Refused, sort_words
from cnc.boards.grbl.simulator.motion import home, move_to, perform, within_travel, write_eeprom

Answer = Generator[Wait, None, int]
REPORTS: dict[str, Callable[[Core], list[str]]] = {
    "#": report.parameters,
    "I": report.build_info,
    "N": report.startup_lines,
}
LARGEST_NUMBER = {"grbl": 255, "grblhal": 65535, "fluidnc": 255}
"""Largest number of a setting."""
MEASURING = (1, 2, 3)
"""Tool change modes that measure the tool; they are not modelled."""
JOG_COMMANDS = {"distance", "units", "other"}


def system_command(core: Core, text: str) -> Answer:
    """Carry out a line that begins with ``$``, in upper case without spaces."""
    body = text[1:]
    if body.startswith("J"):
        return (yield from _jog(core, body[1:]))
    if body == "$":
        if not core.profile.numbered_settings:
            return 3
        if core.state in ("Run", "Hold"):
            return 8
        return (yield from _print(core, report.settings_list(core)))
    if body in IN_ANY_STATE:
        return IN_ANY_STATE[body](core)
    if body[0] in "$GCX":
        return 3
    if core.state not in ("Idle", "Alarm"):
        return 8
    return (yield from _command_at_rest(core, body))


def _command_at_rest(core: Core, body: str) -> Answer:
    """Carry out a command that needs state Idle or Alarm."""
    if body == "ES" and core.profile.name == "grblhal":
        return (yield from _print(core, report.enumerated_settings(core)))
    if body == "I+" and core.profile.name == "grblhal":
        return (yield from _print(core, report.extended_info(core)))
    if body in REPORTS:
        return (yield from _print(core, REPORTS[body](core)))
    if body == "H":
        return (yield from _home(core))
    if body == "SLP":
        core.flags.sleep = True
        return 0
    if body.startswith("RST="):
        return (yield from _restore(core, body[4:]))
    if body.startswith("I="):
        if len(body) - 2 > LONGEST_TEXT:
            return 14
        yield from write_eeprom(core, lambda: core.eeprom.store_build_info(body[2:]))
        return 0
    if body[0] == "N" and "=" in body:
        return (yield from _startup_line(core, body[1:]))
    return (yield from _set(core, body))


def _print(core: Core, lines: list[str]) -> Answer:
    """Print line by line, each as soon as the ring has space."""
    for line in lines:
        core.say(line)
        yield BUSY
    return 0


def _help(core: Core) -> int:
    """``$``."""
    core.say(report.HELP)
    return 0


def _parser_state(core: Core) -> int:
    """``$G``."""
    core.say(report.parser_state(core))
    return 0


def _check_mode(core: Core) -> int:
    """``$C``: on in Idle; off, with a reset."""
    if core.state == "Check":
        core.say("[MSG:Disabled]")
        core.flags.reset = True
    elif core.state != "Idle":
        return 8
    else:
        core.state = "Check"
        core.say("[MSG:Enabled]")
    return 0


def _unlock(core: Core) -> int:
    """``$X``."""
    if core.state == "Alarm":
        if core.environment.door_open:
            return 13
        if core.must_home and core.profile.name == "grblhal":
            return 46
        core.say("[MSG:Caution: Unlocked]")
        core.state = "Idle"
    return 0


IN_ANY_STATE: dict[str, Callable[[Core], int]] = {
    "": _help,
    "G": _parser_state,
    "C": _check_mode,
    "X": _unlock,
}


def _home(core: Core) -> Answer:
    """``$H``, and the start-up lines after it."""
    if not core.setting[22]:
        return 5
    if core.environment.door_open:
        return 13
    yield from home(core)
    yield from run_startup_lines(core)
    return 0


def _restore(core: Core, part: str) -> Answer:
    """``$RST=``, which ends with a reset."""
    if part not in ("$", "#", "*"):
        return 3
    yield from write_eeprom(core, lambda: core.eeprom.restore(part))
    core.say("[MSG:Restoring defaults]")
    core.flags.reset = True
    return 0


def _set(core: Core, body: str) -> Answer:
    """``$x=value``."""
    if body[0] in "#INHSR":
        return 3
    number = NUMBER.match(body)
    if number is None:
        return 2
    rest = body[number.end() :]
    value = NUMBER.fullmatch(rest[1:])
    if not rest.startswith("=") or float(number.group()) not in range(
        LARGEST_NUMBER[core.profile.name] + 1
    ):
        return 3
    if value is None:
        return 2
    profile = core.profile
    try:
        written = core.eeprom.set(
            int(float(number.group())),
            float(value.group()),
            profile.max_step_rate_hz,
            profile.variable_spindle,
        )
    except Refused as refused:
        return refused.code
    yield from write_eeprom(core, lambda: written)
    return 0


def _startup_line(core: Core, body: str) -> Answer:
    """``$Nx=line``: run the line to check it, then store it."""
    index, _, text = body.partition("=")
    if not index.isdecimal() or not index.isascii() or int(index) >= STARTUP_LINES:
        return 3
    if core.state != "Idle":
        return 8
    if len(text) > LONGEST_TEXT:
        return 14
    code = yield from run_line(core, text)
    if not code:
        yield from write_eeprom(core, lambda: core.eeprom.store_startup(int(index), text))
    return code


def run_line(core: Core, text: str) -> Answer:
    """Check a line of the program, and carry it out."""
    try:
        line = check_line(text, core.modes, core.place)
    except Refused as refused:
        return refused.code
    if line.changes_tool and core.setting[TOOL_CHANGE_MODE] in MEASURING:
        # as in a build with a compatibility level of 2
        return 20
    yield from perform(core, line)
    return 0


def run_startup_lines(core: Core) -> Answer:
    """Run the stored start-up lines; each is echoed with its answer."""
    for text in core.eeprom.startup:
        if text:
            core.print(f">{text}:")
            code = yield from run_line(core, text)
            core.say(f"error:{code}" if code else "ok")
            yield BUSY
    return 0


def _jog(core: Core, body: str) -> Answer:
    """``$J=``: a motion that keeps the parser's modes. Errors 8, 15, 16, 22, those of words."""
    if core.state not in ("Idle", "Jog"):
        return 8
    if not body.startswith("="):
        return 3
    try:
        axes = set(core.profile.axes)
        found = sort_words(body[1:], core.profile.codes, core.profile.axes)
        if not set(found.values) & axes and not set(found.commands) - JOG_COMMANDS:
            return 26
        if not found.values.get("F"):
            return 22
        modes: Modes = replace(core.modes, motion="G1", feed_mode="G94")
        line = check_line(body[1:], modes, core.place)
        if set(found.values) & set("ST"):
            return 36
        if set(found.commands) - JOG_COMMANDS or found.commands.get("other", "G53") != "G53":
            return 16
    except Refused as refused:
        return refused.code
    if core.setting[20] and not within_travel(core, line.target):
        return 15
    yield from move_to(core, "jog", line.target, line, line.feed, 0)
    core.parsed = line.target
    core.start_cycle()
    return 0
