"""Sessions in a real browser, against a real server: by mouse, by keyboard, interrupted, and two at once."""

from __future__ import annotations

import shutil
import signal
from contextlib import closing
from urllib.parse import urlsplit

import pytest

from reports.study.schema import connect

pytestmark = pytest.mark.browser


@pytest.fixture
def tab(chromium):
    """``tab(**options)``: a page in a browser of its own, and everything that it complained of or asked other sites for."""
    contexts = []

    def make(**options):
        context = chromium.new_context(viewport={"width": 1280, "height": 800}, **options)
        contexts.append(context)
        page = context.new_page()
        troubles: list[str] = []
        page.on(
            "console", lambda message: troubles.append(message.text) if message.type in ("error", "warning") else None
        )
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("request", lambda request: troubles.append(request.url) if "127.0.0.1" not in request.url else None)
        page.set_default_timeout(15_000)
        return page, troubles

    yield make
    for context in contexts:
        context.close()


def begin(page, address):
    page.goto(address)
    page.get_by_label("I am 18 years or older.").check()
    page.get_by_label("agree to take").check()
    page.get_by_role("button", name="Take part").click()
    page.get_by_role("button", name="Begin").click()
    page.get_by_role("heading", name="Video 1 of 7").wait_for()
    # Keys do something once the page's script has run.
    page.wait_for_load_state("load")


def answer_by_mouse(page, position, pages=7):
    page.get_by_role("heading", name=f"Video {position} of {pages}").wait_for()
    page.locator(".pair .choice").nth(position % 2).click()
    page.locator(".likert .choice").nth(position % 7).click()
    page.locator(".list .choice").first.click()
    page.locator("#next").click()


def until(page, expression):
    """Wait until an expression holds; the page's policy forbids playwright to ask in the page itself."""
    for _ in range(300):
        if page.evaluate(expression):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"never came true: {expression}")


def stored(study, *, rehearsal=False):
    with closing(connect(study.database(rehearsal=rehearsal), read_only=True)) as connection:
        return connection.execute(
            "SELECT rater, position, naturalness FROM answers ORDER BY rater, position"
        ).fetchall()


def test_a_session_by_mouse(tab, serving, study):
    page, troubles = tab()
    with serving(study, "--export", str(study.path / "out.csv")) as (address, _):
        begin(page, address)
        # The video plays, by itself and without end.
        until(page, "document.querySelector('video').currentTime > 0.2")
        assert page.evaluate(
            "(() => { const v = document.querySelector('video'); return v.loop && v.muted && !v.paused })()"
        )
        for position in range(1, 8):
            if position == 3:
                # Something is forgotten: the page says so and keeps the rest.
                page.locator(".likert .choice").nth(2).click()
                page.locator("#next").click()
                assert page.locator("#wait").inner_text() == "An answer is missing."
            answer_by_mouse(page, position)
        page.get_by_role("heading", name="Thank you").wait_for()
    assert [row[1:] for row in stored(study)] == [(position - 1, 1 + position % 7) for position in range(1, 8)]
    assert len((study.path / "out.csv").read_text().splitlines()) == 8
    assert troubles == []


def test_a_session_by_keyboard_only(tab, serving, study):
    page, troubles = tab()
    with serving(study) as (address, _):
        page.goto(address)
        for key in ("Tab", "Space", "Tab", "Space", "Enter"):
            page.keyboard.press(key)
        page.get_by_role("heading", name="What to do").wait_for()
        for _ in range(12):
            page.keyboard.press("Tab")
            if page.evaluate("document.activeElement.textContent") == "Begin":
                break
        page.keyboard.press("Enter")
        for position in range(1, 8):
            page.get_by_role("heading", name=f"Video {position} of 7").wait_for()
            assert page.locator("fieldset.current legend").inner_text().startswith("1")
            page.keyboard.press("2")
            assert page.locator("fieldset.current legend").inner_text().startswith("2")
            page.keyboard.press("9")  # no such answer: nothing happens
            page.keyboard.press("Enter")  # too early: the page stays
            page.keyboard.press(str(position))
            page.keyboard.press("1")
            if position == 4:
                # A second thought: back by Shift+Tab, and the answer is another one.
                page.keyboard.press("Shift+Tab")
                page.keyboard.press("7")
            page.keyboard.press("Enter")
        page.get_by_role("heading", name="Thank you").wait_for()
    assert [row[2] for row in stored(study)] == [1, 2, 3, 7, 5, 6, 7]
    assert troubles == []


def test_loading_again_and_closing_the_tab_in_the_middle(tab, serving, study):
    page, _ = tab()
    with serving(study) as (address, _):
        begin(page, address)
        answer_by_mouse(page, 1)
        page.get_by_role("heading", name="Video 2 of 7").wait_for()
        page.reload()
        page.get_by_role("heading", name="Video 2 of 7").wait_for()
        answer_by_mouse(page, 2)
        page.get_by_role("heading", name="Video 3 of 7").wait_for()
        # Back does not lead to a page that was answered.
        page.go_back()
        page.get_by_role("heading", name="Video 3 of 7").wait_for()
        again = page.context.new_page()
        page.close()
        again.goto(address)
        for position in range(3, 8):
            answer_by_mouse(again, position)
        again.get_by_role("heading", name="Thank you").wait_for()
    assert len(stored(study)) == 7


def test_the_server_is_killed_and_started_again_in_the_middle(tab, serving, study):
    page, _ = tab()
    with serving(study) as (address, process):
        begin(page, address)
        for position in (1, 2, 3):
            answer_by_mouse(page, position)
        page.get_by_role("heading", name="Video 4 of 7").wait_for()
        page.locator(".pair .choice").first.click()
        process.send_signal(signal.SIGKILL)
        process.wait(10)
        assert len(stored(study)) == 3
    with serving(study, port=urlsplit(address).port) as (again, _):
        assert again == address
        # The page is still open, and goes on as if nothing had been.
        for position in range(4, 8):
            answer_by_mouse(page, position)
        page.get_by_role("heading", name="Thank you").wait_for()
    assert [row[1] for row in stored(study)] == list(range(7))


def test_two_raters_at_once(tab, serving, study):
    first, second = tab()[0], tab()[0]
    with serving(study) as (address, _):
        begin(first, address)
        begin(second, address)
        shown = [page.locator('input[name="stimulus"]').get_attribute("value") for page in (first, second)]
        for position in range(1, 8):
            for page in (first, second):
                answer_by_mouse(page, position)
        for page in (first, second):
            page.get_by_role("heading", name="Thank you").wait_for()
    assert len(stored(study)) == 14 and len({row[0] for row in stored(study)}) == 2
    assert all(shown)


def test_without_javascript(tab, serving, study):
    page, _ = tab(java_script_enabled=False)
    with serving(study, "--rehearsal") as (address, _):
        begin(page, address)
        for position in range(1, 8):
            answer_by_mouse(page, position)
        page.get_by_role("heading", name="Thank you").wait_for()
    assert len(stored(study, rehearsal=True)) == 7


def test_a_video_must_be_watched_before_going_on(tab, serving, study):
    from reports.study.plan import read_plan, write_plan

    plan = read_plan(study)
    for seconds in (600.0, 1.0):
        shutil.rmtree(study.answers)
        write_plan(study, plan.model_copy(update={"min_watch": seconds}), study.secret.read_bytes())
        page, _ = tab()
        with serving(study) as (address, _):
            begin(page, address)
            for _ in range(3):
                page.keyboard.press("1")
            if seconds > 100:
                page.keyboard.press("Enter")
                assert page.locator("#next").is_disabled()
                assert page.locator("#wait").inner_text().startswith("You can go on in ")
                assert page.get_by_role("heading", name="Video 1 of 7").is_visible()
            else:
                page.locator("#next:enabled").wait_for()
                page.keyboard.press("Enter")
                page.get_by_role("heading", name="Video 2 of 7").wait_for()
                assert len(stored(study)) == 1


@pytest.mark.parametrize("options", [{}, {"color_scheme": "dark"}, {"viewport": None}], ids=["light", "dark", "phone"])
def test_pages_fit_and_can_be_read(chromium, serving, study, options):
    width = 320 if "viewport" in options else 1280
    context = chromium.new_context(
        viewport={"width": width, "height": 700}, color_scheme=options.get("color_scheme", "light")
    )
    page = context.new_page()
    contrast = """(selector) => [...document.querySelectorAll(selector)].map((element) => {
        const parse = (text) => text.match(/[\\d.]+/g).map(Number);
        const light = ([r, g, b]) => [r, g, b].map((v) => v / 255).map((v) => v <= 0.03928 ? v / 12.92
            : ((v + 0.055) / 1.055) ** 2.4).reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
        let back = element;
        while (parse(getComputedStyle(back).backgroundColor)[3] === 0) back = back.parentElement;
        const [a, b] = [light(parse(getComputedStyle(element).color)), light(parse(getComputedStyle(back).backgroundColor))];
        return (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    })"""
    with serving(study, "--rehearsal") as (address, _):
        page.goto(address)
        checks = "h1, h2, p, li, label span, legend, button, a, .number, .ends span"
        for name, leave in (("Take part", "Take part"), ("What to do", "Begin"), ("Video 1", None)):
            page.get_by_role("button", name=leave or "Next").wait_for()
            page.wait_for_load_state("load")
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), name
            assert min(page.evaluate(contrast, checks)) >= 4.5, name
            unnamed = page.evaluate(
                "[...document.querySelectorAll('input:not([type=hidden]), video, progress')].filter((e) => "
                "!(e.getAttribute('aria-label') || e.labels?.length)).length"
            )
            assert unnamed == 0
            if leave == "Take part":
                page.locator('input[name="adult"]').check()
                page.locator('input[name="agree"]').check()
            if leave:
                page.get_by_role("button", name=leave).click()
        targets = page.evaluate(
            "[...document.querySelectorAll('.choice, button')].map((e) => e.getBoundingClientRect())"
            ".map((r) => Math.min(r.width, r.height))"
        )
        assert min(targets) >= (24 if width < 400 else 40)
    context.close()
