"""The page in a browser: its contents and functions, and that it runs no text of a program."""

import json
import os

import pytest

from cnc import cli
from tests.support.paths import ROOT
from tests.support.soak import share
from tests.support.view.browser import FOUND, INSTALL, Browser
from tests.support.view.drawn import drawn
from tests.view.test_view_command import HOSTILE

LINES = (
    "G21 G90 G94\nG0 X5 Y5\nG1 X60 F1500 (there)\nY45 ; up\nG2 X20 Y45 I-20 J0\nG1 Y5\nG0 Z5\nM2\n"
)
CORNER = "(box => [box.left + 60, box.top + 5])"
"""A JavaScript function: a point near the upper left corner of a box."""
PIXELS = """(() => {
  const gl = m.scene.gl, w = gl.drawingBufferWidth, h = gl.drawingBufferHeight, counts = {};
  const pixels = new Uint8Array(4 * w * h);
  m.draw();
  gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  for (let i = 0; i < pixels.length; i += 4) {
    const colour = pixels.subarray(i, i + 3).join();
    counts[colour] = (counts[colour] || 0) + 1;
  }
  return counts;
})()"""
"""Counts the pixels of each colour on the screen."""


@pytest.fixture(scope="module")
def browser():
    if FOUND is None:
        if os.environ.get("CI"):
            pytest.fail(f"chromium is not installed: {INSTALL}")
        pytest.skip(f"chromium is not installed: {INSTALL}")
    with Browser() as found:
        found.call(
            "Emulation.setDeviceMetricsOverride",
            width=1280,
            height=800,
            deviceScaleFactor=1,
            mobile=False,
        )
        yield found


@pytest.fixture
def show(browser, tmp_path):
    """Return a function: draw a program as a page and open it."""

    def carry_out(text: str, *options: str, name: str = "p.nc") -> None:
        program, page = tmp_path / name, tmp_path / "out.html"
        program.write_text(text, encoding="utf-8")
        assert cli.exit_code(["view", str(program), "-o", str(page), "--quiet", *options]) == 0
        opened = browser.open(page)
        assert opened.isdigit(), opened
        assert browser.complaints == []

    return carry_out


@pytest.fixture
def ask(browser):
    """Return a function: the value of an expression with the model ``m`` of the page."""
    return lambda expression: browser.evaluate(f"opened.then(m => ({expression}))")


def middle_of_line(text, line, tmp_path):
    """Return the time in the middle of the motion of a source line."""
    program = tmp_path / "plan.nc"
    program.write_text(text)
    picture = drawn(program).picture
    row = picture.origins.first.tolist().index(line)
    ends = [*picture.origins.t.tolist(), picture.duration]
    return 0.5 * (ends[row] + ends[row + 1])


def screen_place(ask, t):
    """Return the place of the tool on the screen at a time."""
    return ask(
        "(([x, y], box) => [x + box.left, y + box.top])"
        f"(m.scene.project(...m.place({t})), over.getBoundingClientRect())"
    )


def test_no_text_of_a_program_runs(browser, show, ask, tmp_path):
    show(HOSTILE, name="<img src=x onerror=hacked=1>.nc")
    assert browser.evaluate("typeof hacked") == "undefined"
    assert (
        browser.evaluate("document.querySelectorAll('img, svg, iframe, link, object').length") == 0
    )
    assert browser.evaluate("[...document.scripts].filter(each => !each.type).length") == 1
    rows = browser.evaluate(
        "[...document.querySelectorAll('.row code')].map(row => row.textContent)"
    )
    expected = [
        line.replace("\u2028", "\u00b7").replace("\u202e", "\u00b7") for line in HOSTILE.split("\n")
    ]
    assert rows == expected[: len(rows)] and len(rows) == 6
    assert browser.evaluate("document.title") == str(tmp_path / "<img src=x onerror=hacked=1>.nc")
    for line in range(1, 7):
        browser.evaluate(f"document.querySelectorAll('.row')[{line - 1}].click()")
    assert browser.evaluate("typeof hacked") == "undefined"
    asked = [
        parameters["request"]["url"]
        for method, parameters in browser.events
        if method == "Network.requestWillBeSent"
    ]
    assert asked == [(tmp_path / "out.html").as_uri()]


def test_the_policy_blocks_injected_scripts(browser, show):
    """A script that got into the page would not run."""
    show(LINES)
    browser.evaluate(
        "document.body.insertAdjacentHTML('beforeend', '<img src=\"x:\" onerror=\"hacked = 1\">')"
    )
    browser.evaluate(
        "document.body.append("
        "Object.assign(document.createElement('script'), {text: 'hacked = 1'}))"
    )
    browser.evaluate("new Promise(done => setTimeout(done, 100))")
    assert browser.evaluate("typeof hacked") == "undefined"
    assert any("Content Security Policy" in each for each in browser.complaints)


def test_a_click_on_the_path_selects_the_line_and_the_reverse(browser, show, ask, tmp_path):
    show(LINES)
    assert ask("m.scene.gl !== null")
    for line in (3, 5, 4):
        t = middle_of_line(LINES, line, tmp_path)
        browser.click(*screen_place(ask, t))
        assert browser.evaluate(
            "[...document.querySelectorAll('.row.chosen')].map(row => row.dataset.line)"
        ) == [str(line)]
        assert ask("m.state.at") == pytest.approx(t, abs=0.1)
    program = tmp_path / "plan.nc"
    begins = drawn(program).picture.origins
    for line, start in zip(begins.first.tolist(), begins.t.tolist(), strict=True):
        box = browser.evaluate(
            CORNER
            + f"(document.querySelector('.row[data-line=\"{line}\"]').getBoundingClientRect())"
        )
        browser.click(*box)
        assert ask("m.state.at") == pytest.approx(start, abs=1e-6)
        assert ask("m.scene.chosen.data.length") > 0
    # A line without motion selects no stroke.
    browser.click(
        *browser.evaluate(CORNER + "(document.querySelector('.row').getBoundingClientRect())")
    )
    assert browser.evaluate("document.querySelector('.row.chosen').dataset.line") == "1"
    assert ask("m.scene.chosen") is None


def test_hovering_shows_line_and_time_in_the_path_and_in_the_curves(browser, show, ask, tmp_path):
    show(LINES)
    t = middle_of_line(LINES, 4, tmp_path)
    browser.mouse("mouseMoved", *screen_place(ask, t))
    assert browser.evaluate("document.getElementById('tip').hidden") is False
    assert browser.evaluate("document.getElementById('tip').textContent").startswith(
        "line 4 \u00b7 "
    )
    assert ask("m.state.hover") == pytest.approx(t, abs=0.1)
    x, y = browser.evaluate("(box => [box.left, box.top + 50])(graph.getBoundingClientRect())")
    browser.mouse("mouseMoved", x + ask(f"m.graph.x({t})"), y)
    assert ask("m.state.hover") == pytest.approx(t, abs=ask("m.about.duration / m.graph.width"))
    assert "line 4" in browser.evaluate("document.getElementById('tip').textContent")


def test_playback_and_return_to_the_whole_path(browser, show, ask):
    show(LINES)
    browser.evaluate("document.getElementById('play').click()")
    first = browser.wait(lambda: ask("m.state.at"))
    assert browser.wait(lambda: ask(f"m.state.at > {first}"))
    browser.evaluate("document.getElementById('speed').value = '1000'")
    assert browser.wait(lambda: ask("!m.state.playing"))
    assert ask("m.state.at") == pytest.approx(ask("m.about.duration"))
    browser.evaluate("document.getElementById('stop').click()")
    assert ask("m.state.at") is None


def test_the_path_is_visible_in_each_colour_in_light_and_dark_mode(browser, show, ask):
    show(LINES, "--stock", "X0:70,Y0:60,Z-5:0")
    for dark in (False, True):
        browser.dark(dark)
        browser.wait(lambda: ask("m.state.dark") is dark)  # noqa: B023
        shown = []
        for channel in range(4):
            browser.evaluate(f"document.querySelector('[data-channel=\"{channel}\"]').click()")
            pixels = ask(PIXELS)
            paper = max(pixels, key=pixels.__getitem__)
            assert (sum(map(int, paper.split(","))) < 120) is dark
            assert 1000 < sum(pixels.values()) - pixels[paper] < 0.2 * sum(pixels.values())
            shown.append(pixels)
        assert all(a != b for k, a in enumerate(shown) for b in shown[:k])
        assert json.loads(ask("JSON.stringify(m.about.stock)")) == [[0, 70], [0, 60], [-5, 0]]


def test_the_curves_of_a_joint_are_shown_on_demand(browser, show, ask):
    program = (ROOT / "programs" / "five-axis" / "cone.nc").read_text()
    show(program, "--machine", "trunnion")
    names = browser.evaluate("[...document.querySelectorAll('#joint option')].map(o => o.text)")
    assert names == ["tool tip", *(f"joint {letter}" for letter in "XYZAC")]
    assert ask("m.graph.strips.map(strip => strip[0])") == ["feed", "acceleration", "jerk"]
    before = ask("(m.draw(), m.graph.canvas.toDataURL())")
    browser.evaluate("(joint.value = '5', joint.dispatchEvent(new Event('change')))")
    assert ask("m.graph.strips.map(strip => strip.join())") == [
        "position,\u00b0",
        "velocity,\u00b0/s",
        "acceleration,\u00b0/s\u00b2",
    ]
    assert ask("(m.draw(), m.graph.canvas.toDataURL())") != before
    # C makes one turn along the cone, at most at its limits.
    ends = ask("[0, m.about.duration].map(t => m.graph.values(t)[0])")
    assert [value for pair in ends for value in pair] == pytest.approx([0, 0, 360, 360], abs=1e-3)
    fastest = ask("[1, 2].map(k => Math.max(...m.graph.ranges[k].high.at(-1)))")
    assert 20.0 < fastest[0] <= 1.001 * 120.0
    assert 20.0 < fastest[1] <= 1.001 * 800.0
    browser.mouse(
        "mouseMoved", *ask("(box => [box.left + 200, box.top + 50])(graph.getBoundingClientRect())")
    )
    assert "\nC: " in browser.evaluate("document.getElementById('tip').textContent")
    browser.evaluate("(joint.value = '0', joint.dispatchEvent(new Event('change')))")
    assert ask("(m.state.hover = null, m.draw(), m.graph.canvas.toDataURL())") == before


def test_the_page_of_a_five_axis_program_is_accessible(browser, show):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe()
    show((ROOT / "programs" / "five-axis" / "cone.nc").read_text(), "--machine", "trunnion")
    browser.evaluate(axe.axe_script + "; 0")
    found = browser.evaluate("axe.run().then(r => r.violations.map(v => v.id))")
    assert found == []


def test_without_joints_of_their_own_there_is_no_choice(browser, show, ask):
    show(LINES)
    assert browser.evaluate("joint.hidden")
    assert ask("m.joints.length") == 0


def test_levels_of_detail_are_within_half_a_pixel(browser, show, ask):
    """Each level is compared with the finest at all times of its points."""
    show((ROOT / "programs" / "pocket.nc").read_text())
    off = ask(
        "m.scene.levels.map(level => {"
        " const all = m.scene.levels[0].data, {data, n} = level; let i = 0, worst = 0;"
        " for (let k = 0; k < all.length; k += FLOATS) { const t = all[k + 3];"
        " while (i + 2 < n && data[FLOATS * (i + 1) + 3] < t) i++;"
        " const [a, b] = [FLOATS * i, FLOATS * (i + 1)], span = data[b + 3] - data[a + 3];"
        " const p = span > 0 ? (t - data[a + 3]) / span : 0;"
        " const off = j => data[a + j] + p * (data[b + j] - data[a + j]) - all[k + j];"
        " worst = Math.max(worst, Math.hypot(...[0, 1, 2].map(off))); }"
        " return [worst, level.tolerance, n]; })"
    )
    assert len(off) > 2
    for worst, tolerance, _ in off:
        # The times of points have 32 bits; the tool moves within their rounding.
        assert worst <= tolerance + 2e-3
    assert ask("m.scene.level().tolerance * m.scene.scale") < 0.5
    assert off[-1][2] < off[0][2] / 2


ROWS = "G21 G90 G61 F6000\n" + "".join(
    f"G1 X{40 if row % 2 else 0} Y{0.03 * row:.2f}\nY{0.03 * (row + 1):.2f}\n"
    for row in range(1500)
)


COVERED = """m.scene.levels.map(({tolerance, all, few}) => {
  const near = (x, y) => {
    for (let o = 0; o < few.data.length; o += 16) {
      const [low, high] = [few.data[o], few.data[o + 8]].sort((a, b) => a - b);
      const within = low - tolerance <= x && x <= high + tolerance;
      if (within && Math.abs(few.data[o + 1] - y) < 1.1 * tolerance) return true;
    }
    return false;
  };
  const {data} = all;
  let far = 0, points = 0;
  for (let o = 0; few !== all && o + 8 < data.length; o += 56) {
    for (const part of [0.1, 0.5, 0.9]) {
      const [x, y] = [o, o + 1].map(k => data[k] + part * (data[k + 8] - data[k]));
      points++;
      far += !near(x, y);
    }
  }
  const dashes = ({data, stride, count}) => {
    let n = 0;
    for (let i = 0; i < count; i++) n += data[8 * stride * i + 7] !== NO_DASH_32;
    return n;
  };
  return [few === all, all.count, few.count, points && far / points, dashes(all), dashes(few)];
})"""
"""For each level of detail: whether all strokes are drawn, how many there are, how many are drawn,
the share of points far from those that are drawn, the traverses, and those that are drawn."""


def test_few_strokes_cover_a_dense_path_while_the_view_moves(browser, show, ask):
    """Points of strokes that are left out lie near others, and traverses are never left out."""
    show(ROWS + "G0 Z20\nX0 Y20\nM2\n")
    found = ask(COVERED)
    assert any(not same for same, *_ in found)
    for same, count, few, far, dashes, few_dashes in found:
        assert dashes == few_dashes > 0
        if not same:
            assert few < count / 2
            assert far < 0.1


def test_all_strokes_are_drawn_at_rest_and_few_while_the_view_moves(browser, show, ask):
    show(ROWS + "M2\n")
    ask("m.scene.scale = 2")
    at_rest = ask("(m.scene.coarse = 1, m.draw(), m.scene.drawn)")
    assert at_rest == ask("m.scene.level().n - 1")
    moving = ask("(m.scene.coarse = 8, m.draw(), m.scene.drawn)")
    assert 0 < moving < at_rest / 3


def test_a_pointer_over_the_path_does_not_draw_it_again(browser, show, ask, tmp_path):
    show(LINES)
    ask(
        "(m.drawings = 0, m.scene.draw = (draw => look => {"
        " m.drawings++; draw.call(m.scene, look); })(m.scene.draw))"
    )
    ask("m.draw()")
    before = ask("m.drawings")
    browser.mouse("mouseMoved", *screen_place(ask, middle_of_line(LINES, 3, tmp_path)))
    assert browser.wait(lambda: ask("m.state.hover !== null"))
    ask("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert ask("m.drawings") == before
    ask("m.press({channel: 1})")
    assert browser.wait(lambda: ask("m.drawings") > before)


def test_views_zoom_and_rotation(browser, show, ask):
    show(LINES)
    ask("m.press({view: '3d'})")
    before = ask("[m.scene.yaw, m.scene.scale]")
    browser.mouse("mousePressed", 300, 300, button="left", buttons=1, clickCount=1)
    browser.mouse("mouseMoved", 380, 330, button="left", buttons=1)
    browser.mouse("mouseReleased", 380, 330, button="left", clickCount=1)
    assert ask("m.scene.yaw") != before[0]
    # After slow frames the finest level is drawn when the view is at rest.
    ask("m.scene.coarse = 64")
    browser.mouse("mouseWheel", 300, 300, deltaX=0, deltaY=0)
    assert browser.wait(lambda: ask("m.scene.coarse === 1"))
    ask("m.scene.fit()")
    before = ask("[m.scene.yaw, m.scene.scale]")
    point = ask("m.scene.project(0, 0, 0).slice(0, 2)")
    ask(f"m.scene.zoom(2, {point[0]}, {point[1]})")
    assert ask("m.scene.scale") == pytest.approx(2 * before[1])
    assert ask("m.scene.project(0, 0, 0).slice(0, 2)") == pytest.approx(point, abs=1e-6)
    assert browser.complaints == []


def test_without_webgl_the_curves_and_the_program_are_shown(browser, tmp_path):
    program, page = tmp_path / "p.nc", tmp_path / "out.html"
    program.write_text(LINES)
    assert cli.exit_code(["view", str(program), "-o", str(page), "--quiet"]) == 0
    lost = "HTMLCanvasElement.prototype.getContext = (plain => function (kind, ...more) {"
    lost += " return kind === 'webgl2' ? null : plain.call(this, kind, ...more); })"
    lost += "(HTMLCanvasElement.prototype.getContext)"
    script = browser.call("Page.addScriptToEvaluateOnNewDocument", source=lost)["identifier"]
    try:
        assert browser.open(page).isdigit()
        assert "WebGL" in browser.evaluate("document.getElementById('trouble').textContent")
        browser.click(
            *browser.evaluate(
                CORNER + "(document.querySelectorAll('.row')[2].getBoundingClientRect())"
            )
        )
        assert browser.evaluate("document.querySelector('.row.chosen').dataset.line") == "3"
        assert browser.evaluate("opened.then(m => m.state.at)") > 0
        assert browser.complaints == []
    finally:
        browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script)


def test_a_subroutine_of_another_file_is_shown_with_its_lines(browser, show, ask, tmp_path):
    (tmp_path / "square.ngc").write_text(
        "o<square> sub\nG1 X20 F1500\nG1 Y20\no<square> endsub\nM2\n"
    )
    show("G21 G90\nG0 X10\no<square> call\nG0 X0\nM2\n", name="main.ngc")
    files = "[...document.getElementById('files').options].map(each => each.label)"
    expected = [str(tmp_path / "main.ngc"), str(tmp_path / "square.ngc")]
    assert browser.evaluate(files) == expected
    middle = ask("(m.origins.t[2] + m.origins.t[3]) / 2")
    browser.click(*screen_place(ask, middle))
    assert ask("m.source.file") == 1
    assert browser.evaluate("document.querySelector('.row.chosen code').textContent") == "G1 Y20"


def test_a_long_program_scrolls_to_its_end(browser, show, ask):
    """The lines are taller than the tallest element that browsers permit."""
    lines = share(1_200_000, 500_000)
    show("G21 G90 G0 X1\n" + "\n" * (lines - 3) + "G0 X2\nM2\n")
    assert ask("m.source.count") == lines
    browser.evaluate("opened.then(m => m.source.scroll(m.source.count))")
    assert browser.evaluate("[...document.querySelectorAll('.row')].at(-1).dataset.line") == str(
        lines
    )
    ask("m.chooseTime(m.about.duration)")
    box = browser.evaluate(
        "(box => [box.top, box.bottom, innerHeight])"
        "(document.querySelector('.row.chosen').getBoundingClientRect())"
    )
    assert 0 < box[0] < box[1] < box[2]
