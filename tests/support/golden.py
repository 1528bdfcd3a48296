"""Small pictures that guard RENDERER_VERSION: their scenes, and how they are stored.

``python tests/support/golden.py`` renders them and stores them anew, one file a scene. The scenes
keep away from thresholds: float64, and depth that differs in its last bits, make the same pictures.
They are stored of both backs.
"""

from pathlib import Path

import numpy as np
import torch
from reference import flatten
from renderers import renderer_of
from scenes import card_layers, pattern, slanted, steps
from torch import Tensor
from torch.nn.functional import avg_pool2d

from defocus_core import Aperture

FOLDER = Path(__file__).parents[1] / "laws" / "golden"
COMMAND = "python tests/support/golden.py"
SIZE = (36, 48)  # H, W
SCENES = ("occlusion", "slopes", "highlights", "polygon", "repair")
COMPILED = "compiled-"  # before the name of a scene, that of its pictures by the compiled back
CARRIED = tuple(COMPILED + scene for scene in SCENES)
INFINITY = 7.0  # signed radius in px of what is infinitely far
Pictures = dict[str, Tensor]


def rendered(scene, dtype=torch.float32, nudge=0.0):
    """The pictures of a scene by name.

    Args:
        scene: one of `SCENES` or `CARRIED`.
        dtype: of the picture and of its depth.
        nudge: relative change of the depth, by random signs.
    """
    back, scene = ("auto" if scene in CARRIED else "torch"), scene.removeprefix(COMPILED)
    image, radius = _scene(scene)
    image, radius = image.to(dtype), _nudged(radius, nudge).to(dtype)
    renderer = renderer_of(
        image,
        radius,
        aperture=Aperture(blades=6, rotation=10.0) if scene == "polygon" else Aperture(),
        left_right=scene in ("occlusion", "highlights"),
        infinity=INFINITY if scene == "repair" else None,
        back=back,
    )
    assert (renderer.back == "compiled") == (back == "auto" and dtype == torch.float32)
    views = renderer.picture()
    pictures = {"render": views.render}
    if views.left is not None and views.right is not None:
        pictures |= {"left": views.left, "right": views.right, "trust": views.trust}
    return pictures


def _scene(scene):
    """The picture [3, H, W] and the signed radius [H, W] px of a scene, float64."""
    if scene == "slopes":
        return pattern(SIZE, period=13.0), slanted(SIZE, near=-4.3, far=6.7)
    if scene == "polygon":
        return pattern(SIZE, period=11.0), steps(SIZE) + 0.3
    if scene == "repair":
        return _antialiased_card()
    image, radius = flatten(card_layers(-5.2, 3.3, SIZE, margin=10), SIZE)
    if scene == "highlights":
        image = 0.3 * image
        image[:, 8, 9] = image[:, 25, 40] = 20.0
    return image, radius


def _antialiased_card():
    """A round card whose colour and disparity are averaged over the pixels of its edge."""
    fine = 8
    y, x = ((torch.arange(fine * n, dtype=torch.float64) + 0.5) / fine for n in SIZE)
    on_card = (x - 23.3) ** 2 + (y[:, None] - 17.6) ** 2 < 11.2**2
    share = avg_pool2d(on_card.double()[None], fine)[0]
    tint = torch.tensor([0.9, 0.7, 0.2], dtype=torch.float64)[:, None, None]
    image = share * tint + (1 - share) * pattern(SIZE, period=12.0)
    return image, share * -4.1 + (1 - share) * 4.6


def _nudged(radius, share):
    signs = torch.rand(radius.shape, generator=torch.Generator().manual_seed(4)) < 0.5
    return radius * torch.where(signs, 1 - share, 1 + share)


def stored(scene):
    """The pictures of a scene as they were when they were stored."""
    with np.load(FOLDER / f"{scene}.npz") as arrays:
        return {name: torch.from_numpy(arrays[name]) for name in arrays.files}


def store():
    """Render all scenes and store their pictures."""
    for scene in SCENES + CARRIED:
        pictures = {name: picture.numpy() for name, picture in rendered(scene).items()}
        np.savez_compressed(FOLDER / f"{scene}.npz", **pictures)


if __name__ == "__main__":
    torch.set_num_threads(1)
    store()
