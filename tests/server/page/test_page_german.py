"""The page in German: each of its texts, also those that come with the state."""

import re

import pytest

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
