"""The operator's story in a browser, at a desk and on a phone, against the GRBL simulator."""

import os
import re
from contextlib import suppress
from pathlib import Path

from tests.support.server.console_page import connect, enter, expect, open_part, take
from tests.support.server.quick_mill import PLATE, PLATE_THICKNESS

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
ZERO = "G10 L2 P1 X-150 Y-150 Z-32"
PRESSES = 12
WRONG = "G21 G90\nG0 X1\nG1 X\n"


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


def hold_down(button, page):
    """Hold a jog button until a page shows the jog.

    On a busy computer the dead-man may end it before: then the button is released and held again.
    """
    for _ in range(PRESSES):
        button.dispatch_event("pointerdown", {"pointerId": 1})
        with suppress(AssertionError):
            expect(page.locator("#state")).to_have_text("jogging", timeout=5000)
            return
        button.dispatch_event("pointerup", {"pointerId": 1})
    raise AssertionError("no jog is shown")


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
    expect(page.locator("#state")).to_have_text("idle")
    page.get_by_label("continuous").check()
    button = page.get_by_role("button", name="Jog Y plus", exact=True)
    hold_down(button, page)
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
    open_part(page, "probe")
    cycle = page.locator("#cycles form").filter(has=page.get_by_text("Run probe_z"))
    for name, value in (("thickness", PLATE_THICKNESS), ("distance", 8), ("feed", 1200)):
        cycle.locator(f'[name="{name}"]').fill(str(value))
    cycle.get_by_role("button").click()
    expect(page.locator("#work-z")).to_have_text(f"{PLATE_THICKNESS + 2.0:.3f}")
    expect(page.locator("#state")).to_have_text("idle")
    assert page.inner_text("#machine-z") == f"\u2212{-(PLATE + 2.0):.3f}"
    enter(page, "G0 Z12.5")
    expect(page.locator("#work-z")).to_have_text("12.500")
    picture(page, "console-connected")
    # A program with a fault is refused at its line.
    open_part(page, "program")
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
    open_part(page, "program")
    page.fill("#from-line", "8")
    page.check("#trust")
    page.click("#run")
    expect(page.locator("#question")).to_be_visible()
    expect(page.locator("#space")).to_have_attribute("data-approach", re.compile("[2-9]"))
    picture(page, "console-approach")
    page.click("#yes")
    expect(page.locator("#outcome")).to_contain_text("plate.nc: done")
    expect(page.locator("#from-line")).to_have_value("")
    open_part(page, "history")
    rows = page.locator("#history tbody tr")
    expect(rows).to_have_count(2)
    expect(rows.nth(0)).to_contain_text("done")
    expect(rows.nth(1)).to_contain_text("stopped")
    for row, outcome in ((1, "stopped"), (0, "done")):
        rows.nth(row).get_by_role("button", name="Log of plate.nc").click()
        expect(page.locator("#log")).to_contain_text(f"end: {outcome}")


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
    # The button is marked as one that cannot work now; a press says why.
    phone.locator("#home").dispatch_event("click")
    expect(phone.locator("#message")).to_contain_text("press Take control first")
    expect(phone.locator("#holder")).to_contain_text("you watch")
    open_part(page, "program")
    page.check("#trust")
    page.click("#run")
    expect(phone.locator("#state")).to_have_text("running")
    # Who watches sees the program that runs.
    expect(phone.locator("#jobs")).to_have_value("slow.nc")
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
    hold_down(button, page)
    context.close()
    expect(page.locator("#state")).to_have_text("idle")
