"""Parameters: numbered and named variables of a program, and the file that keeps some of them.

Numbers are the units of the program (mm or inch, as written); a parameter has no unit of its own.
Source: LinuxCNC, "Parameters" (ranges, scope of names, the parameter file), and FANUC's custom
macro B for its ranges and the vacant state.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from cnc.gcode.syntax.words import NEAR_WHOLE, fault
from cnc.model import parameter_numbers as numbers
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError

LOCAL = 30
"""#1 to #30 belong to the call; FANUC's to #33."""
LOCAL_MACRO = 33
LAST = 5602
"""Highest number that the interpreter knows."""
USER = range(31, 5001)
"""Numbers that a program may use as it likes and that the file keeps once they were set."""
SYSTEM = frozenset(
    (
        *numbers.place(numbers.G28_POSITION),
        *numbers.place(numbers.G30_POSITION),
        *range(numbers.SHIFT_IN_EFFECT, numbers.origin(8) + numbers.ROTATION + 1),
    )
)
"""Home positions, G92, the coordinate systems: always there, always kept."""
KEPT_MACRO = frozenset(
    (
        *range(500, 1000),
        *numbers.place(numbers.EXTERNAL_OFFSET),
        *range(
            numbers.G54_1_ORIGIN,
            numbers.G54_1_ORIGIN + numbers.MOST_G54_1_SYSTEMS * numbers.SYSTEM_STEP,
        ),
    )
)
"""FANUC's common variables that stay, the external offset of its coordinate systems, and the
systems of G54.1.
"""
LAST_MACRO = max(KEPT_MACRO)
COMMON_MACRO = KEPT_MACRO | frozenset(range(100, 200))
VACANT = math.nan

_LINE = re.compile(r"\s*([0-9]+)\s+([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*")

Read = Callable[[], float]
Write = Callable[[float], None]


class Parameters:
    """The variables of a program.

    ``values`` is the plain store of the numbers above the locals; ``locals`` holds those of the
    current call. Both are open to compiled expressions, which look there first. ``open_numbers``
    are the numbers of the line that is being computed (:mod:`cnc.gcode.syntax.line_templates`).
    With ``macro`` the ranges are FANUC's, and a number that was never set is vacant (NaN), not 0.
    ``increments`` is how many least input increments a unit of length has: FANUC's ROUND rounds a
    word to that (1000 a mm, 10000 an inch).
    """

    def __init__(self, values: Mapping[int, float] | None = None, *, macro: bool = False) -> None:
        self.macro = macro
        self.values: dict[int, float] = (
            dict.fromkeys(sorted(SYSTEM), 0.0) | {numbers.CURRENT_SYSTEM: 1.0} | dict(values or {})
        )
        self.locals: dict[int, float] = {}
        self.open_numbers: tuple[float, ...] = ()
        self._names: dict[str, float] = {}
        self._globals: dict[str, float] = {}
        self._callers: list[tuple[dict[int, float], dict[str, float]]] = []
        self._bound: dict[int | str, tuple[Read, Write | None]] = {}
        self.increments = 1000.0
        self._last_local = LOCAL_MACRO if macro else LOCAL
        self._unset = VACANT if macro else 0.0

    def number(self, index: float, column: int) -> float:
        """``#index``. GcodeError ``parameter-number`` where there is no such number."""
        number = self._whole(index, column)
        if 0 < number <= self._last_local:
            return self.locals.get(number, self._unset)
        if number in self.values:
            return self.values[number]
        if number in self._bound:
            return self._bound[number][0]()
        if not (number == 0 and self.macro):
            self._check(number, column)
        return self._unset

    def set_number(self, index: float, value: float, column: int) -> None:
        """``#index = value``. GcodeError ``parameter-number``, ``parameter-read-only``,
        ``macro-alarm``.
        """
        number = self._whole(index, column)
        if 0 < number <= self._last_local:
            self._store(self.locals, number, value)
        elif number in self._bound:
            self._write(number, value, column)
        elif number == numbers.ALARM and self.macro:
            message = f"the program stops itself with alarm {numbers.ALARM + value:g}"
            raise fault(
                "macro-alarm", message, column=column, hint="the comment beside it may say why"
            )
        elif number == 0 and self.macro:
            raise fault(
                "parameter-read-only", "#0 is always vacant and can't be set", column=column
            )
        else:
            self._check(number, column)
            self._store(self.values, number, value)

    def name(self, name: str, column: int) -> float:
        """``#<name>``, given without the brackets, in lower case and without blanks. GcodeError
        ``parameter-undefined``.
        """
        value = (self._globals if name.startswith("_") else self._names).get(name)
        if value is not None:
            return value
        if name in self._bound:
            return self._bound[name][0]()
        raise self._undefined(name, column)

    def set_name(self, name: str, value: float, column: int) -> None:
        """``#<name> = value``: global where the name begins with ``_``, else of this call.
        GcodeError ``parameter-read-only``.
        """
        if name in self._bound:
            self._write(name, value, column)
        elif name.startswith("_"):
            self._globals[name] = value
        else:
            self._names[name] = value

    def exists(self, target: str | float) -> bool:
        """Whether a name has a value, or there is a parameter of that number."""
        if isinstance(target, str):
            return target in self._names or target in self._globals or target in self._bound
        return target in self._bound or (1 <= target <= LAST and float(target).is_integer())

    def bind(self, key: int | str, read: Read, write: Write | None = None) -> None:
        """Let a parameter show something live (5420: the position); without ``write`` a program
        can't set it.
        """
        if isinstance(key, int):
            self.values.pop(key, None)
        self._bound[key] = read, write

    def push(self, arguments: Sequence[float]) -> None:
        """Enter a call: it has names of its own, and its own #1.. which begin with the arguments
        (NaN: not given).
        """
        self._callers.append((self.locals, self._names))
        self.locals = {
            number: value for number, value in enumerate(arguments, start=1) if value == value
        }
        self._names = {}

    def pop(self) -> None:
        """Leave a call."""
        self.locals, self._names = self._callers.pop()

    def stored(self) -> dict[int, float]:
        """What the parameter file keeps, ascending: the system's, and the user's that were set."""
        kept = KEPT_MACRO if self.macro else USER
        return {
            number: self.values[number]
            for number in sorted(self.values)
            if number in SYSTEM or number in kept
        }

    def _store(self, store: dict[int, float], number: int, value: float) -> None:
        """Vacant is stored as nothing at all."""
        if value == value:
            store[number] = value
        else:
            store.pop(number, None)

    def _whole(self, index: float, column: int) -> int:
        number = round(index)
        if abs(index - number) > NEAR_WHOLE:
            raise fault(
                "parameter-number",
                f"#{index:g}: the number of a parameter must be whole",
                column=column,
            )
        return number

    def _check(self, number: int, column: int) -> None:
        if self.macro and not (number in COMMON_MACRO or number in SYSTEM):
            hint = f"variables are #1 to #{LOCAL_MACRO}, #100 to #199 and #500 to #999"
            raise fault("parameter-number", f"there is no #{number} here", column=column, hint=hint)
        if not self.macro and not 1 <= number <= LAST:
            raise fault(
                "parameter-number",
                f"there is no #{number}",
                column=column,
                hint=f"parameters are #1 to #{LAST}",
            )

    def _write(self, key: int | str, value: float, column: int) -> None:
        write = self._bound[key][1]
        if write is None:
            shown = f"#<{key}>" if isinstance(key, str) else f"#{key}"
            raise fault("parameter-read-only", f"{shown} can be read only", column=column)
        write(value)

    def _undefined(self, name: str, column: int) -> GcodeError:
        known = [
            *self._names,
            *self._globals,
            *(key for key in self._bound if isinstance(key, str)),
        ]
        near = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean #<{near[0]}>?" if near else f"set it first, or ask EXISTS[#<{name}>]"
        return fault(
            "parameter-undefined",
            f"#<{name}> was never set",
            column=column,
            length=len(name) + 3,
            hint=hint,
        )


def read_parameters(path: str | os.PathLike[str]) -> dict[int, float]:
    """The numbers of a parameter file: a number and its value a line, ascending.

    Raises UsageError with file and line: ``no-such-file``, ``unreadable-file``,
    ``parameter-file-line``, ``parameter-file-order``.
    """
    name = os.fspath(path)
    try:
        text = Path(path).read_text(encoding="latin-1")
    except FileNotFoundError:
        hint = "the first time, make an empty file of this name"
        raise UsageError(
            Diagnostic("no-such-file", f"there is no parameter file {name}", file=name, hint=hint)
        ) from None
    except OSError as error:
        raise UsageError(
            Diagnostic(
                "unreadable-file",
                f"can't read the parameter file {name}: {error.strerror}",
                file=name,
            )
        ) from None
    values: dict[int, float] = {}
    last = 0
    for line, raw in enumerate(text.split("\n"), start=1):
        if not raw.strip():
            continue
        found = _LINE.fullmatch(raw)
        value = float(found[2]) if found else math.inf
        if found is None or not math.isfinite(value):
            raise _file_error(
                "parameter-file-line",
                "this is no number of a parameter and its value",
                name,
                line,
                raw,
                "such as 5221 10.5",
            )
        number = int(found[1])
        if not 1 <= number <= LAST_MACRO:
            raise _file_error(
                "parameter-file-line",
                f"there is no parameter {number}",
                name,
                line,
                raw,
                f"they are 1 to {LAST_MACRO}",
            )
        if number <= last:
            message = f"{number} stands after {last}"
            raise _file_error(
                "parameter-file-order",
                message,
                name,
                line,
                raw,
                "the numbers must ascend, each given once",
            )
        values[number] = value
        last = number
    return values


def write_parameters(path: str | os.PathLike[str], values: Mapping[int, float]) -> None:
    """Write a parameter file. The old one is there whole until the new one is; ``float`` gives
    every value back as it was.

    Raises UsageError ``unwritable-file``.
    """
    replace_text(
        path,
        "".join(f"{number}\t{value!r}\n" for number, value in sorted(values.items())),
        "the parameter file",
    )


def replace_text(path: str | os.PathLike[str], text: str, what: str) -> None:
    """Write a file whole or not at all; ``what`` is what messages call it. UsageError
    ``unwritable-file``.
    """
    target = Path(os.path.realpath(path))
    try:
        handle, draft = tempfile.mkstemp(
            prefix=target.name + ".", suffix=".part", dir=target.parent
        )
        try:
            with open(handle, "w", encoding="utf-8", newline="\n") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(draft, _mode(target))
            os.replace(draft, target)
        except BaseException:
            with suppress(OSError):
                os.unlink(draft)
            raise
    except OSError as error:
        name = os.fspath(path)
        raise UsageError(
            Diagnostic("unwritable-file", f"can't write {what} {name}: {error.strerror}", file=name)
        ) from None


def _mode(target: Path) -> int:
    """The rights of the file that is replaced, or what a new one would have."""
    try:
        return target.stat().st_mode & 0o777
    except OSError:
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask


def _file_error(code: str, message: str, file: str, line: int, text: str, hint: str) -> UsageError:
    shown = text.rstrip()
    return UsageError(
        Diagnostic(
            code,
            message,
            file,
            line,
            len(shown) - len(shown.lstrip()) + 1,
            len(shown.strip()),
            shown,
            hint,
        )
    )
