"""Each question to the operator works after a reload, on a second device, and cut off."""

import re

import pytest

from tests.server.page.test_page import upload
from tests.support.server.console_page import connect, enter, expect, open_part, take
from tests.support.server.quick_mill import SECONDS
from tests.support.soak import share

CUT_SOCKETS = """() => {
  const Real = WebSocket;
  window.WebSocket = class extends Real {
    constructor(url) {
      super(window.isCut ? `${url}-nowhere` : url);
      window.lastSocket = this;
    }
  };
}"""
CUT = "() => { window.isCut = true; window.lastSocket.close(); }"
MEND = "() => { window.isCut = false; }"
BEFORE = "G21 G90 F3000\nG53 G0 X-100 Y-100 Z-19\n"
PROGRAMS = {
    "tool": BEFORE + "T2 M6 (the ball)\nG53 G0 X-101\nM30\n",
    "stop": BEFORE + "M0 (turn the part)\nG53 G0 X-101\nM30\n",
    "restart": BEFORE + "G53 G1 X-101\nM30\n",
}
TEXTS = {"tool": "put in tool 2", "stop": "turn the part", "restart": "from line 3"}
LOSSES = ["reload", "second device", "lost connection"]


@pytest.fixture
def desk(browser, address):
    """A page at a desk whose connection can be cut."""
    context = browser.new_context(viewport={"width": 1400, "height": 1000})
    context.set_default_timeout(1000 * SECONDS)
    expect.set_options(timeout=1000 * SECONDS)
    context.add_init_script(f"({CUT_SOCKETS})()")
    opened = context.new_page()
    opened.goto(address)
    expect(opened.locator("#state")).not_to_have_text("connecting")
    yield opened
    context.close()


@pytest.fixture
def phone(browser, address):
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
    context.set_default_timeout(1000 * SECONDS)
    opened = context.new_page()
    opened.goto(address)
    yield opened
    context.close()


def begin(page, port, kind):
    """Run a program until its question."""
    if page.inner_text("#holder") != "you have control":
        take(page)
    connect(page, port)
    # The result of an earlier check must not count.
    page.evaluate("document.getElementById('outcome').textContent = ''")
    upload(page, f"{kind}.nc", PROGRAMS[kind])
    expect(page.locator("#outcome")).to_contain_text("checked")
    open_part(page, "program")
    if kind == "restart":
        page.fill("#from-line", "3")
    page.check("#trust")
    page.click("#run")
    expect(page.locator("#question-text")).to_contain_text(TEXTS[kind])


def is_on_top(page, selector):
    """Whether a press at the middle of an element meets it."""
    return page.locator(selector).evaluate(
        """place => {
          place.scrollIntoView({block: "nearest"});
          const {left, right, top, bottom} = place.getBoundingClientRect();
          const at = document.elementFromPoint((left + right) / 2, (top + bottom) / 2);
          return place.contains(at);
        }"""
    )


def go_on(page, kind):
    page.click("#yes")
    expect(page.locator("#question")).not_to_be_visible()
    expect(page.locator("#outcome")).to_contain_text(f"{kind}.nc: done")


@pytest.mark.parametrize("kind", share([*PROGRAMS], ["restart"]))
def test_a_question_is_answered_after_a_reload(desk, port, kind):
    begin(desk, port, kind)
    desk.reload()
    expect(desk.locator("#question-text")).to_contain_text(TEXTS[kind])
    expect(desk.locator("#yes")).to_have_attribute("aria-disabled", "true")
    for selector in ("#take", "#question-take", "#no", "#stop", "#yes"):
        assert is_on_top(desk, selector)
    desk.click("#question-take")
    go_on(desk, kind)


@pytest.mark.parametrize("kind", share([*PROGRAMS], ["tool"]))
def test_a_question_is_answered_on_a_second_device(desk, phone, port, kind):
    begin(desk, port, kind)
    expect(phone.locator("#question-text")).to_contain_text(TEXTS[kind])
    for selector in ("#take", "#question-take", "#no", "#stop", "#yes"):
        assert is_on_top(phone, selector)
    phone.locator("#take").tap()
    expect(phone.locator("#holder")).to_have_text("you have control")
    # The first device watches now, and its question says how to answer.
    expect(desk.locator("#question-take")).to_be_visible()
    phone.locator("#yes").tap()
    for page in (phone, desk):
        expect(page.locator("#question")).not_to_be_visible()
    expect(desk.locator("#outcome")).to_contain_text(f"{kind}.nc: done")


@pytest.mark.parametrize("kind", share([*PROGRAMS], ["stop"]))
def test_a_question_is_answered_after_a_lost_connection(desk, port, kind):
    begin(desk, port, kind)
    desk.context.route("**/api/**", lambda route: route.abort())
    desk.evaluate(CUT)
    expect(desk.locator("#state")).to_have_text("no server")
    expect(desk.locator("#yes")).to_have_attribute("aria-disabled", "true")
    desk.locator("#yes").dispatch_event("click")
    expect(desk.locator("#message")).to_contain_text("the server does not answer")
    expect(desk.locator("#question")).to_be_visible()
    desk.context.unroute("**/api/**")
    desk.evaluate(MEND)
    expect(desk.locator("#yes")).not_to_have_attribute("aria-disabled", "true")
    go_on(desk, kind)


def test_a_question_that_was_answered_elsewhere_closes_with_the_connection(desk, phone, port):
    begin(desk, port, "stop")
    desk.evaluate(CUT)
    expect(desk.locator("#state")).to_have_text("no server")
    expect(phone.locator("#question")).to_be_visible()
    phone.locator("#no").tap()
    expect(phone.locator("#question")).not_to_be_visible()
    desk.evaluate(MEND)
    expect(desk.locator("#question")).not_to_be_visible()
    expect(desk.locator("#state")).to_have_text("idle")


@pytest.mark.parametrize(
    ("dialog", "loss"),
    share(
        [(dialog, loss) for dialog in ("entry", "key-map") for loss in LOSSES],
        [("entry", "lost connection")],
    ),
)
def test_a_dialog_of_the_page_itself_traps_nobody(desk, phone, port, dialog, loss):
    take(desk)
    connect(desk, port)
    if dialog == "entry":
        desk.get_by_role("button", name="Set X to a value").click()
    else:
        desk.click("#keys")
    expect(desk.locator(f"#{dialog}")).to_be_visible()
    if loss == "reload":
        desk.reload()
    elif loss == "second device":
        expect(phone.locator(f"#{dialog}")).not_to_be_visible()
        phone.locator("#take").tap()
        expect(phone.locator("#holder")).to_have_text("you have control")
        desk.keyboard.press("Escape")
    else:
        desk.evaluate(CUT)
        expect(desk.locator("#state")).to_have_text("no server")
        desk.keyboard.press("Escape")
        desk.evaluate(MEND)
    expect(desk.locator(f"#{dialog}")).not_to_be_visible()
    expect(desk.locator("#state")).to_have_text("idle")
    if desk.inner_text("#holder") != "you have control":
        take(desk)


def test_the_operator_touches_off_at_a_tool_change(desk, port):
    take(desk)
    connect(desk, port)
    enter(desk, "G10 L2 P1 X-100 Y-100 Z-19")
    begin_text = "G21 G90 F3000\nG0 X0 Y0 Z0\nT2 M6\nG0 X5\nG0 Z-1\nM30\n"
    upload(desk, "touch.nc", begin_text)
    expect(desk.locator("#outcome")).to_contain_text("checked")
    open_part(desk, "program")
    desk.check("#trust")
    desk.click("#run")
    expect(desk.locator("#question-text")).to_contain_text("put in tool 2")
    desk.get_by_label("1 mm", exact=True).check()
    desk.get_by_role("button", name="Jog Z plus", exact=True).click()
    expect(desk.locator("#machine-z")).to_have_text("\u221218.000")
    desk.get_by_role("button", name="Zero Z here").click()
    expect(desk.locator("#work-z")).to_have_text("0.000")
    # A line would change modes: it has to wait, and says so.
    expect(desk.locator("#run")).to_have_attribute("data-why", re.compile("busy"))
    desk.click("#yes")
    expect(desk.locator("#question-text")).to_contain_text("after line 3")
    desk.click("#yes")
    expect(desk.locator("#outcome")).to_contain_text("touch.nc: done")
    expect(desk.locator("#machine-z")).to_have_text("\u221219.000")


def test_controls_that_cannot_work_say_why(desk, phone, port):
    take(desk)
    connect(desk, port)
    for selector in ("#home", "#run", "#zero-all"):
        expect(phone.locator(selector)).to_have_attribute("aria-disabled", "true")
    expect(phone.locator("#holder")).to_contain_text("you watch")
    phone.locator("#home").dispatch_event("click")
    expect(phone.locator("#message")).to_contain_text("press Take control first")
    begin(desk, port, "stop")
    for selector, why in (("#run", "busy"), ("#hold", "nothing moves")):
        expect(desk.locator(selector)).to_have_attribute("data-why", re.compile(why))
    desk.click("#no")
    expect(desk.locator("#state")).to_have_text("idle")
    expect(desk.locator("#resume")).to_have_attribute("data-why", re.compile("nothing is held"))
