"""The page to choose focus and blur on, in a real browser: what a click shows and says."""

import json
import re
import shlex
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest
from browser import Page, chromium
from command_line import color_exr, depth_exr, refused, run, succeed, texture
from depth_files import png
from image_files import save, to_srgb

from defocus_core import read_color
from defocus_core.reports.html.focus_choice import focuses_of

WIDTH, HEIGHT = 96, 64
PIXELS = """(async () => {
  await thumbOf(layerOf("render"));
  return [...bestGrid(layerOf("render")).data];
})()"""


def numbers():
    """A near left half, and a far right one."""
    return np.where(np.arange(WIDTH) < WIDTH // 2, 200, 40) + np.zeros((HEIGHT, 1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A photograph with relative depth, an EXR with metres, and a page of each."""
    root = tmp_path_factory.mktemp("choose")
    color = texture(WIDTH, HEIGHT)
    save(root / "a b.png", (color * 255).astype(np.uint8))
    png(root / "z.png", numbers(), np.uint8)
    color_exr(root / "rgb.exr", color)
    depth_exr(root / "z.exr", (100 / numbers()).astype(np.float32))
    with chdir(root):
        succeed("choose", "a b.png", "z.png", "-o", "photo.html", "--blur", "4px", "-q")
        lens = ("--lens", "@portrait-85", "--focus", "0.5m")
        assert run("choose", "rgb.exr", "z.exr", "-o", "exr.html", *lens).code == 0
    return root


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened


class Choice(Page):
    """A page to choose on that is open."""

    def click(self, x, y):
        """Click on a place of the picture, in parts of its width and height."""
        self.settle()
        place = self.page.evaluate(
            "([x, y]) => [canvas.clientWidth / 2 + (x - view.x) * zoomNow(),"
            " canvas.clientHeight / 2 + (y - view.y) * zoomNow()]",
            [x * WIDTH, y * HEIGHT],
        )
        self.page.locator("#canvas").click(position=dict(zip("xy", place, strict=True)))
        self.settle()

    @property
    def shown(self):
        self.settle()
        return np.reshape(self.page.evaluate(PIXELS), (HEIGHT, WIDTH, 4))[..., :3] / 255

    @property
    def command(self):
        return shlex.split(self.text("#details code"))


def rendered(words, folder):
    """What the command of a page renders, in sRGB."""
    with chdir(folder):
        succeed(*words[1:], "--overwrite")
        pixels = read_color(Path(words[words.index("-o") + 1])).pixels
    return to_srgb(np.clip(pixels, 0, 1))


@pytest.mark.parametrize(
    ("page", "options"),
    [
        ("photo.html", ("--blur 4px --focus-at 24,32", "--blur 8px --focus-at 72,32")),
        ("exr.html", ("--fnumber 1.4 --focus 0.5m", "--fnumber 0.7 --focus 2.5m")),
    ],
)
def test_a_click_shows_the_picture_of_the_command_below_it(page, options, folder, browser):
    opened, pictures = Choice(browser, folder / page), []
    for x, strength, said in zip((0.255, 0.755), "23", options, strict=True):
        opened.click(x, 0.505)
        opened.page.fill("#strength", strength)
        assert shlex.join(opened.command).endswith(said)
        pictures.append(opened.shown)
        made = rendered(opened.command, folder)
        assert np.sqrt(((made - pictures[-1]) ** 2).mean()) < 0.04  # of a JPEG of noise
        assert "nearest of 2 × 5 small pictures" in opened.text("#details")
    (near, far), half = pictures, WIDTH // 2
    for one, other, columns in ((near, far, slice(8, half - 8)), (far, near, slice(half + 8, -8))):
        assert one[:, columns].std() > 2 * other[:, columns].std(), "in focus is sharp"
    opened.close()


def test_its_first_picture_is_that_of_render_and_either_end_may_be_near(tmp_path, browser):
    save(tmp_path / "a.png", (texture(WIDTH, HEIGHT) * 255).astype(np.uint8))
    down, across = np.mgrid[:HEIGHT, :WIDTH]
    person = 170 + 12 * (down / HEIGHT) + 25 * (np.hypot(down - 36, across - 40) < 16)
    png(tmp_path / "z.png", np.where(across > 70, 30, person - 60 * (down < 12)), np.uint8)
    with chdir(tmp_path):
        line = run("render", "a.png", "z.png", "-o", "out.png").err
        succeed("choose", "a.png", "z.png", "-o", "page.html")
    opened = Choice(browser, tmp_path / "page.html")
    opened.settle()
    first = opened.command
    blur, place, sharp = re.search(
        "with --blur (.*) --focus-at (.*) --sharp-range (.*?)[; ]", line
    ).groups()
    said = ("--no-invert", "--sharp-range", sharp, "--blur", blur, "--focus-at", place)
    assert tuple(first[-7:]) == said
    first[first.index("-o") + 1] = "again.png"
    rendered(first, tmp_path)
    again = read_color(tmp_path / "again.png").pixels
    assert np.array_equal(again, read_color(tmp_path / "out.png").pixels)
    opened.press("ArrowUp", "ArrowUp")
    white = opened.shown
    opened.press("i")
    assert opened.text("#end") == "black is near"
    assert opened.command[-7:] == ["--invert", *said[1:4], "8px", *said[5:]]
    made = rendered(opened.command, tmp_path)
    own, other = (np.abs(made - each)[:, 60:80].mean() for each in (opened.shown, white))
    assert own < 0.7 * other, "at the edge"
    opened.close()


def test_keys_do_all_of_it(folder, browser):
    opened = Choice(browser, folder / "photo.html")
    opened.settle()
    opened.press("ArrowRight", "ArrowDown")
    assert opened.command[-4:] == ["--blur", "2px", "--focus-at", "71,31"]
    opened.press("ArrowLeft", "ArrowLeft", "ArrowUp", "ArrowUp", "ArrowUp")
    assert opened.command[-4:-1] == ["--blur", "16px", "--focus-at"]
    assert "the number 200 of the depth" in opened.text("#details")
    opened.page.keyboard.press("?")
    assert opened.page.locator("#help").is_visible()
    opened.close()


def test_a_page_is_replaced_and_no_other_file(folder):
    files = (folder / "a b.png", folder / "z.png")
    before = (folder / "a b.png").read_bytes()
    refused(run("choose", *files, "-o", files[0]), 3, "exists", files[0])
    assert files[0].read_bytes() == before
    ran = run("choose", folder / "rgb.exr", folder / "z.exr", "-o", folder / "n.html")
    refused(ran, 2, "missing-option", "focal-length")


def test_focuses_lie_where_the_depth_has_mass_and_are_there():
    rng = np.random.default_rng(0)
    disparity = np.concatenate([rng.uniform(0, 0.1, 8000), rng.uniform(0.9, 1, 1000), [0.5]])
    found = np.array(focuses_of(disparity.reshape(1, -1)))
    assert len(found) == 8
    assert np.isin(found, disparity).all()
    assert (found < 0.11).sum() >= 4
    assert (found > 0.89).sum() >= 2
    assert focuses_of(np.full((3, 3), 0.25)) == [0.25]


def test_focuses_are_numbers_of_the_file_on_surfaces_up_to_four_times_the_blur(tmp_path):
    x, seeds = np.arange(160), np.random.default_rng(0)
    soft = np.round(23 + 177 * np.clip((x - 70) / 20, 0, 1)) + np.zeros((120, 1))
    files = [save(tmp_path / "a.png", seeds.integers(0, 255, (120, 160, 3)).astype(np.uint8))]
    files.append(png(tmp_path / "z.png", soft, np.uint8))
    succeed("choose", *files, "-o", tmp_path / "page.html", "--blur", "2.5%")
    text = (tmp_path / "page.html").read_text()
    data = json.loads(re.search(r'id="data"[^>]*>(.*?)</script>', text, re.S)[1])
    words = [each["words"] for each in data["strengths"]]
    assert words[::2] == ["blur 1px", "blur 4px", "blur 16px"]
    assert {each["value"] for each in data["focuses"]} <= {23, 24, 25, 26, 197, 198, 199, 200}
    low, high = data["items"][0]["layers"][1]["values"]["ends"]
    assert (low, high - low) == (23, 65535), "a step of the map is one of the file"
