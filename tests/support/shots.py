"""Small shots: frames whose depth is noisy, so that they decide together and see others."""

import numpy as np
from command_line import color_exr, depth_exr

HEIGHT, WIDTH = 40, 64
PULL = "frame,focus,fnumber\n0,2m,2\n9,4m,2\n"
JOBS = """[inputs]
color = "rgb.####.exr"
depth = "z.####.exr"
[lens]
focal-length = "50mm"
[animate]
file = "pull.csv"
"""


def smooth(seed=0):
    """Colours [H, W, 3] that change over some px."""
    coarse = np.random.default_rng(seed).random((HEIGHT // 4, WIDTH // 4, 3))
    return np.kron(coarse, np.ones((4, 4, 1))).astype(np.float32)


def still(folder, frames=10, noise=0.02):
    """A shot of a still wall at 3 m whose disparity has noise."""
    for k in range(frames):
        rng = np.random.default_rng(k)
        metres = 1 / (1 / 3 + noise * rng.standard_normal((HEIGHT, WIDTH)))
        color_exr(folder / f"rgb.{k:04}.exr", smooth())
        depth_exr(folder / f"z.{k:04}.exr", metres.astype(np.float32))
    return folder / "rgb.####.exr", folder / "z.####.exr"


def pull(folder):
    """A jobs file of such a shot whose focus is pulled."""
    still(folder)
    (folder / "pull.csv").write_text(PULL)
    path = folder / "jobs.toml"
    path.write_text(JOBS)
    return path
