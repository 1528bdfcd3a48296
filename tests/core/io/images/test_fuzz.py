"""No damage of a file crashes a reader, hangs it, or takes more than 1 GiB: it is one clear line.

The suite reads 300 damaged files; DEFOCUS_FUZZ=5000 reads more, DEFOCUS_FUZZ_SEED=1 others. A
failure names its cases; ``fuzzing.case(sound_files(FOLDER), SEED, CASE)`` makes the bytes of one.
"""

import json
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from random import Random

import fuzzing
import numpy as np
import pytest

from defocus_core import InputError, read_color

CASES = int(os.environ.get("DEFOCUS_FUZZ", "300"))
SEED = int(os.environ.get("DEFOCUS_FUZZ_SEED", "0"))
SECONDS = 2.0  # of one file on the average, on a machine with other work
ROOT = Path(__file__).parents[4]


def reports(folder, first, end):
    """What a process reports of its cases; the last one is ``wrong`` if it crashed or hung."""
    command = [sys.executable, fuzzing.__file__, folder, SEED, first, end]
    settings = {"env": {**os.environ, "PYTHONPATH": str(ROOT)}, "timeout": SECONDS * (30 + end)}
    try:
        ran = subprocess.run(list(map(str, command)), capture_output=True, check=False, **settings)
        output, ended, printed = ran.stdout, ran.returncode, ran.stderr
    except subprocess.TimeoutExpired as error:
        output, ended, printed = error.stdout or b"", "it hung", b""
    found = []
    for line in output.splitlines():
        if found and "begun" in found[-1]:
            found.pop()
        found.append(json.loads(line))
    if ended or printed:
        found[-1]["wrong"] = f"ended the process: {ended}, {printed[:300]!r}"
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="not on this system: no Linux")
def test_damaged_files_are_refused_in_one_line_or_read(tmp_path):
    found = []
    first = 0
    while first < CASES:
        more = reports(tmp_path, first, CASES)
        assert all("read" in report for report in more if "sound" in report), more
        found += [report for report in more if "sound" not in report]
        last = found[-1]
        first = last.get("index", last.get("begun", first)) + 1
    wrong = [report for report in found if "wrong" in report]
    assert not wrong, "\n".join(map(str, wrong))
    assert len(found) == CASES
    refused = {report["name"] for report in found if "refused" in report}
    assert len(refused) > 0.8 * len({report["name"] for report in found}), "hardly any was damaged"


@pytest.mark.parametrize("name", ["zip.exr", "3x8.png", "3x16.png", "zip8.tif"])
def test_damaged_pixels_are_noticed_where_the_format_has_checksums(name, tmp_path):
    """Other codecs of EXR and TIFF, and JPEG, have none: their damage may be read as pixels."""
    data, path, rng = fuzzing.sound_files(tmp_path)[name], tmp_path / name, Random(SEED)
    sound = read_color(path).pixels
    for _ in range(100):
        spoiled = bytearray(data)
        for _ in range(rng.choice((1, 2, 8))):
            spoiled[rng.randrange(len(data) // 2, len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(spoiled)
        with suppress(InputError):
            assert np.array_equal(read_color(path).pixels, sound), "damaged, but read"
