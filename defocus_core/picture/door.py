"""The main functions of the library: read a picture, define a lens, render, and write views.

Options have the names of those of `defocus render`, with underscores for dashes. Values are
numbers, or texts with a unit as on the command line. Pictures may be files, arrays or tensors.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, NoReturn, cast

import numpy as np
from numpy.typing import NDArray

from defocus_core import gone
from defocus_core.errors import CALLER, DefocusError, UsageProblem, did_you_mean
from defocus_core.io.array_files import array_of
from defocus_core.picture import plain_path
from defocus_core.picture.pair import of_arrays
from defocus_core.picture.preview import write_preview
from defocus_core.picture.take import Arrays, Inputs, Take
from defocus_core.picture.write import disparity_map, shown
from defocus_core.request.job import Job, Machine, Outputs, PictureFiles, Reading
from defocus_core.request.job_options import MACHINE_OPTIONS, OUTPUT_OPTIONS, READING_OPTIONS
from defocus_core.request.lens import LensValues
from defocus_core.request.lens_files import lens_path, read_lens_file
from defocus_core.request.parameters import LENS_OPTIONS, METADATA, Param
from defocus_core.request.picture_lenses import PictureLenses
from defocus_core.request.resolver import (
    Layer,
    fields_of,
    laid_over,
    layer_of,
    outputs_of,
    reading_of,
)
from defocus_core.system.process import cores, settings_kept

Progress = Callable[[int, int], None]
_ARRAY = Path("picture")  # the name of a picture in memory
_UNKNOWN = LensValues(math.nan, math.nan, None)
_SHOWN = 480  # px of the longer side in a notebook


class Pixel(NamedTuple):
    """A pixel of a picture."""

    color: NDArray[np.float32]  # [C], linear light, premultiplied
    depth: float  # metres along the axis, or the number of relative depth


class Picture:
    """Colour with the depth of each pixel, from files or arrays.

    Attributes:
        files: The files; for arrays only names.
        device: Device to render on: auto, cpu or cuda.
    """

    def __init__(
        self,
        color: Any,
        depth: Any,
        *,
        matte: Any = None,
        hidden: tuple[Any, Any] | None = None,
        **reading: Any,
    ) -> None:
        """Make a picture from arrays or tensors in memory.

        Args:
            color: [H, W, C] or [H, W], with 1 to 4 channels: Y, YA, RGB or RGBA. Floats are linear
                light, premultiplied by alpha; integers of 8 or 16 bits are sRGB, as in a PNG.
            depth: [H, W]. A smaller map is enlarged, with edges where the colours change. Floats
                are metres along the optical axis unless options say otherwise, inf is sky; integers
                need a unit, like ``depth_unit="mm"``.
            matte: [H, W], the coverage of the subject, 0 to 1.
            hidden: Colour and depth of the surfaces behind the visible ones.
            **reading: Options of reading, like ``depth_kind`` and ``invalid``.

        Raises:
            ValueError: The arrays are not numbers, or their shapes are wrong.
            InputError: Depth has another aspect ratio than colour, or no known unit.
            UsageProblem: An option is unknown or invalid.
        """
        behind = None if hidden is None else (_array(hidden[0]), _array(hidden[1]))
        coverage = None if matte is None else _array(matte)
        arrays = Arrays(_array(color), _array(depth), coverage, behind)
        files = PictureFiles(_ARRAY.name, _ARRAY, _ARRAY)
        self._decode(files, _layer(reading, READING_OPTIONS), arrays)

    def _decode(self, files: PictureFiles, reading: Layer, arrays: Arrays | None = None) -> None:
        """Set the attributes and decode the inputs, unless depth can only be read with a lens.

        Depth is read as relative if its numbers are not distances.
        """
        self.files, self.device, self._reading, self._arrays = files, "auto", reading, arrays
        self._inputs: tuple[object, Inputs] | None = None
        self._shown: Inputs | None = None
        if (options := reading_of(reading)).needs_lens:
            return
        job = Job(files, _UNKNOWN, options, Outputs(Path()), Machine())
        try:
            self._shown = self._read(job)
        except DefocusError as error:
            try:
                self._shown = self._read(replace(job, lens=replace(_UNKNOWN, blur=1.0)))
            except DefocusError:
                raise error from None

    def _read(self, job: Job) -> Inputs:
        """The inputs decoded with the reading options of a job; the last result is kept."""
        key = job.reading, job.lens_focal
        if self._inputs is None or self._inputs[0] != key:
            arrays = self._arrays
            inputs = plain_path.read(job) if arrays is None else of_arrays(job, arrays)
            self._inputs = key, inputs
        return self._inputs[1]

    @property
    def _decoded(self) -> Inputs:
        if self._shown is None:
            problem = "holds distances to the point, which need the focal length of a lens"
            remedy = "render it, or give ‹focal-px› or ‹fov›"
            raise UsageProblem("missing-option", problem, remedy, field="depth-format")
        return self._shown

    @property
    def color(self) -> NDArray[np.float32]:
        """The colours, float32 [H, W, C], in linear light premultiplied by alpha."""
        color = self._decoded.color
        return cast(NDArray[np.float32], shown(color, color.pixels))

    @property
    def depth(self) -> NDArray[np.float32]:
        """The depth, float32 [H, W]: metres along the optical axis, inf for sky.

        If `is_relative`, it has the numbers of the depth file instead.
        """
        inputs = self._decoded
        return cast(NDArray[np.float32], shown(inputs.color, inputs.depth.metres))

    @property
    def channels(self) -> tuple[str, ...]:
        """The names of the colour channels, like ("R", "G", "B", "A") or ("Y",)."""
        return self._decoded.color.channels

    @property
    def is_relative(self) -> bool:
        """Whether depth has no unit, so that a lens needs ``blur`` in px instead of optics."""
        return self._decoded.depth.is_relative

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings from reading, such as assumptions about the files."""
        return self._decoded.warnings

    @property
    def metadata(self) -> Mapping[str, object]:
        """The metadata of the colour file."""
        return self._decoded.color.attributes

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in px."""
        return self._decoded.color.size

    def at(self, x: int, y: int) -> Pixel:
        """The colour and depth of the pixel in column x and row y, from 0 at the upper left."""
        width, height = self.size
        if not (0 <= x < width and 0 <= y < height):
            raise IndexError(f"pixel {x},{y} lies outside a picture of {width}x{height} px")
        return Pixel(self.color[y, x], float(self.depth[y, x]))

    def to(self, device: str) -> Picture:
        """A picture with the same data that is rendered on `device`: auto, cpu or cuda."""
        picture = self.__class__.__new__(self.__class__)
        picture.__dict__.update(self.__dict__, device=str(device))
        return picture

    def __repr__(self) -> str:
        if self._shown is None:
            return f"<Picture {self.files.color.name}>"
        (width, height), depth = self.size, self._decoded.depth
        solid = self.depth[np.isfinite(self.depth)]
        digits = ".5g" if depth.is_relative else ".3g"
        span = f" {solid.min():{digits}}–{solid.max():{digits}}" if solid.size else ""
        unit = "" if depth.is_relative else " px" if depth.is_radius else " m"
        what = "relative depth" if depth.is_relative else "radii" if depth.is_radius else "depth"
        name = "in memory" if self._arrays is not None else self.files.color.name
        words = f"{width}×{height} {''.join(self.channels)}, {what}{span}{unit * bool(span)}"
        return f"<Picture {words}, {name}>"

    def _repr_png_(self) -> bytes:
        return _png(self.color, self.metadata)


class Lens:
    """A thin lens with focal length, f-number and focus; or with ``blur`` for relative depth."""

    def __init__(
        self,
        focal_length: str | None = None,
        fnumber: float | str | None = None,
        focus: str | float | None = None,
        **options: Any,
    ) -> None:
        """Make a lens from options, which are named as on the command line.

        Args:
            focal_length: A length like ``"50mm"``.
            fnumber: A number like 1.4.
            focus: A distance like ``"2m"`` or ``"inf"``; a number of metres; or a percentile of the
                depth, like ``"percentile(30)"``.
            **options: Further options, like ``sensor_width="36mm"`` (the default), ``blades=7``,
                ``focus_at=(640, 360)`` or ``cat_eye="1.1:0.6"``. For relative depth,
                ``blur="40px"`` replaces focal length and f-number. `defocus help look` explains all
                options.

        Raises:
            UsageProblem: An option is unknown, or its value is invalid.
        """
        self._file: Path | None = None
        self._metadata = bool(options.pop(METADATA.replace("-", "_"), False))
        given = {"focal_length": focal_length, "fnumber": fnumber, **_focus(focus), **options}
        self._layer = _layer(given, LENS_OPTIONS)

    @classmethod
    def load(cls, file: str | PathLike[str], **options: Any) -> Lens:
        """Load a lens file, or a shipped lens like ``@portrait-85``; `options` override its values.

        Raises:
            InputError: The file cannot be read.
            UsageProblem: An option is unknown, or its value is invalid.
        """
        lens = cls(**options)
        lens._file = lens_path(Path(file), CALLER.with_field("lens"))
        return lens

    @property
    def options(self) -> dict[str, str]:
        """The options that were given to this lens, as texts, by name."""
        return {name.replace("-", "_"): each.text for name, each in self._layer.items()}

    def refocus(self, focus: str | float) -> None:
        """Change the focus of this lens to a distance like ``"3m"``, or to a number of metres."""
        self._layer = laid_over(self._layer, _layer(_focus(focus), LENS_OPTIONS))

    def coc(self, picture: Any) -> NDArray[np.float32]:
        """The signed radius of the circle of confusion in px, float32 [H, W].

        It is negative nearer than the focus and positive beyond it.

        Args:
            picture: A `Picture`, or an array of depth [H, W] in metres.
        """
        if not isinstance(picture, Picture):
            depth = _array(picture)
            picture = Picture(np.zeros(depth.shape, np.float32), depth)
        radius: NDArray[np.float32] = _prepared(picture, self, ("coc",), Machine()).shown
        return radius

    def _values(self, picture: Picture, reading: Reading) -> tuple[LensValues, Reading]:
        """The values of this lens for a picture, and the options with which to read its depth."""
        lenses = PictureLenses(
            own=self._layer, file=self._file, reading=reading, metadata=self._metadata
        )
        if not lenses.is_complete:
            from defocus_core.picture import subject

            depth = None if picture._arrays is None else picture._decoded.depth
            files = [picture.files]
            lenses, reading = subject.with_blur_and_focus(lenses, files, reading, (), depth)
        return lenses.lens_of(picture.files)[0], reading

    def __repr__(self) -> str:
        words = [f"{name}={text}" for name, text in self.options.items()]
        return f"<Lens {', '.join(([self._file.stem] if self._file else []) + words)}>"


class Views:
    """The rendered views of a picture. Images and maps are converted on access.

    Attributes:
        device: Device of the tensors that are returned: images [C, H, W], maps [H, W]. None for
            NumPy arrays: images float32 [H, W, C], maps float32 [H, W].
        warnings: Warnings from reading and rendering; after `write` also from writing.
    """

    def __init__(self, take: Take, device: str | None = None) -> None:
        self._take, self.device, self.warnings = take, device, take.warnings

    @property
    def render(self) -> Any:
        """The defocused picture in linear light."""
        return self._image("render")

    @property
    def left(self) -> Any:
        """The view through the left half of the lens; None unless rendered with ``left_right``."""
        return self._image("left")

    @property
    def right(self) -> Any:
        """The view through the right half of the lens; None unless rendered with ``left_right``."""
        return self._image("right")

    @property
    def coc(self) -> Any:
        """The signed radius of the circle of confusion in px, negative nearer than the focus."""
        return self._map(self._take.shown)

    @property
    def disparity(self) -> Any:
        """The horizontal disparity between left and right in px, with the sign of `coc`."""
        return self._map(disparity_map(self._take))

    @property
    def trust(self) -> Any:
        """The share of the lens that saw content of the picture: 1 where nothing is invented."""
        return self._map(self._take.images["trust"][0])

    def write(
        self,
        out: str | PathLike[str],
        kinds: str | None = None,
        *,
        overwrite: bool = False,
        **options: Any,
    ) -> dict[str, Path]:
        """Write ``OUT/<kind>/<stem>.<ext>`` for each kind, as `defocus render` does.

        Args:
            out: A directory; or a file, if only one kind is written.
            kinds: Kinds of output, like ``"render,trust"``; None for all images and the CoC map.
            overwrite: Whether to replace existing files.
            **options: Options of outputs, like ``format="png16"`` and ``exr_type="float"``.

        Returns:
            The path of the file of each kind.

        Raises:
            InputError: A file exists already, or cannot be written.
            UsageProblem: An option is unknown, or its value is invalid.
        """
        from defocus_core.io.write_files import identities, require_replaceable

        job = self._take.job
        if kinds is None:
            kinds = ",".join(kind for kind in job.outputs.kinds if kind != "trust")
        layer = _layer({"outputs": kinds, **options}, OUTPUT_OPTIONS)
        asked = Outputs(Path(out), overwrite=overwrite)
        outputs = outputs_of(layer, asked, one_file=True)
        if missing := [
            k.name for k in outputs.rows if not self._take.images.keys() >= {*k.rendered}
        ]:
            problem, remedy = f"{missing[0]} was not rendered", "render with left_right=True"
            raise UsageProblem("missing-option", problem, remedy, field="outputs")
        take = replace(self._take, job=replace(job, outputs=outputs), images=self._arrays(outputs))
        inputs = identities(job.files.values())
        for path in take.job.written:
            require_replaceable(path, overwrite=overwrite, inputs=inputs)
        outputs.root.mkdir(parents=True, exist_ok=True)
        said = plain_path.write(take).warnings[len(self._take.warnings) :]
        self.warnings = tuple(dict.fromkeys((*self.warnings, *said)))
        _warn(said)
        return take.job.paths

    def _arrays(self, outputs: Outputs) -> dict[str, tuple[Any, ...]]:
        """The rendered arrays of each kind that is to be written."""
        images = self._take.images
        return {
            kind.name: tuple(plane for view in kind.rendered for plane in images[view])
            for kind in outputs.rows
            if kind.rendered
        }

    def to(self, device: str) -> Views:
        """The same views as tensors on a device: cpu or cuda."""
        return Views(self._take, plain_path.choose_device(str(device)))

    def _image(self, kind: str) -> Any:
        planes = self._take.images.get(kind)
        if planes is None:
            return None
        return self._held(planes, axis=-1 if self.device is None else 0)

    def _map(self, plane: Any) -> Any:
        return self._held([plane], axis=0)[0]

    def _held(self, planes: Sequence[Any], axis: int) -> Any:
        """Stack planes along `axis`, as an array or tensor of float32, without overscan."""
        cut = [shown(self._take.inputs.color, plane) for plane in planes]
        pixels = np.stack(cut, axis, dtype=np.float32)
        if self.device is None:
            return pixels
        import torch

        return torch.from_numpy(pixels).to(self.device)

    def __iter__(self) -> Iterator[NoReturn]:
        raise TypeError("views have names: views.render, views.left, views.right, views.coc")

    def __repr__(self) -> str:
        (width, height), (low, high) = self._take.size, self._take.limits
        kinds = ", ".join(self._take.images)
        name = self._take.job.picture.color.name
        return f"<Views {width}×{height} {kinds}, CoC {low:.3g}…{high:.3g} px, {name}>"

    def _repr_png_(self) -> bytes:
        arrays = Views(self._take)
        return _png(arrays.render, self._take.inputs.color.attributes)


def read(
    color: str | PathLike[str],
    depth: str | PathLike[str] | None = None,
    *,
    hidden: tuple[str | PathLike[str], str | PathLike[str]] | None = None,
    over: str | PathLike[str] | None = None,
    over_depth: str | PathLike[str] | None = None,
    holdout: str | PathLike[str] | None = None,
    matte: str | PathLike[str] | None = None,
    **reading: Any,
) -> Picture:
    """Read a picture from files.

    Args:
        color: The colour file: EXR, HDR, PNG, JPEG, TIFF, WEBP or HEIC.
        depth: The depth file, of any supported format; None if the colour file holds both.
        hidden: Colour and depth files of the surfaces behind the visible ones.
        over: The colour file of a plate, which lies behind this picture with alpha.
        over_depth: The depth file of the plate; None if its colour file holds it, or if the plate
            is infinitely far away.
        holdout: A deep EXR with objects that hide what is behind them and are not shown.
        matte: A file with the coverage of the subject, 0 to 1.
        **reading: Options of reading, like ``depth_format="kitti"`` or ``view="left"``.

    Raises:
        InputError: A file cannot be read.
        UsageProblem: An option is unknown, or invalid for these files.
    """
    from defocus_core.request.pairing import find, others_of

    others = {"over": over, "over-depth": over_depth, "holdout": holdout, "matte": matte}
    others |= dict(zip(("hidden", "hidden-depth"), hidden or (), strict=False))
    paths = {name: Path(path) for name, path in others.items() if path is not None}
    layer = _layer(reading, READING_OPTIONS)
    found, _ = find(Path(color), None if depth is None else Path(depth), others_of(paths, CALLER))
    if len(found) != 1:
        problem, remedy = f"names {len(found)} pictures", "give one file, or use run_batch"
        raise UsageProblem("wrong-type", problem, remedy, path=Path(color))
    picture = Picture.__new__(Picture)
    picture._decode(found[0], layer)
    return picture


def render(
    picture: Any = None,
    lens: Any = None,
    *,
    left_right: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> Any:
    """Defocus a picture with a lens.

    Args:
        picture: A `Picture`; or an image tensor [C, H, W] or [B, C, H, W] in linear light.
        lens: A `Lens`; None to choose blur and focus, for relative depth. With an image tensor, the
            signed radii of its pixels in px, [H, W] or [B, 1, H, W].
        left_right: Whether to render the views through the left and the right half of the lens,
            too.
        progress: Function that is called with the number of finished tiles and of all tiles.
        **options: quality, threads, tile, memory and device, as on the command line. With an image
            tensor, the options of `defocus_core.renderer.render.render`.

    Returns:
        `Views` of the picture. For an image tensor, views whose attributes are tensors of its
        shape.

    Raises:
        DefocusError: The picture does not fit the lens or the memory.
        ValueError: A tensor or its options are invalid.
    """
    if not isinstance(picture, Picture):
        from defocus_core.renderer.render import render as render_tensors

        tensors = (each for each in (picture, lens) if each is not None)
        return render_tensors(*tensors, left_right=left_right, progress=progress, **options)
    lens = Lens() if lens is None else lens
    if not isinstance(lens, Lens):
        raise ValueError(f"lens must be a Lens, got {type(lens).__name__}; Lens('50mm', …) is one")
    kinds = ("render", *(("left", "right") if left_right else ()), "coc", "trust")
    layer = _layer({"device": picture.device, **options}, MACHINE_OPTIONS, "left_right", "progress")
    plain_path.load()
    with settings_kept():
        machine = Machine(**{"threads": cores(), **fields_of(layer)})
        take = plain_path.compute(_prepared(picture, lens, kinds, machine), progress)
    _warn(take.warnings)
    return Views(take)


def _prepared(picture: Picture, lens: Lens, kinds: tuple[str, ...], machine: Machine) -> Take:
    """Compute the blur radii of a picture through a lens, ready to render `kinds` of output."""
    reading = reading_of(read_lens_file(lens._file, READING_OPTIONS), picture._reading)
    outputs = Outputs(Path(), kinds=kinds, exr_type="float")
    job = Job(picture.files, *lens._values(picture, reading), outputs, machine)
    return plain_path.prepare(job, picture._read(job))


def _focus(focus: str | float | None) -> dict[str, str | None]:
    """The option ‹focus› as text; a number is a distance in metres."""
    if focus is None or isinstance(focus, str):
        return {"focus": focus}
    return {"focus": "inf" if focus == math.inf else f"{focus:.9g}m"}


def _layer(values: Mapping[str, Any], rows: Mapping[str, Param], *more: str) -> Layer:
    """Parse keyword arguments as options; `more` has other keywords to propose in errors."""
    given = {name.replace("_", "-"): value for name, value in values.items()}
    for name in given:
        if name not in rows or rows[name].only == "files":
            word, *every = (each.replace("-", "_") for each in (name, *rows, *more))
            known = did_you_mean(word, every, f"there are {', '.join(every)}")
            remedy = gone.remedy("option", name, otherwise=known)
            raise UsageProblem("unknown-name", "is not an option", remedy, field=word)
    return layer_of(given, rows, CALLER.with_field)


def _array(values: Any) -> NDArray[Any]:
    """Copy an array or a tensor of numbers to a NumPy array."""
    return np.array(array_of(values))


def _png(pixels: NDArray[np.float32], attributes: Mapping[str, object]) -> bytes:
    """A reduced picture as PNG; `pixels` [H, W, C] is linear light."""
    step = max(1, -(-max(pixels.shape[:2]) // _SHOWN))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "shown.png"
        write_preview(path, np.ascontiguousarray(pixels[::step, ::step]), attributes)
        return path.read_bytes()


def _warn(words: Sequence[str]) -> None:
    """Issue warnings that point at the line which called the library."""
    for each in words:
        warnings.warn(each, stacklevel=3)
