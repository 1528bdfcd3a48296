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
from pathlib import Path

import numpy as np

from defocus_core import DefocusError

SIZE = (24, 32)  # height, width
MAX_BYTES = 2**30
_CODECS = ("zip", "zips", "rle", "piz", "pxr24", "b44", "dwaa", "none")
_NUMBERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_SOUND = "sound"


def sound_files(folder):
    """The bytes of a small sound file of each format, codec and layout, by name."""
    from image_files import multi_part, random_planes, save, write_deep

    from defocus_core.io.exr.writing import write_exr

    folder.mkdir(parents=True, exist_ok=True)
    ramp = np.add.outer(np.arange(SIZE[0]), np.arange(SIZE[1])) / sum(SIZE)
    color = np.stack([ramp, ramp**2, 1 - ramp, np.ones(SIZE)], axis=2)
    floats, bytes_ = color[..., :3].astype(np.float32), (color * 255).astype(np.uint8)
    tags = {"Make": "camera", "Exif__FocalLength": 50.0, "GPS__LatitudeRef": "N"}
    for samples in (bytes_, (color * 65535).astype(np.uint16)):
        bits = 8 * samples.itemsize
        for channels in (1, 3, 4):
            save(folder / f"{channels}x{bits}.png", samples[..., :channels])
        for codec in ("zip", "lzw", "none", "packbits"):
            save(folder / f"{codec}{bits}.tif", samples[..., :3], Compression=codec)
        save(folder / f"tiles{bits}.tif", samples[..., :3], tile=(16, 16))
    for name, samples, more in (
        ("baseline.jpg", bytes_[..., :3], tags),
        ("progressive.jpg", bytes_[..., :3], {"jpeg__progressive": 1}),
        ("grey.jpg", bytes_[..., :1], {}),
        ("float.tif", floats[..., :1], {}),
        ("a.hdr", floats, {}),
    ):
        save(folder / name, samples, **more)
    planes = random_planes("RGB") | {"Z": ramp.astype(np.float32)}
    for codec in _CODECS:
        write_exr(folder / f"{codec}.exr", dict(planes), {}, compression=codec)
    multi_part(folder / "parts.exr", rgb=random_planes("RGB"), depth={"Z": planes["Z"]})
    write_deep(folder / "deep.exr")
    np.save(folder / "a.npy", planes["Z"])
    (folder / "a.pfm").write_bytes(b"Pf\n32 24\n-1.0\n" + ramp.astype("<f4").tobytes())
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


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


def _set_number(spoiled, rng):
    at, size = _place(spoiled, rng), rng.choice((1, 2, 4, 8))
    number = rng.choice(_NUMBERS) & (256**size - 1)
    spoiled[at : at + size] = number.to_bytes(size, rng.choice(("little", "big")))


def _cut_off(spoiled, rng):
    del spoiled[rng.randint(0, len(spoiled) - 1) :]


def _replace(spoiled, rng):
    """Some bytes by others, more or fewer, or by those of another place."""
    at, copied = _place(spoiled, rng), _place(spoiled, rng)
    new = rng.choice((b"", rng.randbytes(rng.choice((1, 4, 3000))), spoiled[copied : copied + 64]))
    spoiled[at : at + rng.choice((0, 1, 4, 30, 64))] = new


_DAMAGES = (_flip, _flip, _set_number, _set_number, _set_number, _cut_off, *[_replace] * 3)


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
    from command_line import run

    from defocus_core.io.images.raster import read_pages, set_tag

    try:
        ran = run("info", path)
        if ran.code:
            return _judged(ran.error, ran.err.rstrip("\n"))
        if path.suffix in (".png", ".jpg", ".tif"):
            for page in read_pages(path):
                for name, tag in page.tags.items():  # as they would be written
                    set_tag(oiio.ImageSpec(), name, tag)
    except BaseException as error:
        return {"wrong": f"{type(error).__name__}: {error}"}
    return {"read": ran.out}


def _judged(error, line):
    if not isinstance(error, DefocusError):
        return {"wrong": line}
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
