"""Sets of scenes with known truth, and the decoded pictures of their shots.

Each directory ``SCENE`` of a set holds ``camera.json``, ``rgb.exr``, ``depth.exr`` and, for each
shot of the camera, ``truth_<shot>.exr``, the true photograph of the scene by a thin lens.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from defocus_core.errors import InputError, UsageProblem, cannot_read, reason
from defocus_core.io.images.color import read_color
from defocus_core.io.read_files import MALFORMED, read_plain
from defocus_core.picture.lens_fit import light_of
from defocus_core.picture.pair import read as read_pair
from defocus_core.picture.radii import radii_of
from defocus_core.picture.take import InputPair
from defocus_core.request.job import PictureFiles, Reading
from defocus_core.request.lens import LensValues

if TYPE_CHECKING:
    from torch import Tensor

BLADES = {"disk": 0, "hexagon": 6}
MIN_INNER = 11  # least side in px of a picture without its border, which SSIM needs


@dataclass(frozen=True)
class TruthShot:
    """A photograph of a scene in a set."""

    folder: Path  # folder of the scene
    name: str  # name of the shot
    lens: LensValues  # lens of the shot
    border: int  # px at each side that may show content from outside the frame


class Pictures(NamedTuple):
    """The decoded pictures of a shot."""

    sharp: Tensor  # [3, H, W], linear
    truth: Tensor  # [3, H, W], linear
    signed_radius: Tensor  # [H, W] px
    infinity: float  # signed radius in px at infinity


def sample_set() -> Path:
    """The folder `sample_scenes` in the current directory, the root of the repository."""
    scenes = Path("sample_scenes").absolute()
    if any(scenes.glob("*/camera.json")):
        return scenes
    problem = "is missing, and the sample scenes are not part of an installed package"
    remedy = "name a directory of <scene>/camera.json"
    raise UsageProblem("missing-option", problem, remedy, field="truth")


def find_shots(root: Path) -> list[TruthShot]:
    """All shots of a set, sorted by the name of the scene; an InputError if there are none."""
    shots = [shot for camera in sorted(root.glob("*/camera.json")) for shot in _shots(camera)]
    if not shots:
        problem, remedy = "holds no <scene>/camera.json with shots", "name a directory of scenes"
        raise InputError("empty", problem, remedy, path=root)
    return shots


def _shots(file: Path) -> list[TruthShot]:
    try:
        camera: dict[str, Any] = json.loads(read_plain(file))
        shots = [_shot(file.parent, camera, shot) for shot in camera["shots"]]
    except OSError as error:
        raise cannot_read(file, error, "check it") from error
    except MALFORMED as error:
        problem = f"does not describe a camera ({type(error).__name__}: {reason(error)})"
        remedy = "compare it with those of sample_scenes"
        raise InputError("malformed", problem, remedy, path=file) from error
    for shot in shots:
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
    """Decode the pictures of a shot."""
    import torch

    files = PictureFiles(shot.name, shot.folder / "rgb.exr", shot.folder / "depth.exr")
    color, depth = read_pair(InputPair(files, Reading()))
    truth = read_color(shot.folder / f"truth_{shot.name}.exr")
    radii = radii_of(shot.lens, depth)
    assert radii.infinity is not None
    px = torch.from_numpy(radii.px)
    return Pictures(light_of(color), light_of(truth, color), px, radii.infinity)
