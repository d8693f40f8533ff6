"""The page in German: each of its texts, also those that come with the state."""

import re

import pytest

from cnc.checks.translations import findings_in
from tests.server.page.test_page import picture, upload
from tests.support.server.console_page import expect, open_part
from tests.support.server.page_texts import catalogue
from tests.support.server.quick_mill import SECONDS

PARTS = ["run", "setup", "program", "probe", "tools", "history", "settings"]
TEXTS = """() => {
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), found = [];
  while (walker.nextNode()) {
    const place = walker.currentNode.parentElement;
    if (!place.closest("script, style, noscript")) found.push(walker.currentNode.data.trim());
  }
  for (const name of ["aria-label", "title", "placeholder"]) {
    for (const place of document.querySelectorAll(`[${name}]`)) {
      found.push(place.getAttribute(name));
    }
  }
  return found;
}"""
CUT_OFF = """() => [...document.querySelectorAll("button, .button, h1, h2, legend, th, .badge")]
  .filter(place => !place.matches(".unseen") && place.checkVisibility()
    && place.scrollWidth > place.clientWidth + 1)
  .map(place => [place.id, place.textContent.trim(), place.scrollWidth, place.clientWidth])"""

OVERLAPS = """() => {
  const shown = [...document.querySelectorAll("#dock, #stage > *")]
    .filter(place => place.checkVisibility());
  const boxes = shown.map(place => [place.id, place.getBoundingClientRect()]);
  return boxes.flatMap(([one, a], k) => boxes.slice(k + 1)
    .filter(([, b]) => a.left < b.right - 1 && b.left < a.right - 1
      && a.top < b.bottom - 1 && b.top < a.bottom - 1)
    .map(([other]) => [one, other]));
}"""


def german(browser, address, width=1400, height=1000):
    context = browser.new_context(viewport={"width": width, "height": height}, locale="de-DE")
    context.set_default_timeout(1000 * SECONDS)
    expect.set_options(timeout=1000 * SECONDS)
    page, wrong = context.new_page(), []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(address)
    expect(page.locator("#state")).not_to_have_text(re.compile("connecting|verbindet"))
    return page, wrong


def english_texts(page):
    """Those of the page whose German text is another one."""
    others = {text for text, other in catalogue("de").items() if text != other}
    # A German text may be the English one of something else.
    return sorted(set(page.evaluate(TEXTS)) & others - set(catalogue("de").values()))


@pytest.mark.parametrize(("width", "height"), [(1400, 1000), (390, 844)])
def test_each_part_is_german_and_nothing_is_cut_off(browser, address, width, height):
    page, wrong = german(browser, address, width, height)
    assert page.get_attribute("html", "lang") == "de"
    for part in PARTS:
        open_part(page, part)
        assert english_texts(page) == []
        assert page.evaluate(CUT_OFF) == []
        assert page.evaluate(OVERLAPS) == []
        width_of_page = page.evaluate("document.documentElement.scrollWidth")
        assert width_of_page <= width
    page.context.close()
    assert wrong == []


def test_reasons_questions_and_messages_are_german(browser, address):
    page, wrong = german(browser, address)
    open_part(page, "setup")
    page.click("#home", force=True)
    expect(page.locator("#message-text")).to_have_text(
        "nur Ansicht: zuerst \u201e\u00dcbernehmen\u201c dr\u00fccken"
    )
    page.click("#take")
    expect(page.locator("#holder")).to_have_text("Bedienung hier")
    expect(page.locator("#state")).to_have_text(re.compile("getrennt|bereit|Alarm"))
    page.click("#take")
    expect(page.locator("#holder")).to_have_text("niemand bedient; nur Ansicht")
    page.context.close()
    assert wrong == []


def test_another_language_is_chosen_and_kept(browser, address):
    page, wrong = german(browser, address)
    open_part(page, "settings")
    page.select_option("#language", "en")
    expect(page.locator("#take")).to_have_text("Take control")
    page.reload()
    expect(page.locator("#take")).to_have_text("Take control")
    assert page.get_attribute("html", "lang") == "en"
    page.context.close()
    assert wrong == []


def test_a_page_without_the_catalogue_is_english(browser, address):
    context = browser.new_context(locale="de-DE")
    context.route("**/page/de.po", lambda route: route.abort())
    page = context.new_page()
    page.goto(address)
    expect(page.locator("#take")).to_have_text("Take control")
    assert page.get_attribute("html", "lang") == "en"
    context.close()


# Findings, refusals and questions: what the server says stands below, marked as English.

FAULTY = "G21 G90 (a\nF100\nF200\nG1 X1,5\nM2\n"
FINDINGS = ["comment-mended", "word-shadowed", "character-unknown"]
PAUSES = "G21 G90 F3000\nG53 G0 X-100 Y-100 Z-19\nT2 M6 (der Fräser)\nG53 G0 X-101\nM30\n"
ENGLISH = """() => {
  const words = /\\b(limit|lines|the|is|are|of|and|not|to|this|with|has|it)\\b/;
  const others = "script, style, noscript, .detail, #lines, #editor, #console, #log";
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), found = [];
  while (walker.nextNode()) {
    const text = walker.currentNode.data.trim(), place = walker.currentNode.parentElement;
    if (words.test(text) && !place.closest(others)) found.push(text);
  }
  return found;
}"""


def connected(page, port):
    """Take control, connect the board, and home, unless a test before this one has."""
    page.click("#take")
    expect(page.locator("#holder")).to_have_text("Bedienung hier")
    if page.inner_text("#state") == "getrennt":
        open_part(page, "setup")
        page.select_option("#board", "grbl")
        page.fill("#port", port)
        page.click("#connection button")
        expect(page.locator("#state")).to_have_text("Alarm")
        page.click("#home")
    expect(page.locator("#state")).to_have_text("bereit")
    # Without the question of a start in the middle.
    page.evaluate("document.getElementById('from-line').value = ''")


def checked(page, width, name):
    """No English outside of what the server says, nothing cut off, and a picture on request."""
    assert page.evaluate(ENGLISH) == []
    # A long state ends with an ellipsis: the question has all of it.
    assert [each for each in page.evaluate(CUT_OFF) if each[0] != "state"] == []
    assert page.evaluate(OVERLAPS) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.emulate_media(color_scheme="dark")
    picture(page, f"{name}-{width}-dark")
    page.emulate_media(color_scheme="light")
    picture(page, f"{name}-{width}-light")


@pytest.mark.parametrize(("width", "height"), [(1400, 1000), (390, 844)])
def test_findings_refusals_and_questions_are_german(browser, address, port, width, height):
    page, wrong = german(browser, address, width, height)
    connected(page, port)
    open_part(page, "program")
    upload(page, "falsch.nc", FAULTY)
    expect(page.locator("#findings li")).to_have_count(len(FINDINGS))
    translated = findings_in("de")
    for code in FINDINGS:
        item = page.locator("#findings li", has_text=code)
        expect(item).to_contain_text(translated[code].meaning.replace("`", ""))
        expect(item).to_contain_text(translated[code].remedy.replace("`", ""))
        expect(item.locator(".detail")).to_have_attribute("lang", "en")
    detail = page.locator("#findings li", has_text="character-unknown").locator(".detail")
    expect(detail).to_have_text("a decimal comma is not G-code\nhelp: write a decimal point")
    checked(page, width, "findings")
    page.get_by_role("button", name="Zeile 4 reparieren: character-unknown").click()
    expect(page.locator("#entry-text")).to_contain_text("einen Dezimalpunkt schreiben?")
    assert page.evaluate(ENGLISH) == []
    page.get_by_role("button", name="Abbrechen", exact=True).click()
    open_part(page, "setup")
    page.fill("#mdi", "G1 X")
    page.press("#mdi", "Enter")
    message = page.locator("#message")
    expect(message).to_contain_text("Ein Buchstabe steht ohne Zahl.")
    expect(message).to_contain_text("Die Zahl schreiben, oder den Buchstaben entfernen.")
    expect(message.locator(".detail")).to_contain_text("X")
    checked(page, width, "refused")
    open_part(page, "program")
    upload(page, "wechsel.nc", PAUSES)
    expect(page.locator("#outcome")).to_contain_text("geprüft")
    page.check("#trust")
    page.click("#run")
    expect(page.locator("#question-text")).to_have_text("Werkzeug 2 einsetzen: der Fräser")
    expect(page.locator("#state")).to_contain_text("Werkzeug 2 einsetzen: der Fräser")
    checked(page, width, "question")
    page.click("#yes")
    expect(page.locator("#question")).not_to_be_visible()
    expect(page.locator("#outcome")).to_contain_text("fertig")
    page.click("#take")
    page.context.close()
    assert wrong == []


TELL = "event => import('/page/api.js').then(({emit}) => emit(event))"
DOUBT = "the board does not report its position"
STEPS = ["lift Z to -3.000", "start the spindle cw with 9000 rpm and wait 3 s", "mist and flood on"]
GERMAN_STEPS = [
    "Z anheben auf -3.000",
    "die Spindel rechts mit 9000 U/min starten und 3 s warten",
    "Sprühnebel und Kühlmittel ein",
]


def asked(page, kind, text, **parts):
    question = {"event": "dialog", "id": 1, "kind": kind, "text": text, "doubts": [], "steps": []}
    page.evaluate(TELL, question | parts)
    expect(page.locator("#question")).to_be_visible()


def test_each_kind_of_question_is_german(browser, address):
    page, wrong = german(browser, address)
    text, more = page.locator("#question-text"), page.locator("#question-help")
    doubt = {"code": "position-assumed", "message": DOUBT, "hint": "", "severity": "warning"}
    begin = f"{DOUBT}; from line 8, in machine coordinates:"
    asked(page, "restart", begin, doubts=[doubt], steps=STEPS)
    meaning = findings_in("de")["position-assumed"].meaning
    expect(text).to_have_text(f"{meaning} ab Zeile 8, in Maschinenkoordinaten:")
    expect(more).to_have_text(DOUBT)
    expect(more).to_have_attribute("lang", "en")
    expect(page.locator("#question-steps li")).to_have_text(GERMAN_STEPS)
    # Steps and doubts of the one question are not those of the next.
    asked(page, "door", "the safety door is open: close it, then resume")
    expect(text).to_have_text("die Schutztür ist offen: schließen, dann „Weiter“ drücken")
    expect(more).to_have_attribute("lang", "de")
    expect(page.locator("#question-steps li")).to_have_count(0)
    first = "set a gauge along X, so that it follows X in both directions by 0.5 mm"
    asked(page, "reading", f"{first}\nthe gauge")
    expect(text).to_have_text("die Messuhr")
    expect(more).to_contain_text("eine Messuhr längs X ansetzen")
    page.context.close()
    assert wrong == []


def test_a_notice_has_its_values_below_the_german_text(browser, address):
    page, wrong = german(browser, address)
    found = {
        "code": "board-differs",
        "message": "$110 is 500, the file has 600",
        "hint": "as usual",
    }
    page.evaluate(TELL, {"event": "notice", "finding": found | {"severity": "warning", "line": 0}})
    message = page.locator("#message")
    expect(message).to_contain_text("Die Steuerkarte fährt nach ihren eigenen Einstellungen")
    expect(message.locator(".detail")).to_have_text(f"{found['message']}\nhelp: as usual")
    # A code that the catalogue does not have is shown as it comes.
    page.evaluate(TELL, {"event": "alarm", "finding": found | {"code": "new-code", "line": 3}})
    expect(page.locator("#message-text")).to_have_text(f"Zeile 3: {found['message']}\nas usual")
    page.context.close()
    assert wrong == []
