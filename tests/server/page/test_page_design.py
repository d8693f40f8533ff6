"""The design of the page: targets, colours, no shift, accessibility, and what is done by hand."""

import os
import re
from pathlib import Path

import pytest

from tests.server.page.test_page import PROGRAM, ZERO, upload, work
from tests.support.server.console_page import connect, enter, expect, open_part, take
from tests.support.server.quick_mill import SECONDS
from tests.support.soak import share

PARTS = ["run", "setup", "program", "probe", "tools", "history", "settings"]
SIZES = {"desk": (1400, 900), "touch": (1920, 1080), "tablet": (820, 1180), "phone": (390, 844)}
PICTURES = {
    "desk": PARTS,
    "touch": ["run"],
    "tablet": ["setup"],
    "phone": ["run", "setup", "program"],
}
"""The pictures of the documentation; that of the touch panel is made in glove mode."""
SMALLEST = {False: 44, True: 64}
"""Least height and width of what is pressed, px: without and with gloves."""
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
TOO_SMALL = """least => {
  const parts = "button, .button, select, label.check, .segments label, "
    + "input:not([type=checkbox], [type=radio], [type=range], [type=file])";
  const shown = [...document.querySelectorAll(parts)].filter(place => place.checkVisibility());
  return shown.map(place => {
    const {width, height} = place.getBoundingClientRect();
    return [place.id || place.textContent.trim(), Math.round(10 * width) / 10, height];
  }).filter(([, width, height]) => width < least - 0.5 || height < least - 0.5);
}"""
PLACES = """() => Object.fromEntries(
  [...document.querySelectorAll("header *, nav, nav button, main, #dock *, #stage > *, footer *")]
    .filter(place => place.checkVisibility() && !place.closest("svg"))
    .map((place, k) => {
      const {x, y, width, height} = place.getBoundingClientRect();
      return [`${k} ${place.id}`, [x, y, width, height].map(Math.round)];
    }))"""
COLOURS = """() => {
  const of = (selector, name) => getComputedStyle(document.querySelector(selector))[name];
  const variable = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const red = of("#stop > span", "backgroundColor");
  const others = [...document.querySelectorAll("body *")].filter(place => !place.closest("#stop"))
    .filter(place => {
      const {backgroundColor, color, borderTopColor} = getComputedStyle(place);
      return [backgroundColor, color, borderTopColor].includes(red);
    });
  return {stop: variable("--stop"), error: variable("--error"), others: others.length,
    shape: of("#stop > span", "clipPath")};
}"""


def channels(colour):
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


def hue(colour):
    """Hue in degrees, by the usual formula of HSV."""
    red, green, blue = channels(colour)
    most, least = max(red, green, blue), min(red, green, blue)
    span = most - least
    if most == red:
        return 60.0 * ((green - blue) / span % 6)
    if most == green:
        return 60.0 * ((blue - red) / span + 2)
    return 60.0 * ((red - green) / span + 4)


def opened_page(browser, address, size, *, theme="light", touch=False):
    width, height = SIZES[size]
    context = browser.new_context(
        viewport={"width": width, "height": height},
        color_scheme=theme,
        has_touch=touch,
        bypass_csp=True,
    )
    context.set_default_timeout(1000 * SECONDS)
    expect.set_options(timeout=1000 * SECONDS)
    page, wrong = context.new_page(), []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(address)
    expect(page.locator("#state")).not_to_have_text("connecting")
    return page, wrong


@pytest.fixture(scope="module")
def desk(browser, address, port):
    """A page at a desk that has control of a homed machine, with a program that is checked."""
    page, wrong = opened_page(browser, address, "desk")
    take(page)
    connect(page, port)
    enter(page, ZERO)
    upload(page, "plate.nc", PROGRAM.format(feed=240).replace("T1 M6\n", ""))
    expect(page.locator("#outcome")).to_contain_text("checked")
    yield page
    page.context.close()
    assert wrong == []


def picture(page, name):
    """Keep a picture for the documentation, in the folder that CNC_PICTURES names."""
    if folder := os.environ.get("CNC_PICTURES"):
        page.evaluate("document.getElementById('dismiss').click()")
        page.evaluate("() => new Promise(done => setTimeout(done, 500))")  # Until it is drawn.
        page.screenshot(path=Path(folder) / f"{name}.png")


@pytest.mark.parametrize(
    ("size", "theme"), share([("desk", "light"), ("phone", "dark")], [("desk", "light")])
)
def test_each_part_is_accessible_in_both_themes(browser, address, desk, size, theme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page, wrong = opened_page(browser, address, size, theme=theme)
    take(page)
    page.evaluate(axe.axe_script)
    # The colours of the other theme are those of the page at a desk.
    for rules in (ALL_RULES, share(ALL_RULES, COLOUR_RULES)):
        for part in PARTS:
            open_part(page, part)
            violations = page.evaluate("options => axe.run(options)", rules)["violations"]
            grave = [each for each in violations if each["impact"] in ("serious", "critical")]
            assert [(each["id"], each["nodes"][0]["failureSummary"]) for each in grave] == []
        for dialog in ("question", "entry", "key-map"):
            faults = page.evaluate(AXE_OF_DIALOG, [dialog, rules])
            assert [each for each in faults if each[1] in ("serious", "critical")] == []
        page.click("#theme")
    page.context.close()
    assert wrong == []
    take(desk)


@pytest.mark.parametrize("size", SIZES)
def test_what_is_pressed_is_large_enough(browser, address, desk, size):
    theme = "dark" if size in ("touch", "phone") else "light"
    page, wrong = opened_page(browser, address, size, theme=theme, touch=True)
    take(page)
    expect(page.locator("#jobs")).to_have_value("plate.nc")
    for glove in (False, True):
        for part in PARTS:
            open_part(page, part)
            small = page.evaluate(TOO_SMALL, SMALLEST[glove])
            # Seven tabs and six distances share the width of a phone.
            if size == "phone":
                shared = {"continuous", "0.01", "0.1", "1", "10", "50"}
                tabs = set(page.locator("nav button").all_inner_texts())
                small = [
                    (name, width, height)
                    for name, width, height in small
                    if name not in shared | tabs or height < SMALLEST[glove] or width < 40
                ]
            assert small == [], part
            # The shell never scrolls, so the actions are always in sight.
            sizes = "[document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
            assert page.evaluate(sizes) == [*SIZES[size]]
            if glove == (size == "touch") and part in PICTURES[size]:
                picture(page, f"screen-{size}-{part}")
        if not glove:
            page.check("#glove")
    # The size is kept, as is the theme.
    page.click("#theme")
    theme = page.get_attribute("html", "data-theme")
    page.reload()
    expect(page.locator("html")).to_have_attribute("data-size", "glove")
    expect(page.locator("html")).to_have_attribute("data-theme", theme)
    page.context.close()
    assert wrong == []
    take(desk)


@pytest.mark.parametrize("size", ["desk", "phone"])
def test_a_message_shifts_nothing(browser, address, desk, size):
    page, wrong = opened_page(browser, address, size)
    expect(page.locator("#jobs")).to_have_value("plate.nc")
    for part in ("run", "setup"):
        open_part(page, part)
        before = page.evaluate(PLACES)
        # A watcher presses what needs control.
        page.locator("#run").dispatch_event("click")
        expect(page.locator("#message")).to_contain_text("press Take control first")
        assert page.evaluate(PLACES) == before
        # A long message covers the parts in place of a shift.
        page.evaluate("document.getElementById('message-text').textContent = 'a line\\n'.repeat(9)")
        assert page.evaluate(PLACES) == before
        page.click("#dismiss")
        expect(page.locator("#message")).not_to_be_visible()
        assert page.evaluate(PLACES) == before
    page.context.close()
    assert wrong == []


def test_stop_alone_is_red_and_has_eight_corners(desk):
    for _ in range(2):
        colours = desk.evaluate(COLOURS)
        assert colours["shape"].count(",") == 7
        assert colours["others"] == 0
        apart = abs(hue(colours["stop"]) - hue(colours["error"]))
        assert min(apart, 360.0 - apart) > 25.0
        desk.click("#theme")


def test_a_zero_is_undone(desk):
    enter(desk, "G53 G0 X-60 Y-70 Z-20")
    expect(desk.locator("#work-x")).to_have_text("90.000")
    desk.get_by_role("button", name="Zero X here").click()
    expect(desk.locator("#work-x")).to_have_text("0.000")
    expect(desk.locator("#undo-zero")).to_contain_text("Undo G54 X")
    assert work(desk, "y") == 80.0
    # The machine has moved on, and another system is shown: the offset comes back all the same.
    enter(desk, "G53 G0 X-65")
    desk.select_option("#system", "G55")
    expect(desk.locator("#system-name")).to_have_text("G55")
    desk.click("#undo-zero")
    expect(desk.locator("#message")).to_contain_text("G54 X is back")
    desk.select_option("#system", "G54")
    expect(desk.locator("#work-x")).to_have_text("85.000")


def test_go_to_zero_and_to_a_named_position_lift_first(desk):
    enter(desk, "G53 G0 X-60 Y-70 Z-20")
    open_part(desk, "setup")
    desk.fill("#place-name", "vice")
    desk.get_by_role("button", name="Keep this position").click()
    sent = desk.locator("#console")
    desk.click("#go-zero")
    # Z to 3 mm below the top of its travel, then the way to the zero of G54.
    expect(desk.locator("#message")).to_contain_text("go_to: done")
    for axis, place in (("x", "0.000"), ("y", "0.000")):
        expect(desk.locator(f"#work-{axis}")).to_have_text(place)
    expect(desk.locator("#machine-z")).to_have_text("\u22123.000")
    lines = [line for line in sent.inner_text().splitlines() if re.match(r"> .*[XYZ]", line)]
    assert [re.sub(r"[^XYZ]", "", line) for line in lines[-2:]] == ["Z", "XY"]
    desk.get_by_role("button", name="Go to vice").click()
    expect(desk.locator("#machine-x")).to_have_text("\u221260.000")
    expect(desk.locator("#machine-y")).to_have_text("\u221270.000")
    # A height outside of the travel is refused; without a height the page asks, and Escape says no.
    open_part(desk, "settings")
    desk.fill("#lift", "5")
    desk.press("#lift", "Enter")
    expect(desk.locator("#message")).to_contain_text("5 is no height in the travel of Z")
    expect(desk.locator("#lift")).to_have_value("-3")
    desk.evaluate("document.getElementById('lift').value = ''")
    desk.click("#go-zero")
    expect(desk.locator("#entry-text")).to_contain_text("Z stays at")
    desk.keyboard.press("Escape")
    expect(desk.locator("#entry")).not_to_be_visible()
    expect(desk.locator("#state")).to_have_text("idle")
    expect(desk.locator("#machine-x")).to_have_text("\u221260.000")
    desk.reload()
    expect(desk.get_by_role("button", name="Go to vice")).to_be_hidden()
    open_part(desk, "setup")
    expect(desk.get_by_role("button", name="Go to vice")).to_have_attribute(
        "data-why", re.compile("Take control")
    )
    take(desk)


def test_the_outline_is_traced_around_the_cuts_and_stop_ends_all_of_it(desk, browser, address):
    """The arcs of the program reach 15 mm beyond its lines: X 5 to 75, Y 20 to 50."""
    open_part(desk, "program")
    desk.fill("#jog-feed", "3000")
    desk.click("#outline")
    expect(desk.locator("#message")).to_contain_text("trace_outline: done")
    expect(desk.locator("#spindle")).to_have_text("0 rev/min")
    open_part(desk, "setup")
    sent = desk.locator("#console").inner_text()
    numbers = {"X": set(), "Y": set(), "Z": set()}
    for line in sent[sent.rindex("> M5") :].splitlines():
        if line.startswith("> ") and not line.startswith("> $"):
            for letter, value in re.findall(r"([XYZ])(-?[0-9.]+)", line):
                numbers[letter].add(round(float(value), 2))
    assert (numbers["X"], numbers["Y"]) == ({5.0, 75.0}, {20.0, 50.0})
    open_part(desk, "program")
    desk.fill("#jog-feed", "200")
    desk.click("#outline")
    expect(desk.locator("#state")).to_have_text("running")
    other, wrong = opened_page(browser, address, "phone")
    other.click("#stop")
    expect(desk.locator("#message")).to_contain_text("trace_outline: stopped")
    expect(desk.locator("#state")).to_have_text("idle")
    other.context.close()
    assert wrong == []


def test_a_line_that_is_pressed_is_shown_in_the_picture(desk):
    open_part(desk, "run")
    space = desk.locator("#space")
    desk.locator("#lines li", has_text="G3 X60").click()
    expect(space).to_have_attribute("data-chosen", re.compile(r"^[1-9]\d*$"))
    desk.locator("#lines li", has_text="G3 X60").click()
    expect(space).to_have_attribute("data-chosen", "0")
    # A comment has no path.
    desk.locator("#lines li", has_text="ball end mill").click()
    expect(desk.locator("#lines .chosen")).to_have_count(1)
    expect(space).to_have_attribute("data-chosen", "0")


def test_a_finding_is_marked_shown_and_repaired(desk):
    open_part(desk, "program")
    upload(desk, "faulty.nc", "G21 G90 (a <b>x</b>\nG0 X1,5\nM2\n")
    expect(desk.locator("#outcome")).to_contain_text("refused: 1 error")
    rows, findings = desk.locator("#lines li"), desk.locator("#findings li")
    # Each line has the sign of its finding, and a mark at its place. No text is markup.
    expect(rows.nth(0)).to_have_text("!     1  G21 G90 (a <b>x</b>")
    expect(rows.nth(1)).to_have_text("\u25b2     2  G0 X1,5")
    expect(rows.nth(1).locator("mark")).to_have_text(",5")
    expect(rows.nth(2)).to_have_text("      3  M2")
    expect(findings).to_have_count(2)
    error = findings.filter(has_text="line 2: error character-unknown")
    expect(error).to_contain_text("column 6")
    assert desk.evaluate(TOO_SMALL, SMALLEST[False]) == []
    error.get_by_role("button").first.click()
    expect(desk.locator("#lines .chosen")).to_have_attribute("data-line", "2")
    # A repair that may change the program says so; Cancel leaves the file.
    repair = desk.get_by_role("button", name="Repair line 2: character-unknown")
    repair.click()
    expect(desk.locator("#entry-text")).to_contain_text("may do something else")
    expect(desk.locator("#entry-lines")).to_have_text("2 \u2212 G0 X1,5\n2 + G0 X1.5")
    # A key that was meant for a hold must not confirm.
    expect(desk.locator("#entry-lines")).to_be_focused()
    desk.keyboard.press(" ")
    desk.get_by_role("button", name="Cancel").click()
    expect(rows.nth(1)).to_contain_text("X1,5")
    repair.click()
    desk.click("#entry-yes")
    expect(rows.nth(1)).to_have_text("      2  G0 X1.5")
    # The check runs again. The other repair keeps the moves.
    expect(desk.locator("#outcome")).to_contain_text("checked")
    desk.get_by_role("button", name="Repair line 1: comment-mended").click()
    expect(desk.locator("#entry-text")).to_contain_text("does the same")
    desk.click("#entry-yes")
    expect(findings).to_have_count(0)
    expect(rows.nth(0)).to_have_text("      1  G21 G90 (a <b>x</b>)")
    expect(desk.locator("#lines mark, #lines b, #findings b, #entry b")).to_have_count(0)
    desk.select_option("#jobs", "plate.nc")
    expect(desk.locator("#outcome")).to_contain_text("checked")


def test_spindle_and_coolant_by_hand(desk):
    open_part(desk, "setup")
    desk.fill("#hand-speed", "750")
    desk.get_by_role("button", name="Clockwise M3").click()
    expect(desk.locator("#spindle")).to_have_text("750 rev/min")
    desk.get_by_role("button", name="Off M5", exact=True).click()
    expect(desk.locator("#spindle")).to_have_text("0 rev/min")
    desk.fill("#hand-speed", "")
    desk.get_by_role("button", name="Clockwise M3").click()
    expect(desk.locator("#message")).to_contain_text("the spindle has no speed")


def test_the_story_on_a_phone(desk, browser, address, port):
    """Connect, home, jog, zero, load, run, hold, override, resume, stop, go on from the line."""
    phone, wrong = opened_page(browser, address, "phone", theme="dark", touch=True)
    tap = lambda selector: phone.locator(selector).tap()  # noqa: E731
    tap("#take")
    expect(phone.locator("#holder")).to_have_text("you have control")
    tap('nav button[data-part="setup"]')
    # Until the machine can be used its connection comes first, then the position and the pad.
    phone.locator("#connect").tap()
    expect(phone.locator("#state")).to_have_text("disconnected")
    for selector in ("#connect", "#home"):
        box = phone.locator(selector).bounding_box()
        assert box["y"] + box["height"] < phone.locator("nav").bounding_box()["y"]
    phone.select_option("#board", "grbl")
    phone.fill("#port", port)
    tap("#connect")
    expect(phone.locator("#state")).to_have_text("idle")
    # The board has kept its position: the pad is in sight.
    expect(phone.locator("#pad")).to_be_in_viewport(ratio=1)
    tap("#home")
    expect(phone.locator("#machine-x")).to_have_text("\u22121.000")  # Off its switch.
    expect(phone.locator("#state")).to_have_text("idle")
    enter(phone, "G53 G0 X-155 Y-150 Z-20")
    open_part(phone, "setup")
    phone.get_by_label("1 mm", exact=True).check()
    phone.get_by_role("button", name="Jog X plus", exact=True).tap()
    expect(phone.locator("#machine-x")).to_have_text("\u2212154.000")
    tap("#zero-all")
    expect(phone.locator("#work-x")).to_have_text("0.000")
    tap("#undo-zero")
    expect(phone.locator("#message")).to_contain_text("is back")
    enter(phone, ZERO)
    tap('nav button[data-part="program"]')
    upload(phone, "phone.nc", PROGRAM.format(feed=240).replace("T1 M6\n", ""))
    expect(phone.locator("#outcome")).to_contain_text("checked")
    phone.check("#trust")
    tap("#run")
    expect(phone.locator("#state")).to_have_text("running")
    # The picture comes by itself.
    expect(phone.locator("#space")).to_be_visible()
    expect(phone.locator("#work-x")).to_have_text(re.compile(r"^(2[1-9]|[3-9]\d)\."))
    tap("#hold")
    expect(phone.locator("#state")).to_contain_text("held")
    tap('[data-override="feed"][data-by="10"]')
    expect(phone.locator("#feed-percent")).to_have_text("110 %")
    tap("#resume")
    expect(phone.locator("#state")).to_have_text("running")
    tap("#stop")
    expect(phone.locator("#outcome")).to_contain_text("stopped at line")
    # Run says where it would begin.
    expect(phone.locator("#run-what")).to_have_text(re.compile(r"from line \d"))
    open_part(phone, "program")
    phone.fill("#from-line", "8")
    tap("#run")
    expect(phone.locator("#question-text")).to_contain_text("from line 8")
    tap("#yes")
    expect(phone.locator("#outcome")).to_contain_text("phone.nc: done")
    phone.context.close()
    assert wrong == []
    take(desk)
