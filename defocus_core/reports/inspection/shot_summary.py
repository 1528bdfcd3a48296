"""The summary of a shot: its frames and gaps, sizes, depth over time, and where blur is largest."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from defocus_core.batch.jobs.job import Picture, Reading
from defocus_core.batch.jobs.shot_lenses import ShotLenses
from defocus_core.batch.lenses.lens import Lens
from defocus_core.batch.lenses.quantities import length_text
from defocus_core.io.images.describe import describe
from defocus_core.io.shots.frame_patterns import frames_of, gaps, in_words
from defocus_core.reports.inspection.inspection import inspect

MAX_READ = 25  # frames that are decoded, evenly spread over the shot


def summarise(
    patterns: Sequence[Path], reading: Reading, lenses: ShotLenses | None
) -> list[dict[str, Any]]:
    """What ``defocus info --json`` prints of each pattern.

    `lenses`: the lens of each frame; None for none.
    """
    files = {pattern: frames_of(pattern) for pattern in patterns}
    colors = files[patterns[0]]

    def lens_of(frame: int, path: Path) -> Lens | None:
        if lenses is None:
            return None
        color = colors.get(frame, path)
        return lenses.of(Picture(path.stem, color, path, frame=frame))[0]

    return [_summary(pattern, of, reading, lens_of) for pattern, of in files.items()]


def _summary(
    pattern: Path,
    files: Mapping[int, Path],
    reading: Reading,
    lens_of: Callable[[int, Path], Lens | None],
) -> dict[str, Any]:
    by_size: dict[tuple[int, int], list[int]] = {}
    for number, path in files.items():
        info = describe(path)
        by_size.setdefault((info.width, info.height), []).append(number)
    numbers = [*files]
    count = min(MAX_READ, len(numbers))
    places = {round(k * (len(numbers) - 1) / max(count - 1, 1)) for k in range(count)}
    depth = []
    for number in (numbers[place] for place in sorted(places)):
        path = files[number]
        found = inspect(path, reading, lens_of(number, path), lone=True)["depth"]
        if found is None:
            break
        shown = {key: found[key] for key in ("range_m", "range", "sky_pixels", "coc_px", "repair")}
        focus = found["lens"] and found["lens"]["focus_mm"]
        depth.append({"frame": number, "focus_mm": focus, **shown})
    blurred = [each for each in depth if each["coc_px"]]
    largest = max(blurred, key=lambda each: max(map(abs, each["coc_px"])), default=None)
    return {
        "pattern": str(pattern),
        "frames": numbers,
        "gaps": list(gaps(numbers)),
        "sizes": [{"size": list(size), "frames": of} for size, of in by_size.items()],
        "depth": depth,
        "largest_blur": largest and {key: largest[key] for key in ("frame", "coc_px")},
    }


def range_words(depth: Mapping[str, Any], digits: int = 6) -> str:
    """The ends of a depth in words: in metres, unless its numbers are no distances."""
    for key, unit in (("range_m", " m"), ("range", "")):
        if depth[key]:
            return " to ".join(f"{end:.{digits}g}{unit}" for end in depth[key])
    return "no finite depth"


def lines(record: Mapping[str, Any]) -> Iterator[str]:
    """A summary in words."""
    lost = f"; {in_words(record['gaps'])} missing" if record["gaps"] else "; no gaps"
    yield f"{record['pattern']}: {in_words(record['frames'])}{lost}"
    sizes = ["{}x{}".format(*each["size"]) for each in record["sizes"]]
    if len(sizes) == 1:
        yield f"  size: {sizes[0]}"
    else:
        changes = (
            f"{size} in {in_words(each['frames'])}"
            for size, each in zip(sizes, record["sizes"], strict=True)
        )
        yield f"  size changes: {'; '.join(changes)}"
    for each in record["depth"]:
        reach = range_words(each, digits=4)
        focus = each["focus_mm"] and f"focus {length_text(float(each['focus_mm']))}"
        blur = "CoC {:.2f} to {:.2f} px".format(*each["coc_px"]) if each["coc_px"] else ""
        yield f"  {each['frame']}: {', '.join(filter(None, (reach, focus, blur, each['repair'])))}"
    if record["largest_blur"]:
        radius = max(map(abs, record["largest_blur"]["coc_px"]))
        yield f"  blur is largest in {record['largest_blur']['frame']}: {radius:.2f} px"
