"""What jobs files, lists, lens files and keys may not say: a row for each door and code."""

import pytest
from jobs_files import FIXED, LENS, jobs, jobs_of, option, touch
from refusals import refuses_as

from defocus_core.request.animation import read_animation, read_keys
from defocus_core.request.pairing import find_pictures
from defocus_core.request.picture_lenses import PictureLenses
from defocus_core.request.resolver import refuse_contradiction

# The door, what it is given, where ¶ ends a line → code and key. Some words stand for long texts.
LINES = """
file [inputs → malformed
file \0 → malformed
file inputs = 3 → malformed
jobs [len] → unknown-name
jobs focus-length = 1 → unknown-name [lens]
jobs file = 'no.toml' → not-found
jobs [outputs] ¶ kinds = ['rendre'] → unknown-name kinds
jobs [outputs] ¶ kinds = [] → malformed kinds
jobs [outputs] ¶ preview = 1 → malformed preview
jobs [outputs] ¶ jpeg-quality = 80 → idle-option jpeg-quality
jobs [reading] ¶ part = -1 → malformed part
jobs [dataset] ¶ license = 'MIT' → unknown-name [dataset]
sweep fnumbr = [2] → unknown-name [sweep]
sweep fnumber = [2, 'x'] → malformed fnumber
sweep fnumber = [2, 2.0] → contradiction [sweep]
sweep focus = ['2m'] ¶ focus-at = ['1,2'] → contradiction focus
sweep focus = '1m..2m' → malformed focus
sweep focus = '1m..inf @ 3 in log' → malformed focus
sweep focus = 'long' → malformed focus
sweep focus = ['4cm'] → out-of-range focus
sweep blades = '5..6 @ 3' → malformed blades
sweep blades = [0, 6] ¶ blade-rotation = [0, 10] → idle-option blade-rotation
sweep lenses = [{fokus = 1}] → unknown-name lenses
sweep lenses = [{focus = 1}] → malformed lenses: focus
sweep lenses = [{fnumber = 2}] ¶ fnumber = [2] → contradiction fnumber
sweep fnumber = '1..2 @ 400' ¶ focus = '1m..2m @ 400' → out-of-range [sweep]
sweep fnumber = '1..2 @ 100001' → out-of-range fnumber
sample seed = 7 → missing-option n
sample n = 5 → missing-option seed
sample n = 0 ¶ seed = 7 → malformed n
sample n = 5 ¶ seed = 7 → idle-option [sample]
sample n = 20000000 ¶ seed = 7 ¶ fnumber = 'uniform(1, 2)' → out-of-range
sample n = 5 ¶ seed = 7 ¶ fnumbr = 'uniform(1, 2)' → unknown-name [sample]
sample n = 5 ¶ seed = 7 ¶ fnumber = 'uniform(4, 2)' → malformed fnumber
sample n = 5 ¶ seed = 7 ¶ focus = 'uniform(percentile(5), 2m)' → malformed focus
sample n = 5 ¶ seed = 7 ¶ focus = 'uniform(4cm, 2m)' → out-of-range focus
sample n = 5 ¶ seed = 7 ¶ blades = 'uniform(5, 9)' → malformed blades
sample n = 5 ¶ seed = 7 ¶ focal-length = 'uniform(20mm, 50mm)' → contradiction focal-length
both n = 1 ¶ seed = 1 ¶ fnumber = 'uniform(1, 2)' → contradiction fnumber
inputs colour = 'a' → unknown-name [inputs]
inputs  → empty [inputs]
inputs depth = '*.exr' → missing-option depth
inputs color = 7 → malformed color
inputs color = 'no.exr' → not-found
inputs color = '*.png' ¶ depth = '1.npy' → wrong-type
inputs color = '*.png' ¶ depth = '*.npy' → empty
inputs color = '[12].*' ¶ depth = '*.npy' → duplicate
inputs color = '*.exr' ¶ hidden-depth = 'h' → missing-option hidden-depth
inputs list = 'l.txt' → wrong-type
inputs pictures = 1 → malformed pictures
inputs [[inputs.pictures]] ¶ depth = '1.npy' → empty [[inputs.pictures]] 1
inputs [[inputs.pictures]] ¶ color = '9.exr' → not-found [[inputs.pictures]] 1
inputs [[inputs.pictures]] ¶ color = 'c.exr' ¶ fokus = '1' → unknown-name [[inputs.pictures]] 1
inputs [[inputs.pictures]] ¶ color = 'c.exr' ¶ stem = 'a/b' → malformed stem
csv  → empty
csv color,color ¶ → duplicate line 1
csv color ¶ c.exr ¶ b.exr,x ¶ → malformed line 3
csv color,speed ¶ c.exr,9 ¶ → unknown-name line 2
csv color,fnumber ¶ c.exr,2 ¶ b.exr,f/x ¶ → malformed fnumber
csv color,focus,focus-at ¶ c.exr,2m,"1,1" ¶ → contradiction focus
csv color ¶ c.exr ¶ d/c.exr ¶ → duplicate line 3
csv color ¶ \udcff ¶ → not-utf-8
jsonl [1] ¶ → malformed line 1
jsonl {"color": "c.exr", "color": "d.exr"} ¶ → malformed line 1
jsonl {"color": ["c.exr"]} ¶ → malformed color
pairs 1.png 2.png - 1.exr → empty
pairs 1.png 1.jpg - 1.exr → duplicate
pairs 1.png - 1.exr 1.npy → duplicate
lens fnumber=2 focus=2m - → missing-option focal-length
lens focal-length=50mm fnumber=2 - focus = "2m" ¶ focus-at = [1, 2] → contradiction focus
lens focal-length=50mm fnumber=2 focus=2m focus-at=1,1 - → contradiction focus
lens focal-length=50mm fnumber=2 focus=50mm - → out-of-range focus
lens focal-length=50mm fnumber=2 focus=2m blades=0 blade-rotation=30 - → idle-option blade-rotation
lens focal-length=50mm fnumber=2 focus=2m - blade-rotation = 30 → idle-option blade-rotation
lens - iso = 100 → unknown-name
lens - focal-length = 50 → malformed focal-length
lens - blades = true → malformed blades
lens - focus 2m → malformed
keys.csv  → empty
keys.csv focus ¶ 1m ¶ → malformed line 1
keys.csv frame,focus ¶ 1 ¶ → malformed line 2
keys.csv frame,focus,focus ¶ 1,1m,1m ¶ → duplicate line 1
keys.csv frame,focus ¶ 1,1m ¶ 1,2m ¶ → duplicate focus
keys.csv \0 → wrong-type
keys.csv many → too-large
keys.csv frame,x,y,focus-at ¶ 1,3,4,"5,6" ¶ → contradiction focus-at
keys.txt 1001 1.5 ¶ → wrong-type
keys.chan 1 0 0 0 0 0 0 ¶ → wrong-type
animated.csv frame,fokus ¶ 1,1m ¶ → unknown-name fokus
animated.csv frame,focus ¶ 1,none ¶ → malformed focus
animated.csv frame,focus,x,y ¶ 1,1m,2,3 ¶ → contradiction focus
animated.toml [lens] ¶ focus = 3 → unknown-name
animated.toml [animate] ¶ focus = {x = "1m"} → malformed focus
split train = 0.9 → malformed [split]
split train = 1.5 → malformed train
split "tr/ain" = 1.0 → malformed tr/ain
split scene = "*" → missing-option scene
"""
MANY = "frame,focus\n" + "".join(f"{frame},2m\n" for frame in range(2**17))


def listed(folder, text, suffix):
    touch(folder, "c.exr")
    (folder / f"l.{suffix}").write_bytes(text.encode(errors="surrogateescape"))
    jobs(folder, FIXED, inputs=f"list = 'l.{suffix}'")


def drawn(folder, text, table):
    lens = "".join(
        line for line in ("fnumber = 2\n", 'focus = "2m"\n') if line.split()[0] not in text
    )
    more = "[sweep]\nfnumber = [2]\n" if table == "both" else ""
    table = "sample" if table == "both" else table
    jobs(folder, f"{LENS}{lens}{more}[{table}]\n{text}\n")


def lens(folder, text):
    flags, _, said = text.partition("-" if text.startswith("-") else " -")
    own = {n: option(n, v) for n, v in (f.split("=") for f in flags.split())}
    refuse_contradiction(own)
    (folder / "lens.toml").write_text(said)
    assert PictureLenses(own, file=folder / "lens.toml").fixed


def inputs(folder, text):
    touch(folder, "1.png", "1.jpg", "2.png", "1.npy", "3.npy", "c.exr", "l.txt")
    jobs(folder, FIXED, inputs=text or "\n")


def file(folder, text):
    (folder / "jobs.toml").write_text(text)
    jobs_of(folder / "jobs.toml", folder)


def pairs(folder, text):
    color, depth = (touch(folder / str(n), *s.split()) for n, s in enumerate(text.split(" - ")))
    find_pictures(color, depth)


def keys(folder, text, suffix, read):
    (folder / f"a.{suffix}").write_text(MANY if text == "many" else text)
    read(folder / f"a.{suffix}")


def give(folder, door, text):
    """Hand a text in at a door."""
    door, _, suffix = door.partition(".")
    match door:
        case "jobs":
            jobs(folder, FIXED + text)
        case "split":
            jobs(folder, f"{FIXED}[split]\n{text}")
        case "sweep" | "sample" | "both":
            drawn(folder, text, door)
        case "csv" | "jsonl":
            listed(folder, text, door)
        case "keys":
            keys(folder, text, suffix, read_keys)
        case "animated":
            keys(folder, text, suffix, lambda path: read_animation([str(path)]))
        case _:
            {"lens": lens, "inputs": inputs, "file": file, "pairs": pairs}[door](folder, text)


@pytest.mark.parametrize("line", LINES.strip().splitlines())
def test_what_makes_no_sense_is_refused_with_its_place(line, tmp_path):
    said, refusal = line.split(" → ")
    door, _, text = said.partition(" ")
    text = text.replace("long", 1000 * "1m..2m@").replace(" ¶ ", "\n").replace(" ¶", "\n")
    with refuses_as(refusal):
        give(tmp_path, door, text)
