"""Arrays of SINUMERIK: an element is a parameter of RS274/NGC with a number.

``R[R1]`` is the R parameter of a computed number. Source: Siemens, "SINUMERIK 840D sl/828D
Programming Manual, Job Planning", "User data": definition and initialisation of arrays.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import product

from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.siemens_variables import ROW, SPAN, Variable, arguments, as_type, written_name
from cnc.gcode.syntax.words import fault

R_PARAMETERS = range(1_000_000, 1_010_000)
"""Numbers of R[0], R[1], .."""
_LIST = re.compile(r"(SET|REP)\s*\((.*)\)", re.I)


def number_of(first: int, indices: Sequence[str]) -> str:
    """Return the expression for the number of an element, from those of its indices."""
    steps = (ROW, 1)[2 - len(indices) :]
    terms = (f"[{each}]*{step}" for each, step in zip(indices, steps, strict=True))
    return "+".join((str(first), *terms))


def following(variable: Variable, indices: Sequence[str], step: int) -> str:
    """Return the expression for the number of the element ``step`` places behind another one.

    The last index counts first. The element itself must be checked: behind a wrong last index, a
    right element of the next row may follow.
    """
    if len(indices) == 1 or not step:
        return f"{number_of(variable.first, indices)}+{step}"
    place, size = f"[[{indices[1]}]+{step}]", variable.sizes[1]
    row = f"[{indices[0]}]+FIX[{place}/{size}]"
    return number_of(variable.first, (row, f"{place} MOD {size}"))


def left_from(variable: Variable, indices: Sequence[str]) -> int | None:
    """Return the number of elements from one on; None if its indices are computed."""
    if not all(each.strip().isdigit() for each in indices):
        return None
    place = 0
    for index, size in zip(indices, variable.sizes, strict=True):
        place = place * size + int(index)
    return len(elements(variable)) - place


def elements(variable: Variable) -> list[int]:
    """Return the numbers of the elements of an array; the last index counts first."""
    steps = (ROW, 1)[2 - len(variable.sizes) :]
    return [
        variable.first + sum(index * step for index, step in zip(indices, steps, strict=True))
        for indices in product(*(range(size) for size in variable.sizes))
    ]


def list_of(text: str) -> tuple[str, list[str]] | None:
    """Return SET or REP, and the values in its brackets; None for another text."""
    found = _LIST.fullmatch(text.strip())
    return (found[1].upper(), arguments(found[2])) if found else None


def initial_values(variable: Variable, text: str) -> list[str] | None:
    """Return the values of the first elements by the SET(..) or REP(..) of a DEF; None for others.

    Elements without a value are 0.
    """
    count = len(elements(variable))
    found = list_of(text) if text else ("REP", ["0"])
    if found is None:
        return None
    kind, values = found
    if kind == "REP":
        if len(values) == 2 and values[1].isdigit():
            values = values[:1] * int(values[1])
        elif len(values) == 1:
            values *= count
        else:
            return None
    values += ["0"] * (count - len(values))
    return (
        [as_type(variable.kind, value or "0") for value in values] if len(values) == count else None
    )


def bind_arrays(parameters: Parameters, variables: Iterable[Variable]) -> None:
    """Bind the numbers of R parameters and of the elements of arrays; show names as written."""
    parameters.written = written_name

    def read(place: int) -> float:
        return parameters.name(f"_r{place}", 1)

    def write(place: int, value: float) -> None:
        parameters.set_name(f"_r{place}", value, 1)

    parameters.bind_row(R_PARAMETERS, read, write)
    for variable in variables:
        if variable.sizes:
            _bind(parameters, variable)


def _bind(parameters: Parameters, variable: Variable) -> None:
    """Bind the numbers of an array. Those around it are errors that name the array."""
    known = {number - variable.first + SPAN // 2 for number in elements(variable)}
    values: dict[int, float] = {}

    def checked(place: int) -> int:
        if place in known:
            return place
        shown = ",".join(str(size) for size in variable.sizes)
        last = " and ".join(f"0 to {size - 1}" for size in variable.sizes)
        message = f"an index is outside of {variable.name}[{shown}]"
        raise fault("parameter-number", message, column=1, hint=f"its indices are {last}")

    def write(place: int, value: float) -> None:
        values[checked(place)] = value

    begin = variable.first - SPAN // 2
    row = range(begin, begin + SPAN)
    parameters.bind_row(row, lambda place: values.get(checked(place), 0.0), write)
