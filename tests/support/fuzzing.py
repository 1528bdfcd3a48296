"""Damaged files of every format, and a process that reads one after the other.

Started as ``python fuzzing.py FOLDER SEED FIRST END`` it reads the cases FIRST to END - 1 with no
more than 1 GiB of memory beyond its modules, and prints a JSON line before and after each.
"""

import io
import json
import os
import random
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

SIZE = (24, 32)  # height, width
MAX_BYTES = 2**30
_CODECS = ("ZIP", "ZIPS", "RLE", "PIZ", "PXR24", "B44", "DWAA", "NO")
_EXTREMES = (0, 1, 0x7F, 0x80, 0xFF)
_NUMBERS = (0, 1, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_SOUND = "sound"


def sound_files(folder):
    """The bytes of a small sound file of each format, codec and layout, by name."""
    from image_files import multi_part, random_planes, save, write_deep

    from defocus_core.io.exr.writing import write_exr

    folder.mkdir(parents=True, exist_ok=True)
    names = {"8": np.uint8, "16": np.uint16}
    ramp = np.add.outer(np.arange(SIZE[0]), np.arange(SIZE[1])) / sum(SIZE)
    color = np.stack([ramp, ramp**2, 1 - ramp, np.ones(SIZE)], axis=2)
    files = []
    for bits, dtype in names.items():
        samples = (color * np.iinfo(dtype).max).astype(dtype)
        for channels in (1, 3, 4):
            files.append(save(folder / f"{channels}x{bits}.png", samples[..., :channels]))
        for codec in ("zip", "lzw", "none", "packbits"):
            files.append(save(folder / f"{codec}{bits}.tif", samples[..., :3], Compression=codec))
        files.append(save(folder / f"tiles{bits}.tif", samples[..., :3], tile=(16, 16)))
    samples = (color[..., :3] * 255).astype(np.uint8)
    tags = {"Make": "camera", "Exif__FocalLength": 50.0, "GPS__LatitudeRef": "N"}
    files.append(save(folder / "baseline.jpg", samples, **tags))
    files.append(save(folder / "progressive.jpg", samples, jpeg__progressive=1))
    files.append(save(folder / "grey.jpg", samples[..., :1]))
    files.append(save(folder / "float.tif", color[..., :1].astype(np.float32)))
    files.append(save(folder / "a.hdr", color[..., :3].astype(np.float32)))
    for codec in _CODECS:
        files.append(_exr(folder / f"{codec.lower()}.exr", codec, ramp))
    write_exr(folder / "ours.exr", {**random_planes("RGB"), "Z": ramp.astype(np.float32)}, {})
    parts = {"rgb": random_planes("RGB"), "depth": {"Z": ramp.astype(np.float32)}}
    files += [folder / "ours.exr", multi_part(folder / "parts.exr", **parts)]
    write_deep(folder / "deep.exr")
    np.save(folder / "a.npy", ramp.astype(np.float32))
    (folder / "a.pfm").write_bytes(b"Pf\n32 24\n-1.0\n" + ramp.astype("<f4").tobytes())
    files += [folder / "deep.exr", folder / "a.npy", folder / "a.pfm"]
    return {path.name: path.read_bytes() for path in files}


def _exr(path, codec, ramp):
    import OpenEXR

    header = {
        "compression": getattr(OpenEXR, f"{codec}_COMPRESSION"),
        "type": OpenEXR.scanlineimage,
    }
    planes = {name: (ramp**power).astype(np.float16) for power, name in enumerate("RGB", 1)}
    OpenEXR.File(header, {**planes, "Z": ramp.astype(np.float32)}).write(str(path))
    return path


def damaged(data, name, rng):
    """A file with one to four damages of random kinds and places, more often near its beginning."""
    spoiled = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        rng.choice(_DAMAGES)(spoiled, rng)
        if not spoiled:
            break
    if name.endswith(".png") and rng.random() < 0.7:
        spoiled = _with_checksums(bytes(spoiled))
    return bytes(spoiled)


def _place(spoiled, rng):
    maximum = len(spoiled) - 1
    return rng.randint(0, min(maximum, 400)) if rng.random() < 0.6 else rng.randint(0, maximum)


def _flip(spoiled, rng):
    spoiled[_place(spoiled, rng)] ^= 1 << rng.randrange(8)


def _set_byte(spoiled, rng):
    spoiled[_place(spoiled, rng)] = rng.choice((*_EXTREMES, rng.randrange(256)))


def _set_number(spoiled, rng):
    at, size = _place(spoiled, rng), rng.choice((2, 4, 8))
    number = rng.choice(_NUMBERS) & (256**size - 1)
    spoiled[at : at + size] = number.to_bytes(size, rng.choice(("little", "big")))


def _cut_off(spoiled, rng):
    del spoiled[rng.randint(0, len(spoiled) - 1) :]


def _remove(spoiled, rng):
    at = _place(spoiled, rng)
    del spoiled[at : at + rng.choice((1, 2, 4, 30))]


def _insert(spoiled, rng):
    at = _place(spoiled, rng)
    spoiled[at:at] = rng.randbytes(rng.choice((1, 2, 4, 30, 3000)))


def _repeat(spoiled, rng):
    at, to = _place(spoiled, rng), _place(spoiled, rng)
    spoiled[to:to] = spoiled[at : at + rng.randint(1, 200)]


def _move(spoiled, rng):
    at, to, size = _place(spoiled, rng), _place(spoiled, rng), rng.randint(1, 64)
    spoiled[to : to + size] = spoiled[at : at + size]


_DAMAGES: tuple[Callable[[bytearray, random.Random], None], ...] = (
    *(_flip, _flip, _set_byte, _set_number, _set_number),
    *(_cut_off, _remove, _insert, _repeat, _move),
)


def _with_checksums(png):
    """A PNG with checksums that fit its damaged chunks, so that their contents are read."""
    out, at = io.BytesIO(), 8
    out.write(png[:8])
    while at + 12 <= len(png):
        size = int.from_bytes(png[at : at + 4], "big")
        body = png[at + 4 : at + 8 + size]
        if at + 12 + size > len(png):
            break
        out.write(png[at : at + 4] + body + zlib.crc32(body).to_bytes(4, "big"))
        at += 12 + size
    out.write(png[at:])
    return out.getvalue()


def case(files, seed, index):
    """The name of the sound file of a case, and its damaged bytes."""
    name = sorted(files)[index % len(files)]
    return name, damaged(files[name], name, random.Random(f"{seed} {index}"))


def outcome(path):
    """``read``, with what info says; ``refused``, with the line; or ``wrong``, with the reason."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    from defocus_cli.commands.info import file_lines
    from defocus_core.errors import DefocusError
    from defocus_core.io.images.raster import read_pages, set_tag
    from defocus_core.reports.inspection.inspection import inspect
    from defocus_core.request.job import Reading

    try:
        inspection = inspect(path, Reading(), None, lone=True)
        text = "\n".join(file_lines(inspection))
        if path.suffix in (".png", ".jpg", ".tif"):
            for page in read_pages(path):
                for name, tag in page.tags.items():  # as they would be written
                    set_tag(oiio.ImageSpec(), name, tag)
    except DefocusError as error:
        return _judged(error, str(error))
    except BaseException as error:
        return {"wrong": f"{type(error).__name__}: {error}"}
    return {"read": text}


def _judged(error, line):
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError) or "bad_alloc" in str(cause) or "allocate" in str(cause):
            return {"wrong": f"more than {MAX_BYTES} bytes: {cause}"}
        cause = cause.__cause__
    if not line.isprintable() or len(line) > 1000 or line.count("case.") > 1:
        return {"wrong": f"no single clear line: {line!r}"}
    return {"refused": line}


def _main(folder, seed, first, end):
    import resource

    import defocus_core  # noqa: F401

    said = os.dup(1)

    def say(**document):
        os.write(said, (json.dumps(document) + "\n").encode())

    files = sound_files(folder / _SOUND)
    for path in sorted((folder / _SOUND).iterdir()):
        say(sound=path.name, **outcome(path))
    status = Path("/proc/self/status").read_text()
    taken = int(status.partition("VmSize:")[2].split()[0]) * 1024
    resource.setrlimit(resource.RLIMIT_AS, (taken + MAX_BYTES, resource.RLIM_INFINITY))
    for index in range(first, end):
        name, data = case(files, seed, index)
        path = folder / f"case{Path(name).suffix}"
        path.write_bytes(data)
        say(begun=index, name=name)
        say(index=index, name=name, **outcome(path))


if __name__ == "__main__":
    _main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
