"""The operator's story in a browser, at a desk and on a phone, against the GRBL simulator.

The simulator is at a pseudo-terminal. It has limit switches, and a plate for the probe.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cnc.boards.grbl.simulator.environment import Environment
from cnc.boards.grbl.simulator.firmware_profile import GRBL
from cnc.boards.grbl.simulator.from_machine import settings_of
from cnc.boards.grbl.simulator.grbl_simulator import GrblSimulator
from cnc.boards.grbl.simulator.workpiece import HalfSpace, Workpiece
from cnc.kernels.code_cache import cache_folder
from cnc.machine.load import load_machine
from tests.support.paths import ROOT

sync_api = pytest.importorskip("playwright.sync_api")
expect = sync_api.expect

SECONDS = 120
"""For each wait. A wait ends when what it waits for is there, so this only limits a failure."""
PROGRAM = """\
G21 G90 G94 G17
(T1 D=6 CR=3 - ball end mill)
T1 M6
S9000 M3
G0 X20 Y20 Z5
G1 Z-3 F3000
G1 X60 F{feed}
G3 X60 Y50 J15 F6000
G1 X20
G3 X20 Y20 J-15
G0 Z5
M30
"""
MILL = """\
[machine]
name = "Quick mill"
[path]
max_feed = 100
tolerance = 0.01
[board]
kind = "grbl"
max_step_rate = 30_000
"""
AXIS = """\
[axes.{letter}]
steps_per_mm = 200
max_velocity = {velocity}
max_acceleration = 2000
max_jerk = 100_000
travel = [{low}, 0]
homing = {{ seek = {velocity}, latch = 20, pull_off = 1, end = "high" }}
"""
PLATE, PLATE_THICKNESS = -22.0, 10.0
"""Machine position of the top of the touch plate, and its thickness, mm."""
ZERO = "G10 L2 P1 X-150 Y-150 Z-32"
WRONG = "G21 G90\nG0 X1\nG1 X\n"
CHROMIUM = [
    "--no-sandbox",
    "--enable-unsafe-swiftshader",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--disable-gpu-compositing",
]


ALL_RULES = {"resultTypes": ["violations"]}
COLOUR_RULES = ALL_RULES | {"runOnly": ["color-contrast", "link-in-text-block"]}
"""A change of the theme changes colours only; these rules of all are about colours."""
AXE_OF_DIALOG = """async ([id, options]) => {
  const place = document.getElementById(id);
  if (id !== "key-map") document.getElementById(`${id}-text`).textContent = "what the dialog asks";
  place.showModal();
  const {violations} = await axe.run(`#${id}`, options);
  place.close();
  return violations.map(({id, impact, nodes}) => [id, impact, nodes[0].failureSummary]);
}"""


@pytest.fixture(scope="module")
def browser():
    program = shutil.which("chromium")
    if program is None:
        if os.environ.get("CI"):
            pytest.fail("chromium is not installed: apt-get install chromium")
        pytest.skip("chromium is not installed: apt-get install chromium")
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=CHROMIUM)
        yield started
        started.close()


@pytest.fixture(scope="module")
def mill(tmp_path_factory):
    """A quick machine, so that the tests wait less."""
    file = tmp_path_factory.mktemp("machine") / "mill.toml"
    axes = [("x", 100, -200), ("y", 100, -200), ("z", 60, -40)]
    tables = [AXIS.format(letter=a, velocity=b, low=c) for a, b, c in axes]
    file.write_text(MILL + "".join(tables), encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def port(mill):
    """The terminal of a simulated board that is not homed."""
    pty_server = pytest.importorskip("cnc.boards.grbl.simulator.pty_server")
    pytest.importorskip("termios")
    settings = settings_of(load_machine(str(mill)))
    around = Environment.of_travels(*(settings[number] for number in (130, 131, 132)))
    around.offset = (-12.0, -12.0, -6.0)  # The switches are near.
    around.workpiece = Workpiece((HalfSpace((0.0, 0.0, 1.0), PLATE),))
    board = GrblSimulator(GRBL, settings=settings, environment=around)
    with pty_server.PtyServer(board) as terminal:
        yield terminal.name


@pytest.fixture(scope="module")
def address(tmp_path_factory, mill, port):
    """The address of a server with an empty library."""
    folder = tmp_path_factory.mktemp("console")
    # The spindle of a run from a line needs no time here, in any process of the server.
    quick = folder / "quick.py"
    quick.write_text(
        "import cnc.cli, cnc.session.resume\n"
        "cnc.session.resume.SPIN_UP = 0.1\n"
        "if __name__ == '__main__':\n    cnc.cli.main()\n"
    )
    arguments = ["serve", "--port", "0", "--library", "jobs", "--machine", str(mill)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "HOME": str(folder)}
    environment["NUMBA_CACHE_DIR"] = str(cache_folder())
    server = subprocess.Popen(
        [sys.executable, quick, *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdout is not None
    yield server.stdout.readline().strip()
    server.send_signal(signal.SIGINT)
    server.wait(SECONDS)
    server.stdout.close()


@pytest.fixture
def page(browser, address):
    """A page at a desk whose script has no error."""
    context = browser.new_context(viewport={"width": 1400, "height": 1000})
    context.set_default_timeout(1000 * SECONDS)
    opened, wrong = context.new_page(), []
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    opened.goto(address)
    expect.set_options(timeout=1000 * SECONDS)
    expect(opened.locator("#state")).not_to_have_text("connecting")
    yield opened
    context.close()
    assert wrong == []


def picture(page, name):
    """Keep a picture for the documentation, in the folder that CNC_PICTURES names."""
    if folder := os.environ.get("CNC_PICTURES"):
        page.evaluate("scrollTo(0, 0)")
        page.screenshot(path=Path(folder) / f"{name}.png")


def upload(page, name, text):
    page.set_input_files(
        "#upload", {"name": name, "mimeType": "text/plain", "buffer": text.encode()}
    )
    expect(page.locator("#jobs")).to_have_value(name)


def take(page):
    page.click("#take")
    expect(page.locator("#holder")).to_have_text("you have control")


def connect(page, port):
    """Connect and home, unless a test before this one has."""
    if page.inner_text("#state") == "disconnected":
        page.select_option("#board", "grbl")
        page.fill("#port", port)
        page.click("#connection button")
        expect(page.locator("#state")).to_have_text("alarm")
        page.click("#home")
    expect(page.locator("#state")).to_have_text("idle")
    expect(page.locator("#lamps")).to_contain_text("X homed: on")


def enter(page, line):
    """Run a line, and wait for its end."""
    page.fill("#mdi", line)
    page.press("#mdi", "Enter")
    expect(page.locator("#message")).to_contain_text("MDI: done")


def work(page, axis):
    return float(page.inner_text(f"#work-{axis}").replace("\u2212", "-"))


def test_from_a_blank_board_to_the_first_part(page, port):
    take(page)
    connect(page, port)
    enter(page, "G53 G0 X-160 Y-155 Z-19")
    # Jog: a step, then continuously until the release.
    page.get_by_label("10 mm").check()
    page.get_by_role("button", name="Jog X plus", exact=True).click()
    expect(page.locator("#machine-x")).to_have_text("\u2212150.000")
    page.get_by_label("continuous").check()
    button = page.get_by_role("button", name="Jog Y plus", exact=True)
    button.dispatch_event("pointerdown", {"pointerId": 1})
    expect(page.locator("#state")).to_have_text("jogging")
    expect(page.locator("#machine-y")).not_to_have_text("\u2212155.000")
    button.dispatch_event("pointerup", {"pointerId": 1})
    expect(page.locator("#state")).to_have_text("idle")
    # Zero: the work position is 0 here, the machine position stays.
    machine_x = page.inner_text("#machine-x")
    page.click("#zero-all")
    expect(page.locator("#work-x")).to_have_text("0.000")
    expect(page.locator("#work-y")).to_have_text("0.000")
    assert page.inner_text("#machine-x") == machine_x
    # A value: Enter sets it, Escape does not.
    value = page.get_by_role("button", name="Set X to a value")
    for key, number in (("Enter", "7.5"), ("Escape", "2")):
        value.click()
        page.fill("#entry-value", number)
        page.press("#entry-value", key)
        expect(value).to_be_focused()
        expect(page.locator("#work-x")).to_have_text("7.500")
    page.get_by_role("button", name="Halve X").click()
    expect(page.locator("#work-x")).to_have_text("3.750")
    page.click("#zero-all")
    expect(page.locator("#work-x")).to_have_text("0.000")
    # Z by touch-off with a plate: the tool rests 2 mm above it.
    page.get_by_text("Probing", exact=True).click()
    cycle = page.locator("#cycles form").filter(has=page.get_by_text("Run probe_z"))
    for name, value in (("thickness", PLATE_THICKNESS), ("distance", 8), ("feed", 1200)):
        cycle.locator(f'[name="{name}"]').fill(str(value))
    cycle.get_by_role("button").click()
    expect(page.locator("#work-z")).to_have_text(f"{PLATE_THICKNESS + 2.0:.3f}")
    page.get_by_text("Probing", exact=True).click()
    expect(page.locator("#state")).to_have_text("idle")
    assert page.inner_text("#machine-z") == f"\u2212{-(PLATE + 2.0):.3f}"
    enter(page, "G0 Z12.5")
    expect(page.locator("#work-z")).to_have_text("12.500")
    picture(page, "console-connected")
    # A program with a fault is refused at its line.
    upload(page, "wrong.nc", WRONG)
    expect(page.locator("#outcome")).to_contain_text("refused")
    expect(page.locator("#findings")).to_contain_text("line 3: error number-missing")
    picture(page, "console-finding")
    # A right one is checked, cut in the simulation, and run.
    upload(page, "plate.nc", PROGRAM.format(feed=240))
    expect(page.locator("#outcome")).to_contain_text("checked")
    expect(page.locator("#limits")).to_contain_text("Z velocity")
    page.fill("#stock", "X0:80,Y15:55,Z-10:0")
    page.click("#simulate")
    expect(page.locator("#outcome")).to_contain_text("cm³ removed")
    # The stock has the work coordinates of the program, so the tool meets it.
    assert float(page.inner_text("#outcome").split()[1]) > 1.0
    picture(page, "console-cut")
    page.click("#run")
    expect(page.locator("#question")).to_be_visible()
    expect(page.locator("#question-text")).to_contain_text("ball end mill")
    # A key that was meant for a hold must not confirm.
    page.keyboard.press(" ")
    expect(page.locator("#question-text")).to_be_focused()
    page.click("#yes")
    expect(page.locator("#question")).not_to_be_visible()
    expect(page.locator("#state")).to_have_text("running")
    expect(page.locator("#work-x")).to_have_text(re.compile(r"^(2[1-9]|[3-9]\d)\."))
    picture(page, "console-running")
    page.click("#hold")
    expect(page.locator("#state")).to_contain_text("held")
    page.locator("#feed-override").fill("150")
    expect(page.locator("#feed-percent")).to_have_text("150 %")
    page.click("#resume")
    expect(page.locator("#lines .now")).to_have_count(1)
    page.click("#stop")
    expect(page.locator("#outcome")).to_contain_text("stopped at line")
    line = page.input_value("#from-line")
    assert int(line) == 7
    # The quick lines of the rest: the steps to them are confirmed.
    page.fill("#from-line", "8")
    page.check("#trust")
    page.click("#run")
    expect(page.locator("#question")).to_be_visible()
    expect(page.locator("#space")).to_have_attribute("data-approach", re.compile("[2-9]"))
    picture(page, "console-approach")
    page.click("#yes")
    expect(page.locator("#outcome")).to_contain_text("plate.nc: done")
    expect(page.locator("#from-line")).to_have_value("")
    page.click("#history-part summary")
    rows = page.locator("#history tbody tr")
    expect(rows).to_have_count(2)
    expect(rows.nth(0)).to_contain_text("done")
    expect(rows.nth(1)).to_contain_text("stopped")
    page.get_by_role("button", name="Log of plate.nc").click()
    expect(page.locator("#log")).to_contain_text("end: done")


def test_a_watcher_sees_the_machine_and_may_stop_it_only(page, browser, address, port):
    take(page)
    connect(page, port)
    enter(page, ZERO)
    upload(page, "slow.nc", PROGRAM.format(feed=60).replace("T1 M6\n", ""))
    expect(page.locator("#outcome")).to_contain_text("checked")
    context = browser.new_context(viewport={"width": 390, "height": 800}, has_touch=True)
    phone = context.new_page()
    phone.goto(address)
    expect(phone.locator("#holder")).to_contain_text("you watch")
    phone.click("#home")
    expect(phone.locator("#message")).to_contain_text("press Take control first")
    expect(phone.locator("#holder")).to_contain_text("you watch")
    page.check("#trust")
    page.click("#run")
    expect(phone.locator("#state")).to_have_text("running")
    picture(phone, "console-phone")
    phone.locator("#stop").tap()
    expect(page.locator("#outcome")).to_contain_text("stopped")
    upload(page, "tools.nc", "T2 M6\nG0 X1\n")
    expect(page.locator("#outcome")).to_contain_text("checked")
    page.click("#run")
    expect(phone.locator("#question-text")).to_contain_text("tool 2")
    # STOP, which the dialog covers, has its effect all the same.
    place = phone.locator("#stop").bounding_box()
    phone.mouse.click(place["x"] + 9, place["y"] + 9)
    expect(page.locator("#outcome")).to_contain_text("stopped")
    expect(phone.locator("#question")).not_to_be_visible()
    context.close()


def test_a_jog_ends_with_its_client(page, browser, address, port):
    context = browser.new_context(viewport={"width": 1200, "height": 900})
    other = context.new_page()
    other.goto(address)
    expect(other.locator("#state")).not_to_have_text("connecting")
    take(other)
    connect(other, port)
    enter(other, "G53 G0 X-190")
    other.get_by_label("continuous").check()
    other.fill("#jog-feed", "60")
    button = other.get_by_role("button", name="Jog X plus", exact=True)
    button.dispatch_event("pointerdown", {"pointerId": 1})
    expect(page.locator("#state")).to_have_text("jogging")
    context.close()
    expect(page.locator("#state")).to_have_text("idle")


@pytest.mark.parametrize(
    ("width", "theme", "parts"),
    [(1400, "light", [None]), (390, "dark", ["operate", "job", "picture", "more"])],
)
def test_the_page_is_accessible(browser, address, width, theme, parts):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    context = browser.new_context(
        viewport={"width": width, "height": 900}, color_scheme=theme, bypass_csp=True
    )
    opened = context.new_page()
    opened.goto(address)
    expect(opened.locator("#state")).not_to_have_text("connecting")
    expect(opened.locator("html")).to_have_attribute("data-theme", theme)
    opened.evaluate(axe.axe_script)
    for rules in (ALL_RULES, COLOUR_RULES):
        for part in parts:
            if part is not None:
                opened.click(f'nav button[data-part="{part}"]')
            found = opened.evaluate("options => axe.run(options)", rules)["violations"]
            grave = [each for each in found if each["impact"] in ("serious", "critical")]
            assert [(each["id"], each["nodes"][0]["failureSummary"]) for each in grave] == []
        for dialog in ("question", "entry", "key-map"):
            found = opened.evaluate(AXE_OF_DIALOG, [dialog, rules])
            assert [each for each in found if each[1] in ("serious", "critical")] == []
        opened.click("#theme")
    context.close()
