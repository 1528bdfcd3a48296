"""A random lens for each picture of a batch: data augmentation that obeys the laws of the lens.

The lens of a sample depends only on its seed and its depth, not on the batch, the device or the
process. Lengths are in mm, radii in px.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from operator import index
from typing import Any, NamedTuple, overload

import torch
from torch import Tensor

from defocus_core.gone import remedy
from defocus_core.optics.aperture import Aperture
from defocus_core.optics.cat_eye import CatEye
from defocus_core.optics.distributions import ATTEMPTS, Distribution, drawn, percentile_rank
from defocus_core.optics.dual_pixel import DualPixel
from defocus_core.optics.sensor_noise import with_noise
from defocus_core.optics.thin_lens import radii_of_each
from defocus_core.renderer.compiled.alone import views_alone
from defocus_core.renderer.defocus_lens import DEPTH_UNITS, DefocusLens
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.engine.scene import Surface
from defocus_core.renderer.engine.settings import Settings
from defocus_core.renderer.samples import Sample, planes_of, restored
from defocus_core.tensors.device_plan import launches_cost
from defocus_core.tensors.threads import graph_break, own_modes, threaded
from defocus_core.tensors.validation import (
    bad_depth,
    depth_maps,
    described,
    number,
    one_of,
    positive,
)
from defocus_core.tensors.views import ViewTensors, batch, no_pictures

Option = float | Distribution


def _shape(name: str, value: Any) -> object:
    return Aperture(6, **{name: value})


def _positive(unit: str) -> Callable[[str, Any], object]:
    return lambda name, value: positive(name, value, f"{unit}, or a Distribution")


def _radii(name: str, value: Any) -> object:
    return number(name, value, "in radii of the pupil, or a Distribution")


_mm, _count = _positive("in mm"), _positive("without a unit")
_electrons = _positive("in electrons")


def _read_noise(name: str, value: Any) -> None:
    if not number(name, value, "in electrons, or a Distribution") >= 0:
        raise ValueError(f"{name} must be 0 or more electrons, got {value}; 0 is none")


class DrawnOption(NamedTuple):
    """An option of a lens that may be drawn at random."""

    default: Option
    check: Callable[[str, Any], object]  # raises ValueError for a value that is not allowed


# By name, in the order of `Lenses`, which says what they are.
OPTIONS: Mapping[str, DrawnOption] = {
    "foclen": DrawnOption(Distribution("loguniform", (24.0, 85.0)), _mm),
    "fnum": DrawnOption(Distribution("loguniform", (1.4, 16.0)), _count),
    "foc_dist": DrawnOption(
        Distribution("percentile", (5.0, 95.0)),
        lambda name, value: value == math.inf or _mm(name, value),
    ),
    "blades": DrawnOption(
        Distribution("choice", (0, 5, 6, 7, 8, 9)), lambda _, value: Aperture(value)
    ),
    "blade_rotation": DrawnOption(
        Distribution("uniform", (0.0, 360.0)),
        lambda name, value: number(name, value, "in degrees, or a Distribution"),
    ),
    "sensor_width": DrawnOption(36.0, _mm),
    "curvature": DrawnOption(0.0, _shape),
    "obstruction": DrawnOption(0.0, _shape),
    "spherical": DrawnOption(0.0, _shape),
    "squeeze": DrawnOption(1.0, _shape),
    "cat_eye_size": DrawnOption(1.0, _radii),
    "cat_eye_shift": DrawnOption(0.0, _radii),
    "crosstalk": DrawnOption(0.0, lambda _, value: DualPixel(crosstalk=value)),
    "electrons": DrawnOption(
        math.inf, lambda name, value: value == math.inf or _electrons(name, value)
    ),
    "read_noise": DrawnOption(0.0, _read_noise),
}
_SHAPES = tuple(name for name, row in OPTIONS.items() if row.check is _shape)


def check_option(name: str, option: Option) -> None:
    """Raise ValueError if an option of a lens may take a value that is not allowed."""
    kind = option.kind if isinstance(option, Distribution) else "number"
    if kind in ("disparity", "percentile") and name != "foc_dist":
        raise ValueError(f"{name} must not be drawn from a {kind}; it is for foc_dist only")
    if name == "blades" and kind not in ("number", "choice"):
        raise ValueError(f"blades must be whole numbers, got {option}; draw them by choice")
    for value in () if kind == "percentile" else _values(option):
        OPTIONS[name].check(name, value)


def check_rim(size: Option, shift: Option) -> None:
    """Raise ValueError if a rim that may be drawn hides the middle of the pupil.

    `size`, `shift`: the options `cat_eye_size` and `cat_eye_shift`.
    """
    sizes, shifts = ([float(value) for value in _values(option)] for option in (size, shift))
    CatEye(min(sizes), max(shifts))


def _values(option: Option) -> tuple[Any, ...]:
    """The ends of the range of an option, the values of a choice, or the one fixed value."""
    return option.values if isinstance(option, Distribution) else (option,)


def aperture_with(options: dict[str, Any]) -> Aperture:
    """The pupil that drawn options describe."""
    shape = {name: options[name] for name in _SHAPES}
    return Aperture(options["blades"], options["blade_rotation"], **shape)


def rim_with(options: dict[str, Any]) -> CatEye | None:
    """The rim of the barrel that drawn options describe; None if it clips nothing."""
    size, shift = options["cat_eye_size"], options["cat_eye_shift"]
    return None if size >= 1 + shift else CatEye(size, shift)


def lens_with(options: dict[str, Any], size: torch.Size) -> DefocusLens:
    """The lens that drawn options describe, on a sensor of `size` (height, width) px."""
    height, width = size
    sensor = (options["sensor_width"], options["sensor_width"] * height / width)
    lens = DefocusLens(options["foclen"], options["fnum"], sensor, (width, height), "cpu")
    lens.refocus(options["foc_dist"])
    return lens


class Lenses(NamedTuple):
    """The lenses that `RandomDefocus` drew; values are [B] on the CPU, in float64.

    Attributes:
        signed_radius: CoC radii in px, [B, 1, H, W].
        foclen: Focal lengths in mm.
        fnum: F-numbers.
        foc_dist: Distances in focus in mm, inf where all is sky.
        blades: Numbers of blades of the aperture, 0 for a round one.
        blade_rotation: Angle of one vertex of the blades in degrees.
        sensor_width: Widths of the sensor in mm.
        curvature: Curvatures of the blades, 0 for straight ones.
        obstruction: Radius of an opaque disc in the middle, in radii of the pupil.
        spherical: Spherical aberration to first order, see `Aperture`.
        squeeze: How many times the pupil is taller than wide.
        cat_eye_size: Radii of the rim of the barrel, in radii of the pupil.
        cat_eye_shift: Distance of the rim from the pupil in the corners, in radii of the pupil.
        crosstalk: Shares of the light of a photodiode that go to the other one.
        electrons: Mean numbers of electrons for a light of 1; inf without noise.
        read_noise: Standard deviations of the read noise, in electrons.
    """

    signed_radius: Tensor
    foclen: Tensor
    fnum: Tensor
    foc_dist: Tensor
    blades: Tensor
    blade_rotation: Tensor
    sensor_width: Tensor
    curvature: Tensor
    obstruction: Tensor
    spherical: Tensor
    squeeze: Tensor
    cat_eye_size: Tensor
    cat_eye_shift: Tensor
    crosstalk: Tensor
    electrons: Tensor
    read_noise: Tensor


class RandomDefocus(torch.nn.Module):
    """Defocuses each picture of a batch with a lens of its own, drawn by a seed.

    The attributes are the arguments, and may be changed later, as for a curriculum. Gradients flow
    to image and depth.
    """

    def __init__(
        self,
        *,
        max_radius: float | None = None,
        left_right: bool = False,
        quality: str = "standard",
        depth_repair: str = "auto",
        threads: int = 1,
        depth_unit: str = "mm",
        **options: Option,
    ) -> None:
        """Set the options that lenses are drawn from.

        Args:
            max_radius: Greatest radius of the blur in px: a lens that exceeds it is drawn again.
                None for no bound.
            left_right: Whether to return the dual-pixel pair too.
            quality: As for `render`.
            depth_repair: As for `render`.
            threads: As for `render`.
            depth_unit: "mm" or "m", the unit of the depth of pictures; all other lengths are in mm.
            **options: Options of the lens, with the names of the attributes of `Lenses`. Each is a
                number or a `Distribution`, which must be a "choice" for `blades`. `foc_dist` may be
                drawn in "disparity", or from a "percentile" of the depth that is not sky. Defaults
                are in `OPTIONS`: focal lengths of 24 to 85 mm, f/1.4 to f/16, 0 to 9 blades, a
                focus on the depth, and none of the other effects.

        Raises:
            ValueError: If a distribution or a value is out of its range.
            TypeError: If an option has an unknown name.
        """
        super().__init__()
        if unknown := options.keys() - OPTIONS.keys():
            name = min(unknown)
            instead = remedy("python", name, "RandomDefocus", f"choose from {', '.join(OPTIONS)}")
            raise TypeError(f"RandomDefocus() has no option {name}; {instead}")
        for name, row in OPTIONS.items():
            setattr(self, name, options.get(name, row.default))
        self.max_radius = max_radius
        self.left_right = left_right
        self.quality = quality
        self.depth_repair = depth_repair
        self.threads = threads
        self.depth_unit = depth_unit
        self._check()

    def _check(self) -> None:
        """Check all options, which may have been changed since they were given."""
        for name in OPTIONS:
            check_option(name, getattr(self, name))
        check_rim(*(getattr(self, name) for name in ("cat_eye_size", "cat_eye_shift")))
        one_of("depth_unit", self.depth_unit, tuple(DEPTH_UNITS))
        if self.max_radius is not None:
            self.max_radius = positive("max_radius", self.max_radius, "None is no bound")
        Settings(
            quality=self.quality,
            left_right=self.left_right,
            threads=self.threads,
            depth_repair=self.depth_repair,
        )

    def extra_repr(self) -> str:
        """The options by name, for the module's repr."""
        others = ("max_radius", "left_right", "quality", "depth_repair", "threads", "depth_unit")
        names = (*OPTIONS, *others)
        return ", ".join(f"{name}={getattr(self, name)!r}" for name in names)

    @overload
    def forward(self, image: Mapping[str, Any]) -> Sample: ...

    @overload
    def forward(
        self, image: Tensor, depth: Tensor, seeds: Sequence[int] | Tensor | torch.Generator
    ) -> tuple[ViewTensors, Lenses]: ...

    @graph_break
    def forward(
        self,
        image: Tensor | Mapping[str, Any],
        depth: Tensor | None = None,
        seeds: Sequence[int] | Tensor | torch.Generator = (),
    ) -> tuple[ViewTensors, Lenses] | Sample:
        """Defocus a batch of pictures, or one sample of a data set.

        Args:
            image: [B, C, H, W], scene-linear. Or a sample: a mapping with ``image`` and ``depth``,
                which are tensors, those of torchvision, or arrays, and with ``seed``, which is
                drawn from torch's generator if it is absent.
            depth: [B, 1, H, W] or [B, H, W], planar depth, > 0, inf for the sky.
            seeds: A whole number for each picture, or a generator to draw them from.

        Returns:
            The views of the pictures, and their lenses. For a sample, a sample with ``image``
            defocused, and with these entries added: ``left`` and ``right``, if wanted; ``coc``, the
            signed radius; and ``lens``, the options of the lens by name. All other entries are
            unchanged.

        Raises:
            ValueError: If shapes disagree, a depth is NaN or not positive, or no lens drawn for a
                picture suits it: the focus is too near, or the blur exceeds `max_radius`.
        """
        self._check()
        if isinstance(image, Mapping):
            return self._transformed(image)
        if depth is None:
            raise ValueError("depth must be a tensor beside image, got None; or give one sample")
        with own_modes(image.device):
            return self._defocused(image, depth, seeds)

    def _transformed(self, sample: Mapping[str, Any]) -> Sample:
        """Defocus a sample of a data set, see `forward`."""
        if not sample.keys() >= {"image", "depth"}:
            wanted = "a sample must have image and depth"
            raise ValueError(f"{wanted}, got {', '.join(map(str, sample))}; rename its entries")
        given, depth, seed = sample["image"], sample["depth"], sample.get("seed")
        image, maps = planes_of("image", given), planes_of("depth", depth)
        seed = int(torch.randint(2**63 - 1, ()) if seed is None else seed)
        with own_modes(image.device):
            views, lenses = self._defocused(image[None], maps[None], [seed])
        names = ("image", "left", "right")
        made = {n: restored(given, one[0]) for n, one in zip(names, views.images, strict=False)}
        lens = {name: float(getattr(lenses, name)) for name in OPTIONS}
        return {**sample, **made, "coc": restored(depth, lenses.signed_radius[0]), "lens": lens}

    def _defocused(
        self, image: Tensor, depth: Tensor, seeds: Sequence[int] | Tensor | torch.Generator
    ) -> tuple[ViewTensors, Lenses]:
        """`forward` for a batch, with options that are already checked."""
        maps = depth_maps(image, depth, torch.float32, image.device) * DEPTH_UNITS[self.depth_unit]
        seeds = _seeds(seeds, len(image))
        drawings = self._draw(maps, seeds)
        radii, views = maps, no_pictures(image, 3 if self.left_right else 1)
        if drawings:
            radii = radii_of_each([drawing.lens for drawing in drawings], maps)
            count = 1 if launches_cost(maps.device) else min(self.threads, len(drawings))
            settings = [self._settings(drawing, self.threads // count) for drawing in drawings]
            every = list(zip(image, radii, settings, strict=True))
            views = batch(list(threaded(_defocused_alone, every, count)))
            views = views._replace(images=_with_noise(views.images, drawings, seeds))
        columns = {
            name: torch.tensor(
                [options[name] for options, _ in drawings], dtype=torch.float64, device="cpu"
            )
            for name in OPTIONS
        }
        return views, Lenses(radii[:, None], **columns)

    def _settings(self, drawing: _Drawing, threads: int) -> Settings:
        """The settings to render a picture with a drawn lens, in `threads` threads."""
        options, lens = drawing
        return Settings(
            aperture=aperture_with(options),
            dual_pixel=DualPixel(crosstalk=options["crosstalk"]),
            cat_eye=rim_with(options),
            quality=self.quality,
            left_right=self.left_right,
            threads=threads,
            infinity=lens.radius_at_infinity(),
            depth_repair=self.depth_repair,
        )

    def _draw(self, maps: Tensor, seeds: list[int]) -> list[_Drawing]:
        """For each of the depth maps [B, H, W], the first lens drawn by its seed that suits it."""
        choices = {name: getattr(self, name) for name in OPTIONS}
        depth, size = maps.detach().flatten(1), maps.shape[1:]
        known = depth.amin(1), depth.amax(1), torch.isfinite(depth).sum(1)
        extremes = torch.stack([values.double() for values in known], 1).tolist()
        if not all(nearest > 0 for nearest, *_ in extremes):
            raise bad_depth("depth", maps, maps > 0, "positive")
        by_percent = getattr(self.foc_dist, "kind", "") == "percentile"
        ascending = depth.sort(1).values if by_percent else depth
        drawings = []
        for seed, (*ends, count), ranked in zip(seeds, extremes, ascending, strict=True):
            for attempt in range(ATTEMPTS):
                options = drawn(choices, seed, attempt)
                if by_percent:
                    rank = percentile_rank(options["foc_dist"], max(round(count), 1))
                    options["foc_dist"] = float(ranked[rank - 1])
                drawing = self._suited(options, ends, size)
                if isinstance(drawing, _Drawing):
                    drawings.append(drawing)
                    break
            else:
                raise ValueError(
                    f"{drawing} with the last of {ATTEMPTS} lenses drawn for seed {seed}; check "
                    f"that depth is in {self.depth_unit}, or change max_radius, foclen or fnum of "
                    f"{self.extra_repr()}"
                )
        return drawings

    def _suited(
        self, options: dict[str, Any], extremes: list[float], size: torch.Size
    ) -> _Drawing | str:
        """The lens that drawn options describe, or the reason why it does not suit a depth map.

        `extremes`: least and greatest depth in mm; `size`: (height, width) in px.
        """
        if not options["blades"]:
            options["curvature"] = 0.0
        if not options["foc_dist"] > options["foclen"]:
            return (
                "depth must be farther in focus than the focal length, got "
                f"{options['foc_dist']:g} mm for {options['foclen']:g} mm"
            )
        lens = lens_with(options, size)
        limits = torch.tensor(extremes, dtype=torch.float64, device="cpu")
        radius = float(lens.signed_radius(limits).abs().max())
        if self.max_radius is None or radius <= self.max_radius:
            return _Drawing(options, lens)
        return f"max_radius must allow some lens, got {self.max_radius:g} for {radius:g} px"


def _with_noise(
    images: Sequence[Tensor], drawings: Sequence[_Drawing], seeds: Sequence[int]
) -> list[Tensor]:
    """Views [B, C, H, W] with the noise of their lenses added; noise has no gradient."""
    noisy = [*images]
    for place, ((options, _), seed) in enumerate(zip(drawings, seeds, strict=True)):
        if options["electrons"] == math.inf:
            continue
        for view, image in enumerate(images):
            light = image[place].detach()
            electrons = options["electrons"] / (2 if view else 1)  # a photodiode has half of them
            own = with_noise(
                light,
                electrons=electrons,
                read=options["read_noise"],
                seed=(3 * seed + view) % 2**63,
            )
            noise = torch.zeros_like(image)
            noise[place] = own.to(light.device) - light
            noisy[view] = noisy[view] + noise
    return noisy


class _Drawing(NamedTuple):
    """A lens that was drawn, and by name the options from which it was made."""

    options: dict[str, Any]
    lens: DefocusLens


def _defocused_alone(one: tuple[Tensor, Tensor, Settings]) -> ViewTensors:
    """The views of one picture, given its colours [C, H, W], radii [H, W] px and settings."""
    image, radius, settings = one
    surface = Surface(image, radius)
    return views_alone(surface, settings) or Renderer(surface, settings).picture()


def _seeds(seeds: Sequence[int] | Tensor | torch.Generator, count: int) -> list[int]:
    """One whole number for each picture: those of the caller, or drawn from a generator."""
    if isinstance(seeds, torch.Generator):
        seeds = torch.randint(2**63 - 1, (count,), generator=seeds, device=seeds.device)
    wanted = f"seeds must be one whole number for each picture, a list of {count}"
    remedy = "the indices of the samples will do"
    try:
        whole = [index(seed) for seed in seeds]
    except TypeError:
        raise ValueError(f"{wanted}, got {described(seeds)}; {remedy}") from None
    if len(whole) != count:
        raise ValueError(f"{wanted}, got one of {len(whole)}; {remedy}")
    return whole
