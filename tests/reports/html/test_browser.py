"""The page as a browser shows it: from disk, without a network, by mouse, keyboard and finger."""

from __future__ import annotations

import shutil

import pytest

from reports.analysis import analyse_run
from reports.build import build_report

pytestmark = pytest.mark.browser

WIDE, PHONE = {"width": 1280, "height": 900}, {"width": 375, "height": 812}


@pytest.fixture(scope="module")
def url(finished, tmp_path_factory):
    folder = tmp_path_factory.mktemp("browser") / "run 1 & more"
    shutil.copytree(finished, folder)
    analyse_run(folder)
    return build_report(folder).as_uri()


@pytest.fixture
def visit(chromium, url):
    """``visit(viewport, **context)``: the page, which must ask for nothing and report nothing."""
    said, contexts = [], []

    def go(viewport, **options):
        context = chromium.new_context(viewport=viewport, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: said.append(request.url) if request.url.split("#")[0] != url else None)
        page.goto(url)
        return page

    yield go
    for context in contexts:
        context.close()
    assert [text for text in said if not text.startswith("data:image/png")] == []


def _wait(page, expression):
    page.wait_for_function(expression, timeout=20_000)


def test_it_opens_from_disk_with_its_figures(visit):
    page = visit(WIDE)
    assert page.title().startswith("Motion style benchmark")
    page.evaluate("() => { for (const image of document.images) image.loading = 'eager'; }")
    _wait(
        page, "() => document.images.length > 3 && [...document.images].every(i => i.complete && i.naturalWidth > 300)"
    )


def test_the_policy_lets_nothing_else_run(chromium, url):
    page = chromium.new_page()
    page.goto(url)
    add = "const s = document.createElement('script'); s.textContent = 'window.broken = 1'; document.body.append(s);"
    page.evaluate(f"() => {{ {add} }}")
    assert page.evaluate("() => window.broken") is None
    assert page.evaluate("() => fetch(location.href).then(() => 'fetched', () => 'refused')") == "refused"
    page.close()


def _column(page, name):
    return page.evaluate(
        """name => {
            const table = document.querySelector('.board:not([hidden]) table');
            const heads = [...table.tHead.rows[0].cells];
            const at = heads.findIndex(head => head.textContent.includes(name));
            const values = [...table.tBodies[0].rows].map(row => Number(row.cells[at].dataset.value));
            return [heads[at].getAttribute('aria-sort'), values];
        }""",
        name,
    )


def test_the_leaderboard_sorts_and_filters_by_mouse_and_keyboard(visit):
    page = visit(WIDE)
    page.get_by_role("radio", name="physics", exact=True).check()
    assert page.locator(".board:not([hidden])").count() == 1
    head = page.locator(".board:not([hidden]) th", has_text="jerk-deviation").get_by_role("button")
    head.click()
    order, values = _column(page, "jerk-deviation")
    assert order == "ascending" and values == sorted(values)
    head.focus()
    page.keyboard.press("Enter")
    order, values = _column(page, "jerk-deviation")
    assert order == "descending" and values == sorted(values, reverse=True)
    # Where 1 is aimed at, the nearest to 1 comes first.
    page.locator(".board:not([hidden]) th", has_text="jerk-ratio").get_by_role("button").click()
    order, values = _column(page, "jerk-ratio")
    assert order == "other" and values == sorted(values, key=lambda value: abs(value - 1))
    assert "best first" in page.locator("#board-status").text_content()
    page.get_by_role("radio", name="cleaned").check()
    assert "cleaned" in page.locator(".board:not([hidden]) h3").text_content()
    # The explanation that a head leads to is unfolded.
    page.locator(".board:not([hidden]) .what").first.click()
    _wait(page, "() => document.querySelector('#metrics').parentElement.querySelector('details[open] tr:target')")


def _state(page):
    return page.evaluate("() => ({...document.getElementById('viewer').dataset})")


def test_the_figures_play_and_obey(visit):
    page = visit(WIDE)
    stage, play = page.locator("#viewer-stage"), page.locator("#viewer-play")
    stage.scroll_into_view_if_needed()
    # It plays by itself once it is seen.
    _wait(page, "() => Number(document.getElementById('viewer').dataset.time) > 0.2")
    play.click()
    assert play.text_content() == "Play"
    before = _state(page)
    page.wait_for_timeout(150)
    assert _state(page) == before
    # What is drawn is not one colour.
    colours = """() => [...document.querySelectorAll('.actor canvas')].map(canvas => new Set(new Uint32Array(
        canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.buffer)).size)"""
    assert min(page.evaluate(colours)) > 100
    # Scrub, and the figures are elsewhere.
    shot = "() => document.querySelector('.actor canvas').toDataURL()"
    picture = page.evaluate(shot)
    page.locator("#viewer-time").fill("0.5")
    _wait(page, "() => document.getElementById('viewer').dataset.time === '0.500'")
    assert page.evaluate(shot) != picture
    # By keys: a step, a turn, closer, reset, play.
    stage.focus()
    for key, part in ((".", "time"), ("ArrowRight", "turn"), ("+", "turn"), ("ArrowUp", "turn")):
        old = _state(page)[part]
        page.keyboard.press(key)
        _wait(page, f"() => document.getElementById('viewer').dataset.{part} !== '{old}'")
    page.keyboard.press("Home")
    _wait(page, "() => document.getElementById('viewer').dataset.turn === '35.0 10.0 1.00'")
    box = stage.bounding_box()
    page.mouse.move(box["x"] + 60, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 160, box["y"] + 60)
    page.mouse.up()
    _wait(page, "() => document.getElementById('viewer').dataset.turn === '-15.0 10.0 1.00'")
    page.keyboard.press("Space")
    assert play.text_content() == "Pause"
    page.keyboard.press("Space")


def test_clips_clocks_and_figures_can_be_chosen(visit):
    page = visit(WIDE, reduced_motion="reduce")
    stage = page.locator("#viewer-stage")
    stage.scroll_into_view_if_needed()
    _wait(page, "() => document.getElementById('viewer').dataset.frames")
    page.wait_for_timeout(150)
    # Whoever wants no motion gets none unasked.
    assert _state(page)["time"] == "0.000" and page.locator("#viewer-play").text_content() == "Play"
    names = page.locator(".actor figcaption").all_text_contents()
    assert len(names) == 3 and names[0].startswith("adult input") and names[2].startswith("held-out child")
    length = page.locator("#viewer-time").get_attribute("max")
    page.locator("#viewer-clip").select_option(index=1)
    assert page.locator("#viewer-time").get_attribute("max") != length
    assert "3 figures" in page.locator("#viewer-status").text_content()
    # By the same clock the shortest is over before the longest, and says so by standing back.
    page.locator("#viewer-time").fill(page.locator("#viewer-time").get_attribute("max"))
    _wait(page, "() => [1, 2].includes(document.querySelectorAll('.actor.over').length)")
    page.locator("#viewer-clock").select_option("phase")
    _wait(page, "() => !document.querySelector('.actor.over')")
    seconds = float(page.locator("#viewer-time").get_attribute("max"))
    assert f"{seconds:.1f} s" in page.locator(".actor figcaption").first.text_content()
    page.locator("#viewer-shown").get_by_label("dynamic-scaling[time]").uncheck()
    assert page.locator(".actor:not([hidden])").count() == 2
    page.locator("#viewer-view").select_option(label="above")
    _wait(page, "() => document.getElementById('viewer').dataset.turn.startsWith('0.0 75.0')")
    page.locator("#viewer-speed").select_option("2")
    page.locator("#viewer-play").click()
    _wait(page, "() => Number(document.getElementById('viewer').dataset.time) > 0.3")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_a_phone_in_both_schemes(visit, scheme):
    page = visit(PHONE, color_scheme=scheme, has_touch=True, is_mobile=True, device_scale_factor=2)
    for group in ("overview", "all"):
        page.get_by_role("radio", name=group, exact=True).check()
        page.evaluate("() => document.querySelectorAll('details').forEach(part => { part.open = true; })")
        assert page.evaluate("() => document.documentElement.scrollWidth") == PHONE["width"], group
    # Sharp: the canvas has the pixels of the screen.
    page.locator("#viewer-stage").scroll_into_view_if_needed()
    _wait(page, "() => (c => c.width === Math.round(2 * c.clientWidth))(document.querySelector('.actor canvas'))")
    light = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    assert (light == "rgb(255, 255, 255)") == (scheme == "light")


def test_everything_can_be_named_and_reached(visit):
    page = visit(WIDE)
    page.evaluate("() => document.querySelectorAll('details').forEach(part => { part.open = true; })")
    faults = page.evaluate(
        """() => {
            const faults = [], ids = new Set();
            for (const element of document.querySelectorAll('[id]')) {
                if (ids.has(element.id)) faults.push(`id ${element.id} twice`);
                ids.add(element.id);
            }
            let level = 0;
            for (const head of document.querySelectorAll('h1, h2, h3, h4, h5')) {
                const now = Number(head.tagName[1]);
                if (now > level + 1) faults.push(`${head.tagName} after h${level}: ${head.textContent}`);
                level = now;
            }
            for (const control of document.querySelectorAll('button, input, select, a')) {
                const name = control.getAttribute('aria-label') || control.textContent.trim()
                    || [...(control.labels || [])].map(label => label.textContent.trim()).join('');
                if (!name) faults.push(`no name: ${control.outerHTML.slice(0, 80)}`);
            }
            for (const image of document.images) if (image.alt.length < 20) faults.push(`no words for ${image.alt}`);
            for (const box of document.querySelectorAll('.scroll'))
                if (!box.getAttribute('aria-label') || box.tabIndex !== 0) faults.push('a table that keys cannot scroll');
            for (const table of document.querySelectorAll('table'))
                for (const head of table.querySelectorAll('th')) if (!head.scope) faults.push('a head without scope');
            for (const name of ['header', 'nav', 'main', 'footer'])
                if (document.querySelectorAll(`.frame > ${name}`).length !== 1) faults.push(`landmark ${name}`);
            if (document.querySelectorAll('h1').length !== 1) faults.push('h1');
            return faults;
        }"""
    )
    assert faults == []
    # The first stop of the Tab key leads past the contents.
    page.keyboard.press("Tab")
    assert page.evaluate("() => document.activeElement.getAttribute('href')") == "#content"
    page.keyboard.press("Enter")
    assert page.evaluate("() => document.activeElement.id") == "content"


def test_simulated_ratings_are_said_to_be_simulated(visit):
    page = visit(WIDE)
    assert page.locator("h3#ratings").text_content() == "Ratings (simulated observers, not people)"
    notice = page.locator("#ratings + .notice")
    assert notice.is_visible() and "Simulated observers, not people." in notice.text_content()
