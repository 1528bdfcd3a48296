"""Evidence, for people, of the format of a depth file whose format was not given.

Evidence does not change how the file is read; only strong evidence is shown.
"""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path

from defocus_core.io.depth_formats.reading import OF_NUKE, DepthReading, own_format
from defocus_core.io.images.describe import FileInfo

# Names of channels and arrays that only one format has.
_TELLING_NAMES = {
    "unreal-mrq": ("FinalImage*WorldDepth*", "ImageDepth*"),
    "coc": ("coc",),
    "houdini": ("Pz", "*.Pz"),
    "hypersim": ("dataset",),
    "nyu-mat": ("rawDepths",),
    "vision-blender": ("depth_map",),
}


def evidence_of(path: Path, reading: DepthReading, info: FileInfo) -> Iterator[str]:
    """Sentences on the formats that a depth file could have."""
    if reading.depth_format is not None:
        return
    names = [name.split(" ")[0] for name in info.names]
    for name, patterns in _TELLING_NAMES.items():
        hits = [n for n in names if any(fnmatchcase(n, pattern) for pattern in patterns)]
        if hits:
            yield f"{hits[-1]}: {name}; say ‹depth-format› {name}"
    own = own_format(path)
    if own == "android-gdepth":
        yield "GDepth in its XMP: android-gdepth; say ‹depth-format› android-gdepth"
    elif own == "apple-heic":
        yield "a depth image beside the picture: apple-heic; say ‹depth-format› apple-heic"
    elif any(name.startswith(OF_NUKE) for part in info.parts for name in part.attributes):
        yield "Nuke wrote it, whose ScanlineRender writes 1/z; say ‹depth-format› nuke-scanline"
