"""Parts of long programs for simulated boards: together they have all lines of the program."""

import pytest

from cnc.api import check
from tests.support.paths import PROGRAMS
from tests.support.programs.tool_parts import END, LONG, file_of, in_parts, parts_of

RISE = 20 * 400
"""Steps of the move to Z 20 before the first tool."""


@pytest.mark.parametrize("name", LONG)
def test_every_line_is_in_one_part(name):
    text = (PROGRAMS / name).read_text()
    parts = parts_of(text)
    head = text[: text.index("T1 M6\n")]
    assert all(part.startswith(head) and part.endswith(END) for part in parts)
    bodies = [part.removeprefix(head).removesuffix(END) for part in parts]
    assert head + "".join(bodies) + END == text
    assert len(bodies) > 3


@pytest.mark.soak
@pytest.mark.parametrize("name", LONG)
def test_the_parts_cut_as_much_as_the_whole(name, tmp_path):
    """The depths are the same: only moves to the first hole of a tool have another start."""

    def steps_of_z(file):
        report = check(file)
        assert report.ok, report.faults
        return int(report.steps["z"])

    whole = steps_of_z(PROGRAMS / name)
    first, *others = (steps_of_z(file_of(part, tmp_path)) for part in in_parts([name]))
    assert first + sum(each - RISE for each in others) == whole
