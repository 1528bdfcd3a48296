"""Focus and depth over time in the report of a shot."""

from __future__ import annotations

import json

import html_reports
import numpy as np
import pytest
from browser import Page, chromium
from command_line import color_exr, depth_exr, pair, render, run, texture

FRAMES = range(8, 13)  # numbers of one and of two digits
NEAR, FAR = 1.0, 4.0


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A shot of a card before a wall and the sky; the focus goes from 1 m to infinity."""
    root = tmp_path_factory.mktemp("shot")
    for frame in FRAMES:
        metres = np.full((16, 24), FAR, np.float32)
        metres[4:12, 2 * (frame - 8) : 2 * (frame - 8) + 6] = NEAR
        metres[0] = np.inf
        color_exr(root / f"sh010.{frame:04}.exr", texture(seed=frame))
        depth_exr(root / f"z.{frame:04}.exr", metres)
    (root / "pull.csv").write_text("frame,focus,fnumber\n8,1m,2\n12,inf,2\n")
    words = ("--focal-length", "50mm", "--animate", root / "pull.csv", "-o", root / "out")
    ran = run("render", root / "sh010.####.exr", root / "z.####.exr", *words)
    assert ran.code == 0, ran.err
    assert run("report", root / "out").code == 0
    return root / "out"


@pytest.fixture
def page(out):
    with chromium() as browser:
        opened = Page(browser, out / "report.html")
        yield opened
        opened.close()


def places(page):
    points = page.page.get_attribute("#chart polyline", "points").split()
    return [(float(x), float(y)) for x, y in (point.split(",") for point in points)]


def test_frames_know_their_number_focus_and_quantiles_of_disparity(out):
    depths = [each["depth"] for each in html_reports.items(out / "report.html")]
    assert [depth["frame"] for depth in depths] == list(FRAMES)
    assert {depth["shot"] for depth in depths} == {"sh010.#"}
    assert [depth["focus"] for depth in depths] == pytest.approx([1, 0.75, 0.5, 0.25, 0])
    for depth in depths:
        quantiles = depth["quantiles"]
        assert (quantiles[0], quantiles[-1]) == (0, 1 / NEAR)
        assert quantiles[len(quantiles) // 2] == 1 / FAR
        nearer = sum(each == 1 / NEAR for each in quantiles) / (len(quantiles) - 1)
        assert nearer == pytest.approx(48 / 384, abs=0.05)


def test_only_frames_have_depth_over_time(tmp_path):
    assert render(*pair(tmp_path), "-o", tmp_path / "out").code == 0
    assert run("report", tmp_path / "out").code == 0
    (item,) = html_reports.items(tmp_path / "out" / "report.html")
    assert item["depth"] is None
    (line,) = (tmp_path / "out" / "journal.jsonl").read_text().splitlines()
    assert "depth_over_time" not in json.loads(line)["measures"]


@pytest.mark.parametrize("broken", [7, {"frame": "1"}, {"frame": 1, "disparity": [1, None]}])
def test_a_journal_of_elsewhere_may_hold_anything(out, tmp_path, broken):
    records = [json.loads(line) for line in (out / "journal.jsonl").read_text().splitlines()]
    for record in records:
        record["measures"]["depth_over_time"] = broken
    (tmp_path / "journal.jsonl").write_text("".join(json.dumps(each) + "\n" for each in records))
    assert run("report", tmp_path).code == 0
    assert all(each["depth"] is None for each in html_reports.items(tmp_path / "report.html"))


def test_the_focus_is_a_curve_over_the_depth_of_each_frame(page):
    points = places(page)
    assert len(points) == len(FRAMES)
    assert points == sorted(points)  # frames to the right
    down = [y for _, y in points]
    assert down == sorted(down, reverse=True)  # a focus that goes away goes up
    assert page.page.locator("#chart text", has_text="∞").count() == 1
    assert page.page.locator("#chart path.depth[d^=M]").count() > 0
    words = page.text("#chart-words")
    assert words == "Frame 8: focus 1 m, depth 1 m to ∞, half of it 4 m to 4 m"


def test_the_chart_shows_the_frame_and_a_click_goes_to_one(page):
    points = places(page)
    page.press("ArrowDown", "ArrowDown")
    assert float(page.page.get_attribute("#chart .now", "x1")) == pytest.approx(points[2][0])
    assert page.text("#chart-words").startswith("Frame 10: focus 2 m")
    box = page.page.locator("#chart").bounding_box()
    view = page.page.evaluate("document.getElementById('chart').getScreenCTM().a")
    shift = page.page.evaluate("document.getElementById('chart').getScreenCTM().e")
    page.page.mouse.click(shift + view * points[4][0], box["y"] + box["height"] / 2)
    assert page.text("#title") == "sh010.0012"
    assert page.text("#chart-words").startswith("Frame 12: focus ∞")


def test_a_shot_plays_without_an_exception_and_its_frames_have_numbers(page):
    assert page.text("#position") == "1 of 5 · frame 0008"
    page.page.locator("#canvas").focus()
    page.press(" ")
    page.wait("document.getElementById('position').textContent.endsWith('frame 0011')")
    page.page.fill("#filter", "nothing like it")
    page.page.wait_for_timeout(200)
    assert page.complaints == []


def test_a_report_without_a_shot_has_no_chart(tmp_path):
    assert render(*pair(tmp_path), "-o", tmp_path / "out").code == 0
    assert run("report", tmp_path / "out").code == 0
    with chromium() as browser:
        page = Page(browser, tmp_path / "out" / "report.html")
        assert page.page.is_hidden("#over-time")
        page.close()
