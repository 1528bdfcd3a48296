"""The report in a real browser: what is shown, filtered, drawn, read and pressed."""

import shlex

import numpy as np
import pytest
from browser import Page, chromium
from command_line import run, write_exr
from depth_files import png

WIDTH, HEIGHT = 64, 48
HOSTILE = "sub</script><script>hacked=1<b>'\"&.exr"  # a folder "sub<", and a file in it
PATCH = (slice(8, 24), slice(40, 56))
BEFORE, AFTER = 0.25, 0.5
SHOWN = {BEFORE: 137, AFTER: 188}  # sRGB


def constant(value):
    return np.full((HEIGHT, WIDTH), value, np.float16)


def write(path, plane):
    write_exr(path, R=plane, G=plane, B=plane)


def patched(value):
    plane = constant(BEFORE)
    plane[PATCH] = value
    return plane


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Pairs: one brighter, one with a bright patch, one with NaN, one the same, one with a name."""
    root = tmp_path_factory.mktemp("report")
    pairs = {
        "render/brighter.exr": (constant(BEFORE), constant(AFTER)),
        "render/patch.exr": (constant(BEFORE), patched(8.0)),
        "render/nan.exr": (constant(BEFORE), patched(np.nan)),
        "render/frame2.exr": (constant(BEFORE), constant(BEFORE)),
        "render/frame10.exr": (constant(BEFORE), constant(BEFORE)),
        HOSTILE: (constant(BEFORE), patched(0.26)),
    }
    for name, (a, b) in pairs.items():
        write(root / "A" / name, a)
        write(root / "B" / name, b)
    file = root / "report.html"
    ran = run("compare", root / "A", root / "B", "--html", file)
    assert ran.code == 1, ran.err
    return file


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened


@pytest.fixture
def page(browser, report):
    opened = Page(browser, report)
    yield opened
    opened.close()


def choose(page, name):
    page.page.click(f"tbody button.name:text-is('{name}')")
    page.wait(f"document.getElementById('title').textContent === '{name}'")
    page.settle()


def test_failures_come_first_and_the_first_is_shown(page):
    names = page.names()
    assert names[0] == "render/nan.exr"
    assert set(names[:4]) == {"render/nan.exr", "render/patch.exr", "render/brighter.exr", HOSTILE}
    assert page.text("#title") == "render/nan.exr"
    assert "NaN in 256 pixels" in page.text("#details")
    page.wait("document.querySelector('tbody img').naturalWidth > 0")  # as it comes into view


def test_a_hostile_name_is_text_and_all_that_can_be_used_has_a_name(page):
    page.page.locator("tbody button.name", has_text="hacked").click()
    assert page.text("#title") == HOSTILE
    assert page.page.evaluate("window.hacked") is None
    unnamed = page.page.evaluate(
        """[...document.querySelectorAll("button, input, select, canvas")].filter(each =>
        !each.textContent.trim() && !each.getAttribute("aria-label") && !each.closest("label"))
        .map(each => each.outerHTML)"""
    )
    assert unnamed == []


def test_pictures_that_are_ticked_are_accepted_by_one_command(page, report):
    assert page.page.locator(".tick").count() == 4
    for name in ("render/patch.exr", HOSTILE):
        page.page.get_by_label(f"Accept {name}", exact=True).check()
    words = shlex.split(page.text("#accept code"))
    assert words[:4] == ["defocus", "compare", *(str(report.with_name(n)) for n in "AB")]
    ran = run(*words[1:4], "--html", report.with_name("second.html"), *words[4:])
    assert "2 files accepted" in ran.out
    left = run("compare", *words[2:4], "--json").json["pairs"]
    differ = {pair["name"] for pair in left if pair["status"] != "same"}
    assert differ == {"render/brighter.exr", "render/nan.exr"}
    page.page.get_by_label("Accept render/patch.exr").uncheck()
    page.page.get_by_label(f"Accept {HOSTILE}", exact=True).uncheck()
    assert page.text("#accept") == ""


def test_a_picture_is_split_by_the_slider(page):
    choose(page, "render/brighter.exr")
    assert page.pixel(0.4, 0.3)[0] == pytest.approx(SHOWN[BEFORE], abs=1)
    assert page.pixel(0.6, 0.3)[0] == pytest.approx(SHOWN[AFTER], abs=1)
    page.page.fill("#split", "700")
    assert page.pixel(0.6, 0.3)[0] == pytest.approx(SHOWN[BEFORE], abs=1)
    page.point(0.7, 0.5)
    page.page.mouse.down()
    page.point(0.45, 0.5)
    page.page.mouse.up()
    assert page.pixel(0.5, 0.3)[0] == pytest.approx(SHOWN[AFTER], abs=1)


def test_one_picture_alone_and_flicker(page):
    choose(page, "render/brighter.exr")
    page.press("1")
    assert page.pixel(0.6, 0.3)[0] == pytest.approx(SHOWN[BEFORE], abs=1)
    page.press("2")
    assert page.pixel(0.4, 0.3)[0] == pytest.approx(SHOWN[AFTER], abs=1)
    page.press("f")
    for value in (BEFORE, AFTER, BEFORE):
        assert any(abs(page.pixel(0.4, 0.3)[0] - SHOWN[value]) <= 1 for _ in range(200))
    assert page.text("#badge") in "AB"


def test_exposure_shows_light_beyond_white(page):
    choose(page, "render/patch.exr")
    page.press("2")
    middle = (0.5 + 16 / WIDTH * 0.5, 0.35)
    assert page.pixel(*middle)[:3] == [255, 255, 255]
    page.press(*["["] * 8)  # 8.0 at −4 EV is 0.5
    assert page.text("#stops") == "-4 EV"
    assert page.pixel(*middle)[0] == pytest.approx(SHOWN[0.5], abs=1)
    page.press("]")
    assert page.text("#stops") == "-3.5 EV"


def test_the_difference_is_hot_where_pixels_differ_and_nan_is_magenta(page):
    choose(page, "render/patch.exr")
    page.press("d")
    assert not page.page.is_hidden("#legend")
    inside, outside = page.pixel(0.62, 0.35), page.pixel(0.4, 0.7)
    assert sum(inside[:3]) > 400
    assert sum(outside[:3]) < 20
    choose(page, "render/nan.exr")
    assert page.pixel(0.62, 0.35)[:3] == [255, 0, 255]


def test_values_under_the_pointer_are_those_of_the_files(page):
    choose(page, "render/patch.exr")
    page.press("g")  # the worst pixel, in the middle of the view
    page.point(0.5, 0.5)
    page.wait("document.getElementById('readout').textContent.includes('B 8 8 8')")
    assert "A 0.25 0.25 0.25" in page.text("#readout")


def test_integers_of_8_and_16_bits_are_shown_as_they_are(browser, tmp_path):
    for name, dtype in (("8.png", np.uint8), ("16.png", np.uint16)):
        for folder, share in (("A", 0.2), ("B", 0.6)):
            values = np.full((24, 32, 3), share * np.iinfo(dtype).max).astype(dtype)
            values[0, 0] += 1  # no integer of 8 bits
            (tmp_path / folder).mkdir(exist_ok=True)
            png(tmp_path / folder / name, values, dtype)
    run("compare", tmp_path / "A", tmp_path / "B", "--html", tmp_path / "report.html")
    page = Page(browser, tmp_path / "report.html")
    for name in ("8.png", "16.png", "8.png"):
        choose(page, name)
        shown = [page.pixel(place, 0.3)[0] for place in (0.4, 0.6)]
        assert shown == pytest.approx([0.2 * 255, 0.6 * 255], abs=1)
    page.close()


def test_zoom_and_place_stay_while_items_change(page):
    choose(page, "render/patch.exr")
    page.press("g")
    page.point(0.5, 0.5)
    page.wait("document.getElementById('readout').textContent.includes('B 8')")
    place = page.text("#readout").split("  ")[0]
    choose(page, "render/brighter.exr")
    page.point(0.5, 0.49)
    page.point(0.5, 0.5)
    page.wait("document.getElementById('readout').textContent.includes('B 0.5')")
    assert page.text("#readout").split("  ")[0] == place
    page.press("0")
    assert page.pixel(0.01, 0.5)[3] == 0  # the whole picture has a border


def test_arrows_go_through_the_items_and_the_help_names_keys(page):
    names = page.names()
    page.press("ArrowDown")
    assert page.text("#title") == names[1]
    page.press("ArrowRight", "ArrowUp")
    assert page.text("#title") == names[1]
    assert page.text("#news").startswith(names[1])
    page.press("?")
    assert page.page.is_visible("#help")
    page.press("f")  # means nothing there
    page.page.keyboard.press("Escape")
    assert page.page.is_hidden("#help")
    assert page.page.get_attribute("[data-mode=flicker]", "aria-pressed") == "false"


def test_the_table_is_filtered_by_words_rules_and_status(page):
    every = len(page.names())
    page.press("/")
    page.page.keyboard.type("patch")
    assert page.names() == ["render/patch.exr"]
    page.page.fill("#filter", "max>1 render")
    assert page.names() == ["render/patch.exr"]
    assert page.text("#shown") == f"1 of {every}"
    page.page.fill("#filter", "nothing like it")
    assert page.page.is_visible("#nothing")
    page.page.fill("#filter", "")
    page.page.uncheck("[name=status][value=different]")
    assert "render/nan.exr" not in page.names()
    assert "render/frame2.exr" in page.names()


def test_the_table_is_sorted_by_a_column(page):
    page.page.click("[data-sort=name]")
    names = page.names()
    assert names.index("render/frame2.exr") < names.index("render/frame10.exr")
    page.page.click("[data-sort=psnr]")
    assert page.names()[0] in ("render/brighter.exr", "render/patch.exr")
    assert page.page.get_attribute("th:has([data-sort=psnr])", "aria-sort") == "ascending"
    page.page.click("[data-sort=psnr]")
    assert page.page.get_attribute("th:has([data-sort=psnr])", "aria-sort") == "descending"


def test_items_play_like_a_film(page):
    page.page.fill("#filter", "frame")
    page.page.click("[data-sort=name]")
    page.page.locator("#canvas").focus()
    page.press(" ")
    assert page.text("#position") in ("1 of 2 · frame 2", "2 of 2 · frame 10")
    for name in ("frame10", "frame2", "frame10"):
        page.wait(f"document.getElementById('title').textContent.includes('{name}.')")
    page.press(" ")
    title = page.text("#title")
    page.page.wait_for_timeout(400)
    assert page.text("#title") == title
    assert page.pixel(0.5, 0.3)[0] == pytest.approx(SHOWN[BEFORE], abs=3)  # a thumbnail
