"""Actions of an operator on the page of the console."""

import pytest

expect = pytest.importorskip("playwright.sync_api").expect


def open_part(page, name):
    page.click(f'nav button[data-part="{name}"]')


def take(page):
    page.click("#take")
    expect(page.locator("#holder")).to_have_text("you have control")


def connect(page, port):
    """Connect and home, unless a test before this one has."""
    if page.inner_text("#state") == "disconnected":
        open_part(page, "setup")
        page.select_option("#board", "grbl")
        page.fill("#port", port)
        page.click("#connection button")
        expect(page.locator("#state")).to_have_text("alarm")
        page.click("#home")
    expect(page.locator("#state")).to_have_text("idle")
    expect(page.locator("#lamps")).to_contain_text("X homed: on")


def enter(page, line):
    """Run a line, and wait for its end."""
    open_part(page, "setup")
    # The message of an earlier line must not count.
    page.evaluate("document.getElementById('message-text').textContent = ''")
    page.fill("#mdi", line)
    page.press("#mdi", "Enter")
    expect(page.locator("#message")).to_contain_text("MDI: done")
    # The state that allows the next motion may come after the message.
    expect(page.locator("#state")).not_to_have_text("running")
