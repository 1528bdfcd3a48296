"""Under a limit of the size of files, a picture is whole or is not there."""

import subprocess
import sys

import numpy as np
import pytest

from defocus_core.io.picture_files import read_color, write_image

WRITE = """
import resource, sys, torch  # which looks for a folder of its own
import numpy as np
from defocus_core.errors import DefocusError
from defocus_core.io.picture_files import write_image
light = np.random.default_rng(0).random((40, 60, 3))
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
try:
    write_image(sys.argv[1], light, bits=int(sys.argv[3]))
except DefocusError as error:
    sys.exit(error.code)
"""
KINDS = (("a.png", 8), ("a.png", 16), ("a.tif", 8), ("a.webp", 8), ("a.jpg", 8), ("a.exr", 8))


@pytest.mark.parametrize(("name", "bits"), KINDS)
def test_a_limit_of_the_size_of_files_leaves_no_cut_picture(name, bits, tmp_path):
    whole, limited = tmp_path / "whole" / name, tmp_path / name
    write_image(whole, np.random.default_rng(0).random((40, 60, 3)), bits=bits)
    size = whole.stat().st_size
    for limit in (0, 1, size // 3, size - 1, size + 200):
        command = [sys.executable, "-c", WRITE, limited, limit, bits]
        ran = subprocess.run(map(str, command), capture_output=True, text=True, timeout=60)
        assert [path.name for path in tmp_path.iterdir() if path.is_file()] == [name] * (
            limit > size
        )
        assert ran.stderr == ("" if limit > size else "unwritable\n")
    assert limited.read_bytes() == whole.read_bytes()
    assert read_color(limited).size == (60, 40)
