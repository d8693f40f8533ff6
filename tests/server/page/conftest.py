"""A browser, and a server of the console with a simulated GRBL board at a pseudo-terminal.

The browser starts once for the tests of this folder, the server and its board once for a file. The
browser ends with the last test: the event loop of Playwright runs in this thread, where other tests
need loops of their own.
The board has limit switches, and a plate for the probe.
"""

import os
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from cnc.compiled.code_cache import cache_folder
from cnc.gcode.reader import tables
from cnc.machine.load import load_machine
from cnc.simulators.grbl.firmware_profile import GRBL, settings_of
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.workpiece import Environment, HalfSpace, Workpiece
from tests.support.paths import ROOT
from tests.support.server.quick_mill import AXIS, MILL, PLATE, SECONDS
from tests.support.view.browser import NO_POPUP

WITHOUT = (
    *NO_POPUP,
    "HttpsFirstBalancedModeAutoEnable",
    "HttpsUpgrades",
    "MediaRouter",
    "OptimizationHints",
    "PaintHolding",
    "Translate",
)
"""Features of Chromium that are off. The list takes the place of that of Playwright."""
CHROMIUM = [
    f"--disable-features={','.join(WITHOUT)}",
    "--no-sandbox",
    "--enable-unsafe-swiftshader",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--disable-gpu-compositing",
    "--use-fake-ui-for-media-stream",
    "--use-fake-device-for-media-stream",
]


@pytest.fixture(scope="package")
def browser():
    program = shutil.which("chromium")
    if program is None:
        if os.environ.get("CI"):
            pytest.fail("chromium is not installed: apt-get install chromium")
        pytest.skip("chromium is not installed: apt-get install chromium")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=CHROMIUM)
        yield started
        started.close()


@pytest.fixture(scope="package")
def mill(tmp_path_factory):
    """A quick machine, so that the tests wait less."""
    file = tmp_path_factory.mktemp("machine") / "mill.toml"
    axes = [("x", 100, -200), ("y", 100, -200), ("z", 60, -40)]
    tables = [AXIS.format(letter=a, velocity=b, low=c) for a, b, c in axes]
    file.write_text(MILL + "".join(tables), encoding="utf-8")
    return file


@contextmanager
def board_with_power(mill):
    """Provide the terminal of a simulated board that is not homed."""
    pty_server = pytest.importorskip("cnc.simulators.grbl.ports")
    pytest.importorskip("termios")
    settings = settings_of(load_machine(str(mill)))
    around = Environment.of_travels(*(settings[number] for number in (130, 131, 132)))
    around.offset = (-12.0, -12.0, -6.0)  # The switches are near.
    around.workpiece = Workpiece((HalfSpace((0.0, 0.0, 1.0), PLATE),))
    board = GrblSimulator(GRBL, settings=settings, environment=around)
    with pty_server.PtyServer(board) as terminal:
        yield terminal.name


@pytest.fixture(scope="module")
def port(mill):
    """The terminal of a simulated board that is not homed."""
    with board_with_power(mill) as name:
        yield name


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
    # The tables of the grammars, which would be made again in an empty home.
    environment["XDG_CACHE_HOME"] = str(tables.cache_folder().parent)
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
    playwright = pytest.importorskip("playwright.sync_api")
    playwright.expect.set_options(timeout=1000 * SECONDS)
    playwright.expect(opened.locator("#state")).not_to_have_text("connecting")
    yield opened
    context.close()
    assert wrong == []
