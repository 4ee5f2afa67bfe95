"""The replay page in a real browser: opened from disk, no errors, everything does what it says."""

import hashlib
import time

import numpy as np
import pytest
from browser import chromium, needs_chromium
from traffic import hidden_mixture, recording, tracks

from pmbm.metrics import evaluate
from pmbm.reports.render import run_page
from pmbm.reports.values import ReplayPage, Section
from pmbm.study import TrialResult, summarise
from pmbm.types import Site

pytestmark = [pytest.mark.browser, needs_chromium]

HOSTILE = "<img src=x onerror=\"document.title='broken'\"></script><b>\u2028"


def page(scene, by_tracker, name="hand-made", **changes):
    scores = {key: evaluate(scene, value) for key, value in by_tracker.items()}
    series = {
        key: {name: value.series for name, value in one.items() if value.series is not None}
        for key, one in scores.items()
    }
    results = [
        TrialResult("s", 0, trial, "d", {key: one.scalars() for key, one in scores.items()}, {})
        for trial in range(3)
    ]
    section = Section(
        name=name,
        stresses="A hidden car.",
        summary=summarise(results),
        replay=ReplayPage(recording=scene, tracks=by_tracker, series=series, **changes),
        provenance=scene.provenance,
    )
    return run_page([section], title=f"Report on {name}", command=f"pmbm run {name}")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("profile")) as driver:
        yield driver


@pytest.fixture(scope="module")
def plain_page(tmp_path_factory):
    scene = recording()
    path = tmp_path_factory.mktemp("pages") / "plain.html"
    by_tracker = {"careful": tracks(scene, undetected=True), "sloppy": tracks(scene, sloppy=True)}
    path.write_text(page(scene, by_tracker), encoding="utf-8")
    return path


def opened(driver, path):
    driver.get(path.as_uri())
    wait(driver, "return !!document.querySelector('.replay.ready')")
    driver.execute_script(
        "window.player = document.querySelector('.replay').player;"
        "window.pixels = (s = '.stage canvas') => document.querySelector(s).toDataURL();"
        "document.querySelector('.replay').scrollIntoView();"
    )
    settle(driver)


def wait(driver, script, seconds=30):
    end = time.monotonic() + seconds
    while not driver.execute_script(script):
        assert time.monotonic() < end, f"never true: {script}"
        time.sleep(0.02)


def settle(driver):
    """Until the drawing that is due has been done."""
    driver.execute_async_script(
        "const done = arguments[0];"
        "requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 0)));"
    )


def click(driver, selector):
    driver.find_element("css selector", selector).click()
    settle(driver)


def press(driver, key):
    driver.find_element("css selector", ".replay").send_keys(key)
    settle(driver)


def pixels(driver):
    """A digest of what the first stage shows."""
    return hashlib.sha256(driver.execute_script("return pixels()").encode()).hexdigest()[:16]


def frame(driver):
    return driver.execute_script("return player.state.frame")


def complaints(driver):
    return [entry for entry in driver.get_log("browser") if entry["level"] != "INFO"]


@pytest.fixture
def plain(browser, plain_page):
    opened(browser, plain_page)
    yield browser
    assert complaints(browser) == []


def test_the_scrubber_moves_the_frame(plain):
    before = pixels(plain)
    plain.execute_script(
        "const s = document.querySelector('input[type=range]'); s.value = 40;"
        "s.dispatchEvent(new Event('input', {bubbles: true}));"
    )
    settle(plain)
    assert frame(plain) == 40
    assert pixels(plain) != before
    assert plain.find_element("css selector", ".clock").text.startswith("4.0 /")


def test_play_advances_and_pause_stops(plain):
    click(plain, "[data-do=play]")
    wait(plain, "return player.state.frame >= 3")
    click(plain, "[data-do=play]")
    stopped = frame(plain)
    time.sleep(0.3)
    assert frame(plain) == stopped


def test_play_ends_at_the_last_frame_and_starts_over(plain):
    plain.execute_script("player.seek(97)")
    click(plain, "[data-do=play]")
    wait(plain, "return !player.state.playing")
    assert frame(plain) == 99
    click(plain, "[data-do=play]")
    wait(plain, "return player.state.frame >= 1 && player.state.frame < 50")


def test_playing_keeps_the_time_of_the_recording(plain):
    """By a clock of our own, so that a busy machine does not matter: 9.9 s at 4x."""
    plain.execute_script(
        "let now = performance.now(); window.began = now; performance.now = () => now;"
        "window.requestAnimationFrame = (f) => setTimeout(() => f((now += 25)), 0);"
        "const s = document.querySelector('.transport select'); s.value = '4';"
        "s.dispatchEvent(new Event('change', {bubbles: true}));"
        "player.seek(0); player.act('play');"
    )
    wait(plain, "return !player.state.playing", seconds=60)
    lasted = plain.execute_script("return (performance.now() - began) / 1000")
    assert frame(plain) == 99
    assert lasted == pytest.approx(9.9 / 4, abs=0.1)


def test_every_layer_switches(plain):
    plain.execute_script("player.choose(0); player.seek(47)")
    assert_layers_switch(
        plain, "truth detections tracks trails velocity uncertainty shadows view site undetected"
    )
    plain.execute_script("player.choose(1); player.seek(30)")
    assert_layers_switch(plain, "errors identity")


def assert_layers_switch(driver, layers):
    settle(driver)
    before = pixels(driver)
    for layer in layers.split():
        button = f"[data-layer={layer}]"
        pressed = driver.find_element("css selector", button).get_attribute("aria-pressed")
        click(driver, button)
        assert pixels(driver) != before, layer
        now = driver.find_element("css selector", button).get_attribute("aria-pressed")
        assert {pressed, now} == {"true", "false"}
        click(driver, button)
        assert pixels(driver) == before, layer


def test_trackers_switch_and_stand_side_by_side(plain):
    plain.execute_script("player.seek(30)")
    settle(plain)
    first = pixels(plain)
    click(plain, "[data-tracker='1']")
    assert pixels(plain) != first
    assert plain.find_element("css selector", ".caption").text == (
        "5 tracks · 0 missed · 1 false · 0 switched so far"
    )
    click(plain, "[data-tracker=compare]")
    captions = [e.text for e in plain.find_elements("css selector", ".caption")]
    assert [text.split(":")[0] for text in captions] == ["careful", "sloppy"]
    click(plain, "[data-tracker='0']")
    assert pixels(plain) == first


def test_keys(plain):
    from selenium.webdriver.common.keys import Keys

    press(plain, Keys.ARROW_RIGHT)
    assert frame(plain) == 1
    press(plain, Keys.SHIFT + Keys.ARROW_RIGHT)
    assert frame(plain) == 11
    press(plain, Keys.NULL + Keys.ARROW_LEFT)
    assert frame(plain) == 10
    press(plain, Keys.END)
    assert frame(plain) == 99
    press(plain, "2")
    assert plain.execute_script("return player.state.tracker") == 1
    press(plain, "w")
    gospa = plain.execute_script("const t = player.data.trackers[1]; return t.series.gospa")
    # Nothing is tracked in the first three frames: the first second is left out.
    assert int(np.argmax(gospa)) < 3
    assert frame(plain) == 11 + int(np.argmax(gospa[11:]))
    scale = plain.execute_script("return player.camera.scale")
    press(plain, "+")
    assert plain.execute_script("return player.camera.scale") > scale


def test_keys_go_to_the_next_error_and_the_next_switch(plain):
    """The second tracker reports nothing at first and a false track from frame 21 on, and changes
    an id at 61."""
    plain.execute_script("player.choose(1); player.seek(5)")
    press(plain, "e")
    assert frame(plain) == 21
    press(plain, "E")
    assert frame(plain) == 0
    plain.execute_script("player.seek(0)")
    press(plain, "s")
    assert frame(plain) == 61
    press(plain, "s")
    assert frame(plain) == 61
    plain.execute_script("player.seek(90)")
    press(plain, "S")
    assert frame(plain) == 61


def test_identity_switches_are_told(plain):
    plain.execute_script("player.choose(1); player.seek(60)")
    settle(plain)
    assert "0 switched so far" in plain.find_element("css selector", ".caption").text
    plain.execute_script("player.seek(61)")
    settle(plain)
    assert "1 switched so far" in plain.find_element("css selector", ".caption").text
    assert plain.execute_script("return player.data.trackers[1].switches") == [
        [61, "22", "22", "122"]
    ]
    marked = pixels(plain)
    click(plain, "[data-layer=errors]")
    assert pixels(plain) != marked


def test_dragging_pans_and_fit_comes_back(plain):
    from selenium.webdriver import ActionChains

    before = pixels(plain)
    canvas = plain.find_element("css selector", ".stage canvas")
    ActionChains(plain).drag_and_drop_by_offset(canvas, 60, 20).perform()
    settle(plain)
    assert pixels(plain) != before
    click(plain, "[data-do=home]")
    plain.execute_script("player.state.hover = null; player.refresh()")
    settle(plain)
    assert pixels(plain) == before


def pointer_on_the_truck(driver):
    """Moves the mouse onto object 11 in frame 40."""
    from selenium.webdriver import ActionChains

    x, y = driver.execute_script(
        "const d = player.data.truth, row = d.at[40].find((r) => d.ids[d.object[r]] === '11');"
        "const c = document.querySelector('.stage canvas');"
        "const [x, y] = player.camera.toScreen(d.x[row], d.y[row]);"
        "return [x - c.clientWidth / 2, y - c.clientHeight / 2]"
    )
    canvas = driver.find_element("css selector", ".stage canvas")
    return ActionChains(driver).move_to_element_with_offset(canvas, int(x), int(y))


def test_a_click_follows_an_object(plain):
    plain.execute_script("player.seek(40)")
    settle(plain)
    middle = "return [player.camera.x, player.camera.y]"
    before = plain.execute_script(middle)
    pointer_on_the_truck(plain).click().perform()
    plain.execute_script("player.seek(60)")
    settle(plain)
    x, y = plain.execute_script(middle)
    # Its track is the truck's own place, which moves at 2 m/s, give or take .25 m a frame.
    assert [x - before[0], y - before[1]] == pytest.approx([4.0, 0.0], abs=1.5)
    click(plain, "[data-do=follow]")
    plain.execute_script("player.seek(80)")
    settle(plain)
    assert plain.execute_script(middle) == [x, y]


def test_hovering_tells_the_details(plain):
    plain.execute_script("player.seek(40)")
    settle(plain)
    pointer_on_the_truck(plain).perform()
    settle(plain)
    text = plain.find_element("css selector", ".tip").text
    assert "track 11" in text
    assert "object 11 (truck)" in text
    assert "100 % visible" in text


REGION = ((40.0, 8.0), (54.0, 6.0), (58.0, 20.0), (47.0, 13.0), (42.0, 19.0))
"""Not convex, and cutting through the components behind the truck."""


def in_world(driver, ring):
    centre = np.array(driver.execute_script("return player.data.centre"))
    return np.array(ring) + centre


def pointer_at(driver, actions, place):
    """Adds a move of the mouse to a place (x, y) in the world."""
    x, y = driver.execute_script(
        "const c = document.querySelector('.stage canvas');"
        "const [u, v] = arguments[0].map((value, i) => value - player.data.centre[i]);"
        "const [x, y] = player.camera.toScreen(u, v);"
        "return [x - c.clientWidth / 2, y - c.clientHeight / 2]",
        list(place),
    )
    canvas = driver.find_element("css selector", ".stage canvas")
    return actions.move_to_element_with_offset(canvas, round(x), round(y))


def test_a_polygon_drawn_with_the_mouse_counts_hidden_objects(plain):
    """Clicked corner by corner; the browser's number against the exact integral."""
    from selenium.webdriver import ActionChains

    plain.execute_script("player.choose(0); player.seek(30)")
    click(plain, "[data-do=measure]")
    assert "Drag a rectangle" in plain.find_element("css selector", ".counted").text
    for corner in (*REGION, REGION[0]):
        pointer_at(plain, ActionChains(plain), corner).click().perform()
        settle(plain)
    assert plain.execute_script("return [player.state.open, player.state.region.length]") == [
        False,
        len(REGION),
    ]
    ring = in_world(plain, plain.execute_script("return player.state.region"))
    # Corners are where whole pixels are.
    assert ring == pytest.approx(np.array(REGION), abs=0.6)
    counted = plain.execute_script("return player.hidden(player.state.region)")
    exact = hidden_mixture().expected_count(ring)
    assert 0.05 < exact < 0.4
    # The page keeps cells of 1.9 m or less, and their intensity to 2.8 %.
    assert counted["expected"] == pytest.approx(exact, rel=0.03)
    assert counted["there"] == 0
    said = plain.find_element("css selector", ".counted").text
    assert f"{counted['expected']:.2f} undetected objects expected, 0 there" in said
    before = pixels(plain)
    click(plain, "[data-do=measure]")
    assert plain.execute_script("return player.state.region") is None
    assert pixels(plain) != before


def test_true_hidden_objects_in_a_region_are_counted(plain):
    """Before any detection of it: a car that nobody knows of is there; later it is known."""
    plain.execute_script("player.choose(0); player.seek(0)")
    rows = plain.execute_script(
        "const t = player.data.truth; return t.at[0].map((r) => [t.x[r], t.y[r], t.flags[r]])"
    )
    for x, y, flags in rows:
        ring = [[x - 1, y - 1], [x + 1, y - 1], [x + 1, y + 1], [x - 1, y + 1]]
        counted = plain.execute_script("return player.hidden(arguments[0])", ring)
        assert counted["there"] == (0 if int(flags) & 4 else 1)
        assert counted["hidden"] == (0 if int(flags) & 1 else 1)
        assert counted["area"] == pytest.approx(4.0, rel=1e-5)


def test_the_rectangle_is_drawn_with_the_mouse(plain):
    from selenium.webdriver import ActionChains

    plain.execute_script("player.choose(0); player.seek(30)")
    click(plain, "[data-do=measure]")
    canvas = plain.find_element("css selector", ".stage canvas")
    before = pixels(plain)
    x, y = plain.execute_script("return [player.camera.x, player.camera.y]")
    ActionChains(plain).drag_and_drop_by_offset(canvas, 90, -40).perform()
    settle(plain)
    scale = plain.execute_script("return player.camera.scale")
    region = np.array(plain.execute_script("return player.state.region"))
    # From the middle of the picture, up and to the right; the picture itself does not move.
    low, high = region.min(axis=0), region.max(axis=0)
    assert [*low, *high] == pytest.approx([x, y, x + 90 / scale, y + 40 / scale], abs=1 / scale)
    assert pixels(plain) != before
    counted = plain.execute_script("return player.hidden(player.state.region)")
    exact = hidden_mixture().expected_count(in_world(plain, region))
    assert counted["expected"] == pytest.approx(exact, rel=0.03, abs=1e-4)


def test_hidden_objects_are_counted_without_a_pointer(plain):
    from selenium.webdriver.common.keys import Keys

    plain.execute_script("player.choose(0); player.seek(30)")
    press(plain, "h")
    middle = "const b = player.state.region; return [0, 1].map((k) => (b[0][k] + b[2][k]) / 2)"
    x, y = plain.execute_script(middle)
    width = "const b = player.state.region; return b[2][0] - b[0][0]"
    wide = plain.execute_script(width)
    press(plain, Keys.ARROW_RIGHT)
    press(plain, Keys.ARROW_UP)
    assert plain.execute_script(middle) == pytest.approx([x + 1, y + 1], abs=1e-3)
    press(plain, Keys.SHIFT + Keys.ARROW_RIGHT)
    assert plain.execute_script(width) == pytest.approx(wide + 2, abs=1e-3)
    assert frame(plain) == 30
    assert "objects expected" in plain.find_element("css selector", ".counted").text
    press(plain, Keys.NULL + Keys.ESCAPE)
    assert plain.execute_script("return player.state.measuring") is False
    press(plain, Keys.ARROW_RIGHT)
    assert frame(plain) == 31


def test_hostile_strings_stay_strings(browser, tmp_path):
    scene = recording(
        frames=12,
        name=HOSTILE,
        object_name={11: HOSTILE},
        provenance={HOSTILE: HOSTILE},
        site=Site(),
    )
    path = tmp_path / "hostile.html"
    path.write_text(
        page(scene, {HOSTILE: tracks(scene), "b": tracks(scene)}, name=HOSTILE, title=HOSTILE),
        encoding="utf-8",
    )
    opened(browser, path)
    browser.execute_script("player.choose('compare'); player.seek(6)")
    settle(browser)
    browser.execute_script(
        "const d = player.data.truth, row = d.at[6].find((r) => d.ids[d.object[r]] === '11');"
        "const p = player.camera.toScreen(d.x[row], d.y[row]);"
        "player.hover(document.querySelector('.stage canvas'), 0, ...p)"
    )
    settle(browser)
    assert HOSTILE.split("\u2028")[0] in browser.find_element("css selector", ".tip").text
    assert browser.find_elements("css selector", "img, b") == []
    assert browser.title.startswith("Report on <img")
    assert complaints(browser) == []


def test_a_foreign_script_does_not_run(browser, plain_page, tmp_path):
    """The policy itself, not only the escaping: a script that got in is refused."""
    path = tmp_path / "injected.html"
    text = plain_page.read_text(encoding="utf-8")
    path.write_text(text.replace("<main>", "<main><script>document.title='broken'</script>"))
    opened(browser, path)
    assert browser.title != "broken"
    assert any("Content Security Policy" in entry["message"] for entry in complaints(browser))


def test_narrow_screens_do_not_scroll_sideways(browser, plain_page):
    browser.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True},
    )
    try:
        opened(browser, plain_page)
        width = browser.execute_script("return document.documentElement.scrollWidth")
        assert width <= 390
        assert complaints(browser) == []
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@pytest.fixture
def three(browser, tmp_path):
    """A page of three trackers, in a window whose size a test may set."""
    scene = recording()
    by_tracker = {
        "pmbm": tracks(scene, undetected=True),
        "argoverse": tracks(scene, sloppy=True),
        "probabilistic_kf": tracks(scene, sloppy=True),
    }
    path = tmp_path / "three.html"
    path.write_text(page(scene, by_tracker), encoding="utf-8")
    opened(browser, path)

    def sized(width):
        metrics = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        settle(browser)
        settle(browser)

    browser.sized = sized
    yield browser
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_the_verdicts_on_three_trackers_fit_on_a_laptop(three):
    three.sized(1400)
    widths = three.execute_script(
        "const e = document.querySelector('.scroll'); return [e.scrollWidth, e.clientWidth]"
    )
    assert widths[0] == widths[1]


def test_a_phone_shows_every_entry_of_a_legend(three):
    three.sized(390)
    ends, width, lines = three.execute_script(
        "const p = player.plots, ends = [], lines = [];"
        "for (const row of p.rows) {"
        "  const names = p.names(row), at = p.placed(p.longestTitle(row), names);"
        "  lines.push(at.lines);"
        "  names.forEach((n, i) => ends.push("
        "    at.places[i].x + 12 + p.context.measureText(n + ' 88.88').width));"
        "}"
        "return [ends, p.width, lines]"
    )
    assert len(ends) == 4 + 3 + 3
    assert max(ends) <= width
    assert max(lines) > 1


def test_a_replay_is_drawn_before_a_printer_sees_it(three):
    """A new size clears canvases; paper waits for no animation frame that would draw them again."""
    blank = three.execute_script(
        "player.resize();"
        "return [...document.querySelectorAll('.replay canvas')].map((drawn) => {"
        "  const empty = document.createElement('canvas');"
        "  [empty.width, empty.height] = [drawn.width, drawn.height];"
        "  return empty.toDataURL() === drawn.toDataURL();"
        "})"
    )
    assert blank == [False, False]


def test_empty_recordings_and_no_tracks_are_shown(browser, tmp_path):
    from pmbm.types import Tracks, TrackSequence

    scene = recording(frames=5, detections=(), frame=[], origin=None)
    none = TrackSequence(steps=tuple(Tracks.empty(0.1 * k) for k in range(5)), frame=range(5))
    path = tmp_path / "empty.html"
    path.write_text(page(scene, {"silent": none}), encoding="utf-8")
    opened(browser, path)
    assert complaints(browser) == []
    assert browser.find_element("css selector", ".caption").text.startswith(
        "0 tracks · 5 missed · 0 false"
    )


def test_a_study_page_shows_its_curves_and_worst_trials(browser, tmp_path):
    from test_report_study import cell, study

    from pmbm.reports.study_report import study_page
    from pmbm.reports.values import WorstTrial

    scene = recording(frames=6)
    replay = ReplayPage(recording=scene, tracks={"a": tracks(scene)}, start=4)
    night = study(
        *(cell(0.5 * k, point={"rate": k}) for k in (1, 2)),
        worst=[WorstTrial(why="crossing, trial 3", command="pmbm study", replay=replay)],
    )
    path = tmp_path / "study.html"
    path.write_text(study_page(night), encoding="utf-8")
    opened(browser, path)
    assert frame(browser) == 4
    browser.execute_script("document.querySelector('.curves').scrollIntoView()")
    wait(browser, "return [...document.images].every((i) => i.complete && i.naturalWidth > 100)")
    assert browser.execute_script("return document.images.length") == 2
    loaded = "return performance.getEntriesByType('resource').map((e) => e.name.slice(0, 20))"
    assert all(name.startswith("data:") for name in browser.execute_script(loaded))
    assert complaints(browser) == []


def test_a_notebook_shows_a_replay_in_its_frame(browser, tmp_path):
    from pmbm.reports.notebook import show

    scene = recording(frames=8, name=HOSTILE)
    path = tmp_path / "cell.html"
    for tracker in (tracks(scene), {"a": tracks(scene), "b": tracks(scene)}, None):
        cell = show(scene, tracker)._repr_html_()
        path.write_text(f"<!doctype html><meta charset=utf-8><body>{cell}", encoding="utf-8")
        browser.get(path.as_uri())
        browser.switch_to.frame(0)
        try:
            wait(browser, "return !!document.querySelector('.replay.ready')")
            browser.execute_script("document.querySelector('.replay').player.seek(5)")
            settle(browser)
            assert browser.find_element("css selector", ".clock").text.startswith("0.5 /")
        finally:
            browser.switch_to.default_content()
        assert complaints(browser) == []


def test_the_switch_of_the_detections_says_which_sensor_is_drawn_how(browser, tmp_path):
    from pmbm import PMBMTracker, run
    from pmbm.sim.scenario.scenario import Scenario, load_scenario

    scene = Scenario({**load_scenario("lidar_radar").document, "duration": 0.5}).record(0)
    path = tmp_path / "sensors.html"
    path.write_text(page(scene, {"pmbm": run(PMBMTracker(site=scene.site), scene)}), "utf-8")
    opened(browser, path)
    switch = browser.find_element("css selector", "[data-layer=detections]")
    assert switch.text.split() == ["detections", "lidar", "radar"]
    drawn = browser.find_elements("css selector", "[data-layer=detections] rect")
    assert [one.get_attribute("stroke-dasharray") for one in drawn] == ["", "5 3"]
    before = pixels(browser)
    click(browser, "[data-layer=detections]")
    assert pixels(browser) != before
    assert complaints(browser) == []
