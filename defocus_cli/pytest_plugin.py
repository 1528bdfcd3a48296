"""The pytest fixture ``golden``: pictures of a test are compared with those that were accepted.

``golden.check(image, "name", psnr=45)`` compares an array, a tensor or a file with
``goldens/TEST_FILE/name.exr`` beside the test. ``pytest --golden-update`` accepts what there is.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from defocus_cli.compare.thresholds import Rules

_FOLDER = "goldens"
# Another processor, or another version of torch, rounds otherwise.
_DEFAULT = {"max": 1e-4}
_CHANNELS = {1: "Y", 2: "YA", 3: "RGB", 4: "RGBA"}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--golden-update``."""
    group = parser.getgroup("defocus")
    text = "accept the pictures of golden.check() as the new goldens"
    group.addoption("--golden-update", action="store_true", help=text)


class Golden:
    """The goldens of a test file.

    Attributes:
        folder: where they are.
        update: whether pictures are accepted.
    """

    def __init__(self, folder: Path, *, update: bool) -> None:
        self.folder, self.update = folder, update

    def check(self, image: Any, name: str, **bounds: float) -> None:
        """Compare an image with its golden, and fail the test if it is not like it.

        Args:
            image: an array [H, W] or [H, W, C]; a tensor [H, W], [C, H, W] or [1, C, H, W]; or the
                path of a file. Arrays and tensors are linear.
            name: of the golden, unique in the test file; may hold slashes.
            bounds: metrics of ``defocus compare`` with what is just allowed, like ``psnr=45`` or
                ``max=0.02``; rel_rmse, p999 and edges_psnr for rel-rmse, p99.9 and edges-psnr.
                By default, no value may differ by more than 1e-4.

        Raises:
            ValueError: the image has another shape, or a metric is not known.
        """
        __tracebackhide__ = True
        rules = _rules(bounds or _DEFAULT)
        source = Path(image) if isinstance(image, str | Path) else None
        golden = self.folder / f"{name}{source.suffix if source else '.exr'}"
        if self.update:
            _accept(golden, image if source is None else source)
            return
        if not golden.exists():
            pytest.fail(f"{golden}: there is no such golden; make it with pytest --golden-update")
        message = _difference(golden, image if source is None else source, name, rules)
        if message:
            pytest.fail(f"{message}\n--golden-update makes it the golden {golden}", pytrace=False)


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Golden:
    """The goldens of the test file."""
    file = Path(request.path)
    update = bool(request.config.getoption("--golden-update"))
    return Golden(file.parent / _FOLDER / file.stem, update=update)


def _rules(bounds: Mapping[str, float]) -> Rules:
    from defocus_cli.compare.metrics import METRICS
    from defocus_cli.compare.thresholds import Rule, Rules

    rules = []
    for key, bound in bounds.items():
        name = {"p999": "p99.9"}.get(key, key.replace("_", "-"))
        if name not in METRICS:
            raise ValueError(f"bounds must be metrics ({', '.join(METRICS)}), got {key}")
        sign = "<" if METRICS[name].better == "high" else ">"
        rules.append(Rule(name, sign, float(bound), f"{name}{sign}{bound:g}"))
    return Rules(fail=tuple(rules))


def _difference(golden: Path, image: Any, name: str, rules: Rules) -> str:
    """The line of a picture that is not like its golden; empty if it is."""
    from defocus_cli.compare.comparison import compare_pictures
    from defocus_cli.compare.record import Settings
    from defocus_cli.diagnosis.picture import Picture, read_picture
    from defocus_cli.reports.compare_report import line

    if isinstance(image, Path):
        picture = read_picture(image)
    else:
        planes = _planes(image)
        height, width = next(iter(planes.values())).shape
        types = {channel: plane.dtype.name for channel, plane in planes.items()}
        picture = Picture(Path(name), width, height, planes, types)
    flip = any(rule.metric.startswith("flip") for rule in rules.fail)
    record, _ = compare_pictures(name, read_picture(golden), picture, rules, Settings(flip=flip))
    return "" if record.passes else line(record)


def _accept(golden: Path, image: Any) -> None:
    from defocus_cli.exr.writing import write_exr
    from defocus_cli.system.safe_files import written_whole

    if isinstance(image, Path):
        with written_whole(golden) as file:
            file.write(image.read_bytes())
    else:
        write_exr(golden, _planes(image), {})


def _planes(image: Any) -> dict[str, Any]:
    """Channels [H, W], half or float, of an array or a tensor."""
    import numpy as np

    if hasattr(image, "detach"):  # a tensor, whose channels come first
        values = np.asarray(image.detach().cpu().numpy())
        values = values[0] if values.ndim == 4 and values.shape[0] == 1 else values
        values = np.moveaxis(values, 0, -1) if values.ndim == 3 else values
    else:
        values = np.asarray(image)
    if values.dtype != np.float16:
        values = values.astype(np.float32)
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[2] not in _CHANNELS or not values.size:
        wanted = "[H, W], [H, W, C] or, as a tensor, [C, H, W] with 1 to 4 channels"
        raise ValueError(f"image must be {wanted}, got {list(np.shape(image))}")
    names = _CHANNELS[values.shape[2]]
    return {name: np.ascontiguousarray(values[..., k]) for k, name in enumerate(names)}
