"""The backlash of an axis is measured at a desk, goes on at a phone, and is written when agreed."""

import re

import pytest

from cnc.machine.load import load_machine
from tests.server.page.test_dialogs import is_on_top
from tests.server.page.test_page_design import SMALLEST, TOO_SMALL, opened_page, picture
from tests.support.server.console_page import expect, open_part, take

AXIS = """\
[axes.{letter}]
steps_per_mm = 400.0
max_velocity = 100.0
max_acceleration = 2000.0
max_jerk = 100000.0
travel = [-60, 60]
"""
READINGS = ["1.0", "0.55", "1.0", "0.549", "1.001", "0.552", "1.0"]
"""Of a gauge: first, then three reversals by 0.5 mm, each back at the beginning."""


@pytest.fixture(scope="module")
def mill(tmp_path_factory):
    """A machine whose board plays pulses, so that its errors can be compensated."""
    file = tmp_path_factory.mktemp("machine") / "mill.toml"
    tables = "".join(AXIS.format(letter=letter) for letter in "xyz")
    file.write_text(f'[machine]\nname = "Mill"\n{tables}[board]\nkind = "loopback"\n')
    return file


@pytest.fixture(scope="module")
def port():
    return ""


def begin(page):
    open_part(page, "setup")
    if page.inner_text("#state") == "disconnected":
        page.click("#connection button")
        expect(page.locator("#state")).to_have_text("idle")
    page.select_option("#measure-kind", "backlash")
    page.get_by_role("button", name="Measure", exact=True).click()


def answer(page, text, number):
    expect(page.locator("#question-text")).to_have_text(text)
    question = page.get_attribute("#question", "data-id")
    page.fill("#question-value", number)
    page.press("#question-value", "Enter")
    expect(page.locator(f'#question[open][data-id="{question}"]')).to_have_count(0)


def targets(page):
    return page.evaluate(TOO_SMALL, SMALLEST[False])


def test_a_measurement_goes_on_at_a_phone_and_is_written_when_agreed(browser, address, mill):
    before = mill.read_text()
    desk, wrong = opened_page(browser, address, "desk")
    phone, wrong_there = opened_page(browser, address, "phone", touch=True)
    take(desk)
    begin(desk)
    expect(desk.locator("#question-text")).to_have_text("the gauge")
    expect(desk.locator("#question-help")).to_contain_text("set a gauge along X")
    expect(desk.locator("#measure-title")).to_have_text("Backlash of an axis: under way")
    # No number is no answer; and nothing else moves the machine meanwhile.
    desk.fill("#question-value", "")
    desk.click("#yes")
    expect(desk.locator("#message")).to_contain_text("type the number first")
    for selector in ("#run", "#home"):
        why = re.compile("answer its questions")
        expect(desk.locator(selector)).to_have_attribute("data-why", why)
    picture(desk, "measure-question-desk")
    answer(desk, "the gauge", READINGS[0])
    expect(desk.locator("#question-text")).to_have_text("the gauge after reversal 1 of 3")
    desk.reload()
    expect(desk.locator("#question-text")).to_have_text("the gauge after reversal 1 of 3")
    expect(desk.locator("#yes")).to_have_attribute("aria-disabled", "true")
    # Who watches cannot answer; the phone takes control, and goes on.
    expect(phone.locator("#question-text")).to_have_text("the gauge after reversal 1 of 3")
    phone.locator("#take").tap()
    expect(phone.locator("#holder")).to_have_text("you have control")
    for page in (desk, phone):
        for selector in ("#take", "#question-value", "#yes", "#no", "#stop"):
            assert is_on_top(page, selector)
        assert targets(page) == []
    picture(phone, "measure-question-phone")
    texts = [
        text
        for number in (1, 2, 3)
        for text in (f"the gauge after reversal {number} of 3", "the gauge where it began")
    ]
    for text, number in zip(texts, READINGS[1:], strict=True):
        answer(phone, text, number)
    for page in (desk, phone):
        open_part(page, "setup")
        expect(page.locator("#question")).not_to_be_visible()
        expect(page.locator("#measure-title")).to_have_text("backlash of X: 0.05 mm")
        expect(page.locator("#measure-picture tbody tr")).to_have_count(3)
        expect(page.locator("#measure-steps")).to_have_text("axes.x.backlash = 0.05")
        page.locator("#measure-result").scroll_into_view_if_needed()
        assert targets(page) == []
        for theme in ("light", "dark"):
            picture(page, f"measure-{'desk' if page is desk else 'phone'}-{theme}")
            page.click("#theme")
    assert mill.read_text() == before
    expect(desk.locator("#measure-write")).to_have_attribute("aria-disabled", "true")
    phone.locator("#measure-write").tap()
    expect(phone.locator("#entry-lines")).to_have_text("axes.x.backlash = 0.05")
    phone.get_by_role("button", name="Cancel").tap()
    expect(phone.locator("#entry")).not_to_be_visible()
    assert mill.read_text() == before
    phone.locator("#measure-write").tap()
    phone.locator("#entry-yes").tap()
    expect(phone.locator("#measure-note")).to_contain_text("Written to")
    expect(desk.locator("#measure-note")).to_contain_text("home the machine then")
    assert load_machine(mill).axes["x"].backlash == pytest.approx(0.05, abs=0.0025)
    phone.locator("#measure-discard").tap()
    expect(desk.locator("#measure-result")).not_to_be_visible()
    for page in (desk, phone):
        page.context.close()
    assert wrong + wrong_there == []


def test_a_stop_ends_a_measurement(browser, address, mill):
    before = mill.read_text()
    page, wrong = opened_page(browser, address, "desk")
    take(page)
    begin(page)
    expect(page.locator("#question-text")).to_have_text("the gauge")
    page.click("#no")
    expect(page.locator("#question")).not_to_be_visible()
    expect(page.locator("#message")).to_contain_text("the measurement was stopped")
    expect(page.locator("#measure-result")).not_to_be_visible()
    page.get_by_role("button", name="Measure", exact=True).click()
    expect(page.locator("#question-text")).to_have_text("the gauge")
    page.click("#stop")
    expect(page.locator("#question")).not_to_be_visible()
    expect(page.locator("#state")).to_have_text("idle")
    assert mill.read_text() == before
    page.context.close()
    assert wrong == []


def test_each_measurement_has_its_form_with_a_picture(browser, address):
    page, wrong = opened_page(browser, address, "desk")
    take(page)
    open_part(page, "setup")
    forms = []
    for kind in ("backlash", "pitch", "square", "limits", "shaking", "ringing"):
        page.select_option("#measure-kind", kind)
        for method in ("gauge", "probe"):
            if not page.locator("#measure-method").is_visible():
                assert kind in ("limits", "shaking", "ringing")
            else:
                page.select_option("#measure-method", method)
            expect(page.locator("#measure-sketch .sketch")).to_be_visible()
            forms.append(page.inner_text("#measure-help") + page.inner_text("#measure-fields"))
            assert targets(page) == []
            page.locator("#measure-form").scroll_into_view_if_needed()
            picture(page, f"measure-form-{kind}-{method}")
    assert len(set(forms)) == 9
    # A record is read without a board, and what is no record is refused with a reason.
    page.set_input_files(
        "#measure-fields [name=record]",
        {"name": "taps.csv", "mimeType": "text/csv", "buffer": b"nothing"},
    )
    page.click("#measure-begin")
    expect(page.locator("#message")).to_contain_text("taps.csv is not a table of times")
    page.context.close()
    assert wrong == []
