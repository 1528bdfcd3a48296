"""Thin-lens defocus of RGB-D images, as a library: pictures in files, batches, and their rendering.

Lengths are in mm, the depth of files in metres, CoC radii in px, signed: negative nearer than
focus, positive beyond. The import is light: the module of a name, and torch if that module
computes, is imported when the name is first used.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from defocus_core import gone

if TYPE_CHECKING:  # for type checkers and editors; a test compares it with the table below
    from defocus_core.batch.datasets.finished import samples as samples
    from defocus_core.batch.datasets.torch_dataset import BatchDataset as BatchDataset
    from defocus_core.batch.datasets.torch_dataset import decode_sample as decode_sample
    from defocus_core.batch.run_batch import batch_jobs as batch_jobs
    from defocus_core.batch.run_batch import run_batch as run_batch
    from defocus_core.compare.comparison import compare_images as compare_images
    from defocus_core.depth.guided_resize import GuidedDepth as GuidedDepth
    from defocus_core.depth.guided_resize import guided_depth as guided_depth
    from defocus_core.depth.ramps import (
        radius_from_relative_disparity as radius_from_relative_disparity,
    )
    from defocus_core.depth.repair import repair_depth as repair_depth
    from defocus_core.errors import DefocusError as DefocusError
    from defocus_core.errors import InputError as InputError
    from defocus_core.errors import UsageProblem as UsageProblem
    from defocus_core.fitting.pair import fit as fit
    from defocus_core.io.picture_files import read_color as read_color
    from defocus_core.io.picture_files import read_depth as read_depth
    from defocus_core.io.picture_files import write_image as write_image
    from defocus_core.io.picture_files import write_map as write_map
    from defocus_core.optics.aperture import Aperture as Aperture
    from defocus_core.optics.cat_eye import CatEye as CatEye
    from defocus_core.optics.distributions import Distribution as Distribution
    from defocus_core.optics.dual_pixel import DualPixel as DualPixel
    from defocus_core.optics.outline import PupilImage as PupilImage
    from defocus_core.optics.parts import sensitivities as sensitivities
    from defocus_core.optics.sensor_noise import with_noise as with_noise
    from defocus_core.picture.door import Lens as Lens
    from defocus_core.picture.door import Picture as Picture
    from defocus_core.picture.door import Views as Views
    from defocus_core.picture.door import read as read
    from defocus_core.picture.door import render as render
    from defocus_core.renderer.defocus_lens import DefocusLens as DefocusLens
    from defocus_core.renderer.layers.layer import HiddenLayer as HiddenLayer
    from defocus_core.renderer.random_defocus import RandomDefocus as RandomDefocus
    from defocus_core.renderer.render import render_layers as render_layers
    from defocus_core.renderer.samples import mirrored as mirrored
    from defocus_core.tensors.clipped_lights import with_lights as with_lights

# The public names of each module, in groups.
_GROUPS = {
    "pictures": {"picture.door": "read Picture Lens render Views"},
    "lens and rendering of tensors": {
        "renderer.defocus_lens": "DefocusLens",
        "renderer.render": "render_layers",
        "renderer.layers.layer": "HiddenLayer",
        "optics.aperture": "Aperture",
        "optics.cat_eye": "CatEye",
        "optics.dual_pixel": "DualPixel",
        "optics.outline": "PupilImage",
        "optics.parts": "sensitivities",
        "optics.sensor_noise": "with_noise",
        "tensors.clipped_lights": "with_lights",
    },
    "depth": {
        "depth.ramps": "radius_from_relative_disparity",
        "depth.guided_resize": "guided_depth GuidedDepth",
        "depth.repair": "repair_depth",
    },
    "training": {
        "optics.distributions": "Distribution",
        "renderer.random_defocus": "RandomDefocus",
        "renderer.samples": "mirrored",
        "batch.datasets.torch_dataset": "BatchDataset decode_sample",
    },
    "files": {
        "io.picture_files": "read_color read_depth write_image write_map",
        "errors": "DefocusError InputError UsageProblem",
    },
    "batches": {"batch.run_batch": "batch_jobs run_batch", "batch.datasets.finished": "samples"},
    "comparison and fits": {"compare.comparison": "compare_images", "fitting.pair": "fit"},
}
_MODULE_OF = {
    name: module
    for modules in _GROUPS.values()
    for module, names in modules.items()
    for name in names.split()
}


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})


if not TYPE_CHECKING:  # type checkers know all names from the imports above
    __all__ = sorted(_MODULE_OF)

    def __getattr__(name: str) -> Any:
        """Import the module of a name that is used for the first time."""
        if name not in _MODULE_OF:
            words = f"module {__name__!r} has no attribute {name!r}"
            remedy = gone.remedy("python", name)
            # ``from defocus_core import NAME`` would replace the words of an AttributeError
            is_import = sys._getframe(1).f_code.co_name == "_handle_fromlist"
            raise (ImportError if remedy and is_import else AttributeError)(
                f"{words}; {remedy}" if remedy else words
            )
        path = f"{__name__}.{_MODULE_OF[name]}"
        module = import_module(path)
        value = getattr(module, name) if hasattr(module, name) else import_module(f"{path}.{name}")
        globals()[name] = value
        return value
