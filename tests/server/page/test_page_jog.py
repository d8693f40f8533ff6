"""Jogs by touch and by gamepad: each ends on release, lost focus and a lost gamepad."""

import math

import pytest

from tests.support.server.console_page import connect, enter, expect, open_part, take
from tests.support.server.quick_mill import SECONDS
from tests.support.soak import share

GAMEPAD = """() => {
  const button = () => ({pressed: false, touched: false, value: 0});
  const buttons = Array.from({length: 17}, button);
  window.pad = {connected: true, index: 0, axes: [0, 0, 0, 0], buttons};
  navigator.getGamepads = () => [null, window.pad];
  dispatchEvent(new Event("gamepadconnected"));
}"""
HOLD_STICK = """x => {
  window.pad.buttons[5].pressed = true;
  window.pad.axes[0] = x;
}"""
LET_GO = """() => {
  window.pad.buttons[5].pressed = false;
  window.pad.axes = [0, 0, 0, 0];
}"""
LOST_FOCUS = {
    "the window": "() => dispatchEvent(new Event('blur'))",
    "the tab": """() => {
      Object.defineProperty(document, "hidden", {value: true, configurable: true});
      document.dispatchEvent(new Event("visibilitychange"));
      delete document.hidden;
    }""",
}
FRAMES = """() => new Promise(done => {
  let left = 5;
  const next = () => left-- ? requestAnimationFrame(next) : done();
  next();
})"""
"""Waits until the page has read the gamepad some times."""


@pytest.fixture(scope="module")
def phone(browser, address, port):
    """A page on a phone that has control of a homed machine; its jogs are slow and continuous."""
    context = browser.new_context(
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True
    )
    context.set_default_timeout(1000 * SECONDS)
    expect.set_options(timeout=1000 * SECONDS)
    opened, wrong = context.new_page(), []
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    opened.goto(address)
    expect(opened.locator("#state")).not_to_have_text("connecting")
    take(opened)
    connect(opened, port)
    opened.fill("#jog-feed", "600")
    opened.evaluate(GAMEPAD)
    yield opened
    context.close()
    assert wrong == []


@pytest.fixture(autouse=True)
def in_the_middle(phone):
    """Move the machine away from the ends of its travel."""
    enter(phone, "G53 G0 X-100 Y-100 Z-20")
    open_part(phone, "setup")  # Its top, with the pad.
    phone.get_by_label("continuous").check()
    expect(phone.locator("#machine-x")).to_have_text("\u2212100.000")


class Finger:
    """A finger on the screen of the browser, which makes the events of it."""

    def __init__(self, phone):
        self._session = phone.context.new_cdp_session(phone)
        self._is_down = False

    def press(self, button):
        box = button.bounding_box()
        point = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
        self._touch("touchStart", [point])
        self._is_down = True

    def slide(self, x, y):
        self._touch("touchMove", [{"x": x, "y": y}])

    def lift(self):
        if self._is_down:
            self._touch("touchEnd", [])
        self._is_down = False

    def _touch(self, kind, points):
        self._session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


def moving(phone, axis="x"):
    """Wait for a jog. On a busy computer its dead-man may have ended it already."""
    expect(phone.locator(f"#machine-{axis}")).not_to_have_text("\u2212100.000")


def at_rest(phone):
    """Wait for rest; the axes are far from the ends of their travel, which end a jog, too."""
    expect(phone.locator("#state")).to_have_text("idle")
    for axis in "xy":
        place = float(phone.inner_text(f"#machine-{axis}").replace("\u2212", "-"))
        assert -190.0 < place < -10.0


@pytest.fixture
def finger(phone):
    made = Finger(phone)
    yield made
    made.lift()


def test_a_finger_jogs_until_it_lifts(phone, finger):
    button = phone.get_by_role("button", name="Jog X plus Y plus")
    finger.press(button)
    moving(phone)
    moving(phone, "y")
    finger.lift()
    at_rest(phone)


def test_a_finger_that_slides_off_its_button_still_jogs_until_it_lifts(phone, finger):
    finger.press(phone.get_by_role("button", name="Jog X plus", exact=True))
    moving(phone)
    finger.slide(5, 5)
    phone.evaluate(FRAMES)
    finger.lift()
    at_rest(phone)


@pytest.mark.parametrize("lost", share([*LOST_FOCUS], ["the tab"]))
def test_a_jog_by_touch_ends_with_the_focus(phone, finger, lost):
    finger.press(phone.get_by_role("button", name="Jog X minus", exact=True))
    moving(phone)
    phone.evaluate(LOST_FOCUS[lost])
    at_rest(phone)


def drawn(phone, finger, angle, length=80.0):
    """Draw the stick of the pad from its middle, px and degrees; return its middle."""
    box = phone.locator("#pad .stick").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    finger.press(phone.locator("#pad .stick"))
    turn = math.radians(angle)
    finger.slide(x + length * math.cos(turn), y - length * math.sin(turn))
    return x, y


def test_the_stick_of_the_pad_jogs_where_it_is_drawn(phone, finger):
    middle = drawn(phone, finger, 30.0)
    moving(phone)
    moving(phone, "y")
    finger.slide(*middle)
    at_rest(phone)
    x, y = (float(phone.inner_text(f"#machine-{axis}").replace("\u2212", "-")) for axis in "xy")
    assert (y + 100.0) / (x + 100.0) == pytest.approx(math.tan(math.radians(30.0)), rel=0.1)
    # It was never let go: another direction begins from rest.
    finger.slide(middle[0], middle[1] + 60.0)
    phone.wait_for_function(
        "y => Number(document.getElementById('machine-y').innerText.replace('\u2212', '-')) < y",
        arg=y,
    )
    finger.lift()
    at_rest(phone)


def test_the_stick_makes_one_step_each_time_that_it_is_drawn(phone, finger):
    phone.get_by_label("10 mm").check()
    drawn(phone, finger, 95.0)
    expect(phone.locator("#machine-y")).to_have_text("\u221290.000")
    phone.evaluate(FRAMES)
    finger.lift()
    at_rest(phone)
    expect(phone.locator("#machine-y")).to_have_text("\u221290.000")
    expect(phone.locator("#machine-x")).to_have_text("\u2212100.000")


@pytest.mark.parametrize("lost", share([*LOST_FOCUS], ["the window"]))
def test_a_jog_by_the_stick_of_the_pad_ends_with_the_focus(phone, finger, lost):
    drawn(phone, finger, 180.0)
    moving(phone)
    phone.evaluate(LOST_FOCUS[lost])
    at_rest(phone)
    phone.evaluate(FRAMES)
    expect(phone.locator("#state")).to_have_text("idle")


@pytest.fixture
def gamepad(phone):
    """The simulated gamepad: a stick, and a shoulder button that must be held."""
    yield lambda x: phone.evaluate(HOLD_STICK, x)
    phone.evaluate(LET_GO)
    phone.evaluate(FRAMES)


@pytest.mark.parametrize(
    "release",
    ["() => { window.pad.axes[0] = 0; }", "() => { window.pad.buttons[5].pressed = false; }"],
    ids=["the stick", "the shoulder button"],
)
def test_a_jog_by_gamepad_ends_with_its_release(phone, gamepad, release):
    gamepad(0.6)
    moving(phone)
    phone.evaluate(release)
    at_rest(phone)


@pytest.mark.parametrize("lost", share([*LOST_FOCUS], ["the window"]))
def test_a_jog_by_gamepad_ends_with_the_focus_and_the_stick_must_be_let_go_first(
    phone, gamepad, lost
):
    gamepad(-1.0)
    moving(phone)
    phone.evaluate(LOST_FOCUS[lost])
    at_rest(phone)
    phone.evaluate(FRAMES)
    expect(phone.locator("#state")).to_have_text("idle")


def test_a_jog_ends_with_its_gamepad(phone, gamepad):
    gamepad(1.0)
    moving(phone)
    phone.evaluate("() => { navigator.getGamepads = () => [null, null]; }")
    at_rest(phone)
    phone.evaluate(LET_GO)
    phone.evaluate(GAMEPAD)


def requests_during(phone, action):
    """Return the paths and bodies of the requests of a page during an action."""
    sent = []

    def keep(request):
        sent.append((request.url.rsplit("/api/")[-1], request.post_data_json))

    phone.on("request", keep)
    action()
    phone.evaluate(FRAMES)
    phone.remove_listener("request", keep)
    return sent


def test_a_gamepad_jogs_nothing_while_another_window_has_the_focus(phone, gamepad):
    phone.evaluate("() => { document.hasFocus = () => false; }")
    assert requests_during(phone, lambda: gamepad(1.0)) == []
    # The stick that is held when the focus comes back must be let go first.
    back = "() => { delete document.hasFocus; }"
    assert requests_during(phone, lambda: phone.evaluate(back)) == []


def test_a_gamepad_jogs_by_whole_steps_however_far_its_stick_is(phone, gamepad):
    phone.get_by_label("10 mm").check()
    sent = requests_during(phone, lambda: gamepad(-0.4))
    assert [(path, body["distances"]) for path, body in sent] == [("jog/step", {"x": -10})]
    expect(phone.locator("#machine-x")).to_have_text("\u2212110.000")
    at_rest(phone)
