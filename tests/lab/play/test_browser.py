# SPDX-License-Identifier: MIT
"""The playground in headless Chromium: values, keys, mouse and touch, colours, phone width, reduced motion."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import stiffgen
from lab.play.browser import Browser, Page
from stiffgen import open_robot
from stiffgen.lab.play.page import write_page
from support.chains import chain_urdf
from support.playground import require_wasm
from support.project import ROOT, assert_close

pytestmark = pytest.mark.slow

ROBOTS = {
    "six axes": ("rrrrrr", {}),
    "one joint": ("r", {}),
    "slides and mimics": ("rrpmrr", {}),
    "floating base": ("rrr", {"floating_base": True}),
    "tool at run time": ("rrrr", {"runtime_tool": True}),
    "two tips": (None, {"tip": ["left hand", "right-hand"]}),
}
ASYMMETRY = "Math.max(...playground.now.matrices.antisymmetric.map(Math.abs))"
NET = "playground.now.works.conventional.at(-1)"

CONTRAST = """(() => {
  const channel = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  const luminance = ([r, g, b]) => 0.2126 * channel(r / 255) + 0.7152 * channel(g / 255) + 0.0722 * channel(b / 255);
  const rgb = (text) => text.match(/[\\d.]+/g).map(Number);
  const ratio = (a, b) => {
    const [x, y] = [luminance(a), luminance(b)].sort((p, q) => q - p);
    return (x + 0.05) / (y + 0.05);
  };
  const behind = (e) => {
    for (; e; e = e.parentElement) {
      const colour = rgb(getComputedStyle(e).backgroundColor);
      if (colour.length < 4 || colour[3] > 0) return colour;
    }
    return [255, 255, 255];
  };
  const written = (e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
  const texts = [...document.querySelectorAll("body *")].filter((e) => e.checkVisibility() && written(e))
    .map((e) => ratio(rgb(getComputedStyle(e).color), behind(e)));
  const section = document.querySelector("section"), probe = section.appendChild(document.createElement("i"));
  const lines = ["corrected", "conventional", "exact", "secant"].map((name) => {
    probe.style.color = `var(--${name})`;
    return ratio(rgb(getComputedStyle(probe).color), behind(section));
  });
  probe.remove();
  return [Math.min(...texts), Math.min(...lines), texts.length];
})()"""
"""The least contrast of texts, and of the lines of the work; how many texts."""


@pytest.fixture
def page(browser: Browser, file: Path) -> Page:
    """Return the page in a browser; fail at the end for errors or requests to other hosts."""
    opened = browser.page()
    opened.window(1280, 900)
    opened.open(file)
    yield opened
    assert opened.errors == []
    assert all(address.startswith("file:") or address.startswith("data:") for address in opened.requests)
    opened.do("Page.close")


def focus(page: Page, label: str) -> None:
    """Focus the slider with an accessible name."""
    page.js(
        "[...document.querySelectorAll('input[type=range]')]"
        f".find(e => e.getAttribute('aria-label').startsWith({json.dumps(label)})).focus()"
    )


def press(page: Page, button: str) -> None:
    """Find a button by its text and press it with the keyboard."""
    page.js(f"[...document.querySelectorAll('button')].find(b => b.textContent === {json.dumps(button)}).focus()")
    page.do("Input.dispatchKeyEvent", type="keyDown", key="Enter", code="Enter", windowsVirtualKeyCode=13, text="\r")
    page.do("Input.dispatchKeyEvent", type="keyUp", key="Enter", code="Enter", windowsVirtualKeyCode=13)
    page.settle()


def choose(page: Page, select: str, value: int) -> None:
    """Choose an option of a select element."""
    page.js(
        f"(() => {{ const select = document.getElementById('{select}'); select.value = {value};"
        " select.dispatchEvent(new Event('change')); })()"
    )
    page.settle()


def place_of_tip(page: Page) -> list[float]:
    return page.js("Array.from([3, 7, 11], k => playground.tips[0].pose(playground.state.q)[k])")


def seen_tip(page: Page) -> tuple[float, float]:
    """Return where the tip is on the screen [pixels]."""
    x, y = page.js(
        "(() => { const box = document.getElementById('arm').getBoundingClientRect();"
        " const [x, y] = playground.view.seen([3, 7, 11].map(k => playground.tips[0].pose(playground.state.q)[k]));"
        " return [box.left + x, box.top + y]; })()"
    )
    return x, y


def test_values_are_pythons(page: Page, robot: ModuleType) -> None:
    """Compute joint stiffnesses in the page: Python's values, in 20 states."""
    random = np.random.default_rng(5)
    formula = "playground.tips[0].jointStiffness(...[{q}, {F}, {K}].map(x => Float64Array.from(x)), {c})"
    for _ in range(20):
        q, wrench = random.uniform(-2, 2, 7), 20 * random.normal(size=6)
        gains = random.uniform(10, 900, 6)
        given = {"q": q.tolist(), "F": wrench.tolist(), "K": np.diag(gains).ravel().tolist()}
        got = [page.js(f"Array.from({formula.format(**given, c=c)})") for c in ("true", "false")]
        assert_close(np.reshape(got[0], (7, 7)), robot.hybrid.joint_stiffness(q, wrench, np.diag(gains)))
        assert_close(np.reshape(got[1], (7, 7)), robot.hybrid.joint_stiffness_uncorrected(q, wrench, np.diag(gains)))


def test_a_moment_by_keyboard_makes_it_asymmetric_at_once(page: Page) -> None:
    """Raise the moment to 2 N m by keyboard: asymmetry, and net work -pi r^2 m with r = 0.1 m."""
    press(page, "No load")
    assert page.js(ASYMMETRY) < 1e-12
    assert abs(page.js(NET)) < 1e-12
    assert page.js("document.getElementById('law-conventional').textContent") == "0 J"
    focus(page, "moment along z")
    page.press("ArrowRight", 20)
    page.settle()
    assert page.js("playground.state.wrench[5]") == pytest.approx(2.0)
    assert page.js("document.activeElement.getAttribute('aria-valuetext')") == "2.0 N m"
    assert page.js(ASYMMETRY) > 0.5
    assert page.js(NET) == pytest.approx(-np.pi * 0.01 * 2, abs=1e-5)
    assert page.js("document.getElementById('law-conventional').textContent") == "−0.0628 J"
    assert page.js("document.getElementById('law-exact').textContent") == "0 J"
    assert "asymmetric by" in page.js("document.getElementById('verdict').textContent")


def test_presets_and_controls(page: Page) -> None:
    """Use presets, sliders, loops and matrix maps by keyboard: state and words follow."""
    press(page, "Near singular")
    near = page.js("Array.from(playground.state.q)")
    press(page, "Paper's posture")
    assert np.abs(np.degrees(page.js("Array.from(playground.state.q)")) - near).max() > 1
    np.testing.assert_allclose(np.degrees(page.js("playground.state.q[3]")), -94.85, atol=1e-9)
    focus(page, "joint 4")
    page.press("ArrowRight", 5)
    np.testing.assert_allclose(np.degrees(page.js("playground.state.q[3]")), -94.4, atol=0.11)
    focus(page, "stiffness along x")
    page.press("ArrowLeft", 3)
    assert page.js("playground.state.gains[0]") == 670
    page.js("document.getElementById('chosen').click()")
    page.settle()
    assert "gains as they are" in page.js("document.getElementById('verdict').textContent")
    page.js("document.querySelector('#maps canvas').focus()")
    page.press("ArrowDown")
    page.press("ArrowRight")
    assert "A2, A2" in page.js("document.querySelector('#maps output').textContent")
    for k in range(7):  # every loop
        choose(page, "loop", k)
        works = page.js("Object.fromEntries(Object.entries(playground.now.works).map(([law, w]) => [law, w.at(-1)]))")
        assert abs(works["exact"]) < 1e-10
        assert abs(works["corrected"]) < 1e-10


PRESSED = "[...document.querySelectorAll('#presets [aria-pressed=true]')].map(b => b.textContent)"


def test_the_preset_that_was_pressed_is_marked_while_it_holds(page: Page) -> None:
    """Reversed, the loop with energy is only a moment at the tip, and nobody pressed that."""
    assert page.js(PRESSED) == ["Paper's posture"]
    press(page, "Energy out of nothing")
    assert page.js(PRESSED) == ["Energy out of nothing"]
    made = page.js(NET)
    assert made > 1
    press(page, "Reverse")
    assert page.js(PRESSED) == []
    assert page.js(NET) < -1
    focus(page, "moment along z")
    page.press("ArrowRight")
    page.settle()
    assert page.js(PRESSED) == []


def test_a_clamped_value_says_so(page: Page) -> None:
    """Type 500 degrees: clamped to the limit of 170, and a note says it."""
    page.js(
        "(() => { const box = document.querySelector('#joints input[type=number]'); box.value = 500;"
        " box.dispatchEvent(new Event('input')); })()"
    )
    page.settle()
    assert page.js("playground.state.q[0]") == pytest.approx(np.radians(170), abs=1e-3)
    assert page.js("document.querySelector('#joints .note').textContent").startswith("500 is beyond the end: 170")
    focus(page, "joint 1")
    page.press("ArrowLeft")
    assert page.js("document.querySelector('#joints .note').hidden")


def test_push_and_let_go(page: Page) -> None:
    """Let three arms go: the conventional one puts out energy, the others none."""
    press(page, "Let go")
    page.js("new Promise(done => setTimeout(() => done(null), 1500))")
    laws, text = page.js("[playground.swing.arms(), document.getElementById('swing-text').textContent]")
    assert [each["law"] for each in laws] == ["conventional", "corrected", "exact"]
    assert "exact 0 J" in text and "corrected 0 J" in text and "conventional 0 J" not in text
    assert page.js("document.querySelectorAll('#letters .laws b').length") == 3
    press(page, "Back to the start")
    assert page.js("playground.swing.arms()") is None


def test_an_arm_on_joint_springs_gives_way(page: Page) -> None:
    """Pressed along itself it falls by a metre, the usual formula says a millimetre; pressed again, it stands."""
    ellipsoids = "playground.shown().ellipsoids.map(({ name }) => name)"
    assert page.js(ellipsoids) == ["rotation", "translation"]
    page.prefer(prefers_reduced_motion="reduce")
    page.settle()
    press(page, "Gives way")
    assert page.js(PRESSED) == ["Gives way"]
    assert page.js(ellipsoids) == ["conventional", "exact"]
    loaded, usual, text = page.js(
        "(({ loaded, usual }) => [loaded, usual, document.getElementById('press-text').textContent])"
        "(playground.compliance.press.ways())"
    )
    assert loaded > 0.5 and usual < 0.005
    assert "80.0 N: the arm gave way at 56" in text
    press(page, "Back to the start")
    assert page.js("playground.compliance.press") is None
    focus(page, "gain of all turning joints")
    page.press("PageUp", 3)
    page.settle()
    press(page, "Press")
    assert "gave way" not in page.js("document.getElementById('press-text').textContent")
    assert "the posture holds" in page.js("document.getElementById('softness').textContent")


def test_a_ball_joint_flutters_on_three_drives(page: Page) -> None:
    """Push the ball joint: three drives swing on, the trace form rests; with more damping both rest."""
    page.prefer(prefers_reduced_motion="reduce")
    page.settle()
    press(page, "A ball joint")
    assert page.js(PRESSED) == ["A ball joint"]
    assert page.js("document.querySelectorAll('#letters .laws b').length") == 3
    text = page.js("document.getElementById('push-text').textContent")
    assert text.startswith("After 6.00 s") and "three drives 2.6" in text and "trace 0 rad" in text
    focus(page, "damping ratio")
    page.press("PageUp", 2)
    page.settle()
    assert page.js("playground.drives.bodies()") is None
    press(page, "Push")
    text = page.js("document.getElementById('push-text').textContent")
    assert "three drives 0 rad" in text
    press(page, "Back to the arm")
    assert page.js("playground.shown().arms") is None


def test_every_control_has_a_name_and_is_reached_by_tab(page: Page) -> None:
    """Walk through the page by Tab: each control has a name and shows its focus."""
    nodes = page.do("Accessibility.getFullAXTree")["nodes"]
    roles = ("slider", "spinbutton", "button", "combobox", "checkbox", "radio", "application", "image")
    named = [node for node in nodes if node.get("role", {}).get("value") in roles]
    assert len(named) > 50
    assert [node["role"]["value"] for node in named if not node.get("name", {}).get("value")] == []
    numbers = "(e => [...document.querySelectorAll('*')].indexOf(e))"
    controls = page.js(
        "[...document.querySelectorAll('button, select, input, canvas[tabindex]')].filter(e => e.checkVisibility()"
        f" && !(e.type === 'radio' && !e.checked)).map({numbers})"
    )
    page.js("document.activeElement.blur()")
    reached, unseen = set(), []
    for _ in range(len(controls)):
        page.press("Tab")
        number, width = page.js(
            f"[{numbers}(document.activeElement), parseFloat(getComputedStyle(document.activeElement).outlineWidth)]"
        )
        reached.add(number)
        if width < 2:
            unseen.append(number)
    assert reached == set(controls)
    assert unseen == []


def test_tip_is_dragged_by_mouse_and_keys(page: Page) -> None:
    """Drag the tip by mouse, then move it by keys: the arm follows within 4 pixels."""
    before, (x, y) = place_of_tip(page), seen_tip(page)
    page.drag([(x, y), (x - 7, y - 6), (x - 18, y - 14), (x - 28, y - 21)])
    page.settle()
    assert 0.02 < np.linalg.norm(np.subtract(place_of_tip(page), before)) < 0.6
    np.testing.assert_allclose(seen_tip(page), (x - 28, y - 21), atol=4)
    shown = float(page.js("document.querySelector('#joints input[type=number]').value"))
    assert shown == pytest.approx(np.degrees(page.js("playground.state.q[0]")), abs=0.06)  # sliders follow
    page.js("document.getElementById('arm').focus()")
    before = place_of_tip(page)
    page.press("PageUp", 3, shift=True)
    moved = np.subtract(place_of_tip(page), before)
    assert moved[2] > 0.02
    assert np.abs(moved[:2]).max() < 0.01
    turned = page.js("playground.view.azimuth")
    page.press("ArrowLeft")
    assert page.js("playground.view.azimuth") != turned


def test_loop_is_gone_round(page: Page) -> None:
    """Go round the loop by button, keys and mouse."""
    press(page, "Go round")
    page.js("new Promise(done => setTimeout(() => done(null), 600))")
    assert page.js("playground.state.lap") > 0
    press(page, "Stop")
    focus(page, "place on the loop")
    page.press("ArrowRight", 3)
    assert not page.js("playground.state.going")
    page.js("document.getElementById('arm').scrollIntoView()")
    at = page.js("playground.state.lap")
    (x, y) = page.js(
        "(() => { const b = document.getElementById('arm').getBoundingClientRect(), [x, y] = playground.view.seen("
        "playground.now.marker(2 * Math.PI * playground.state.lap)); return [b.left + x, b.top + y]; })()"
    )
    ahead = page.js(
        "(() => { const b = document.getElementById('arm').getBoundingClientRect(), [x, y] = playground.view.seen("
        "playground.now.marker(2 * Math.PI * (playground.state.lap + 0.1))); return [b.left + x, b.top + y]; })()"
    )
    page.drag([(x, y), tuple(ahead)])
    assert page.js("playground.state.lap") == pytest.approx(at + 0.1, abs=0.04)


def test_less_motion(page: Page) -> None:
    page.prefer(prefers_reduced_motion="reduce")
    page.settle()
    press(page, "An eighth of a lap on")
    assert page.js("[playground.state.lap, playground.state.going]") == [0.125, False]


def test_phone_with_touch(page: Page) -> None:
    """Use the page on a phone's screen by touch: nothing is cut off, and the arm stays in view."""
    page.window(360, 740, scale=2, touch=True)
    page.settle()
    assert page.js("document.documentElement.scrollWidth") == 360
    labels = "[...document.querySelectorAll('.slider label')].filter(e => e.checkVisibility())"
    assert page.js(f"{labels}.filter(e => e.scrollWidth > e.clientWidth).map(e => e.textContent)") == []
    page.js("document.getElementById('arm').scrollIntoView()")
    before, (x, y) = place_of_tip(page), seen_tip(page)
    page.drag([(x, y), (x - 10, y - 8), (x - 20, y - 20)], touch=True)
    page.settle()
    assert np.linalg.norm(np.subtract(place_of_tip(page), before)) > 0.02
    page.js("document.getElementById('load-title').scrollIntoView()")
    page.settle()
    top, height, scrolled = page.js(
        "(box => [box.top, box.height, scrollY])(document.getElementById('arm').getBoundingClientRect())"
    )
    assert scrolled > 300 and 0 <= top < 5 and height < 400  # the arm stays in view beside the sliders
    page.drag([(20, 250), (20, 200), (20, 100)], touch=True)
    page.settle()
    assert page.js("scrollY") > scrolled + 50
    small = page.js(
        "[...document.querySelectorAll('button, select, input')].filter(e => e.checkVisibility()).map(e =>"
        " (e.closest('label') ?? e).getBoundingClientRect().height).filter(height => height < 24).length"
    )
    assert small == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_contrast(page: Page, scheme: str) -> None:
    """Text has the contrast of WCAG AA, 4.5, and what is drawn 3 where it carries meaning alone."""
    page.prefer(prefers_color_scheme=scheme)
    page.settle()
    texts, lines, count = page.js(CONTRAST)
    assert count > 60
    assert texts >= 4.5
    assert lines >= 3.0
    assert (
        page.js("getComputedStyle(document.body).backgroundColor")
        == {"light": "rgb(255, 255, 255)", "dark": "rgb(13, 17, 23)"}[scheme]
    )


def test_without_webgl_the_rest_works(browser: Browser, file: Path, tmp_path: Path) -> None:
    """Take WebGL away: a message in place of the arm, and the controls still work."""
    text = file.read_text().replace('getContext("webgl2"', 'getContext("none"')
    (tmp_path / "play.html").write_text(text)
    page = browser.page()
    page.open(tmp_path / "play.html")
    assert "The arm is not drawn: no WebGL" in page.js("document.getElementById('failure').textContent")
    focus(page, "moment along z")
    page.press("ArrowRight", 2)
    page.settle()
    assert page.js("playground.state.wrench[5]") == pytest.approx(8.2)
    assert page.errors == []
    page.do("Page.close")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in ("one joint", "two tips") else pytest.mark.wide) for name in ROBOTS]
)
def test_other_robots(browser: Browser, name: str, tmp_path: Path) -> None:
    """Open the pages of other robots: sliders for each coordinate, and no work of the exact law."""
    types, options = ROBOTS[name]
    urdf = ROOT / "tests" / "data" / "dual_arm.urdf" if types is None else tmp_path / "arm.urdf"
    if types:
        urdf.write_text(chain_urdf(types))
    fewer = {"batches": False, "controller": False, "build": False}
    folder = stiffgen.generate(urdf, output=tmp_path, name="arm", **fewer, **options)
    page = browser.page()
    page.window(1280, 900)
    page.open(write_page(folder, tmp_path / "arm.html"))
    n = len(open_robot(folder).chain.coordinates)
    assert page.js("document.querySelectorAll('#joints input[type=range]').length") == n
    for button in ("Near singular", "Gives way", "Moment at the tip", "Bent posture", "No load"):
        press(page, button)
        assert np.isfinite(page.js("playground.compliance.softness().stability"))
    if name == "two tips":
        choose(page, "tip", 1)
        assert page.js("playground.state.tip === playground.tips[1]")
    if name == "tool at run time":
        before = place_of_tip(page)
        focus(page, "tool's length")
        page.press("ArrowRight", 10)
        page.settle()
        assert np.linalg.norm(np.subtract(place_of_tip(page), before)) == pytest.approx(0.05)
    works = page.js("Object.fromEntries(Object.entries(playground.now.works).map(([law, w]) => [law, w.at(-1)]))")
    assert abs(works["exact"]) < 1e-10
    assert abs(works["corrected"]) < 1e-10
    assert page.errors == []
    page.do("Page.close")


GAPS = "playground.ends().flatMap(([a, b]) => a.map((x, i) => Math.abs(x - b[i])))"


@pytest.fixture(scope="module")
def four_bar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page of the four-bar of docs/loops.md, with a shoulder before it so that the loop is cut off base."""
    require_wasm()
    folder = tmp_path_factory.mktemp("four_bar")
    links = [("arm", "ground", "0.1 0 0.2"), ("crank", "arm", "0.1 0 0"), ("coupler", "crank", "0.25 0 0")]
    links += [("rocker", "arm", "0.4 0 0"), ("tip", "coupler", "0.2 0.1 0")]
    text = "".join(
        f'<link name="{name}"/><joint name="{name}" type="{"fixed" if name == "tip" else "continuous"}">'
        f'<parent link="{parent}"/><child link="{name}"/><origin xyz="{xyz}"/><axis xyz="0 0 1"/></joint>'
        for name, parent, xyz in links
    )
    urdf = folder / "fourbar.urdf"
    urdf.write_text(f'<robot name="fourbar"><link name="ground"/>{text}</robot>')
    loop = ["coupler:0.35,0,0=rocker:0.25,0,0"]
    made = stiffgen.generate(
        urdf, output=folder, tip="tip", masses=False, loop=loop, actuated=["crank"], controller=False, build=False
    )
    return write_page(made, folder / "play.html")


def test_a_four_bar_stays_closed_while_it_is_dragged(browser: Browser, four_bar: Path) -> None:
    """Slider, tip and link; what the motors feel against the unrolled functions; a crank that the loop stops at 0."""
    page = browser.page()
    page.window(1280, 900)
    page.open(four_bar)
    assert page.js("document.querySelectorAll('#joints input[type=range]').length") == 2
    assert page.js("document.getElementById('matrix-title').checkVisibility()") is False
    model = stiffgen.StiffnessModel(open_robot(four_bar.parent / "fourbar").chain)
    names = [each.name for each in model.chain.coordinates]
    crank = names.index("crank")

    def check(before: np.ndarray) -> np.ndarray:
        """Fail unless the loop is closed and the motors' stiffness is Python's; return q."""
        page.settle()
        q = np.array(page.js("Array.from(playground.state.q)"))
        assert np.abs(q - before).max() > 0.01
        assert max(page.js(GAPS)) < 1e-12
        assert np.abs(np.array(model.motors.residual(q))).max() < 1e-12
        wrench, K, motors = page.js(
            "[playground.state.wrench, playground.now.matrices.K, playground.now.motors.stiffness]"
            ".map(x => Array.from(x))"
        )
        right = np.array(model.motors.joint_stiffness(q, wrench, np.reshape(K, (6, 6))))
        assert_close(np.reshape(motors, right.shape), right)
        return q

    q = np.array(page.js("Array.from(playground.state.q)"))
    focus(page, f"joint {crank + 1}, crank")
    page.press("ArrowRight", 20)
    q = check(q)
    x, y = seen_tip(page)
    page.drag([(x, y), (x - 8, y - 5), (x - 20, y - 8), (x - 35, y - 10)])
    q = check(q)
    x, y = page.js(
        "(() => { const box = document.getElementById('arm').getBoundingClientRect(), [[a]] = playground.ends();"
        " const [x, y] = playground.view.seen(a); return [box.left + x, box.top + y]; })()"
    )
    page.drag([(x, y), (x + 6, y + 6), (x + 14, y + 14)])
    q = check(q)
    torque, whole, without = page.js(
        "[...document.querySelectorAll('#motors tr:last-child td')].map(cell => cell.textContent)"
    )
    assert torque.endswith("N m") and whole.endswith("N m/rad") and without.endswith("N m/rad") and whole != without
    page.js(
        "(() => { const boxes = document.querySelectorAll('#joints input[type=number]'), box = boxes[boxes.length - 1];"
        " box.value = 0; box.dispatchEvent(new Event('input')); })()"
    )
    page.settle()
    assert "do not close with crank" in page.js("document.getElementById('closed').textContent")
    np.testing.assert_allclose(page.js("Array.from(playground.state.q)"), q, atol=1e-15)
    assert page.errors == []
    page.do("Page.close")
