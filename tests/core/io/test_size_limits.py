"""Under a limit of the size of files, a picture is whole or is not there."""

import json
import subprocess
import sys

import numpy as np

from defocus_core.io.picture_files import read_color, write_image

WRITE = """
import json, os, resource, sys, torch  # which looks for a folder of its own
import numpy as np
from defocus_core.errors import DefocusError
from defocus_core.io.picture_files import write_image
light = np.random.default_rng(0).random((40, 60, 3))
for place, name, bits, limit in json.loads(sys.argv[1]):
    if os.fork():
        os.wait()
        continue
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit,) * 2)
    try:
        write_image(f"{place}/{name}", light, bits=bits)
    except DefocusError as error:
        print(place, error.code, file=sys.stderr)
    os._exit(0)
"""
KINDS = (("a.png", 8), ("a.png", 16), ("a.tif", 8), ("a.webp", 8), ("a.jpg", 8), ("a.exr", 8))


def test_a_limit_of_the_size_of_files_leaves_no_cut_picture(tmp_path):
    short, enough = [], []
    for name, bits in KINDS:
        whole = tmp_path / f"whole{bits}" / name
        write_image(whole, np.random.default_rng(0).random((40, 60, 3)), bits=bits)
        size = whole.stat().st_size
        for limit in (0, size // 3, size - 1, 2**23):
            place = tmp_path / f"{name}{bits}-{limit}"
            place.mkdir()
            (short if limit < size else enough).append((place.name, name, bits, limit))
    words = [sys.executable, "-c", WRITE, json.dumps(short + enough)]
    ran = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert ran.stderr.splitlines() == [f"{place} unwritable" for place, *_ in short]
    assert not any([*(tmp_path / place).iterdir()] for place, *_ in short)
    for place, name, bits, _ in enough:
        limited = tmp_path / place / name
        assert limited.read_bytes() == (tmp_path / f"whole{bits}" / name).read_bytes()
        assert read_color(limited).size == (60, 40)
