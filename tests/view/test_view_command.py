"""`cncrun view`: its files, and the exit codes of `check`."""

import base64
import hashlib
import json
import re
import subprocess
import sys
import zipfile
import zlib
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from cnc import cli
from cnc.view.figure import _view_matrix, traverses
from tests.support.paths import ROOT
from tests.support.soak import share
from tests.support.view.drawn import EVERYTHING, drawn

LITTLE_MOTION = ["", "G4 P1\nM2\n", "G0 X10\nM2\n", "G1 Z10 F600\nM2"]
GOOD = "G21 G90 G94\nG0 X5 Y5\nG1 X10 F600\nG2 X20 Y5 I5 J0\nM2\n"
HOSTILE = """(</script><script>hacked = 1</script>)
(<img src=x onerror="hacked = 1"> --> ]]> </style> \u2028 \u202e {{script}} <!--data-->)
G21 G90 ; <svg onload=hacked=1>
G1 X10 F600 (' " ` $& \\u003c \\x3c)
G0 Y10
M2
"""
PNG = b"\x89PNG\r\n\x1a\n"


class Elements(HTMLParser):
    """Collects the elements of a page: tag, attributes, text."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None], str]] = []
        self.open = False

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs), ""))
        self.open = True

    def handle_endtag(self, tag):
        self.open = False

    def handle_data(self, data):
        if self.open:
            tag, attributes, text = self.found[-1]
            self.found[-1] = (tag, attributes, text + data)


def elements(page: Path) -> list[tuple[str, dict[str, str | None], str]]:
    parser = Elements()
    parser.feed(page.read_text(encoding="utf-8"))
    return parser.found


def unpacked(page: Path, name: str) -> bytes:
    text = next(text for _, attributes, text in elements(page) if attributes.get("id") == name)
    return zlib.decompress(base64.b64decode(text, validate=True))


def integers(page: Path, name: str) -> np.ndarray:
    """Return the numbers of a column, decoded independently of data.js."""
    planes = (
        np.frombuffer(unpacked(page, f"column-{name}"), np.uint8).reshape(4, -1).astype(np.int64)
    )
    zigzag = planes[0] + (planes[1] << 8) + (planes[2] << 16) + (planes[3] << 24)
    return np.cumsum(np.where(zigzag % 2, -(zigzag // 2) - 1, zigzag // 2))


@pytest.fixture
def view(tmp_path, capfd):
    """Return a function: draw a program, and return exit code and standard error."""

    def carry_out(
        text: str | bytes, output: str, *options: str, name: str = "p.nc"
    ) -> tuple[int, str]:
        file = tmp_path / name
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        code = cli.exit_code(["view", str(file), "-o", str(tmp_path / output), "--quiet", *options])
        return code, capfd.readouterr().err

    return carry_out


@pytest.mark.parametrize(
    ("suffix", "begins"), [("html", b"<!doctype html>"), ("png", PNG), ("svg", b"<?xml")]
)
def test_a_picture_in_each_format(view, tmp_path, suffix, begins):
    assert view(GOOD, f"out.{suffix}") == (0, "")
    assert (tmp_path / f"out.{suffix}").read_bytes().startswith(begins)
    assert sorted(each.name for each in tmp_path.iterdir()) == [f"out.{suffix}", "p.nc"]


def test_a_lathe_is_drawn_with_z_to_the_right_and_diameters_upwards(view, tmp_path):
    machine = str(ROOT / "config" / "lathe.toml")
    text = "G21 G18 G99\nG97 S600 M3\nG0 X40. Z2.\nG1 Z-30. F0.2\nX50.\nM30\n"
    for name in ("out.svg", "out.html"):
        assert view(text, name, "--machine", machine, "--dialect", "fanuc") == (0, "")
    drawn_text = (tmp_path / "out.svg").read_text(encoding="utf-8")
    labels = set(re.findall("<!-- (.*?) -->", drawn_text))
    assert {"Z, mm", "X (diameter), mm", "50"} <= labels
    assert json.loads(unpacked(tmp_path / "out.html", "about"))["lathe"] is True
    right, up, towards = _view_matrix(flat=False, lathe=True)
    assert right @ (1, 2, 3) == 3
    assert up @ (1, 2, 3) == 1
    np.testing.assert_array_equal(np.cross(right, up), towards)


@pytest.mark.parametrize(
    ("text", "suffix"),
    [
        *((text, "html") for text in LITTLE_MOTION[:: share(1, 2)]),
        *((text, "png") for text in LITTLE_MOTION[:: share(1, 3)]),
    ],
)
def test_programs_with_little_motion_are_drawn(view, tmp_path, text, suffix):
    assert view(text, f"out.{suffix}") == (0, "")
    assert (tmp_path / f"out.{suffix}").stat().st_size > 1000


@pytest.mark.parametrize(
    "text",
    [
        "G21 G90\nG2 X20 Y5 I5 J9 F100\nM2\n",
        "G1 X1000 F600\nM2\n",
        "G1 X10\nM2\n",
        "G1 X1 F600\nG9999\nM2\n",
        "\x00\x01\x02",
        "G1 X10 F600\nG1 X[1/0]\nM2\n",
        "G38.2 X10\nM2\n",
    ],
)
def test_a_rejected_program_is_reported_as_by_check_and_writes_nothing(view, tmp_path, capfd, text):
    (tmp_path / "out.html").write_text("as before")
    code, messages = view(text, "out.html")
    checked = cli.exit_code(["check", str(tmp_path / "p.nc"), "--quiet"])
    assert (code, messages) == (checked, capfd.readouterr().err)
    assert code == 1
    assert (tmp_path / "out.html").read_text() == "as before"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["out.html", "p.nc"]


def test_wrong_usage_has_exit_code_2_and_a_hint(view, tmp_path, capfd):
    for output, code in (
        ("out.jpg", "output-format"),
        ("out", "output-format"),
        ("none/out.html", "can-not-write"),
    ):
        assert view(GOOD, output)[0] == 2
        assert view(GOOD, output)[1].startswith(f"{code}: ")
    assert cli.exit_code(["view", str(tmp_path / "p.nc")]) == 2
    assert (
        cli.exit_code(["view", str(tmp_path / "missing.nc"), "-o", str(tmp_path / "out.html")]) == 2
    )
    assert cli.exit_code(["view", str(tmp_path), "-o", str(tmp_path / "out.html")]) == 2
    assert "Traceback" not in capfd.readouterr().err
    message = f"output-over-input: an output would overwrite {tmp_path / 'p.html'}\n"
    over = f"{message}  help: give it another name\n"
    assert view(GOOD, "p.html", name="p.html") == (2, over)
    assert (tmp_path / "p.html").read_text() == GOOD


def test_without_matplotlib_only_the_page_can_be_drawn(view, monkeypatch, tmp_path):
    for module in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    code, messages = view(GOOD, "out.png")
    assert code == 2
    assert messages.startswith("drawing-missing: .png needs matplotlib")
    assert "pip install 'cncrun[view]'" in messages
    assert view(GOOD, "out.html") == (0, "")


def test_the_page_of_standard_input_contains_its_text(tmp_path):
    page = tmp_path / "out.html"
    command = [sys.executable, "-m", "cnc.cli", "view", "-", "-o", str(page), "--quiet"]
    assert subprocess.run(command, input=GOOD.encode(), check=False).returncode == 0
    assert unpacked(page, "text-0") == GOOD.encode()


def test_a_page_contains_the_program_as_data_only(view, tmp_path):
    """The elements do not depend on the text of the program, and its bytes are kept."""
    assert view(GOOD, "plain.html") == (0, "")
    for text in (
        HOSTILE.encode(),
        HOSTILE.encode("utf-8").replace(b"\n", b"\r\n"),
        b"\xef\xbb\xbfG0 X1 (\xff\xfe \x80)\nM2\n",
    ):
        assert view(text, "out.html", name="<img src=x onerror=hacked=1>&'\".nc") == (0, "")
        page = tmp_path / "out.html"
        shape = [(tag, attributes) for tag, attributes, _ in elements(page)]
        assert shape == [
            (tag, attributes) for tag, attributes, _ in elements(tmp_path / "plain.html")
        ]
        assert unpacked(page, "text-0") == text
        assert b"hacked" not in page.read_bytes() and b"onerror" not in page.read_bytes()


def test_the_policy_permits_one_script_and_no_requests(view, tmp_path):
    view(HOSTILE, "out.html")
    found = elements(tmp_path / "out.html")
    policy = next(
        attributes["content"]
        for tag, attributes, _ in found
        if attributes.get("http-equiv") == "Content-Security-Policy"
    )
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert "unsafe" not in policy and "http" not in policy
    for tag, rule in (("script", "script-src"), ("style", "style-src")):
        (text,) = [text for each, attributes, text in found if each == tag and not attributes]
        assert (
            rules[rule]
            == f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
        )
    kinds = {attributes.get("type") for tag, attributes, _ in found if tag == "script"}
    assert kinds == {None, "application/octet-stream"}
    assert not re.search(
        r"\b(src|href|srcset|on\w+)=",
        " ".join(f"{name}=" for _, attributes, _ in found for name in attributes),
    )


def test_the_columns_contain_the_picture(view, tmp_path):
    text = (ROOT / "programs" / "pocket.nc").read_text()
    assert view(text, "out.html", "--stock", "X-1:120,Y-2:80,Z-10:0") == (0, "")
    page, picture = tmp_path / "out.html", drawn(tmp_path / "p.nc").picture
    about = json.loads(unpacked(page, "about"))
    strokes = picture.strokes
    t = integers(page, "t") * about["tick"]
    assert np.abs(t - strokes.t).max() <= about["tick"]
    for axis, middle, expected in zip("xyz", about["middle"], strokes.position.T, strict=True):
        assert (
            np.abs(integers(page, axis) * about["quantum"] + middle - expected).max()
            <= 0.51 * about["quantum"]
        )
    for name in ("feed", "accel", "jerk"):
        assert (
            np.abs(integers(page, name) * about["units"][name] - getattr(strokes, name)).max()
            <= about["units"][name]
        )
    assert (integers(page, "rapid") == strokes.rapid).all()
    assert (integers(page, "origin-first") == picture.origins.first).all()
    assert about["stock"] == [[-1, 120], [-2, 80], [-10, 0]]
    assert about["travel"] == [[-10, 410], [-10, 310], [-110, 60]]
    assert about["tolerance"] == strokes.tolerance and len(strokes.t) < EVERYTHING.strokes
    assert f"within {strokes.tolerance:g} mm" in about["accuracy"]


def test_traverses_over_the_same_line_are_drawn_once(tmp_path):
    """Dashes of traverses in both directions would fill each other's gaps."""
    program = tmp_path / "p.nc"
    program.write_text(
        "G21 G90 G61.1 G0 Z10\nX30 Y30\nZ5\nZ15\nZ2\nG1 Z0 F600\nG0 Z20\nX0 Y0\nM2\n"
    )
    lines = sorted(np.round(line, 3).tolist() for line in traverses(drawn(program).picture.strokes))
    expected = [
        [[0, 0, 0], [0, 0, 10]],
        [[0, 0, 10], [30, 30, 10]],
        [[0, 0, 20], [30, 30, 20]],
        [[30, 30, 0], [30, 30, 20]],
    ]
    assert np.allclose(lines, expected, atol=0.01)


@pytest.mark.parametrize("suffix", share(["png", "svg"], ["svg"]))
def test_names_are_not_read_as_formulas_or_markup(view, tmp_path, suffix):
    """matplotlib reads text between dollars as a formula; fonts and XML lack some letters."""
    assert view(GOOD, f"out.{suffix}", name="a $\\frac{1$ <b> & \x01 \u4e2d.nc") == (0, "")
    if suffix == "svg":
        text = (tmp_path / "out.svg").read_text()
        assert ElementTree.fromstring(text).tag.endswith("svg")
        assert "<script" not in text
        again = tmp_path / "again.svg"
        assert view(GOOD, "again.svg", name="a $\\frac{1$ <b> & \x01 \u4e2d.nc") == (0, "")
        assert again.read_text() == text


@pytest.mark.soak
def test_an_installed_wheel_can_make_a_page(tmp_path):
    build = "import sys; from hatchling.build import build_wheel; print(build_wheel(sys.argv[1]))"
    done = subprocess.run(
        [sys.executable, "-c", build, str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    wheel, installed = tmp_path / done.stdout.split()[-1], tmp_path / "installed"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(installed)
    program = tmp_path / "p.nc"
    program.write_text(GOOD)
    draw = """
import sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
import numpy as np
from cnc.machine.load import load_machine
from cnc.report.targets import TextTarget
from cnc.report.result import Report
from cnc.view import page
from cnc.view.collect import Collector
assert page.__file__.startswith(sys.argv[1]), page.__file__
machine, target = load_machine(None), TextTarget(sys.argv[2])
picture = Collector(machine, page.SIZES, "p.nc", np.zeros(3)).picture()
page.write_page(target, picture, Report("p.nc", machine), [("p.nc", Path(sys.argv[3]))])
target.close()
"""
    out = tmp_path / "out.html"
    environment = {"PATH": "/usr/bin:/bin", "NUMBA_DISABLE_JIT": "1", "HOME": str(tmp_path)}
    subprocess.run(
        [sys.executable, "-c", draw, str(installed), str(out), str(program)],
        cwd=tmp_path,
        env=environment,
        check=True,
    )
    assert unpacked(out, "text-0") == GOOD.encode()
