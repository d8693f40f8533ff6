"""Twelve tasks of an operator with the fewest presses: their number is that of the note."""

import re

import pytest

from tests.server.page.conftest import board_with_power
from tests.server.page.test_page import PROGRAM, ZERO, upload
from tests.server.page.test_page_design import opened_page
from tests.support.paths import ROOT
from tests.support.server.console_page import enter, expect, open_part, take
from tests.support.server.quick_mill import PLATE_THICKNESS
from tests.support.soak import share

NOTE = ROOT / "docs" / "notes" / "2026-11-29-console-layouts.md"
COLUMNS = ("desk", "phone", "gSender desk", "gSender phone")
CUT = PROGRAM.format(feed=240).replace("T1 M6\n", "")
TOOL_CHANGE = "G21 G90 F3000\nG0 X0 Y0 Z0\nT2 M6\nG0 X5\nG0 Z-1\nM30\n"
DISTANCE = "#steps input[aria-label='1 mm']"


def noted():
    """Return the touches of the note by task, of which None is a task that has no way."""
    text = NOTE.read_text(encoding="utf-8")
    head = f"| task | {' | '.join(COLUMNS)} |\n"
    rows = re.findall(r"^\| ([^|]+) \|(.*)\|$", text.partition(head)[2].partition("\n\n")[0], re.M)
    return {
        task: dict(
            zip(
                COLUMNS,
                (int(cell) if cell.strip().isdigit() else None for cell in cells.split("|")),
                strict=True,
            )
        )
        for task, cells in rows
        if not task.startswith("-")
    }


class Hand:
    """An operator whose presses are counted.

    Args:
        page: The page.
        port: The port of the board.
        size: That of the screen.
    """

    def __init__(self, page, port, size):
        self.page, self.port, self.size = page, port, size
        self.presses = 0

    def press(self, selector):
        """Press what is in sight; what has to be scrolled to is a touch more."""
        place = self.page.locator(selector)
        expect(place).to_be_visible()
        inside = """place => {
          const {left, right, top, bottom} = place.getBoundingClientRect();
          const at = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
          return place.contains(at);
        }"""
        self.presses += 1 if place.evaluate(inside) else 2
        place.click()

    def shows(self, selector, text):
        """Wait until a place has a text."""
        expect(self.page.locator(selector)).to_contain_text(text)

    def choose_file(self, selector, name, text):
        """Press what opens the file dialog, and choose a file there."""
        with self.page.expect_file_chooser() as chooser:
            self.press(selector)
        chooser.value.set_files({"name": name, "mimeType": "text/plain", "buffer": text.encode()})
        expect(self.page.locator("#jobs")).to_have_value(name)


def connect_and_take(hand):
    hand.shows("#guide", "no board is connected")
    hand.page.fill("#port", hand.port)
    hand.press("#connect")
    hand.shows("#holder", "you have control")
    expect(hand.page.locator("#state")).to_have_text(re.compile("alarm|idle"))


def home(hand):
    hand.press("#home")
    hand.shows("#machine-x", "\u22121.000")
    hand.shows("#state", "idle")


def jog_to_a_corner(hand):
    hand.press(DISTANCE)
    hand.press("#pad button[aria-label='Jog X minus Y minus']")
    hand.shows("#machine-x", "\u22122.000")
    hand.shows("#machine-y", "\u22122.000")


def zero_z_by_a_plate(hand):
    hand.press('nav button[data-part="probe"]')
    cycle = hand.page.locator("#cycles form").first
    for name, value in (("thickness", PLATE_THICKNESS), ("distance", 8), ("feed", 1200)):
        cycle.locator(f'[name="{name}"]').fill(str(value))
    hand.press("#cycles form:has-text('Run probe_z') button")
    hand.shows("#work-z", f"{PLATE_THICKNESS + 2.0:.3f}")


def load_a_program(hand):
    if hand.size == "desk":
        hand.choose_file("#upload-here", "plate.nc", CUT)
    else:
        hand.press('nav button[data-part="program"]')
        hand.choose_file("#job label:has(#upload)", "plate.nc", CUT)


def check_it(hand):
    hand.shows("#outcome", "checked")


def run_it(hand):
    hand.press("#run")
    hand.shows("#state", "running")
    expect(hand.page.locator("#work-x")).to_have_text(re.compile(r"^(2[1-9]|[3-9]\d)\."))


def hold(hand):
    hand.press("#hold")
    hand.shows("#state", "held")


def feed_faster(hand):
    hand.press('[data-override="feed"][data-by="10"]')
    hand.shows("#feed-percent", "110 %")


def resume(hand):
    hand.press("#resume")
    expect(hand.page.locator("#state")).to_have_text("running")


def stop_and_go_on(hand):
    hand.press("#stop")
    hand.shows("#outcome", "stopped at line")
    expect(hand.page.locator("#run-what")).to_have_text(re.compile(r"from line \d"))
    hand.press("#run")
    hand.shows("#question-text", "from line")
    hand.press("#yes")
    expect(hand.page.locator("#state")).to_have_text("running")


def change_a_tool(hand):
    hand.press("#pad button[aria-label='Jog Z plus']")
    hand.shows("#machine-z", "\u221218.000")
    hand.press("#readout button[aria-label='Zero Z here']")
    hand.shows("#work-z", "0.000")
    hand.press("#yes")
    hand.shows("#question-text", "after line 3")
    hand.press("#yes")
    hand.shows("#outcome", "tool.nc: done")


def beside_the_plate(page):
    enter(page, "G53 G0 X-160 Y-155 Z-19")


def at_zero(page):
    enter(page, ZERO)


def at_a_tool_change(page):
    page.click("#stop")
    expect(page.locator("#state")).to_have_text("idle")
    enter(page, "G10 L2 P1 X-100 Y-100 Z-19")
    upload(page, "tool.nc", TOOL_CHANGE)
    expect(page.locator("#outcome")).to_contain_text("checked")
    page.click("#run")
    expect(page.locator("#question-text")).to_contain_text("put in tool 2")


TASKS = (
    ("connect and take control", None, connect_and_take),
    ("home", None, home),
    ("jog to a corner: distance, diagonal", None, jog_to_a_corner),
    ("zero Z by a plate", beside_the_plate, zero_z_by_a_plate),
    ("load a program", at_zero, load_a_program),
    ("check it", None, check_it),
    ("run it", None, run_it),
    ("hold", None, hold),
    ("feed 10 % faster", None, feed_faster),
    ("resume", None, resume),
    ("stop in the middle and go on", None, stop_and_go_on),
    ("change a tool: jog Z, zero Z, go on, confirm", at_a_tool_change, change_a_tool),
)
"""Task of the note, what is done before it without counting, and the task."""


@pytest.fixture(scope="module", params=["desk", "phone"])
def size(request):
    return request.param


@pytest.fixture(scope="module")
def port(mill, size):
    """The terminal of a board that is not homed, for each screen."""
    with board_with_power(mill) as name:
        yield name


def test_each_task_takes_the_touches_of_the_note(browser, address, port, size):
    page, wrong = opened_page(browser, address, size, touch=size == "phone")
    hand, touches = Hand(page, port, size), {}
    for task, prepare, action in TASKS:
        if prepare is not None:
            prepare(page)
        hand.presses = 0
        action(hand)
        touches[task] = hand.presses
    assert touches == {task: row[size] for task, row in noted().items()}
    page.context.close()
    assert wrong == []


@pytest.mark.parametrize("size", share(["desk", "phone"], ["desk"]), indirect=True)
def test_connect_takes_control_from_nobody_else(browser, address, port, size):
    (page, wrong), (other, also_wrong) = (opened_page(browser, address, size) for _ in range(2))
    connect, watches = other.locator("#connect"), re.compile("press Take control first")
    take(page)
    open_part(page, "setup")
    if other.locator("#state").inner_text() == "disconnected":
        page.fill("#port", port)
        page.click("#connect")
    expect(other.locator("#state")).not_to_have_text("disconnected")
    expect(connect).to_have_attribute("data-why", watches)
    page.click("#take")
    expect(other.locator("#holder")).to_contain_text("nobody has control")
    # Another client may need the board that nobody controls now.
    expect(connect).to_have_attribute("data-why", watches)
    take(page)
    page.click("#connect")
    expect(other.locator("#state")).to_have_text("disconnected")
    expect(connect).to_have_attribute("data-why", watches)
    page.click("#take")
    expect(connect).to_have_attribute("data-why", "")
    page.context.close()
    other.context.close()
    assert wrong + also_wrong == []


def test_no_task_takes_more_touches_than_in_gsender():
    rows = noted()
    assert len(rows) == len(TASKS)
    for size in ("desk", "phone"):
        more = {
            task
            for task, row in rows.items()
            if (theirs := row[f"gSender {size}"]) is not None and row[size] > theirs
        }
        assert more == set()
