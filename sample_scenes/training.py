"""Train a small network to see the blur of a pixel in a dual-pixel pair: a worked example.

    python sample_scenes/training.py

Its samples are drawn by `RandomDefocus` while it trains, and read from a batch that `defocus batch`
finished; the scenes of the batch's split test are held out. Left and right hold the signed radius:
a point beyond the focus lies to the left in LEFT, a nearer one to the right.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import OpenEXR
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, interpolate
from torch.utils.data import DataLoader

from defocus_core import BatchDataset, Distribution, RandomDefocus

SIDE, CROP = 96, 64  # px of a scene, and of what the network sees of it
MAX_PX = 6.0  # radius
JOBS = """
[inputs]
color = "scenes/*.rgb.exr"
depth = "scenes/*.depth.exr"
[split]
test = 3
train = 1.0
[reading]
depth-repair = "off"
[lens]
focal-length = "50mm"
sensor-width = "3mm"
clamp-blur = "6px"
[sample]
n = 3
seed = 1
fnumber = "loguniform(2, 8)"
focus = "percentile(5, 95)"
[outputs]
kinds = ["left", "right", "coc"]
"""


def scene(seed: int) -> tuple[Tensor, Tensor]:
    """Three textured cards before a textured wall: linear light [3, H, W], depth [1, H, W] in m."""
    random = torch.Generator().manual_seed(seed)

    def texture() -> Tensor:
        coarse = torch.rand(1, 3, SIDE // 6, SIDE // 6, generator=random)
        fine = torch.rand(1, 3, SIDE, SIDE, generator=random)
        return (0.5 * interpolate(coarse, SIDE, mode="bilinear") + 0.5 * fine)[0]

    image, depth = texture(), torch.full((1, SIDE, SIDE), 8.0)
    for metres in (5.0, 3.5, 2.5):
        top, left = torch.randint(0, SIDE // 2, (2,), generator=random).tolist()
        height, width = torch.randint(SIDE // 5, SIDE // 2, (2,), generator=random).tolist()
        card = (slice(None), slice(top, top + height), slice(left, left + width))
        image[card], depth[card] = texture()[card], metres
    return image, depth


def drawn(steps: int, size: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Batches of left and right [B, 6, h, w] and signed radii [B, 1, h, w], drawn anew."""
    defocus = RandomDefocus(
        foclen=50.0,
        sensor_width=3.0,
        fnum=Distribution("loguniform", (2.0, 8.0)),
        max_radius=MAX_PX,
        left_right=True,
        depth_repair="off",
        depth_unit="m",
    )
    for step in range(steps):
        seeds = [step * size + number for number in range(size)]
        scenes = [scene(seed) for seed in seeds]
        images = torch.stack([image for image, _ in scenes])
        depths = torch.stack([metres for _, metres in scenes])
        views, lenses = defocus(images, depths, seeds)
        yield torch.cat([views.left, views.right], dim=1), lenses.signed_radius


def finished(out: Path, split: str) -> tuple[Tensor, Tensor]:
    """Left and right [N, 6, H, W] and signed radii [N, 1, H, W] of a split of a finished batch."""
    data = BatchDataset(out, ["left", "right", "coc"], split=split)
    (every,) = DataLoader(data, batch_size=len(data))
    return torch.cat([every["left"], every["right"]], dim=1), every["coc"]


def make_batch(folder: Path, scenes: int) -> Path:
    """Write scenes, and have `defocus batch` take them; the folder of the finished batch."""
    (folder / "scenes").mkdir(parents=True)
    for number in range(scenes):
        image, metres = scene(1_000_000 + number)
        stem = folder / "scenes" / f"s{number:02}"
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        for name, planes in (
            ("rgb", zip("RGB", image, strict=True)),
            ("depth", [("Z", metres[0])]),
        ):
            pixels = {channel: plane.contiguous().numpy() for channel, plane in planes}
            OpenEXR.File(dict(header), pixels).write(f"{stem}.{name}.exr")
    (folder / "jobs.toml").write_text(JOBS)
    words = ["batch", str(folder / "jobs.toml"), "-o", str(folder / "out")]
    subprocess.run([sys.executable, "-m", "defocus_cli", *words], check=True)
    return folder / "out"


class Matching(nn.Module):
    """Differences of left and right at several shifts, and a few convolutions on them."""

    shifts = range(-5, 6)  # px, of the disparity

    def __init__(self) -> None:
        super().__init__()
        width = 24
        self.judge = nn.Sequential(
            nn.Conv2d(len(self.shifts), width, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(width, 1, 3, padding=1),
        )

    def forward(self, pair: Tensor) -> Tensor:
        """The signed radius in px [B, 1, H, W] of left and right [B, 6, H, W]."""
        left, right = pair[:, :3], pair[:, 3:]
        unlike = [(left.roll(k, -1) - right).abs().mean(1, keepdim=True) for k in self.shifts]
        cost = avg_pool2d(torch.cat(unlike, 1), 5, 1, padding=2)
        minimum, mean = cost.amin(1, keepdim=True), cost.mean(1, keepdim=True)
        seen: Tensor = self.judge((cost - minimum) / (mean - minimum + 1e-3))
        return seen


def loss_of(model: nn.Module, pair: Tensor, radius: Tensor) -> Tensor:
    """The mean absolute error of the radius, in px."""
    seen: Tensor = model(pair)
    return (seen - radius).abs().mean()


def train(out: Path, steps: int = 240, size: int = 4) -> tuple[float, float]:
    """Train; the loss on the held-out scenes before and after, in px.

    Args:
        out: a finished batch with splits train and test.
        steps: of the training; each fourth one draws new samples, the others read the batch.
        size: samples of a step.
    """
    torch.manual_seed(0)
    model = Matching()
    held_out, known = finished(out, "test"), finished(out, "train")
    optimiser = torch.optim.Adam(model.parameters(), lr=4e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 1e-2, total_steps=steps)
    new = drawn(-(-steps // 4), size)
    with torch.no_grad():
        before = float(loss_of(model, *held_out))
    for step in range(steps):
        if step % 4:
            chosen = torch.randint(len(known[0]), (size,))
            pair, radius = known[0][chosen], known[1][chosen]
        else:
            pair, radius = next(new)
        top, left = torch.randint(0, SIDE - CROP + 1, (2,)).tolist()
        window = (..., slice(top, top + CROP), slice(left, left + CROP))
        optimiser.zero_grad()
        loss_of(model, pair[window], radius[window]).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    with torch.no_grad():
        return before, float(loss_of(model, *held_out))


def main() -> None:
    """Make a batch, train, and say how well it went."""
    with tempfile.TemporaryDirectory() as folder:
        out = make_batch(Path(folder), scenes=16)
        before, after = train(out)
    print(f"error of the radius on held-out scenes: {before:.2f} px before, {after:.2f} px after")


if __name__ == "__main__":
    main()
