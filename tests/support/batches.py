"""Small batches for the tests."""

import json
import os

from command_line import pair, render

JOBS = """
[inputs]
color = "rgb/*.exr"
depth = "depth/*.exr"
[lens]
focal-length = "50mm"
fnumber = 2
[sweep]
focus = ["1.5m", "2m"]
[outputs]
kinds = ["coc"]
"""


def jobs_file(folder, *stems, text=JOBS):
    """A jobs file, and two lenses' worth of pictures beside it."""
    for stem in stems or ("a", "b"):
        for file in pair(folder, stem):
            os.utime(file, (0, 0))  # a time that is relied on
    path = folder / "jobs.toml"
    path.write_text(text)
    return path


def tables(folder, **more):
    """The tables of a jobs file for one picture by one lens."""
    color, depth = pair(folder)
    return {
        "inputs": {"color": str(color), "depth": str(depth)},
        "lens": {"focal-length": "50mm", "fnumber": 2, "focus": "2m"},
        "outputs": {"kinds": ["coc"]},
        **more,
    }


def again(folders, out, *args):
    """The CoC of these pictures, whatever was done before."""
    return render(*folders, "-o", out, "--outputs", "coc", *args)


def records(out, name="journal.jsonl"):
    """The values of the lines of a journal."""
    return [json.loads(line) for line in (out / name).read_bytes().splitlines()]


def contents(out):
    """All files but journals."""
    found = {path for path in out.rglob("*") if path.is_file() and "journal" not in path.name}
    return {str(path.relative_to(out)): path.read_bytes() for path in found}


def without_times(out):
    """The records by name, less what differs from one run to another."""
    found = []
    for record in records(out):
        for stamp in record["outputs"].values():
            stamp.pop("mtime_ns", None)
        found.append({k: v for k, v in record.items() if k not in ("seconds", "finished")})
    return sorted(found, key=lambda record: str(record["sample_id"]))
