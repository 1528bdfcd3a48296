"""Runs a command that ends at its n-th step on the disk, for each n, and again to its end.

    python stopped_at_steps.py kill|full EVERY FOLDER -- ARGUMENT…

A step writes, syncs, makes, moves or removes a file. In each round the folder is as it was at
first, the command is killed at its step, or the disk is full from then on, and the same command is
run again. Prints, as JSON, for each round the exit code of the stopped command, the files that it
left half-written, the records of files that are not there, the exit code of the one that went on,
and the files that differ in the end from those of a command that nothing stopped. EVERY is the
distance of one n to the next. What takes seconds to import is imported once: each run is a fork.
"""

import hashlib
import io
import itertools
import json
import os
import re
import shutil
import signal
import sys
from pathlib import Path

WRITES = ("write", "fsync", "fdatasync", "mkdir")
STEPS = (*WRITES, "replace", "rename", "unlink", "rmdir")
# Not looked at by people; a journal's last line may be torn.
HIDDEN = re.compile(r"(^|/)\.|journal")
FDOPEN = os.fdopen


class Steps:
    """Counts steps, and stops at one; a full disk refuses all further writes, too."""

    def __init__(self, at, stop):
        self.at, self.is_kill, self.count = at, stop == "kill", 0

    def __call__(self, *, writes=True):
        """Count a step; whether it is one to stop at."""
        self.count += 1
        return self.count == self.at or (not self.is_kill and writes and self.count > self.at)

    def stop(self):
        """End this process, or refuse what was to be written."""
        if self.is_kill:
            os.kill(os.getpid(), signal.SIGKILL)
        raise OSError(28, os.strerror(28))

    def counted(self, name):
        """A function of `os` that is a step."""
        do, writes = getattr(os, name), name in WRITES

        def step(*args, **named):
            is_data = name == "write"
            if not (is_data and args[0] in (1, 2)) and self(writes=writes):
                if is_data:
                    do(args[0], args[1][: len(args[1]) // 2])
                if self.is_kill or writes:
                    self.stop()
            return do(*args, **named)

        return step

    def opened(self, number, mode="r", *args, **named):
        """``os.fdopen``, whose files count what is written to them."""
        if mode != "wb":
            return FDOPEN(number, mode, *args, **named)
        steps = self

        class Counted(io.BufferedWriter):
            def write(self, data):
                if steps():
                    super().write(bytes(data)[: len(bytes(data)) // 2])
                    super().flush()
                    steps.stop()
                return super().write(data)

        return Counted(io.FileIO(number, "wb"))


def run(arguments, steps=None):
    """Run a command in a process of its own; its exit code, negative that of a signal."""
    if child := os.fork():
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    if steps is not None:
        for name in STEPS:
            setattr(os, name, steps.counted(name))
        os.fdopen = steps.opened
    code = main(arguments)
    os._exit(99 if steps is not None and steps.count < steps.at else code)


def files(folder):
    """The hash of each file below a folder; of journals, without what varies."""
    found = {}
    for path in filter(Path.is_file, folder.rglob("*")):
        data = path.read_bytes()
        if "journal" in path.name and path.suffix != ".tmp":
            data = b"".join(sorted(map(steady, data.splitlines())))
        found[path.relative_to(folder).as_posix()] = hashlib.sha256(data).hexdigest()
    return found


def steady(line):
    """A record without the times in it."""
    try:
        record = json.loads(line)
        stamps = [*record["outputs"].values(), *record["inputs"].values()]
    except (ValueError, KeyError):  # torn, or no record
        return line
    for stamp in stamps:
        stamp.pop("mtime_ns", None)
    return json.dumps({**record, "finished": 0, "seconds": 0}).encode()


def lies(folder):
    """Records that are whole and speak of files that are not."""
    for journal in folder.rglob("journal*.jsonl"):
        for line in filter(None, journal.read_bytes().split(b"\n")[:-1]):
            for stamp in json.loads(line)["outputs"].values():
                path = journal.parent / stamp["path"]
                if not path.exists() or path.stat().st_size != stamp["size"]:
                    yield stamp["path"]


def rounds(stop, every, folder, arguments):
    """What comes of a command that is stopped at each of its steps."""
    first = folder.with_name(folder.name + ".first")
    shutil.copytree(folder, first)
    before, wanted_code = files(folder), run(arguments)
    wanted = files(folder)
    for at in itertools.count(1, every):
        shutil.rmtree(folder)
        shutil.copytree(first, folder)
        code = run(arguments, Steps(at, stop))
        if code == 99:
            return
        left = {name: digest for name, digest in files(folder).items() if not HIDDEN.search(name)}
        told = {"at": at, "code": code, "lies": [*lies(folder)]}
        told["halves"] = [n for n, d in left.items() if d not in (before.get(n), wanted.get(n))]
        told["again"] = run(arguments) - wanted_code
        now = files(folder)
        yield told | {"differ": [n for n in {*now, *wanted} if now.get(n) != wanted.get(n)]}


if __name__ == "__main__":
    from defocus_cli.main import main
    from defocus_core.picture import plain_path

    plain_path.load()
    stop, every, place, _, *arguments = sys.argv[1:]
    sys.stdout.write(json.dumps([*rounds(stop, int(every), Path(place), arguments)]))
