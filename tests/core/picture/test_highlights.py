"""--highlights on photographs: lamps become discs, whose light moves no edge of depth."""

import numpy as np
from batches import records
from command_line import succeed
from image_files import save


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
        lens = ("--focal-length", "85mm", "--fnumber", "2", "--focus", "2m")
        given = ("--depth-kind", "disparity", "--depth-range", "1m", "20m", "--highlights", word)
        succeed(
            "render", color, depth, *given, *lens, "-o", tmp_path / word, "--sensor-width", "4mm"
        )
        record = records(tmp_path / word)[-1]
        notes.append((record["depth_note"], record["depth_repair"]))
    assert notes[0] == notes[1]
    assert "repaired" in notes[0][0]
