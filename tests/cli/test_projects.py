"""The project file: what holds for a program, and why."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from cnc.batch.task import Task
from cnc.cli import exit_code
from cnc.cli.projects import machine_of
from cnc.machine.project import forget_projects, project_of, project_schema
from cnc.model.diagnostics import MachineFileError
from tests.support.paths import ROOT

AXIS = "steps_per_mm = 100\nmax_velocity = 100\nmax_acceleration = 500\nmax_jerk = 5000\n"
MACHINE = f"[axes.x]\n{AXIS}[axes.z]\n{AXIS}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with machines and programs in folders."""
    for name in ("mill", "lathe"):
        (tmp_path / f"{name}.toml").write_text(f"[machine]\nname = '{name}'\n{MACHINE}")
    for name in ("a.nc", "lathe/b.nc", "lathe/deep/c.nc", "other/d.tap"):
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("G21 G90\nG1 X1 F99999\nM30\n")
    return tmp_path


def held(folder: Path, program: str) -> dict[str, object]:
    """Return the values that hold for a program."""
    project = project_of(folder / program)
    assert project is not None
    return {key: item.value for key, item in project.settings(folder / program).items()}


def write(folder: Path, text: str, name: str = "cncrun.toml") -> None:
    """Write the project file."""
    (folder / name).write_text(text)


def test_the_last_table_that_names_a_program_counts(folder: Path) -> None:
    write(
        folder,
        """
        machine = "mill.toml"
        ignore = ["spindle-off"]
        dialect = "grbl"
        [[programs]]
        files = ["lathe/**/*.nc"]
        machine = "lathe.toml"
        ignore = ["feed-unreachable"]
        [[programs]]
        files = ["lathe/*.nc", "*.tap"]
        dialect = "fanuc"
        """,
    )
    both, mill, lathe = ("spindle-off", "feed-unreachable"), "mill.toml", "lathe.toml"
    for program, machine, dialect, ignored in (
        ("a.nc", mill, "grbl", both[:1]),
        ("lathe/b.nc", lathe, "fanuc", both),
        ("lathe/deep/c.nc", lathe, "grbl", both),
        ("other/d.tap", mill, "grbl", both[:1]),  # * is no folder
    ):
        wanted = {"machine": str(folder / machine), "dialect": dialect, "ignore": ignored}
        assert held(folder, program) == wanted


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("*.nc", {"a.nc"}),
        ("**/*.nc", {"a.nc", "lathe/b.nc", "lathe/deep/c.nc"}),
        ("lathe/", {"lathe/b.nc", "lathe/deep/c.nc"}),
        ("./lathe/?.nc", {"lathe/b.nc"}),
        ("other/**", {"other/d.tap"}),
    ],
)
def test_patterns_name_files_below_the_project(folder: Path, pattern: str, names: set[str]) -> None:
    write(folder, f"[[programs]]\nfiles = ['{pattern}']\nstyle = 'compact'\n")
    programs = ("a.nc", "lathe/b.nc", "lathe/deep/c.nc", "other/d.tap")
    project_of.__globals__["_project_in"].cache_clear()
    assert {name for name in programs if held(folder, name)} == names


def test_the_nearest_file_counts(folder: Path) -> None:
    write(folder, "style = 'compact'")
    write(folder / "lathe", "[tool.cncrun]\nstyle = 'readable'", "pyproject.toml")
    write(folder / "other", "[tool.ruff]\nline-length = 3", "pyproject.toml")  # not ours
    assert held(folder, "lathe/deep/c.nc") == {"style": "readable"}
    assert held(folder, "other/d.tap") == {"style": "compact"}


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        ("ignor = []", ":1:1", "ignor: there is no such key"),
        ("style = 'pretty'", ":1:1", "style: must be one of 'readable' or 'compact'"),
        ("\nignore = ['feed-unreachabel']", ":2:1", "no warning or note has the code"),
        ("machine = 'none.toml'", ":1:1", "machine: there is no"),
        ("[[programs]]\nstyle = 'compact'", ":1:3", "programs.files: is missing"),
        (
            "[[programs]]\nfiles = ['*']\nmachine = 'mill.toml'\n"
            "[[programs]]\nfiles = ['*']\nmachine = 'none.toml'",
            ":6:1",
            "programs.machine: there is no",
        ),
        ("ignore = 'spindle-off'", ":1:1", "ignore: must be a list"),
        ("jobs = 0", ":1:1", "jobs: must be at least 1"),
        ("a = = 2", ":1:5", "Invalid value"),
    ],
)
def test_faults_name_the_place(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str, place: str, message: str
) -> None:
    write(folder, text)
    assert exit_code(["check", str(folder / "a.nc")]) == 2
    shown = capsys.readouterr().err
    assert f"{folder / 'cncrun.toml'}{place}: project-file" in shown
    assert message in shown


def summary(folder: Path, *arguments: str) -> dict[str, object]:
    """Check a program; return its summary and the exit code."""
    file = folder / "summary.json"
    code = exit_code(["check", *arguments, "--quiet", "--json", str(file)])
    read = json.loads(file.read_text())
    return {"code": code, "machine": read["machine"], "found": [e["code"] for e in read["errors"]]}


def test_a_check_follows_the_project_and_options_count_more(folder: Path) -> None:
    program = str(folder / "a.nc")
    write(folder, "machine = 'mill.toml'\nignore = ['feed-unreachable']")
    assert summary(folder, program) == {"code": 0, "machine": "mill", "found": []}
    given = summary(folder, program, "--machine", str(folder / "lathe.toml"))
    assert given == {"code": 0, "machine": "lathe", "found": []}
    project_of.__globals__["_project_in"].cache_clear()
    write(folder, "machine = 'mill.toml'\nerrors = ['feed-unreachable']")
    assert summary(folder, program) == {"code": 1, "machine": "mill", "found": ["feed-unreachable"]}


def test_nothing_runs_after_a_warning_that_counts_as_an_error(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program = folder / "a.nc"
    program.write_text("G21 G90\nG1 X1 F100\nM30\n")
    text = "machine = 'mill.toml'\ndialect = 'fanuc'\n"
    pulses = folder / "pulses.npz"
    write(folder, text)
    assert exit_code([str(program), "--quiet", "--pulses", str(pulses)]) == 0
    pulses.unlink()
    project_of.__globals__["_project_in"].cache_clear()
    write(folder, text + "errors = ['decimal-point-missing']")
    assert exit_code([str(program), "--pulses", str(pulses)]) == 1
    assert f"{program}:2:4: decimal-point-missing" in capsys.readouterr().err
    assert not pulses.exists()


def test_each_program_of_a_check_has_its_own_machine(folder: Path) -> None:
    write(
        folder,
        "machine = 'mill.toml'\n[[programs]]\nfiles = ['lathe/']\nmachine = 'lathe.toml'\n",
    )
    file = folder / "summary.json"
    assert exit_code(["check", str(folder), "--quiet", "--json", str(file)]) == 0
    machines = {
        Path(each["program"]).name: each["machine"] for each in json.loads(file.read_text())
    }
    assert machines == {"a.nc": "mill", "b.nc": "lathe", "c.nc": "lathe", "d.tap": "mill"}


def test_programs_of_several_machines_share_their_processes(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A set of processes for each machine would load the kernels again and again."""
    write(
        folder,
        "machine = 'mill.toml'\n[[programs]]\nfiles = ['lathe/']\nmachine = 'lathe.toml'\n",
    )
    sets: list[list[str]] = []

    def check_here(tasks: Sequence[Task], *_: object) -> Iterator[tuple[int, object]]:
        sets.append([task.machine.name for task in tasks])
        yield from enumerate([task.perform() for task in tasks])

    monkeypatch.setattr("cnc.batch.pool._check_locally", check_here)
    assert exit_code(["check", str(folder), "--quiet"]) == 0
    assert sets == [["mill", "lathe", "lathe", "mill"]]


def test_config_says_what_holds_and_why(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(folder, "style = 'compact'\n[[programs]]\nfiles = ['lathe/']\nmachine = 'lathe.toml'\n")
    assert exit_code(["config", str(folder / "lathe" / "b.nc")]) == 0
    rows = [line.split(maxsplit=2) for line in capsys.readouterr().out.splitlines()]
    file = str(folder / "cncrun.toml")
    assert rows == [
        ["machine", str(folder / "lathe.toml"), f"{file}, [[programs]] with lathe/"],
        ["style", "compact", file],
    ]


def test_the_form_follows_the_project(
    folder: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    write(folder, "machine = 'mill.toml'\nstyle = 'compact'")
    assert exit_code(["format", str(folder / "a.nc")]) == 0
    assert capsysbinary.readouterr().out == b"G21G90\nG1X1F99999\nM30\n"


def test_the_schema_has_each_key() -> None:
    """``cncrun schema project > docs/schemas/project.schema.json`` writes it."""
    schema = project_schema()
    shipped = ROOT / "docs" / "schemas" / "project.schema.json"
    assert json.loads(shipped.read_text(encoding="utf-8")) == schema
    assert {"machine", "programs", "jobs", "errors"} <= schema["properties"].keys()
    assert schema["$defs"]["Programs"]["required"] == ["files"]


def test_the_programs_of_the_repository_are_right(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["check", str(ROOT / "programs"), "--quiet"]) == 0, capsys.readouterr().err


def test_an_unreadable_project_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "cncrun.toml").write_bytes(b"\xff")
    with pytest.raises(MachineFileError, match="project-file-unreadable"):
        project_of(tmp_path / "a.nc")


def test_diff_reads_each_program_as_its_project_says(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second one is in another language."""
    write(folder, 'machine = "mill.toml"\n[[programs]]\nfiles = ["b.nc"]\ndialect = "heidenhain"\n')
    (folder / "a.nc").write_text("G21 G90\nG1 X5 F600\nM30\n")
    (folder / "b.nc").write_text("BEGIN PGM B MM\nL X+6 F600\nEND PGM B MM\n")
    assert exit_code(["diff", str(folder / "a.nc"), str(folder / "b.nc")]) == 0
    assert "1 mm" in capsys.readouterr().out


def test_diff_refuses_programs_of_two_machines(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(
        folder,
        'machine = "mill.toml"\n[[programs]]\nfiles = ["lathe/*.nc"]\nmachine = "lathe.toml"\n',
    )
    programs = [str(folder / "a.nc"), str(folder / "lathe/b.nc")]
    assert exit_code(["diff", *programs]) == 2
    assert "--machine" in capsys.readouterr().err
    # Followed to the letter, the advice leads to the result.
    assert exit_code(["diff", *programs, "--machine", str(folder / "mill.toml")]) == 0


def test_the_machine_for_all_programs_of_a_folder(tmp_path):
    assert machine_of(tmp_path) is None
    for name in ("mill.toml", "lathe.toml"):
        (tmp_path / name).touch()
    lathe = '[[programs]]\nfiles = ["lathe/*.nc"]\nmachine = "lathe.toml"\n'
    (tmp_path / "cncrun.toml").write_text(f'machine = "mill.toml"\n{lathe}')
    forget_projects()
    assert machine_of(tmp_path / "jobs") == str(tmp_path / "mill.toml")
    (tmp_path / "cncrun.toml").write_text(lathe)
    forget_projects()
    assert machine_of(tmp_path / "jobs") is None
