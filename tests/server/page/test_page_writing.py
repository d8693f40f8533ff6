"""What an operator writes in the page: simple jobs, programs with findings as typed, macros."""

import re

import pytest

from tests.server.page.test_page import PROGRAM, ZERO, upload
from tests.server.page.test_page_design import (
    SMALLEST,
    TOO_SMALL,
    opened_page,
    picture,
)
from tests.support.server.console_page import connect, enter, expect, open_part, take

GRAVE = """async () => {
  const {violations} = await axe.run(document, {resultTypes: ["violations"]});
  return violations.filter(({impact}) => ["serious", "critical"].includes(impact))
    .map(({id, nodes}) => [id, nodes[0].failureSummary]);
}"""


@pytest.fixture(scope="module")
def desk(browser, address, port):
    page, wrong = opened_page(browser, address, "desk")
    take(page)
    connect(page, port)
    enter(page, ZERO)
    upload(page, "plate.nc", PROGRAM.format(feed=240).replace("T1 M6\n", ""))
    expect(page.locator("#outcome")).to_contain_text("checked")
    yield page
    page.context.close()
    assert wrong == []


def usable(page):
    """What is pressed is large enough, and no serious fault of accessibility is there."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    page.evaluate(axe.axe_script)
    assert page.evaluate(TOO_SMALL, SMALLEST[False]) == []
    for _ in range(2):
        assert page.evaluate(GRAVE) == []
        page.click("#theme")


def test_a_simple_job_is_written_checked_and_shown(desk):
    open_part(desk, "program")
    desk.locator("#make > summary").click()
    desk.select_option("#make-kind", "round-pocket")
    field = lambda name: desk.locator(f'#make-fields [name="{name}"]')  # noqa: E731
    for name, value in (("x", 40), ("y", 40), ("bore", 20), ("depth", 1), ("tool", 0)):
        field(name).fill(str(value))
    usable(desk)
    picture(desk, "screen-desk-simple")
    desk.get_by_role("button", name="Write the program").click()
    expect(desk.locator("#jobs")).to_have_value("round-pocket.nc")
    expect(desk.locator("#outcome")).to_contain_text("checked")
    expect(desk.locator("#lines li").first).to_contain_text("(Round pocket, depth 1 mm")
    # A value that cannot be cut is refused with its reason; the values stay for the next time.
    desk.locator("#make > summary").click()
    expect(field("bore")).to_have_value("20")
    field("bore").fill("6.1")
    desk.get_by_role("button", name="Write the program").click()
    expect(desk.locator("#message")).to_contain_text("the pocket needs 6.6 mm")
    field("bore").fill("24")
    desk.get_by_role("button", name="Write the program").click()
    expect(desk.locator("#entry-text")).to_contain_text("Replace round-pocket.nc?")
    desk.click("#entry-yes")
    expect(desk.locator("#make")).not_to_have_attribute("open", "")
    expect(desk.locator("#lines")).to_contain_text("I-9 J0")  # The wall: (24 - 6) / 2.
    # The place of the simple job is kept by the page, as those of its kind.
    desk.reload()
    take(desk)


def test_a_program_is_changed_with_findings_as_typed(desk):
    open_part(desk, "program")
    desk.select_option("#jobs", "plate.nc")
    expect(desk.locator("#outcome")).to_contain_text("checked")
    desk.click("#edit")
    editor, state = desk.locator("#editor"), desk.locator("#edit-state")
    expect(editor).to_be_focused()
    expect(state).to_have_text("0 errors, 0 warnings and notes")
    desk.keyboard.type("G1 X<b>5\n")
    expect(state).to_contain_text("1 error,")
    expect(desk.locator("#edit-signs .error")).to_contain_text("\u25b2     1")
    expect(desk.locator("#edit-marks mark.error")).to_have_count(1)
    expect(desk.locator("#edit-marks b")).to_have_count(0)
    finding = desk.locator("#findings li").first
    expect(finding).to_contain_text("line 1: error")
    usable(desk)
    picture(desk, "screen-desk-edit")
    # The marks stand where the letters are: the same place on the screen as in the text.
    desk.keyboard.press("ControlOrMeta+End")
    finding.get_by_role("button").click()
    assert editor.evaluate("place => place.selectionStart") == 0
    # What is not saved is not lost without a question.
    desk.click("#edit-close")
    expect(desk.locator("#entry-text")).to_contain_text("not saved")
    desk.keyboard.press("Escape")
    expect(editor).to_be_visible()
    text = editor.input_value()
    editor.fill(text.replace("G1 X<b>5\n", "(first)\n"))
    expect(state).to_have_text("0 errors, 0 warnings and notes")
    desk.click("#edit-save")
    expect(editor).to_be_hidden()
    expect(desk.locator("#outcome")).to_contain_text("checked")
    expect(desk.locator("#lines li").first).to_have_text("      1  (first)")


def test_a_text_that_was_changed_elsewhere_is_not_replaced(desk):
    open_part(desk, "program")
    desk.click("#edit")
    expect(desk.locator("#editor")).to_be_focused()
    desk.keyboard.type("(mine)\n")
    body = "{method: 'PUT', headers: {'Content-Type': 'application/json'}, body: "
    desk.evaluate(f"() => fetch('/api/jobs/plate.nc', {body}'{{\"text\": \"M2\\\\n\"}}'}})")
    desk.click("#edit-save")
    expect(desk.locator("#message")).to_contain_text("plate.nc has changed since it was shown")
    expect(desk.locator("#editor")).to_have_value(re.compile(r"^\(mine\)"))
    # Under another name it is saved; the name is shown as it is.
    desk.fill("#edit-name", "<i>mine \u202e.nc")
    desk.click("#edit-save")
    expect(desk.locator("#editor")).to_be_hidden()
    expect(desk.locator("#jobs option:checked")).to_contain_text("<i>mine \\u{202e}.nc")
    expect(desk.locator("i")).to_have_count(0)


def test_a_new_program_is_written_and_run(desk):
    open_part(desk, "program")
    desk.click("#new")
    desk.fill("#edit-name", "no ending")
    expect(desk.locator("#edit-state")).to_contain_text("cannot be the name of a job")
    desk.fill("#edit-name", "mine.nc")
    desk.locator("#editor").fill("G21 G90\nG0 Z5\nG0 X1 Y1\nM2\n")
    expect(desk.locator("#edit-state")).to_contain_text("0 errors")
    desk.click("#edit-save")
    expect(desk.locator("#outcome")).to_contain_text("checked")
    desk.check("#trust")
    desk.click("#run")
    expect(desk.locator("#outcome")).to_contain_text("mine.nc: done")
    desk.click("#run")
    expect(desk.locator("#message")).to_contain_text("mine.nc: done")
    # Each run has its log.
    open_part(desk, "history")
    rows = desk.locator("#history tbody tr")
    expect(rows).to_have_count(2)
    for k in range(2):
        rows.nth(k).get_by_role("button").click()
        expect(desk.locator("#log")).to_contain_text("end: done")


def test_a_macro_is_written_run_changed_and_removed(desk):
    open_part(desk, "setup")
    desk.click("#new-macro")
    desk.fill("#edit-name", "up.ngc")
    desk.locator("#editor").fill("G21 G90\nG53 G0 Z-5\nM2\n")
    desk.click("#edit-save")
    # The page is again where the macro is run.
    run = desk.locator("#macros").get_by_role("button", name="up.ngc", exact=True)
    run.click()
    expect(desk.locator("#message")).to_contain_text("up.ngc: done")
    expect(desk.locator("#machine-z")).to_have_text("\u22125.000")
    usable(desk)
    desk.get_by_role("button", name="Change up.ngc").click()
    desk.locator("#editor").fill("G21 G90\nG53 G0 Z-7\nM2\n")
    desk.click("#edit-save")
    run.click()
    expect(desk.locator("#machine-z")).to_have_text("\u22127.000")
    desk.get_by_role("button", name="Change up.ngc").click()
    desk.click("#edit-remove")
    desk.click("#entry-yes")
    expect(desk.locator("#macros")).to_contain_text("There is no macro yet")


def test_a_program_is_changed_on_a_phone(browser, address, desk):
    phone, wrong = opened_page(browser, address, "phone", theme="dark", touch=True)
    phone.locator('nav button[data-part="program"]').tap()
    phone.locator("#edit").tap()
    expect(phone.locator("#editor")).to_be_in_viewport()
    phone.keyboard.type("G1 X\n")
    expect(phone.locator("#edit-state")).to_contain_text("1 error")
    assert phone.evaluate("document.documentElement.scrollWidth") == 390
    picture(phone, "screen-phone-edit")
    phone.locator("#edit-close").tap()
    phone.locator("#entry-yes").tap()
    expect(phone.locator("#editor")).to_be_hidden()
    phone.context.close()
    assert wrong == []
