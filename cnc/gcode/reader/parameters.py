"""Parameters: the numbered and named variables of a program.

Numbers are the units of the program (mm or inch, as written); a parameter has no unit of its own.
Source: LinuxCNC, "Parameters" (ranges, scope of names), and FANUC's custom macro B for its ranges
and the vacant state.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import tempfile
from collections.abc import Callable, Container, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from cnc.gcode.kernels import rules
from cnc.gcode.reader.words import NEAR_WHOLE, fault
from cnc.model import parameter_numbers as numbers
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError

LOCAL, LOCAL_MACRO = rules.LOCAL, 33
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
MORE_MACRO = range(10_000, 11_000)
"""More common variables that stay, of Haas' controls."""
LAST_MACRO = max(KEPT_MACRO)
COMMON_MACRO = KEPT_MACRO | frozenset(range(100, 200))
VACANT = math.nan

Read = Callable[[], float]
Write = Callable[[float], None]
ReadRow = Callable[[int], float]
"""Returns the value of a parameter of a row, counted from 0."""
WriteRow = Callable[[int, float], None]


class Parameters:
    """The variables of a program.

    Attributes:
        macro: Whether the ranges are FANUC's. Unset parameters are then vacant (NaN), not 0.
        values: Values of the numbers above the locals. Expressions read it first.
        locals: Values of the numbers of the current call. Expressions read it first.
        changed: Numbers and names that were set, or shown by a function, since the set was emptied.
            None while nobody asks.
        unstored: Stores the names that compiled code has set; called before a name is read. None if
            all are stored.
        calls: Number of calls entered and left.
        kept: Numbers that the file keeps once they were set.
        written: Returns a name as the program writes it.
        increments: Least input increments in a unit of length: 1000 for mm, 10000 for inches.
            FANUC's ROUND rounds words to them.
    """

    def __init__(self, values: Mapping[int, float] | None = None, *, macro: bool = False) -> None:
        self.macro = macro
        self.values: dict[int, float] = (
            dict.fromkeys(sorted(SYSTEM), 0.0) | {numbers.CURRENT_SYSTEM: 1.0} | dict(values or {})
        )
        self.locals: dict[int, float] = {}
        self._own_names: dict[str, float] = {}
        self._global_names: dict[str, float] = {}
        self._callers: list[tuple[dict[int, float], dict[str, float]]] = []
        self._bound: dict[int | str, tuple[Read, Write | None]] = {}
        self._rows: list[tuple[range, ReadRow, WriteRow]] = []
        self._first_in_row = LAST_MACRO + 1
        self._row_writes = 0
        self.changed: set[int | str] | None = None
        self.unstored: Callable[[], None] | None = None
        self.calls = 0
        self.kept: Container[int] = KEPT_MACRO if macro else USER
        self.written: Callable[[str], str] = "#<{}>".format
        self.increments = 1000.0
        self._last_local = LOCAL_MACRO if macro else LOCAL
        self.unset = VACANT if macro else 0.0

    def settle(self) -> None:
        """Store the names that compiled code has set."""
        if self.unstored:
            self.unstored()

    @property
    def _names(self) -> dict[str, float]:
        """The names of the current call."""
        self.settle()
        return self._own_names

    @property
    def _globals(self) -> dict[str, float]:
        """The names of all calls."""
        self.settle()
        return self._global_names

    def number(self, index: float, column: int) -> float:
        """Return ``#index``.

        Raises:
            GcodeError: ``parameter-number``, if there is no such number.
        """
        number = self._whole(index, column)
        if 0 < number <= self._last_local:
            return self.locals.get(number, self.unset)
        if number in self.values:
            return self.values[number]
        if number in self._bound:
            return self._bound[number][0]()
        if number >= self._first_in_row and (found := self._row_of(number)):
            row, read, _ = found
            return read(number - row.start)
        if not (number == 0 and self.macro):
            self._check(number, column)
        return self.unset

    def set_number(self, index: float, value: float, column: int) -> None:
        """Execute ``#index = value``.

        Raises:
            GcodeError: ``parameter-number``, ``parameter-read-only``, ``macro-alarm``.
        """
        number = self._whole(index, column)
        if 0 < number <= self._last_local:
            self._store(self.locals, number, value)
        elif number in self._bound:
            self._write(number, value, column)
        elif number == numbers.ALARM and self.macro:
            message = f"the program stops itself with alarm {numbers.ALARM + value:g}"
            raise fault(
                "macro-alarm",
                message,
                column=column,
                hint="the comment in its line may give the reason",
            )
        elif number == 0 and self.macro:
            raise fault(
                "parameter-read-only", "#0 is always vacant and cannot be set", column=column
            )
        elif number >= self._first_in_row and (found := self._row_of(number)):
            row, _, write = found
            self._row_writes += 1
            write(number - row.start, value)
        else:
            self._check(number, column)
            self._store(self.values, number, value)

    def name(self, name: str, column: int) -> float:
        """Return ``#<name>``. The name is in lower case, without brackets and blanks.

        Raises:
            GcodeError: ``parameter-undefined``.
        """
        value = (self._globals if name.startswith("_") else self._names).get(name)
        if value is not None:
            return value
        if name in self._bound:
            return self._bound[name][0]()
        raise self._undefined(name, column)

    def set_name(self, name: str, value: float, column: int) -> None:
        """Execute ``#<name> = value``. A name that begins with ``_`` is global.

        Raises:
            GcodeError: ``parameter-read-only``.
        """
        if name in self._bound:
            self._write(name, value, column)
        else:
            (self._globals if name.startswith("_") else self._names)[name] = value
            if self.changed is not None:
                self.changed.add(name)

    def stored_value(self, key: int | str) -> float:
        """Return the value of a number up to 5000 or of a name; NaN if a function shows it.

        A name that was never set is NaN, too.
        """
        if key in self._bound:
            return math.nan
        if isinstance(key, str):
            return (self._globals if key.startswith("_") else self._names).get(key, math.nan)
        return (self.locals if key <= self._last_local else self.values).get(key, self.unset)

    def store_value(self, key: int | str, value: float) -> None:
        """Store the value of a number up to 5000 or of a name, which no function shows."""
        if isinstance(key, str):
            (self._globals if key.startswith("_") else self._names)[key] = value
        else:
            (self.locals if key <= self._last_local else self.values)[key] = value

    def known_names(self) -> list[str]:
        """Return the names that have a value, or that functions show."""
        return [*self._globals, *self._names, *(key for key in self._bound if isinstance(key, str))]

    def known_numbers(self, last: int) -> set[int]:
        """Return the numbers up to ``last`` that were set, or that a function shows."""
        numbers = {
            *self.locals,
            *self.values,
            *(key for key in self._bound if isinstance(key, int)),
        }
        return {number for number in numbers if 0 < number <= last}

    def is_bound(self, key: int | str) -> bool:
        """Return whether a function shows the parameter."""
        return key in self._bound

    def exists(self, target: str | float) -> bool:
        """Return whether a name has a value, or a parameter of that number exists."""
        if isinstance(target, str):
            return target in self._names or target in self._globals or target in self._bound
        return target in self._bound or (1 <= target <= LAST and float(target).is_integer())

    def bind(self, key: int | str, read: Read, write: Write | None = None) -> None:
        """Bind a parameter to functions, such as 5420 to the position.

        Args:
            key: Number or name of the parameter.
            read: Returns its value.
            write: Sets its value; None if programs may not set it.
        """
        if isinstance(key, int):
            self.values.pop(key, None)
        self._bound[key] = read, write
        if self.changed is not None:
            self.changed.add(key)

    def bind_row(self, row: range, read: ReadRow, write: WriteRow) -> None:
        """Bind parameters with consecutive numbers to functions. Compiled code does not see them.

        They take the place of functions that were bound before.

        Args:
            row: The numbers.
            read: Returns the value of a parameter, counted from 0.
            write: Sets it.
        """
        # A name in a range would be compared with each of its numbers.
        for key in [key for key in self._bound if isinstance(key, int) and key in row]:
            del self._bound[key]
        self._rows.insert(0, (row, read, write))
        self._first_in_row = min(self._first_in_row, row.start)

    def _row_of(self, number: int) -> tuple[range, ReadRow, WriteRow] | None:
        """Return the row that has a number, with its functions."""
        return next((row for row in self._rows if number in row[0]), None)

    def state(self) -> tuple[object, ...]:
        """Return all values, for a comparison. It differs if a row of functions was written."""
        callers = [(dict(numbers), dict(names)) for numbers, names in self._callers]
        own = dict(self.values), dict(self.locals), dict(self._names), dict(self._globals)
        return (*own, callers, self._row_writes)

    def push(self, arguments: Sequence[float]) -> None:
        """Enter a call, which has its own names and its own local numbers.

        Args:
            arguments: Values of #1, #2, ..; NaN for those that are not given.
        """
        self._callers.append((self.locals, self._names))
        self.locals = {
            number: value for number, value in enumerate(arguments, start=1) if value == value
        }
        self._own_names = {}
        self.calls += 1

    def pop(self) -> None:
        """Leave a call."""
        self.settle()
        self.calls += 1
        self.locals, self._own_names = self._callers.pop()

    def stored(self) -> dict[int, float]:
        """Return the values for the parameter file, by ascending number.

        They are those of the system, and those of the user that were set.
        """
        return {
            number: self.values[number]
            for number in sorted(self.values)
            if number in SYSTEM or number in self.kept
        }

    def _store(self, store: dict[int, float], number: int, value: float) -> None:
        """Store a value. A vacant value removes the parameter."""
        if self.changed is not None:
            self.changed.add(number)
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
        if self.macro and not (number in COMMON_MACRO or number in SYSTEM or number in self.kept):
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
            raise fault("parameter-read-only", f"{shown} is read-only", column=column)
        write(value)

    def _undefined(self, name: str, column: int) -> GcodeError:
        names = self.known_names()
        shown = self.written(name)
        near = difflib.get_close_matches(name, names, 1)
        hint = f"did you mean {self.written(near[0])}?" if near else "set it first"
        if not near and shown.startswith("#"):
            hint += f", or test it with EXISTS[{shown}]"
        return fault(
            "parameter-undefined",
            f"{shown} was never set",
            column=column,
            length=len(name) + 3,
            hint=hint,
        )


# Variables that a program of SINUMERIK defines; :mod:`cnc.gcode.sinumerik.variables` reads them.


class Variable(NamedTuple):
    """A variable.

    Attributes:
        name: Its name in capitals.
        kind: REAL, INT or BOOL.
        local: Whether it belongs to the call of a subprogram.
        sizes: Numbers of elements of an array, by index; empty for a single value.
        first: Number of the parameter of the first element of an array.
    """

    name: str
    kind: str
    local: bool = False
    sizes: tuple[int, ...] = ()
    first: int = 0

    @property
    def stored(self) -> str:
        """Name here."""
        return f"p{self.name.lower()}" if self.local else f"_v{self.name.lower()}"


Variables = tuple[Variable, ...]


class Names:
    """The variables of a program by their names."""

    def __init__(self, variables: Variables) -> None:
        self._variables = {variable.name: variable for variable in variables}
        self._ambiguous = {
            variable.name
            for variable in variables
            if self._variables[variable.name] is not variable
        }

    def is_variable(self, name: str) -> bool:
        """Whether a name is that of a variable. One that begins with _ needs no definition."""
        return name.startswith("_") or name in self._variables

    def is_ambiguous(self, name: str) -> bool:
        """Whether more than one program of the text has a variable of that name."""
        return name in self._ambiguous

    def find(self, name: str) -> Variable | None:
        """Return a variable; None if it is not defined, or more than once."""
        return None if name in self._ambiguous else self._variables.get(name)

    def stored(self, name: str) -> str:
        """Return the name here of an R parameter or a variable, which is written in capitals."""
        if re.fullmatch("R[0-9]+", name):
            return f"_r{int(name[1:])}"
        return self._variables.get(name, Variable(name, "REAL")).stored

    def in_compiled_code(self, written: str) -> tuple[str, bool]:
        """Return the name here of a name in a line, and whether compiled code may set it.

        The name of none is one that no program can write.
        """
        name = written.upper()
        if re.fullmatch("R[0-9]+", name):
            return self.stored(name), True
        variable = self.find(name)
        if variable is None and not (name.startswith("_") and not self.is_ambiguous(name)):
            return f"?{written}", False
        if variable is None:
            return self.stored(name), True
        return (
            (f"?{written}", False) if variable.sizes else (variable.stored, variable.kind == "REAL")
        )


# The parameter file: numbers and values of the parameters that stay between programs.
#
# Source: LinuxCNC, "Parameters", the parameter file.

_LINE = re.compile(r"\s*([0-9]+)\s+([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)\s*")


def read_parameters(path: str | os.PathLike[str]) -> dict[int, float]:
    """Read a parameter file: a number and its value in each line, by ascending number.

    Raises:
        UsageError: ``no-such-file``, ``unreadable-file``, ``parameter-file-line``,
            ``parameter-file-order``, with file and line.
    """
    name = os.fspath(path)
    try:
        text = Path(path).read_text(encoding="latin-1")
    except FileNotFoundError:
        hint = "to begin with, make an empty file of this name"
        raise UsageError(
            Diagnostic("no-such-file", f"there is no parameter file {name}", file=name, hint=hint)
        ) from None
    except OSError as error:
        raise UsageError(
            Diagnostic(
                "unreadable-file",
                f"cannot read the parameter file {name}: {error.strerror}",
                file=name,
            )
        ) from None
    values: dict[int, float] = {}
    last = 0
    for line, raw in enumerate(text.split("\n"), start=1):
        if not raw.strip():
            continue
        match = _LINE.fullmatch(raw)
        value = float(match[2]) if match else math.inf
        if match is None or not math.isfinite(value):
            raise _file_error(
                "parameter-file-line",
                "this is not the number of a parameter and its value",
                name,
                line,
                raw,
                "such as 5221 10.5",
            )
        number = int(match[1])
        if not (1 <= number <= LAST_MACRO or number in MORE_MACRO):
            raise _file_error(
                "parameter-file-line",
                f"there is no parameter {number}",
                name,
                line,
                raw,
                f"parameters are 1 to {LAST_MACRO}, and Haas' {MORE_MACRO[0]} to {MORE_MACRO[-1]}",
            )
        if number <= last:
            message = f"{number} comes after {last}"
            raise _file_error(
                "parameter-file-order",
                message,
                name,
                line,
                raw,
                "numbers must ascend, each given once",
            )
        values[number] = value
        last = number
    return values


def write_parameters(path: str | os.PathLike[str], values: Mapping[int, float]) -> None:
    """Write a parameter file. ``float`` reads each value back exactly.

    The old file is replaced when the new one is complete.

    Raises:
        UsageError: ``unwritable-file``.
    """
    replace_text(
        path,
        "".join(f"{number}\t{value!r}\n" for number, value in sorted(values.items())),
        "the parameter file",
    )


def replace_text(path: str | os.PathLike[str], text: str, name_in_messages: str) -> None:
    """Replace a file by a new one when the new one is complete.

    Args:
        path: The file.
        text: Its new text.
        name_in_messages: The file as messages call it, such as "the tool table".

    Raises:
        UsageError: ``unwritable-file``.
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
            Diagnostic(
                "unwritable-file",
                f"cannot write {name_in_messages} {name}: {error.strerror}",
                file=name,
            )
        ) from None


def _mode(target: Path) -> int:
    """Return the permissions of the file that is replaced, or those of a new file."""
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
