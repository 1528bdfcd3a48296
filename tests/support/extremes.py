"""Pictures at the ends of all options, and what in their views or gradients is not finite."""

from dataclasses import dataclass, field
from typing import Any

import torch

from defocus_core import Aperture, CatEye, DualPixel, PupilImage, render

DTYPES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
KINDS = ("constant", "slanted", "checkerboard", "random")
MAX_RADIUS = 5000.0
# The brightest that a type holds, or that the renderer takes.
_MAXIMUM = {torch.float16: 65504.0, torch.bfloat16: 9.9e29}
# A gradient in float16 is at most 65504, and that to a pixel on the verge of being a highlight
# hundreds of times itself: divided by less, it is infinite.
_MIN_SCALE = 2e-2
# What a view may exceed of the least and the greatest of a channel: a share of them, by rounding,
# and of its range, in a half of the lens by detail as fine as a pixel.
_ROUNDING, _OVERSHOOT = 1e-3, 0.1


def dots():
    """A pupil whose light lies aside of its middle."""
    picture = torch.zeros(9, 9, dtype=torch.float64)
    picture[1, 2], picture[7, 7], picture[0, 8] = 1.0, 0.5, 0.2
    return PupilImage(picture)


@dataclass(frozen=True)
class Extreme:
    """A picture of noise with lights, and how it is taken."""

    size: tuple[int, int] = (12, 16)  # (height, width) in px
    radius: float = 4.0  # greatest radius in px
    kind: str = "constant"  # how radii lie: one of KINDS
    side: int = 1  # -1 nearer than focus, 0 on both sides, 1 beyond it
    light: float = 1.0  # light of the brightest pixel
    lights: int = 1  # number of pixels that are a thousand times as bright as others
    dtype: torch.dtype = torch.float32  # type of the picture
    seed: int = 0  # of the noise
    pupil: dict[str, Any] = field(default_factory=dict)  # attributes of the aperture
    # attributes of the cat's eye, if there is one
    rim: dict[str, Any] = field(default_factory=dict)
    pair: dict[str, Any] = field(default_factory=dict)  # attributes of the dual pixel
    learnt: str = ""  # the name of a number of the pupil or the rim that a gradient flows to
    options: dict[str, Any] = field(default_factory=dict)  # other options of `render`

    def scene(self):
        """The picture [3, H, W] and its radii [H, W]."""
        generator, (H, W) = torch.Generator().manual_seed(self.seed), self.size
        noise = torch.rand(4, H, W, generator=generator, dtype=torch.float64)
        image, depth = noise[:3], noise[3]
        image.view(3, -1)[:, torch.randint(H * W, (self.lights,), generator=generator)] *= 1000
        image = image / image.max() * min(self.light, _MAXIMUM.get(self.dtype, self.light))
        y, x = (torch.linspace(0, 1, n, dtype=torch.float64) for n in (H, W))
        if self.kind == "constant":
            depth = torch.ones_like(depth)
        elif self.kind == "slanted":
            depth = (y[:, None] + x) / 2
        elif self.kind == "checkerboard":
            depth = ((torch.arange(H)[:, None] + torch.arange(W)) % 2).double()
        radius = self.radius * (self.side * depth if self.side else 2 * depth - 1)
        wide = self.dtype == torch.float64
        return image.to(self.dtype), radius if wide else radius.float()

    def views(self, image, radius, leaf=None):
        """The picture rendered, `leaf` in place of the number that learns."""
        pupil, rim = dict(self.pupil), dict(self.rim)
        if leaf is not None:
            (rim if self.learnt in rim else pupil)[self.learnt] = leaf
        options = dict(self.options)
        if rim:
            options["cat_eye"] = CatEye(**rim)
        aperture, pair = Aperture(**pupil), DualPixel(**self.pair)
        return render(image, radius, aperture=aperture, dual_pixel=pair, left_right=True, **options)

    def _beyond(self, image, views):
        """The views that are darker or brighter than the picture, each channel by itself."""
        values = image.double().flatten(1)
        least, greatest = values.amin(1), values.amax(1)
        if self.rim.get("vignetting"):
            least = torch.zeros_like(least)
        rounding = max(_ROUNDING, 2 * torch.finfo(image.dtype).eps)
        found = []
        for name, seen in views.items():
            more = 0.0 if name == "render" else _OVERSHOOT * (greatest - least)
            shown = seen.double().flatten(1)
            dark = (least - more - shown.amin(1)) / (least if name == "render" else greatest)
            bright = (shown.amax(1) - greatest - more) / greatest
            for word, beyond in (("darker", dark), ("brighter", bright)):
                if float(beyond.nan_to_num(0.0).amax()) > rounding:
                    found.append(f"{name} is {word} than the picture by {float(beyond.amax()):.4g}")
        return found

    def faults(self):
        """What is not finite, or darker or brighter than the picture and a rounding."""
        image, radius = (x.requires_grad_() for x in self.scene())
        leaves = {"image": image, "radius": radius}
        if self.learnt:
            start = {"curvature": 0.0, "obstruction": 0.0, "spherical": 0.0, "squeeze": 1.0}
            value = float({**start, **self.pupil, **self.rim}[self.learnt])
            leaves[self.learnt] = torch.tensor(value, dtype=torch.float64, requires_grad=True)
        views = self.views(image, radius, leaves.get(self.learnt))
        named = dict(zip(("render", "left", "right"), views.images, strict=True))
        found = [
            f"{name} is not finite"
            for name, seen in {**named, "trust": views.trust}.items()
            if not bool(seen.isfinite().all())
        ]
        found += self._beyond(image.detach(), {n: seen.detach() for n, seen in named.items()})
        brightest = float(image.detach().amax()) or 1.0
        generator = torch.Generator().manual_seed(self.seed)
        weigh = torch.rand(3, 1, *self.size, generator=generator, dtype=torch.float64)
        scale = max(brightest, _MIN_SCALE)
        total = (torch.stack(list(views.images)).double() / scale * weigh).sum()
        # on the verge of a highlight trust falls by 1 for a change far below the brightest pixel
        total = total + min(scale, 1.0) * views.trust.double().sum()
        gradients = torch.autograd.grad(total, list(leaves.values()), allow_unused=True)
        return found + [
            f"the gradient to {name} is not finite"
            for name, gradient in zip(leaves, gradients, strict=True)
            if gradient is not None and not bool(gradient.isfinite().all())
        ]
