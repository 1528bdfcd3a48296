"""Sets of scenes with known truth, and their decoded shots.

Each directory ``SCENE`` of a set holds ``camera.json``, ``rgb.exr``, ``depth.exr`` and, for each
shot of the camera, ``truth_<shot>.exr``: the photograph by a thin lens.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from defocus_core.errors import InputError, UsageProblem, cannot_read, reason
from defocus_core.io.below import read_plain
from defocus_core.io.depth_formats.depth import read_depth, require_valid
from defocus_core.io.images.color import read_color, require_finite
from defocus_core.io.safe_files import MALFORMED
from defocus_core.picture.radii import radii_of
from defocus_core.request.lens import LensValues

if TYPE_CHECKING:
    from torch import Tensor

BLADES = {"disk": 0, "hexagon": 6}
MIN_INNER = 11  # px that SSIM needs


@dataclass(frozen=True)
class TruthShot:
    """One picture of a set."""

    folder: Path  # folder of the scene
    name: str  # name of the shot
    lens: LensValues  # lens of the shot
    border: int  # px at each side that may show content from outside the frame

    @property
    def scene(self) -> str:
        """The name of the scene."""
        return self.folder.name

    @property
    def truth(self) -> Path:
        """The file of the thin-lens picture."""
        return self.folder / f"truth_{self.name}.exr"


class Pictures(NamedTuple):
    """A shot decoded: sharp picture and truth [3, H, W], linear; signed radius [H, W] in px.

    `infinity` is the radius at infinity.
    """

    sharp: Tensor
    truth: Tensor
    signed_radius: Tensor
    infinity: float


def sample_set() -> Path:
    """The scenes of the repository this runs from."""
    scenes = Path("sample_scenes").absolute()
    if any(scenes.glob("*/camera.json")):
        return scenes
    problem = "is missing, and the sample scenes are not part of an installed package"
    raise UsageProblem(
        "missing-option", problem, "name a directory of <scene>/camera.json", field="truth"
    )


def find_shots(root: Path) -> list[TruthShot]:
    """All shots of a set, by name of the scene."""
    if not root.is_dir():
        raise InputError(
            "not-found", "is not a directory", "name one that holds <scene>/camera.json", path=root
        )
    cameras = sorted(root.glob("*/camera.json"))
    if not cameras:
        raise InputError(
            "empty", "holds no <scene>/camera.json", "name a directory of such scenes", path=root
        )
    shots = [shot for camera in cameras for shot in _shots(camera)]
    if not shots:
        raise InputError("empty", "holds no shot", "list shots in camera.json", path=root)
    return shots


def _shots(file: Path) -> list[TruthShot]:
    try:
        camera: dict[str, Any] = json.loads(read_plain(file))
        shots = [_shot(file.parent, camera, shot) for shot in camera["shots"]]
    except OSError as error:
        raise cannot_read(file, error, "check it") from error
    except MALFORMED as error:
        problem = f"does not describe a camera ({type(error).__name__}: {reason(error)})"
        raise InputError(
            "malformed", problem, "compare it with those of sample_scenes", path=file
        ) from error
    for shot in shots:
        for path in (shot.folder / "rgb.exr", shot.folder / "depth.exr", shot.truth):
            if not path.is_file():
                raise InputError(
                    "missing-option",
                    "is missing",
                    f"add it or take the shot out of {file}",
                    path=path,
                )
        if min(camera["width"], camera["height"]) - 2 * shot.border < MIN_INNER:
            problem = f"{shot.name} leaves no picture within its border of {shot.border} px"
            raise InputError("empty", problem, "use larger pictures or less blur", path=file)
    return shots


def _shot(folder: Path, camera: dict[str, Any], shot: dict[str, Any]) -> TruthShot:
    lens = LensValues(
        foclen=float(camera["focal_length_mm"]),
        fnum=float(shot.get("thin_lens_fnumber", shot["fnumber"])),
        foc_dist=1000 * float(shot["focus_distance_m"]),
        sensor_width=float(camera["sensor_width_mm"]),
        blades=BLADES[shot.get("aperture", "disk")],
        blade_rotation=float(shot.get("aperture_rotation_deg", 0)),
    )
    return TruthShot(folder, str(shot["name"]), lens, math.ceil(shot["max_coc_radius_px"]))


def read(shot: TruthShot) -> Pictures:
    """Decode a shot."""
    import torch

    depth = read_depth(shot.folder / "depth.exr")
    require_valid(depth)
    radii, size = radii_of(shot.lens, depth), depth.metres.shape
    radius = torch.from_numpy(radii.px)
    sharp, truth = (_rgb(path, size) for path in (shot.folder / "rgb.exr", shot.truth))
    assert radii.infinity is not None
    return Pictures(sharp, truth, radius, radii.infinity)


def _rgb(path: Path, size: tuple[int, int]) -> Tensor:
    import torch

    color = read_color(path)
    require_finite(color)
    if color.pixels.shape != (*size, 3):
        shape = "x".join(map(str, color.pixels.shape))
        problem = f"is {shape} (height, width, channels), not {size[0]}x{size[1]}x3 as depth.exr is"
        raise InputError("wrong-size", problem, "write RGB of the size of the depth", path=path)
    return torch.from_numpy(color.pixels.transpose(2, 0, 1).copy())
