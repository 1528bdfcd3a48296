"""Under a limit of the size of files, a picture is whole or is not there."""

import subprocess
import sys

import numpy as np
import pytest

from defocus_core.io.picture_files import read_color, write_image

WRITE = """
import os, resource, sys, torch  # which looks for a folder of its own
import numpy as np
from defocus_core.errors import DefocusError
from defocus_core.io.picture_files import write_image
light = np.random.default_rng(0).random((40, 60, 3))
name, bits, *limits = sys.argv[1:]
for limit in limits:
    if os.fork():
        os.wait()
        continue
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(limit),) * 2)
    try:
        write_image(f"{limit}/{name}", light, bits=int(bits))
    except DefocusError as error:
        print(limit, error.code, file=sys.stderr)
    os._exit(0)
"""
KINDS = (("a.png", 8), ("a.png", 16), ("a.tif", 8), ("a.webp", 8), ("a.jpg", 8), ("a.exr", 8))


@pytest.mark.parametrize(("name", "bits"), KINDS)
def test_a_limit_of_the_size_of_files_leaves_no_cut_picture(name, bits, tmp_path):
    whole = tmp_path / "whole" / name
    write_image(whole, np.random.default_rng(0).random((40, 60, 3)), bits=bits)
    size = whole.stat().st_size
    short, enough = (0, 1, size // 3, size - 1), size + 200
    for limit in (*short, enough):
        (tmp_path / str(limit)).mkdir()
    command = [sys.executable, "-c", WRITE, name, bits, *short, enough]
    command = list(map(str, command))
    ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert ran.stderr.splitlines() == [f"{limit} unwritable" for limit in short]
    assert not any(list((tmp_path / str(limit)).iterdir()) for limit in short)
    limited = tmp_path / str(enough) / name
    assert limited.read_bytes() == whole.read_bytes()
    assert read_color(limited).size == (60, 40)
