"""Laws of invariance: flips, tiles, threads and batches do not change a picture.

Where it is cut into tiles, what computes it, how it is rounded, and what else is asked for.
"""

from __future__ import annotations

import torch

from defocus_core.evaluation.law_checks import Check, Setting, greatest, pictures, rendered
from defocus_core.evaluation.law_probes import (
    Scene,
    card,
    rounded,
    scenes,
    slope,
    strips,
    waves,
    worst,
    worst_relative,
)


def tiles(setting: Setting) -> list[Check]:
    """Tiles leave no seam: a picture is the same where it is part of a larger one.

    But for what is invented behind edges, which continues all that is seen.
    """
    # px; the border is beyond all reach
    whole, size, (top, left), border = (320, 384), (192, 256), (64, 64), 60
    rows, columns = slice(top, top + size[0]), slice(left, left + size[1])
    off = []
    for radius in (slope(whole), strips(whole)):
        large = Scene(waves(whole), radius)
        part = Scene(large.image[:, rows, columns], radius[rows, columns])
        one, other = (rendered(scene, setting, torch.float32) for scene in (part, large))
        observed = one.trust > 1 - 1e-5
        for a, b in zip(pictures(one), pictures(other), strict=True):
            seam = (a - b[:, rows, columns]) * observed
            off.append(worst(seam[:, border:-border, border:-border]))
    return [Check("tiles", "part of a larger picture, difference", "-", greatest(off), 2e-6)]


def same_bytes(setting: Setting) -> list[Check]:
    """Threads, and whether left and right are asked for, change no byte of the centre."""
    size = (200, 210)  # four tiles
    threads, outputs = 0.0, 0.0
    for scene in (Scene(waves(size), slope(size)), card(-7.0, 5.0, size=size)):
        one = rendered(scene, setting, torch.float32, threads=1)
        two = rendered(scene, setting, torch.float32, threads=2)
        alone = rendered(scene, setting, torch.float32, left_right=False)
        for a, b in zip(pictures(one), pictures(two), strict=True):
            threads += float((a != b).sum())
        outputs += float((one.render != alone.render).sum())
    return [
        Check("same bytes", "1 and 2 threads, values that differ", "count", threads, 0.0),
        Check("same bytes", "with and without left, right", "count", outputs, 0.0),
    ]


def rounding(setting: Setting) -> list[Check]:
    """Rounding decides nothing: neither that of the renderer nor that of what it is given.

    Which surface is beside, behind or alike is asked of numbers that are often equal, as of depth
    in levels: a picture that hung on their last bits would be another one on another device.
    """
    precision: list[float] = []
    given: list[float] = []
    for image, radius in scenes():
        scene = Scene(image.float(), radius.float())
        single, changed = (
            pictures(rendered(each, setting, torch.float32))
            for each in (scene, Scene(*map(rounded, scene)))
        )
        double = pictures(rendered(scene, setting, torch.float64))
        for off, others in ((precision, double), (given, changed)):
            off += [worst_relative(a - b, b) for a, b in zip(single, others, strict=True)]
    return [
        Check(
            "rounding", "float32 off float64, of the local maximum", "-", greatest(precision), 2e-5
        ),
        Check("rounding", "last bits of what is given, likewise", "-", greatest(given), 2e-5),
    ]


def devices(setting: Setting) -> list[Check]:
    """The CPU and the GPU render the same picture; without a GPU there is nothing to compare."""
    off: list[float] = []
    host = Setting("cpu", setting.quality, setting.threads)
    for scene in scenes() if setting.device != "cpu" else []:
        there, here = (pictures(rendered(scene, s, torch.float32)) for s in (setting, host))
        off += [worst_relative(a.cpu() - b, b) for a, b in zip(there, here, strict=True)]
    value = greatest(off) if off else None
    return [Check("CPU and GPU", "difference, of the local maximum", "-", value, 1e-4)]
