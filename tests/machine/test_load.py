"""Loading of machine files, and errors that name file, key and line."""

from pathlib import Path

import pytest

from cnc.machine.load import load_machine, shipped_machines
from cnc.model.diagnostics import EXIT_USAGE, Diagnostic, MachineFileError

AXES = """[axes.x]
steps_per_mm = 100
max_velocity = 50
max_acceleration = 500
max_jerk = 9000
travel = [0, 100]
"""


def load(tmp_path: Path, text: str):
    file = tmp_path / "m.toml"
    file.write_text(text, encoding="utf-8")
    return load_machine(file)


def fault(tmp_path: Path, text: str) -> Diagnostic:
    with pytest.raises(MachineFileError) as caught:
        load(tmp_path, text)
    assert caught.value.exit_code == EXIT_USAGE
    found = caught.value.diagnostic
    assert found.file == str(tmp_path / "m.toml")
    return found


def test_every_shipped_machine_loads():
    assert {"default", "paper-nurbs", "grbl-uno", "stepper-uno", "lathe"} <= set(shipped_machines())
    for name, file in shipped_machines().items():
        machine = load_machine(file)
        assert machine == load_machine(name)
        expected = {"lathe": "xz", "trunnion": "xyzac"}.get(name, "xyz")
        assert machine.axis_names == tuple(expected)
        assert all(axis.travel for letter, axis in machine.axes.items() if letter != "c")


def test_without_a_name_the_default_is_loaded():
    assert load_machine(None) == load_machine("default")


def test_paper_machine_has_the_limits_of_the_paper():
    machine = load_machine("paper-nurbs")
    path = machine.path
    assert (path.max_feed, path.max_tangential_acceleration, path.max_normal_acceleration) == (
        300,
        2400,
        4903.325,
    )
    assert (path.max_jerk, path.chord_error, path.step_deviation, path.period) == (
        48000,
        0.001,
        0.001,
        0.001,
    )
    for axis in machine.axes.values():
        assert axis.steps_per_mm == 1000
        assert axis.max_acceleration is None
        assert axis.max_jerk is None
        assert axis.max_velocity >= 300


def test_all_tables_but_the_axes_have_defaults(tmp_path):
    machine = load(tmp_path, AXES)
    assert machine.name == "machine"
    assert machine.board.kind == "loopback"
    assert machine.board.max_step_rate == 200_000
    assert machine.program.dialect == "auto"
    assert machine.path.period == 0.001
    assert machine.path.max_tangential_acceleration is None


def test_columns_are_in_the_order_of_the_file(tmp_path):
    machine = load(
        tmp_path, AXES.replace("axes.x", "axes.z") + AXES + AXES.replace("axes.x", "axes.a")
    )
    assert machine.axis_names == ("z", "x", "a")


def test_utf8_with_byte_order_mark_and_windows_line_ends(tmp_path):
    file = tmp_path / "m.toml"
    file.write_bytes(
        b"\xef\xbb\xbf" + ("[machine]\nname = 'Fräse'\n" + AXES).replace("\n", "\r\n").encode()
    )
    assert load_machine(file).name == "Fräse"


def test_files_are_relative_to_the_machine_file(tmp_path):
    (tmp_path / "subs").mkdir()
    (tmp_path / "tools.tbl").write_text("")
    machine = load(tmp_path, AXES + '[program]\nsubroutines = ["subs"]\ntool_table = "tools.tbl"\n')
    assert machine.program.subroutines == ((tmp_path / "subs").resolve(),)
    assert machine.program.tool_table == (tmp_path / "tools.tbl").resolve()


def test_machine_is_frozen():
    with pytest.raises(ValueError, match="frozen"):
        load_machine().axes["x"].steps_per_mm = 1.0


@pytest.mark.parametrize(
    ("text", "line", "column", "words"),
    [
        (
            AXES.replace("= 100\n", "= 0\n"),
            2,
            1,
            "axes.x.steps_per_mm: must be greater than 0, not 0",
        ),
        (
            AXES.replace("= 50\n", "= -50\n"),
            3,
            1,
            "axes.x.max_velocity: must be at least 0.0001, not -50",
        ),
        (
            AXES.replace("= 50\n", "= inf\n"),
            3,
            1,
            "axes.x.max_velocity: must be a finite number, not inf",
        ),
        (
            AXES.replace("= 50\n", "= nan\n"),
            3,
            1,
            "axes.x.max_velocity: must be a finite number, not nan",
        ),
        (
            AXES.replace("= 50\n", "= true\n"),
            3,
            1,
            "axes.x.max_velocity: must be a number, not true",
        ),
        (
            AXES.replace("= 50\n", '= "fast"\n'),
            3,
            1,
            'axes.x.max_velocity: must be a number, not "fast"',
        ),
        (AXES.replace("max_velocity = 50\n", ""), 1, 2, "axes.x.max_velocity: is missing"),
        (AXES.replace("[0, 100]", "[100, 0]"), 6, 1, "axes.x.travel: must be [lowest, highest]"),
        (AXES.replace("[0, 100]", "[0]"), 6, 1, "axes.x.travel: must be [lowest, highest]"),
        (AXES.replace("[0, 100]", "[0, 1, 2]"), 6, 1, "axes.x.travel: must have at most 2 values"),
        (
            AXES.replace("[0, 100]", '[0, "far"]'),
            6,
            1,
            'axes.x.travel: must be a number, not "far"',
        ),
        (AXES.replace("[0, 100]", "100"), 6, 1, "axes.x.travel: must be a list, not 100"),
        (AXES + 'invert = "no"\n', 7, 1, 'axes.x.invert: must be true or false, not "no"'),
        ("[machine]\nname = 3\n" + AXES, 2, 1, "machine.name: must be text in quotes, not 3"),
        ("machine = 3\n" + AXES, 1, 1, "machine: must be a table, not 3"),
        ("[machine]\nname = 'x'\n", 0, 0, "axes: is missing"),
        ("[axes]\n", 1, 2, "axes: must have at least 1 value(s)"),
        ("axes = 3\n", 1, 1, "axes: must be a table, not 3"),
        ("path = 3\n" + AXES, 1, 1, "path: must be a table, not 3"),
        ("axes.x = 3\n", 1, 1, "axes.x: must be a table, not 3"),
        (AXES + "[board]\nbaud = 9600.5\n", 8, 1, "board.baud: must be a whole number, not 9600.5"),
        (AXES + "[board]\nkind = ''\n", 8, 1, 'board.kind: must not be empty, not ""'),
        (AXES + "[program]\ndialect = 'okuma'\n", 8, 1, "program.dialect: must be one of"),
        (
            AXES + "[program]\ntool_table = 4\n",
            8,
            1,
            "program.tool_table: must be the name of a file in quotes, not 4",
        ),
        (
            AXES + "[program]\nsubroutines = ['nowhere']\n",
            8,
            1,
            "program.subroutines: there is no ",
        ),
        (
            AXES.replace("= 50\n", "= 2001\n"),
            3,
            1,
            "axes.x.max_velocity: 2001 mm/s at 100 steps/mm is 200100 steps/s",
        ),
        (
            AXES.replace("max_acceleration = 500\n", ""),
            1,
            2,
            "axes.x.max_acceleration: nothing limits the acceleration",
        ),
        (AXES.replace("max_jerk = 9000\n", ""), 1, 2, "axes.x.max_jerk: nothing limits the jerk"),
    ],
)
def test_wrong_value_is_reported_with_its_key_and_line(tmp_path, text, line, column, words):
    found = fault(tmp_path, text)
    assert found.message.startswith(words)
    assert (found.code, found.line, found.column) == ("machine-file", line, column)


@pytest.mark.parametrize(
    ("text", "line", "column", "key", "hint"),
    [
        (
            AXES.replace("max_velocity", "max_velocty"),
            3,
            1,
            "axes.x.max_velocty",
            "did you mean max_velocity?",
        ),
        (AXES.replace("axes.x", "axes.q"), 1, 2, "axes.q", "known keys: x, y, z, a, b, c, u, v, w"),
        (AXES.replace("axes.x", "axes.X"), 1, 2, "axes.X", "did you mean x?"),
        (AXES + "[borad]\n", 7, 2, "borad", "did you mean board?"),
        (AXES + "[path]\nmax_fed = 3\n", 8, 1, "path.max_fed", "did you mean max_feed?"),
        (AXES + "[path]\nzzz = 3\n", 8, 1, "path.zzz", "known keys: max_feed, "),
        (
            "path = { max_feed = 3, perod = 1 }\n" + AXES,
            1,
            24,
            "path.perod",
            "did you mean period?",
        ),
        ("board.prot = 'x'\n" + AXES, 1, 1, "board.prot", "did you mean port?"),
        ("[machine]\nnam = 'x'\n" + AXES, 2, 1, "machine.nam", "did you mean name?"),
        ("name = 'x'\n" + AXES, 1, 1, "name", "put the name into [machine]"),
    ],
)
def test_unknown_key_is_reported_with_a_suggestion(tmp_path, text, line, column, key, hint):
    found = fault(tmp_path, text)
    assert found.message == f"{key}: there is no such key"
    assert (found.line, found.column) == (line, column)
    assert found.hint.startswith(hint)


@pytest.mark.parametrize(("begin", "end"), [("[", "]"), ("{a=", "}")])
@pytest.mark.parametrize("depth", [500, 20_000])
def test_a_file_that_is_nested_deeply_is_refused(tmp_path, begin, end, depth):
    inner = "1" if begin != "[" else ""
    found = fault(tmp_path, f"[axes.x]\nsteps_per_mm = {begin * depth}{inner}{end * depth}\n\n")
    assert (found.code, found.line) == ("machine-file-syntax", 2)
    assert "too deeply" in found.message


def test_syntax_error_has_line_and_column(tmp_path):
    found = fault(tmp_path, AXES.replace("= 50\n", "= = 50\n"))
    assert (found.code, found.line, found.column, found.text) == (
        "machine-file-syntax",
        3,
        16,
        "max_velocity = = 50",
    )
    assert fault(tmp_path, AXES + 'x = "').line == 7


def test_missing_file_lists_the_shipped_machines(tmp_path):
    with pytest.raises(MachineFileError) as caught:
        load_machine(tmp_path / "gone.toml")
    assert caught.value.diagnostic.code == "no-such-file"
    assert "paper-nurbs" in caught.value.diagnostic.hint


def test_unreadable_files_are_reported(tmp_path):
    (tmp_path / "m.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MachineFileError) as caught:
        load_machine(tmp_path / "m.toml")
    assert caught.value.diagnostic.code == "machine-file-encoding"
    with pytest.raises(MachineFileError) as caught:
        load_machine(tmp_path)
    assert caught.value.diagnostic.code == "machine-file-unreadable"


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("axes.x", "max_velocity", "1e-300"),
        ("axes.x", "max_acceleration", "1e-9"),
        ("axes.x", "max_jerk", "1e-9"),
        ("path", "max_feed", "1e-6"),
        ("path", "max_normal_acceleration", "1e-9"),
        ("path", "chord_error", "1e-300"),
        ("path", "step_deviation", "1e-300"),
        ("path", "period", "1e-300"),
        ("path", "period", "1e300"),
    ],
)
def test_a_limit_that_no_motion_can_keep_is_refused(tmp_path, table, key, value):
    axes = "".join(line for line in AXES.splitlines(keepends=True) if not line.startswith(key))
    extra = f"{key} = {value}\n"
    found = fault(tmp_path, axes + (extra if table == "axes.x" else f"[path]\n{extra}"))
    assert found.message.startswith(f"{table}.{key}: must be at ")


def test_a_huge_step_rate_is_written_with_few_digits(tmp_path):
    found = fault(tmp_path, AXES.replace("= 50\n", "= 1e300\n"))
    assert "is 1e+302 steps/s, but board.max_step_rate is 200000" in found.message


def test_path_limits_replace_those_of_the_axes(tmp_path):
    bare = AXES.replace("max_acceleration = 500\nmax_jerk = 9000\n", "")
    limits = (
        "[path]\nmax_tangential_acceleration = 10\nmax_normal_acceleration = 10\nmax_jerk = 10\n"
    )
    assert load(tmp_path, bare + limits).path.max_jerk == 10
    # A tangential limit alone would leave curves unbounded.
    found = fault(tmp_path, bare + limits.replace("max_normal_acceleration = 10\n", ""))
    assert "path.max_normal_acceleration" in found.hint
