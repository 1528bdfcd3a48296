"""--highlights on photographs: lamps become discs, and nothing beyond their reach changes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import read_exr, run
from image_files import save, to_srgb

REAL = Path(__file__).parents[4] / "shared" / "real"
# Files, their meaning, a lens, the share of pixels beyond the reach of lights, and of those that
# may change by more than 1 / 255: hidden surfaces are continued from such pixels.
PHOTOGRAPHS = {
    "hall": (
        ("clear.png", "estimated_depth.png", "--depth-kind", "depth", "--depth-range", "0.5m"),
        ("10m", "--focal-length", "50mm", "--fnumber", "1.4", "--focus", "0.8m"),
        (0.5, 5e-4),
    ),
    "street": (
        ("street_8_all-in-focus.jpg", "street_8_disparity.jpg", "--depth-kind", "disparity"),
        ("--depth-range", "1m", "20m", "--focal-length", "85mm", "--fnumber", "4", "--focus", "2m"),
        (0.3, 1e-4),
    ),
}


@pytest.mark.skipif(not REAL.exists(), reason="needs ../shared/real")
@pytest.mark.parametrize("name", ["hall", pytest.param("street", marks=pytest.mark.bench)])
def test_nothing_changes_beyond_the_reach_of_lights(tmp_path, name):
    (color, depth, *kind), lens, (beyond, changed) = PHOTOGRAPHS[name]
    color, depth = (_part(REAL / file, tmp_path) for file in (color, depth))
    found = {}
    for word in ("off", "auto"):
        out = ("-o", tmp_path / word, "--outputs", "render,coc", "--highlights", word)
        out += ("--sensor-width", "18mm")  # of that half
        ran = run("render", color, depth, *kind, *lens, *out)
        assert ran.code == 0, ran.err
        (file,) = (tmp_path / word / "render").glob("*.exr")
        planes = read_exr(file)
        found[word] = 255 * to_srgb(
            np.stack([planes[name] for name in "RGB"]).clip(0, 1).astype(np.float32)
        )
    record = json.loads((tmp_path / "auto/journal.jsonl").read_text().splitlines()[-1])
    assert int(record["color_note"].split(", ")[-1].split()[0]) > 50
    apart = np.abs(found["auto"] - found["off"]).max(0)
    assert (apart > 60).mean() > 1e-4, "lights are discs"
    radius = np.abs(read_exr(tmp_path / "off/coc" / file.name)["coc"])
    far = ~_reached(color, radius)
    assert far.mean() > beyond
    assert (apart[far] > 1).mean() <= changed


def _part(file, folder):
    """The part of a photograph in which its lamps are: half of its width."""
    import OpenImageIO as oiio  # noqa: N813

    image, path = oiio.ImageBuf(str(file)), folder / f"{file.stem}.png"
    width, height = image.spec().width, image.spec().height
    part = oiio.ImageBufAlgo.cut(image, oiio.ROI(width // 2, width, 0, 3 * height // 4))
    assert part.write(str(path))
    return path


def _reached(photograph, radius):
    """Where the light of pixels reaches that are brightened, by windows of 16 px."""
    import OpenImageIO as oiio  # noqa: N813
    import torch

    from defocus_core import with_lights

    pixels = oiio.ImageBuf(str(photograph)).get_pixels(oiio.FLOAT)[..., :3] ** 2.2
    image = torch.from_numpy(np.ascontiguousarray(np.moveaxis(pixels, 2, 0)))
    threshold = 0.92  # linear light of either coding begins here at the latest
    lit = with_lights(image, threshold)
    reached = np.zeros(radius.shape, bool)
    for y, x in np.argwhere((lit != image).any(0).numpy()):
        r = int(np.ceil(radius[y, x])) + 16
        reached[max(y - r, 0) : y + r + 1, max(x - r, 0) : x + r + 1] = True
    return reached


def test_the_light_of_lamps_does_not_guide_the_repair_of_depth(tmp_path):
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:96, :128]
    card = np.hypot(y - 48, x - 64) < 28
    photo = np.where(card, 120, 50)[..., None] + rng.integers(0, 20, (96, 128, 3))
    photo[20:22, 30:32] = photo[46:48, 90:92] = 255
    ramp = np.clip((30 - np.hypot(y - 48, x - 66)) / 6 + 0.5, 0, 1)  # soft, and beside the card
    color = save(tmp_path / "photo.png", photo.astype(np.uint8))
    depth = save(tmp_path / "depth.png", np.round(40 + 180 * ramp)[..., None].astype(np.uint8))
    notes = []
    for word in ("off", "auto"):
        lens = (
            "--focal-length",
            "85mm",
            "--fnumber",
            "2",
            "--focus",
            "2m",
            "--sensor-width",
            "4mm",
        )
        given = ("--depth-kind", "disparity", "--depth-range", "1m", "20m", "--highlights", word)
        ran = run(
            "render", color, depth, *given, *lens, "-o", tmp_path / word, "--sensor-width", "4mm"
        )
        assert ran.code == 0, ran.err
        record = json.loads((tmp_path / word / "journal.jsonl").read_text().splitlines()[-1])
        notes.append((record["depth_note"], record["depth_repair"]))
    assert notes[0] == notes[1]
    assert "repaired" in notes[0][0]
