"""Parameters: ranges, scope, bound parameters, and the parameter file."""

from __future__ import annotations

import math
import os
import stat
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.gcode.reader.parameters import SYSTEM, Parameters, read_parameters, write_parameters
from cnc.model.diagnostics import GcodeError, UsageError


def code_of(action: object) -> str:
    with pytest.raises(GcodeError) as caught:
        action()  # type: ignore[operator]
    assert caught.value.diagnostic.column == 7
    return caught.value.diagnostic.code


@pytest.mark.parametrize("number", [1, 30, 31, 100, 5000, 5161, 5390, 5602])
def test_a_number_is_0_until_it_is_set(number: int) -> None:
    known = Parameters()
    assert known.number(number, 7) == 0
    known.set_number(number, -2.5, 7)
    assert known.number(number, 7) == -2.5
    assert known.number(number + 0.9e-4, 7) == -2.5


def test_the_first_coordinate_system_is_in_use_from_the_start() -> None:
    assert Parameters().number(5220, 7) == 1


@pytest.mark.parametrize("number", [0, -1, 5603, 1e6, 1.5, 1.001, -0.4])
def test_unknown_numbers_are_errors(number: float) -> None:
    known = Parameters()
    assert code_of(lambda: known.number(number, 7)) == "parameter-number"
    assert code_of(lambda: known.set_number(number, 1.0, 7)) == "parameter-number"


@pytest.mark.parametrize("number", [34, 99, 200, 499, 1000, 3001, -1, 1.5])
def test_unknown_macro_variables_are_errors(number: float) -> None:
    known = Parameters(macro=True)
    assert code_of(lambda: known.number(number, 7)) == "parameter-number"
    assert code_of(lambda: known.set_number(number, 1.0, 7)) == "parameter-number"


@pytest.mark.parametrize("number", [1, 33, 100, 199, 500, 999])
def test_a_variable_is_vacant_until_set_and_when_set_to_vacant(number: int) -> None:
    known = Parameters(macro=True)
    assert math.isnan(known.number(number, 7))
    known.set_number(number, 0.0, 7)
    assert known.number(number, 7) == 0
    known.set_number(number, math.nan, 7)
    assert math.isnan(known.number(number, 7))
    assert number not in known.values and number not in known.locals


def test_variable_0_is_always_vacant() -> None:
    known = Parameters(macro=True)
    assert math.isnan(known.number(0, 7))
    assert code_of(lambda: known.set_number(0, 1.0, 7)) == "parameter-read-only"
    assert known.number(5221, 7) == 0, "the coordinate systems are there"


def test_setting_3000_is_an_alarm() -> None:
    assert code_of(lambda: Parameters(macro=True).set_number(3000, 1.0, 7)) == "macro-alarm"
    Parameters().set_number(3000, 1.0, 7)


def test_names() -> None:
    known = Parameters()
    assert code_of(lambda: known.name("a", 7)) == "parameter-undefined"
    assert not known.exists("a")
    known.set_name("a", 1.0, 7)
    known.set_name("_g", 2.0, 7)
    assert (known.name("a", 7), known.name("_g", 7)) == (1, 2)
    assert known.exists("a") and known.exists("_g")


def test_a_call_has_its_own_names_and_numbers() -> None:
    known = Parameters()
    known.set_number(1, 10.0, 7)
    known.set_number(31, 11.0, 7)
    known.set_name("a", 12.0, 7)
    known.set_name("_g", 13.0, 7)
    known.push([5.0, math.nan, 7.0])
    assert [known.number(number, 7) for number in (1, 2, 3, 4, 31)] == [5, 0, 7, 0, 11]
    assert not known.exists("a")
    assert known.name("_g", 7) == 13
    known.set_number(1, -1.0, 7)
    known.set_number(31, -2.0, 7)
    known.set_name("a", -3.0, 7)
    known.set_name("_g", -4.0, 7)
    known.push([])
    assert known.number(1, 7) == 0
    known.pop()
    known.pop()
    assert [known.number(1, 7), known.number(31, 7), known.name("a", 7), known.name("_g", 7)] == [
        10,
        -2,
        12,
        -4,
    ]


def test_an_argument_that_is_not_given_is_vacant() -> None:
    known = Parameters(macro=True)
    known.push([1.0, math.nan, 3.0])
    assert [known.number(number, 7) for number in (1, 3, 33)] == [
        1,
        3,
        pytest.approx(math.nan, nan_ok=True),
    ]
    assert math.isnan(known.number(2, 7))


def test_bound_parameters() -> None:
    known, position = Parameters(), [1.0]
    known.bind(5420, lambda: position[0])
    known.bind("_x", lambda: position[0])
    known.bind(3000, lambda: 0.0, position.append)
    position[0] = 4.5
    assert (known.number(5420, 7), known.name("_x", 7)) == (4.5, 4.5)
    assert known.exists("_x") and known.exists(5420)
    assert code_of(lambda: known.set_number(5420, 1.0, 7)) == "parameter-read-only"
    assert code_of(lambda: known.set_name("_x", 1.0, 7)) == "parameter-read-only"
    known.set_number(3000, 8.0, 7)
    assert position == [4.5, 8.0]
    assert not known.stored().keys() & {3000, 5420}


def test_values_stored_in_the_parameter_file() -> None:
    known = Parameters()
    for number in (1, 30, 31, 5000, 5061, 5070, 5161, 5221, 5390, 5399, 5602):
        known.set_number(number, 0.5, 7)
    known.set_name("_g", 1.0, 7)
    assert known.stored().keys() == SYSTEM | {31, 5000}
    assert list(known.stored()) == sorted(known.stored())
    macro = Parameters(macro=True)
    for number in (1, 33, 100, 199, 500, 999):
        macro.set_number(number, 0.5, 7)
    assert macro.stored().keys() == SYSTEM | {500, 999}


# The file


@given(st.dictionaries(st.integers(1, 5602), st.floats(allow_nan=False, allow_infinity=False)))
def test_stored_values_are_read_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, values: dict[int, float]
) -> None:
    path = tmp_path_factory.getbasetemp() / "rs274ngc.var"
    write_parameters(path, values)
    found = read_parameters(path)
    assert {number: value.hex() for number, value in found.items()} == {
        number: value.hex() for number, value in values.items()
    }
    assert list(found) == sorted(values)


def test_the_format_of_the_parameter_file(tmp_path: Path) -> None:
    path = tmp_path / "a.var"
    write_parameters(path, {5221: 1.5, 31: -2.0})
    assert path.read_bytes() == b"31\t-2.0\n5221\t1.5\n"


def test_a_parameter_file_of_linuxcnc_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.var"
    path.write_bytes(
        b"5161\t0.000000\r\n  5162   -10.5  \n\n5220\t1.000000\n5221 +.25\n5222 1e-3\n"
    )
    assert read_parameters(path) == {5161: 0, 5162: -10.5, 5220: 1, 5221: 0.25, 5222: 0.001}


@pytest.mark.parametrize(
    ("text", "code", "line", "column"),
    [
        ("5161 0\n5162", "parameter-file-line", 2, 1),
        ("5161 0\n  x 1", "parameter-file-line", 2, 3),
        ("5161 1 2", "parameter-file-line", 1, 1),
        ("5161 1_0", "parameter-file-line", 1, 1),
        ("5161 nan", "parameter-file-line", 1, 1),
        ("5161 inf", "parameter-file-line", 1, 1),
        ("5161 1e999", "parameter-file-line", 1, 1),
        ("5161.5 1", "parameter-file-line", 1, 1),
        ("-5 1", "parameter-file-line", 1, 1),
        ("0 1", "parameter-file-line", 1, 1),
        ("7961 1", "parameter-file-line", 1, 1),
        ("; comment", "parameter-file-line", 1, 1),
        ("\u0665 1", "parameter-file-line", 1, 1),
        ("5162 1\n5161 1", "parameter-file-order", 2, 1),
        ("5162 1\n5162 1", "parameter-file-order", 2, 1),
    ],
)
def test_a_malformed_file_is_refused_at_its_line(
    tmp_path: Path, text: str, code: str, line: int, column: int
) -> None:
    path = tmp_path / "a.var"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        read_parameters(path)
    found = caught.value.diagnostic
    assert (found.code, found.file, found.line, found.column) == (code, str(path), line, column)
    assert found.text and found.hint


def test_a_missing_or_unreadable_parameter_file(tmp_path: Path) -> None:
    for path, code in ((tmp_path / "none.var", "no-such-file"), (tmp_path, "unreadable-file")):
        with pytest.raises(UsageError) as caught:
            read_parameters(path)
        assert caught.value.diagnostic.code == code


def test_a_failed_write_leaves_the_file_unchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.var"
    write_parameters(path, {31: 1.0})

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(UsageError) as caught:
        write_parameters(path, {31: 2.0})
    assert caught.value.diagnostic.code == "unwritable-file"
    assert "No space left" in caught.value.diagnostic.message
    assert read_parameters(path) == {31: 1.0}
    assert list(tmp_path.iterdir()) == [path], "no draft is left"


def test_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as caught:
        write_parameters(tmp_path / "none" / "a.var", {})
    assert caught.value.diagnostic.code == "unwritable-file"


@pytest.mark.skipif(os.name == "nt", reason="rights of another kind")
def test_permissions_and_links_are_kept(tmp_path: Path) -> None:
    target, link = tmp_path / "a.var", tmp_path / "link.var"
    target.write_text("")
    target.chmod(0o640)
    link.symlink_to(target)
    write_parameters(link, {31: 1.0})
    assert link.is_symlink()
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert read_parameters(target) == {31: 1.0}
    mask = os.umask(0o027)
    try:
        write_parameters(tmp_path / "new.var", {})
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "new.var").stat().st_mode) == 0o640
