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

DIFFERING = """async () => {
  const {differing} = await import("/page/heights.js");
  const x = [0, 5, 10, 15, 20], y = [0, 4, 8, 12];
  const heights = y.map(b => x.map(a => 0.05 * a - 0.08 * b));
  heights[2][3] -= 0.4;
  heights[0][0] += 0.15;
  return differing({x, y, heights}).map(({at, by}) => [at, by]);
}"""
SLIDE = """time => {
  const place = document.getElementById("play-time");
  place.value = time;
  place.dispatchEvent(new Event("input"));
  return new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
}"""
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
    expect(state).to_contain_text("; line 1: ")
    expect(desk.locator("#edit-signs .error")).to_contain_text("\u25b2     1")
    expect(desk.locator("#edit-marks mark.error")).to_have_count(1)
    expect(desk.locator("#edit-marks b")).to_have_count(0)
    finding = desk.locator("#findings li").first
    expect(finding).to_contain_text("line 1: error")
    usable(desk)
    picture(desk, "screen-desk-edit")
    # A finding that is pressed puts the caret at its place.
    desk.keyboard.press("ControlOrMeta+End")
    finding.get_by_role("button").click()
    assert editor.evaluate("place => place.selectionStart") == len("G1 ")
    # What is not saved is not run, and not lost without a question.
    expect(desk.locator("#run")).to_have_attribute("data-why", re.compile("not saved"))
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


def test_the_path_is_played_with_its_line_and_time(desk):
    """Half of the time of a straight line is half of its way: at a constant feed of 240 mm/min."""
    open_part(desk, "program")
    upload(desk, "line.nc", "G21 G90\nG0 X0 Y0 Z5\nG1 X8 F240\nG1 Y4\nM2\n")
    expect(desk.locator("#outcome")).to_contain_text("checked")
    open_part(desk, "run")
    shown, lines = desk.locator("#play-shown"), desk.locator("#lines .now")
    expect(shown).to_have_text(re.compile(r"^[1-9].* s$"))
    end = float(desk.get_attribute("#play-time", "max"))
    expect(shown).to_have_text(f"{end:.1f} s")
    desk.evaluate(SLIDE, end - 0.3)
    expect(shown).to_have_text(f"{end - 0.3:.1f} s, line 4")
    expect(lines).to_contain_text("G1 Y4")
    # 4 mm take 1 s, and 0.3 s before the end the tool has 1.2 mm to go.
    place = desk.evaluate("document.getElementById('space').dataset.tool").split()
    assert [float(value) for value in place[:2]] == pytest.approx([-142.0, -147.2], abs=0.05)
    desk.evaluate(SLIDE, end - 1.5)
    expect(lines).to_contain_text("G1 X8")
    picture(desk, "screen-desk-playback")
    # It plays at ten times the speed, and rests at the end.
    desk.select_option("#play-speed", "10")
    desk.click("#play")
    expect(shown).to_contain_text(f"{end:.1f} s, line 4")
    expect(desk.locator("#play")).to_have_attribute("aria-pressed", "false")
    desk.click("#play-all")
    expect(lines).to_have_count(0)
    expect(shown).to_have_text(f"{end:.1f} s")
    # A run ends it: the picture shows the machine.
    desk.evaluate(SLIDE, 1.0)
    desk.click("#run")
    expect(desk.locator("#message")).to_contain_text("line.nc: done")
    expect(desk.locator("#play-all")).to_be_hidden()


def test_the_dimensions_of_the_cuts_are_shown(desk):
    open_part(desk, "program")
    upload(desk, "box.nc", "G21 G90\nG0 X-30 Y2 Z5\nG1 Z-3 F900\nX12.5\nY22\nG0 Z5\nM2\n")
    expect(desk.locator("#outcome")).to_contain_text("checked")
    open_part(desk, "run")
    texts = "document.getElementById('over').dataset.texts"
    assert desk.evaluate(texts) == ""
    sizes = desk.get_by_role("button", name="Dimensions of the cuts")
    sizes.click()
    expect(sizes).to_have_attribute("aria-pressed", "true")
    desk.wait_for_function(f"() => {texts}.split('; ').length === 3")
    assert desk.evaluate(texts).replace("\u2212", "-").split("; ") == [
        "X 42.5 (-30 to 12.5)", "Y 20 (2 to 22)", "Z 8 (-3 to 5)",
    ]  # fmt: skip
    usable(desk)
    picture(desk, "screen-desk-dimensions")
    # A side that is seen from its end has no number.
    desk.get_by_role("button", name="top", exact=True).click()
    desk.wait_for_function(f"() => {texts}.split('; ').length === 2")
    sizes.click()
    desk.wait_for_function(f"() => {texts} === ''")


def without_a_contact(route):
    """Answer with the map, without the height of its second point."""
    surface = route.fetch().json()
    surface["heights"][0][1] = None
    route.fulfill(json=surface)


def test_points_of_a_height_map_are_probed_again(desk):
    """A plane with two wrong points: they alone are found, whatever the tilt."""
    found = desk.evaluate(DIFFERING)
    assert [at for at, _ in found] == ["3 2", "0 0"]
    assert [by for _, by in found] == pytest.approx([-0.4, 0.15], abs=1e-6)
    enter(desk, "G53 G0 X-60 Y-70 Z-20")
    enter(desk, "G10 L20 P1 X0 Y0 Z2")
    open_part(desk, "probe")
    form = desk.locator("#grid-form")
    for name, value in (("x0", 0), ("x1", 20), ("y0", 0), ("y1", 10), ("step", 10)):
        form.locator(f'[name="{name}"]').fill(str(value))
    for name, value in (("clear", 1), ("depth", 2), ("feed", 1000)):
        form.locator(f'[name="{name}"]').fill(str(value))
    form.locator('[name="name"]').fill("plate")
    form.get_by_role("button").click()
    expect(desk.locator("#map-shown")).to_have_value("plate")
    expect(desk.locator("#map-range")).to_contain_text("3 x 2 points, Z 0.000 to 0.000 of G54")
    expect(desk.locator("#map-points li")).to_have_count(0)
    box = desk.locator("#map-picture").bounding_box()
    desk.locator("#map-picture").click(position={"x": box["width"] / 2, "y": box["height"] - 30})
    expect(desk.locator("#map-points li")).to_contain_text("X 10.000, Y 0.000: Z 0.000")
    usable(desk)
    picture(desk, "screen-desk-map")
    desk.get_by_role("button", name="Probe this point again").click()
    expect(desk.locator("#message")).to_contain_text("height map plate is in the library")
    expect(desk.locator("#map-points li")).to_have_count(0)
    desk.route("**/height-maps/plate", without_a_contact)
    desk.locator("#map-shown").dispatch_event("change")
    expect(desk.locator("#map-range")).to_contain_text(
        "Z 0.000 to 0.000 of G54; 1 without a contact"
    )
    expect(desk.locator("#map-points li")).to_contain_text("X 10.000, Y 0.000: no contact")
    picture(desk, "screen-desk-map-gap")
    desk.unroute("**/height-maps/plate")
    desk.locator("#map-shown").dispatch_event("change")
    expect(desk.locator("#map-points li")).to_have_count(0)


def test_a_turned_system_is_in_sight_and_its_rotation_is_removed(desk):
    enter(desk, "G10 L2 P1 X-150 Y-150 Z-32 R30")
    expect(desk.locator("#system-name")).to_have_text("G54 \u2220 30.000\u00b0")
    enter(desk, "G0 X20 Y10 Z5")
    # R turns (20, 10) by 30 degrees: 20 cos - 10 sin, 20 sin + 10 cos.
    expect(desk.locator("#work-x")).to_have_text(re.compile(r"^(20\.00|19\.99)"))
    assert float(desk.inner_text("#machine-x").replace("\u2212", "-")) == pytest.approx(
        -150 + 12.321, abs=0.01
    )
    # Zero of X alone, and its undo: X and Y of a turned system belong together.
    desk.get_by_role("button", name="Zero X here").click()
    expect(desk.locator("#work-x")).to_have_text(re.compile(r"^\u2212?0\.00"))
    expect(desk.locator("#work-y")).to_have_text(re.compile(r"^(10\.00|9\.99)"))
    desk.click("#undo-zero")
    expect(desk.locator("#work-x")).to_have_text(re.compile(r"^(20\.00|19\.99)"))
    expect(desk.locator("#work-y")).to_have_text(re.compile(r"^(10\.00|9\.99)"))
    open_part(desk, "setup")
    usable(desk)
    picture(desk, "screen-desk-turned")
    desk.get_by_role("button", name="Remove the rotation of G54").click()
    expect(desk.locator("#system-name")).to_have_text("G54")
    expect(desk.locator("#straight")).to_be_hidden()


def test_a_camera_has_cross_hairs_an_offset_and_sets_the_zero(desk):
    """The camera is 30 mm to the right and 12 mm in front of the tool."""
    open_part(desk, "setup")
    desk.click("#camera")
    expect(desk.locator("#camera-picture")).to_be_visible()
    desk.wait_for_function("() => document.getElementById('camera-video').videoWidth > 0")
    desk.locator("#camera-seen").click()
    expect(desk.locator("#message")).to_contain_text("the place of the mark is not known")
    enter(desk, "G53 G0 X-60 Y-70 Z-20")
    desk.click("#camera-mark")
    enter(desk, "G53 G0 X-90 Y-58")
    desk.click("#camera-seen")
    expect(desk.locator("#camera-x")).to_have_value("30.000")
    expect(desk.locator("#camera-y")).to_have_value("-12.000")
    usable(desk)
    picture(desk, "screen-desk-camera")
    # The mark becomes the zero, and the tool goes back to it.
    desk.click("#camera-zero")
    expect(desk.locator("#work-x")).to_have_text("\u221230.000")
    expect(desk.locator("#work-y")).to_have_text("12.000")
    desk.click("#camera-go")
    expect(desk.locator("#message")).to_contain_text("go_to: done")
    expect(desk.locator("#machine-x")).to_have_text("\u221260.000")
    expect(desk.locator("#work-x")).to_have_text("0.000")
    expect(desk.locator("#work-y")).to_have_text("0.000")
    desk.click("#camera")
    expect(desk.locator("#camera-picture")).to_be_hidden()
    # The offset is kept in this browser.
    desk.reload()
    expect(desk.locator("#camera-x")).to_have_value("30")
    take(desk)
