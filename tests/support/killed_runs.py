"""Runs a command in processes that are killed at random moments, until one comes to its end.

    python killed_runs.py SEED KILLS JOURNAL -- ARGUMENT…

What takes seconds to import is imported once: each run is a fork of this process. Prints how many
runs were killed, and how often a record was there without its files.
"""

import json
import os
import random
import signal
import sys
import time
from pathlib import Path


def start(arguments):
    """Run a command in a process of its own."""
    process = os.fork()
    if process:
        return process
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    os._exit(main(arguments))


def ended(process):
    return os.waitpid(process, os.WNOHANG)[0] != 0


def size(path):
    return path.stat().st_size if path.exists() else 0


def lies(journal):
    """Records that are whole and speak of files that are not."""
    count = 0
    for line in journal.read_bytes().split(b"\n")[:-1] if journal.exists() else ():
        stamps = json.loads(line)["outputs"].values() if line else ()
        count += any(size(journal.parent / stamp["path"]) != stamp["size"] for stamp in stamps)
    return count


def run(seed, kills, journal, arguments):
    moment = random.Random(seed)
    killed = lied = 0
    while killed < kills:
        process = start(arguments)
        goal, limit = size(journal) + moment.randrange(3500), time.monotonic() + 5
        while not ended(process):
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
    code = os.waitstatus_to_exitcode(os.waitpid(start(arguments), 0)[1])
    sys.stdout.write(json.dumps({"killed": killed, "lies": lied, "code": code}))


if __name__ == "__main__":
    from defocus_cli.main import main
    from defocus_core.picture import plain_path

    plain_path.load()
    run(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]), sys.argv[5:])
