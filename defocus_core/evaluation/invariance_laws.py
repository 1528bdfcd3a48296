"""Laws of invariance: tiles, threads, rounding and the device do not change a picture."""

from __future__ import annotations

import torch

from defocus_core.evaluation import law_probes as probes
from defocus_core.evaluation.law_checks import Check, Setting, greatest, pictures, rendered
from defocus_core.evaluation.law_probes import Probe


def tiles(setting: Setting) -> list[Check]:
    """Tiles leave no seam: a picture is the same where it is part of a larger one.

    Pixels with content invented behind edges are left out: it continues all of the visible picture.
    """
    # px; the border is wider than the blur reaches
    whole, size, (top, left), border = (320, 384), (192, 256), (64, 64), 60
    rows, columns = slice(top, top + size[0]), slice(left, left + size[1])
    off = []
    for radius in (probes.slope(whole), probes.strips(whole)):
        large = Probe(probes.waves(whole), radius)
        part = Probe(large.image[:, rows, columns], radius[rows, columns])
        one, other = (rendered(scene, setting, torch.float32) for scene in (part, large))
        observed = one.trust > 1 - 1e-5
        for a, b in zip(pictures(one), pictures(other), strict=True):
            seam = (a - b[:, rows, columns]) * observed
            off.append(probes.worst(seam[:, border:-border, border:-border]))
    return [Check("tiles", "part of a larger picture, difference", "-", greatest(off), 2e-6)]


def same_bytes(setting: Setting) -> list[Check]:
    """Threads, and whether left and right are rendered too, change no byte of the centre."""
    size = (200, 210)  # four tiles
    threads, outputs = 0.0, 0.0
    for scene in (Probe(probes.waves(size), probes.slope(size)), probes.card(-7.0, 5.0, size=size)):
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
    """Rounding decides nothing, neither in the renderer nor in its input.

    The renderer compares numbers that are often equal, like depth in levels, to find the surfaces
    beside and behind a pixel. If last bits decided, other devices would render other pictures.
    """
    precision: list[float] = []
    inputs: list[float] = []
    for image, radius in probes.scenes():
        scene = Probe(image.float(), radius.float())
        single, changed = (
            pictures(rendered(each, setting, torch.float32))
            for each in (scene, Probe(*map(probes.rounded, scene)))
        )
        double = pictures(rendered(scene, setting, torch.float64))
        for off, others in ((precision, double), (inputs, changed)):
            off += [probes.worst_relative(a - b, b) for a, b in zip(single, others, strict=True)]
    measured = "float32 off float64, of the local maximum"
    return [
        Check("rounding", measured, "-", greatest(precision), 2e-5),
        Check("rounding", "last bits of the input, likewise", "-", greatest(inputs), 2e-5),
    ]


def devices(setting: Setting) -> list[Check]:
    """The CPU and the GPU render the same picture; without a GPU there is nothing to compare."""
    off: list[float] = []
    host = Setting("cpu", setting.quality, setting.threads)
    for scene in probes.scenes() if setting.device != "cpu" else []:
        on_device, on_cpu = (pictures(rendered(scene, s, torch.float32)) for s in (setting, host))
        off += [
            probes.worst_relative(a.cpu() - b, b) for a, b in zip(on_device, on_cpu, strict=True)
        ]
    value = greatest(off) if off else None
    return [Check("CPU and GPU", "difference, of the local maximum", "-", value, 1e-4)]
