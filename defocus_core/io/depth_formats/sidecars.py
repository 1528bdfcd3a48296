"""Files beside a depth file that hold a part of its rule: calibration, cameras, masks.

For HEIC and GDepth the metadata in the depth file itself takes the place of a sidecar.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from defocus_core.errors import InputError, reason
from defocus_core.io.depth_formats.reading import DepthNumbers, Mark
from defocus_core.io.depth_formats.table import DepthFormat, Mask
from defocus_core.io.images.raster import choose_page, read_pages, read_samples
from defocus_core.io.read_files import MALFORMED, decoding, read_plain

_LONGEST = 1 << 20  # bytes of a sidecar
_CHECK = "check the file"

Found = Mapping[str, Any]  # fields of a `DepthFormat`


def with_sidecar(row: DepthFormat, samples: DepthNumbers) -> DepthFormat:
    """A format completed by the sidecar of a depth file; unchanged if there is none."""
    place = _sidecar(row, samples.path)
    if place is None:
        return row
    try:
        read, _ = _SIDECARS[row.sidecar]
        return replace(row, **read(place, samples))
    except (OSError, *MALFORMED) as error:  # the file has other content
        problem = f"lacks what {samples.path.name} needs of it ({reason(error)})"
        raise InputError("malformed", problem, _CHECK, path=place) from None


def _text(path: Path) -> str:
    return read_plain(path, _LONGEST).decode("utf-8", "replace")


def _calib(place: Path, _: DepthNumbers) -> Found:
    """The fields that Middlebury's calibration gives.

    Its lines are ``cam0=[f 0 cx; 0 f cy; 0 0 1]`` and ``doffs=`` in px, ``baseline=`` in mm.
    """
    lines = dict(line.split("=", 1) for line in _text(place).splitlines() if "=" in line)
    focal, baseline = float(lines["cam0"].strip(" []").split()[0]), float(lines["baseline"]) / 1000
    focal, baseline, doffs = _positive(focal), _positive(baseline), float(lines.get("doffs", 0))
    return {"words": place.name, "focal_px": focal, "baseline": baseline, "shift": doffs}


def _scene_camera(place: Path, samples: DepthNumbers) -> Found:
    """The fields that BOP's cameras give: ``{"IMAGE": {"depth_scale": MM}}``.

    IMAGE is the number of the image, MM the millimetres per unit.
    """
    scale = _positive(float(json.loads(_text(place))[str(int(samples.path.stem))]["depth_scale"]))
    return {"words": f"{scale:g} mm by {place.name}", "scale": scale / 1000}


def _heic(_: Path, samples: DepthNumbers) -> Found:
    """The fields that the metadata of a HEIC photograph gives.

    By ``representation_type``, numbers are linear in 1/z from far to near (0), in disparity in 1/m
    (1), or in z (2).
    """
    metadata = samples.metadata
    kind = int(metadata.get("representation_type", 1))
    if kind not in (0, 1, 2):
        raise ValueError(f"representation_type {kind}, which is none of 0, 1 and 2")
    if kind == 1:
        ends = float(metadata["d_min"]), float(metadata["d_max"])
        return {"words": "d_min and d_max", "rule": "per-metre", "ends": ends}
    near, far = (_positive(float(metadata[key])) for key in ("z_near", "z_far"))
    if kind == 2:
        return {"words": "z_near and z_far", "rule": "scale", "ends": (near, far)}
    return {"words": "z_near and z_far", "rule": "per-metre", "ends": (1 / far, 1 / near)}


def _gdepth(_: Path, samples: DepthNumbers) -> Found:
    """The fields that the properties of GDepth give.

    In the format RangeInverse, numbers are linear in 1/z, in RangeLinear in z; Near and Far are in
    m or mm.
    """
    metadata = samples.metadata
    unit = {"m": 1.0, "mm": 1e-3}[str(metadata["Units"])]
    near, far = (_positive(float(metadata[key]) * unit) for key in ("Near", "Far"))
    rule, ends = {
        "RangeInverse": ("per-metre", (1 / near, 1 / far)),
        "RangeLinear": ("scale", (near, far)),
    }[metadata["Format"]]
    geometry = "radial" if metadata.get("MeasureType") == "OpticRay" else "planar"
    words = f"GDepth {metadata['Format']}"
    return {"words": words, "rule": rule, "ends": ends, "geometry": geometry}


def _positive(value: float) -> float:
    if not 0 < value < math.inf:
        raise ValueError(f"{value:g} is not positive")
    return value


# By name: the function that reads a sidecar, given its path and the numbers of the depth file, and
# the paths where it may lie, relative to that file's folder; none if it is the file's own metadata.
_SIDECARS: dict[str, tuple[Callable[[Path, DepthNumbers], Found], tuple[str, ...]]] = {
    "calib.txt": (_calib, ("calib.txt",)),
    "scene_camera.json": (_scene_camera, ("scene_camera.json", "../scene_camera.json")),
    "heic": (_heic, ()),
    "gdepth": (_gdepth, ()),
}


def _found(places: tuple[str, ...], path: Path) -> Path | None:
    """The first existing file of some paths relative to a depth file; None if there is none.

    In `places`, ``{stem}`` is the stem of the depth file and ``{folder}`` the name of its folder.
    """
    words = {"stem": path.stem, "folder": path.parent.name}
    files = (path.parent / template.format(**words) for template in places)
    return next((file for file in files if file.is_file() and file != path), None)


def _sidecar(row: DepthFormat, path: Path) -> Path | None:
    """The file that holds the data of a depth file's sidecar; None if there is none.

    This may be the depth file itself, if its metadata take the place of a sidecar.
    """
    _, places = _SIDECARS[row.sidecar]
    return _found(places, path) if places else path


def files_beside(row: DepthFormat, path: Path) -> dict[str, Path]:
    """The sidecar and the mask of a depth file, by the keys ``depth_sidecar`` and ``depth_mask``.

    A file that does not exist has no key.
    """
    sidecar = _sidecar(row, path) if row.sidecar else None
    mask = _found(row.mask.places, path) if row.mask is not None else None
    files = {"depth_sidecar": sidecar, "depth_mask": mask}
    return {role: file for role, file in files.items() if file not in (None, path)}


def mask_beside(mask: Mask, path: Path, shape: tuple[int, int]) -> Mark:
    """The pixels of `shape` (height, width) that the mask file of a depth file marks as invalid.

    Without such a file none are marked.
    """
    place = _found(mask.places, path)
    if place is None:
        return Mark(np.broadcast_to(np.False_, shape), math.nan, "no mask beside it")
    if place.suffix == ".npy":
        with decoding(place):
            values = np.load(place, mmap_mode="r", allow_pickle=False)
            values = values.reshape(values.shape[:2])
    else:
        values = read_samples(place, choose_page(place, read_pages(place), None).page)[:, :, 0]
    if values.shape != shape:
        sizes = [f"{'x'.join(map(str, each[::-1]))} px" for each in (values.shape, shape)]
        problem = f"is {sizes[0]} and {path} is {sizes[1]}"
        raise InputError("wrong-size", problem, _CHECK, path=place)
    words = f"mask {place.name}"
    return Mark((values == 0) == mask.zeros, math.nan, words)
