"""Runs a command that ends at its n-th step on the disk, for each n, and again to its end.

    python stopped_at_steps.py kill|full EVERY FOLDER -- ARGUMENT…
    python stopped_at_steps.py random SEED KILLS JOURNAL -- ARGUMENT…

A step writes, syncs, makes, moves or removes a file. In each round the folder is as it was at
first, the command is killed at its step, or the disk is full from then on, and the same command is
run again. Prints, as JSON, for each round the exit code of the stopped command, the files that it
left half-written, the exit code of the one that went on, and the files that differ in the end from
those of a command that nothing stopped. EVERY is the distance of one n to the next. In the second
form runs are killed at random moments, until one comes to its end: how many, and how often a record
was there without its files. What takes seconds to import is imported once: each run is a fork.
"""

import hashlib
import io
import itertools
import json
import os
import random
import re
import shutil
import signal
import sys
import time
from pathlib import Path

STEPS = ("write", "fsync", "fdatasync", "replace", "rename", "unlink", "mkdir", "rmdir")
# Not looked at by people; a journal's last line may be torn.
HIDDEN = re.compile(r"(^|/)\.|journal")
TIMES = re.compile(rb' time="[0-9.]+"')  # of JUnit


def kill():
    """End this process at once."""
    os.kill(os.getpid(), signal.SIGKILL)


def fill():
    """Refuse what was to be written."""
    raise OSError(28, os.strerror(28))


class Steps:
    """Counts steps, and stops at one; a full disk refuses all further writes, too."""

    def __init__(self, at, stop):
        self.at, self.stop, self.count = at, stop, 0

    def __call__(self, *, writes=True):
        """Count a step; whether it is the one to stop at."""
        self.count += 1
        return self.count == self.at or (self.stop is fill and writes and self.count > self.at)

    def counted(self, name):
        """A function of `os` that is a step."""
        do = getattr(os, name)

        def step(*args, **named):
            if name == "write" and args[0] in (1, 2):
                return do(*args, **named)
            if self(writes=name in STEPS[:3] or name == "mkdir"):
                if name == "write":
                    do(args[0], args[1][: len(args[1]) // 2])
                if self.stop is kill or name in STEPS[:3] or name == "mkdir":
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


FDOPEN = os.fdopen


def run(arguments, steps=None):
    """Run a command in a process of its own; its exit code, negative that of a signal."""
    return os.waitstatus_to_exitcode(os.waitpid(start(arguments, steps), 0)[1])


def start(arguments, steps=None):
    """Start a process that runs a command."""
    if child := os.fork():
        return child
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    if steps is not None:
        for name in STEPS:
            setattr(os, name, steps.counted(name))
        os.fdopen = steps.opened
    code = main(arguments)
    if steps is not None and steps.count < steps.at:
        code = 99
    os._exit(code)


def files(folder):
    """The hash of each file below a folder; of journals, without what varies."""
    found = {}
    for path in folder.rglob("*"):
        if path.is_file():
            data = path.read_bytes()
            if "journal" in path.name and path.suffix != ".tmp":
                data = b"".join(sorted(map(steady, data.splitlines())))
            data = TIMES.sub(b"", data)
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


def rounds(stop, every, folder, arguments):
    """What comes of a command that is stopped at each of its steps."""
    first = folder.with_name(folder.name + ".first")
    shutil.copytree(folder, first)
    before = files(folder)
    wanted_code = run(arguments)
    wanted = files(folder)
    told = []
    for at in itertools.count(1, every):
        shutil.rmtree(folder)
        shutil.copytree(first, folder)
        code = run(arguments, Steps(at, stop))
        if code == 99:
            return told
        halves = {
            name
            for name, digest in files(folder).items()
            if not HIDDEN.search(name) and digest not in (before.get(name), wanted.get(name))
        }
        again = run(arguments)
        now = files(folder)
        differ = [name for name in {*now, *wanted} if now.get(name) != wanted.get(name)]
        told.append(
            {"at": at, "code": code, "halves": sorted(halves), "again": again - wanted_code}
            | {"differ": sorted(differ)}
        )
    return told


def size(path):
    return path.stat().st_size if path.exists() else 0


def lies(journal):
    """Records that are whole and speak of files that are not."""
    count = 0
    for line in journal.read_bytes().split(b"\n")[:-1] if journal.exists() else ():
        stamps = json.loads(line)["outputs"].values() if line else ()
        count += any(size(journal.parent / stamp["path"]) != stamp["size"] for stamp in stamps)
    return count


def killed_at_random(seed, kills, journal, arguments):
    """What comes of a command that is killed at moments when its journal has grown."""
    moment, killed, lied = random.Random(seed), 0, 0
    while killed < kills:
        process = start(arguments)
        goal, limit = size(journal) + moment.randrange(3500), time.monotonic() + 5
        while os.waitpid(process, os.WNOHANG)[0] == 0:
            if size(journal) > goal or time.monotonic() > limit:
                time.sleep(moment.random() * 0.02)
                os.kill(process, signal.SIGKILL)
                os.waitpid(process, 0)
                killed += 1
                break
            time.sleep(0.001)
        else:
            break
        lied += lies(journal)
    return {"killed": killed, "lies": lied, "code": run(arguments)}


if __name__ == "__main__":
    from defocus_cli.main import main
    from defocus_core.picture import plain_path

    plain_path.load()
    at = sys.argv.index("--")
    mode, *more, place = sys.argv[1:at]
    if mode == "random":
        told = killed_at_random(*map(int, more), Path(place), sys.argv[at + 1 :])
    else:
        stop = fill if mode == "full" else kill
        told = rounds(stop, int(more[0]), Path(place), sys.argv[at + 1 :])
    sys.stdout.write(json.dumps(told))
