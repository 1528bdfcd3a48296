"""What a user sees of mistakes: each a row with its exit code, its code and its line.

Every mistake ends in one line that names the file or the option, the problem and the remedy. Exit
code 2 is usage, 3 is input or output. Nothing is written. Other tests assert codes, files and keys.
"""

import os
import shlex
import socket
import subprocess
import sys
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import (
    color_exr,
    depth_exr,
    files_under,
    pair,
    photograph,
    ramp,
    refused,
    refused_input,
    render,
    run,
    succeed,
    texture,
    write_exr,
)
from image_files import multi_part, save, write_deep

from defocus_core.batch.journal.runs import locked

HEAD = """[inputs]
color = "rgb.exr"
depth = "z.exr"
[lens]
focal-length = "50mm"
fnumber = 2
"""
OUTSIDE = 'focal-length = "50mm"\nfnumber = 2\nfocus-at = [24, 0]\n'
TOML: dict[str, str | bytes] = {
    "jobs": HEAD + 'focus = "2m"\n',
    "sweep": HEAD + "[sweep]\nfnumbr = [2]\n",
    "match": HEAD + '[sample]\nn = 2\nseed = 1\nmatch = "set"\n',
    "idle": HEAD + '[reading]\ndepth-repair = "off"\nedge-width = "4px"\n',
    "wide": HEAD + "[reading]\nedge-width = 101\n",
    "self": '[inputs]\ncolor = "link/**/*.exr"\ndepth = "z.exr"\n',
    "radii": HEAD.replace("z.exr", "coc.exr") + '[reading]\ndepth-format = "coc"\n',
    "misspelt": 'focal-lenght = "50mm"\n',
    "underscored": 'Focal_Length = "50mm"\n',
    "outside": OUTSIDE,
    "near": OUTSIDE.replace("24", "0"),
    "semicolons": '[inputs]\nlist = "semicolons.csv"\n[lens]\n',
    "numpy": b"\x93NUMPY\x01\xff\xfe",
    "brackets": "[" * 100_000,
}

# The command → its exit code, the code of the error or "-", and the line; a line that depends on
# the machine, or says what another row says, ends in "…". Of commands R is
# `render rgb.exr z.exr -o out LENS`, B is `batch -o out`, and C compares rgb.exr with itself.
WORDS = {
    "R": "render rgb.exr z.exr -o out LENS",
    "B": "batch -o out",
    "C": "compare rgb.exr rgb.exr",
    "LENS": "--focal-length 50mm --fnumber 2 --focus 2m",
    "BLUR": "--blur 8px --focus-value 2",
}
LINES = """
R --focus-at 1,1 → 2 contradiction --focus: contradicts --focus-at; give one of them
R --edge-width 4 --depth-repair off → \
2 contradiction --edge-width: of 4px contradicts depth-repair off; leave one of them out
B idle.toml → \
2 contradiction idle.toml: [reading] edge-width: of 4px contradicts depth-repair off; leave one \
of them out
R --blade-rotation 10deg → \
2 idle-option --blade-rotation: turns blades; this aperture has none; add --blades 6, or leave it \
out
R --vignetting on → \
2 idle-option --vignetting: has no effect without a rim; add --cat-eye 1.05:1.5, or leave it out
R --noise-seed 3 → \
2 idle-option --noise-seed: has no effect without noise; add --noise 4000:3, or leave it out
R --format jpg --exr-type half → \
2 idle-option --exr-type: has no effect on jpg; leave it out, or write the format exr
R --format png --jpeg-quality 80 → \
2 idle-option --jpeg-quality: has no effect on png; leave it out, or write the format jpg
fit rgb.exr z.exr rgb.exr --dual-pixel → \
2 idle-option --dual-pixel: has no effect without the right picture; add --right FILE
render rgb.exr coc.exr -o out --depth-format coc --focus-at 3,3 → \
2 idle-option --focus-at: has no effect: with depth-format coc, the files hold the radii; …
render rgb.exr z.exr -o out --fnumber 2 --focus 2m → \
2 missing-option --focal-length: is missing; run: defocus render --json rgb.exr z.exr -o out \
--fnumber 2 --focus 2m --lens @portrait-85
render rgb.exr z.exr -o out → \
2 missing-option --focal-length: is missing, as are --fnumber and --focus; run: defocus render \
--json rgb.exr z.exr -o out --lens @portrait-85 --focus-at 4,7
info z.exr --focal-length 50mm → \
2 missing-option --fnumber: is missing, as is --focus; add --fnumber 1.4, --focus 2m or \
--focus-at, or a --lens FILE that has them
R -o a.hdr → \
2 wrong-type a.hdr: is of a type that is not written; end its name in .exr, .png, .tif, .jpg, .webp
R --lens @portrait-58 → \
2 unknown-name --lens: no lens @portrait-58 ships with defocus; did you mean @portrait-85?
R --lens underscored.toml → \
2 unknown-name underscored.toml: unknown key 'Focal_Length'; did you mean focal-length?
R --lens misspelt.toml → \
2 unknown-name misspelt.toml: unknown key 'focal-lenght'; did you mean focal-length?
B match.toml → \
2 unknown-name match.toml: [sample]: unknown key 'match'; it was removed in 0.2.0: …
retry out → 2 unknown-name retry: no such command; it was removed in 0.2.0: …
B sweep.toml → 2 unknown-name sweep.toml: [sweep]: unknown key 'fnumbr'; did you mean fnumber?
rendr → 2 unknown-name rendr: no such command; did you mean render?
bokeh → 2 unknown-name bokeh: no such command; see 'defocus --help'
help lenses → 2 unknown-name lenses: no such topic; topics are conventions, look, photo, …
R --focus 2 → 2 malformed --focus: '2' has no unit; write it with a unit, like 2m or 50mm
R --focus percentile(101) → 2 malformed --focus: …
R --focus 'percentile(5, 95)' → 2 malformed --focus: …
R --fnumber 0 → 2 malformed --fnumber: '0' is not positive and finite; give one that is, like 1.4
R --outputs coc,rendr → 2 unknown-name --outputs: 'rendr' is not known; did you mean render?
R --blades 2 → 2 malformed --blades: 2 blades make no aperture; give 0 (round) or 3 and more
R --obstruction 2 → \
2 malformed --obstruction: '2' is not a share of the radius; give 0 to 0.95, like 0.4
R --noise 1000 → \
2 malformed --noise: '1000' is not a sensor noise; write match, or ELECTRONS:READ, like 4000:3
R --depth-repair of → 2 unknown-name --depth-repair: 'of' is not known; did you mean off?
R --depth-format kiti → 2 malformed --depth-format: 'kiti' is not known; did you mean kitti?
B wide.toml → \
2 malformed wide.toml: [reading] edge-width: '101' is not the width of an edge; give 0 to \
100, like 8px
C --fail psnr>45 → \
2 malformed --fail: 'psnr>45' is met by the better pictures: higher psnr is better; write psnr<45
C --region 1,2,3 → \
2 malformed --region: '1,2,3' is not a region; write X,Y,WIDTH,HEIGHT in px, like 0,0,64,64
R --focus 30mm → \
2 out-of-range --focus: 30mm is not farther than the focal length 50mm; focus farther away than \
that, or give a shorter focal length
render rgb.exr z.exr -o out --focal-length 50mm --fnumber 2 --focus-at 24,0 → \
2 out-of-range --focus-at: 24,0 lies outside z.exr of 24x16 px; give X from 0 to 23 and Y from 0 \
to 15
render none.exr z.exr -o out LENS → 3 not-found none.exr: no such file or directory; check the name
B none.toml → \
3 not-found none.toml: cannot be read: No such file or directory; give a jobs file, with tables \
[inputs] and [lens]
render lost z.exr -o out LENS → \
3 not-found lost: is a symbolic link that leads to nothing; make the link anew, or name another path
B self.toml → \
3 circular-link link/self: is a symbolic link to a folder that contains it; remove it, or use a \
narrower pattern
info link → 3 wrong-type link: is a directory, not an image; name a file in it
render rgb.exr z.exr -o out.png LENS --outputs coc → \
2 wrong-type out.png: cannot hold coc; give it another suffix
compare link rgb.exr → \
3 wrong-type link: is a directory but rgb.exr is a file; name two files, or two directories
status link → 3 empty link: has no journal; name the directory that a batch writes to
merge link → 3 empty link: …
bench --truth link → \
3 empty link: holds no <scene>/camera.json with shots; name a directory of scenes
R --lens '' → 2 empty --lens: is empty; give a path
render rgb.exr rgb.exr -o out LENS → \
3 no-depth rgb.exr: has no depth channel, only R, G, B; if one of them is the depth, give \
--depth-channel NAME
render deep.exr z.exr -o out LENS → \
3 no-color deep.exr: has no colour channels (R, G, B or Y), only Z; name a file that has them
render rgb.exr two.exr -o out LENS → \
3 ambiguous two.exr: has 2 candidates for the depth channel: depth.Z, other.depth; choose one, \
like --depth-channel depth.Z, or a part with --part
render layers.exr z.exr -o out LENS → \
3 ambiguous layers.exr: has 2 candidates for the colour layer: sun/RGB, lamp/RGB; choose one, \
like --color-layer sun/RGB, or a part with --part
info layers.exr --part 2 → \
3 no-such-part layers.exr: has no part 2, only 2; --part counts from 0 to 1
info rgb.exr --part 1 → 3 no-such-part rgb.exr: has no part 1, only 1; leave --part out
info z.exr --depth-channel W → \
3 no-such-channel z.exr: has no channel W; it has Z; check --depth-channel
R --view left → 3 no-such-view rgb.exr: has no views, and so no view left; leave --view out
render rgb.exr double.exr -o out LENS → \
3 wrong-size double.exr: is 48x32 px but its colour is 24x16 px; give depth of the size of the \
colour, or give --resize-depth guided, or nearest
render rgb.exr square.exr -o out LENS --resize-depth guided → \
3 wrong-size square.exr: is 5x5 px but its colour is 24x16 px, of another aspect; give depth of \
the view that the colour shows, all of it
render rgb.exr holes.exr -o out LENS → \
3 invalid-depth holes.exr: is NaN or ≤ 0 in 2 pixels, the first at 5,7; fill the holes, and write \
inf for sky; or give --invalid far, or fill
render nan.exr z.exr -o out LENS → \
3 not-finite nan.exr: is NaN or infinite in 1 pixel, the first at 4,3; render or save it again \
with finite values
render rgb.exr tiny.exr -o out LENS → \
3 too-blurred tiny.exr: has a depth of 1e-18 m, which is blurred by 4.3e+17 px; check \
--depth-unit and --focus
info z.npy → 3 unknown-unit z.npy: holds uint16 numbers, whose unit is unknown; give --depth-unit mm
render rgb.exr z8.png -o out LENS → \
3 unknown-unit z8.png: has 8 bits, too few for depth and without a metric scale; save depth as \
EXR, PFM, NPY or float TIFF, or 16-bit PNG in millimetres; or give --depth-range NEAR FAR and \
--depth-kind; \
or take it as relative with --blur 20px --focus-at X,Y instead of a lens
render rgb.exr smallcoc.exr -o out --depth-format coc --resize-depth nearest → \
3 radii smallcoc.exr: holds radii in px of a picture of 12x8 px; give radii of the size of the \
colour
depth coc.exr --depth-format coc -o z2.exr → \
2 radii --depth-format: holds radii of a lens, and no depth; give such files to 'defocus render'
depth z.exr coc.exr -o z2.exr → \
2 one-file --out: is one file, and there are 2 to convert; name a directory, without .exr
depth z.exr -o depth.png → \
2 malformed --out: ends in .png, and depth is written as EXR; end it in .exr, or name a directory
compare rgb.exr rgb.exr --html page.png → \
2 malformed page.png: is the name of a picture, not of a report; end its name in .html
depth z.exr -o small.exr → \
3 exists small.exr: exists already; name another output, or add --overwrite
render rgb.exr z.exr -o done LENS --outputs coc → \
3 exists done/coc/rgb.exr: exists already, and the journal does not know it; move it away, choose \
another -o, or add --overwrite to render all again
render rgb.exr z.exr -o rgb.exr LENS --overwrite → \
3 replaces-input rgb.exr: is an input and would be overwritten; name another output
render rgb.####.exr z.####.exr -o out LENS → \
3 missing-frames z.####.exr: lacks 1 frame, 3; give --missing skip to leave them out, or name \
others with --frames
B jobs.toml --shards-size 1GB --shard 1/2 → \
2 whole-batch --shards-size: needs the whole batch; give it to 'defocus merge'
B jobs.toml --scheduler head → 2 malformed --scheduler: 'head' is not a scheduler; …
merge held → 3 in-use held/.journal.lock: held is being written by process …
R --quality best → \
2 unknown-name --quality: 'best' is not known; choose from standard, high, reference
R --threads 0 → 2 malformed --threads: 0 is not in the range 1 to 1024; give one that is
R --focal-lenght 50mm → 2 - --focal-lenght: no such option; did you mean --focal-length or …
R more → 2 - command line: Got unexpected extra argument (more); see 'defocus render --help'
R --fnumber → 2 - --fnumber: requires an argument; see 'defocus render --help'
--nonsense → 2 - --nonsense: no such option; see 'defocus --help'
render → 2 - COLOR: is missing; see 'defocus render --help'
info → 2 - FILE...: is missing; see 'defocus info --help'
render rgb.exr z.exr → 2 - --out: is missing; add -o OUT
B jobs.toml --quality high → \
2 - --quality: no such option; write quality below [machine] of the jobs file
R --fnumber 1e-300 → 2 out-of-range --fnumber: f/1e-300 makes the blur of this picture infinite; …
render rgb.exr near.exr -o out --focal-length 50mm --fnumber 2 --focus-at 0,0 → \
2 out-of-range --focus-at: near.exr at 0,0: 10mm is not farther than the focal length 50mm; …
render rgb.exr near.exr -o out --lens near.toml → \
2 out-of-range near.toml: focus-at: near.exr at 0,0: 10mm is not farther than …
render rgb.exr z.exr -o out --lens outside.toml → \
2 out-of-range outside.toml: focus-at: 24,0 lies outside z.exr of 24x16 px; …
render rgb.exr z.exr -o out --lens outside.toml --focus-at 24,0 → \
2 out-of-range --focus-at: 24,0 lies outside z.exr of 24x16 px; …
R --lens numpy.toml → 3 malformed numpy.toml: is not a text file; …
R --lens brackets.toml → 3 malformed brackets.toml: is not TOML: …
R --lens pipe.toml → 3 unreadable pipe.toml: cannot be read: is not a regular file; …
R --lens link → 3 unreadable link: cannot be read: Is a directory; …
R --lens none.toml → 3 not-found none.toml: cannot be read: No such file or directory; …
R --lens portrait-85 → 2 unknown-name --lens: no file portrait-85; did you mean @portrait-85?
render grey.exr -o out LENS → \
3 no-depth grey.exr: has Y alone, which is not both colour and depth; …
render '' z.exr -o out LENS → 2 empty COLOR: is empty; give a path
R -o '' → 2 empty --out: is empty; give a path
render rgb.0001.exr rgb.0002.exr -o out LENS → \
2 contradiction rgb.0002.exr: looks like the next frame of rgb.0001.exr, not its depth; …
render 1001-1005#.exr -o out LENS → \
3 not-found 1001-1005#.exr: matches no file; write 'shot.####.exr', and the range as --frames \
1001-1005
render no*.png z.exr -o out LENS → 3 not-found no*.png: matches nothing: …
R --animate semicolons.csv → \
3 malformed semicolons.csv: line 1: has semicolons between its cells; write commas
B semicolons.toml → 3 malformed semicolons.csv: line 1: has semicolons …
R -q -v → 2 contradiction --quiet: contradicts -v; leave one of them out
R -o text.txt → 3 wrong-type text.txt: is a file where a directory is needed; choose another -o
R -o lost → 3 not-found lost: is a symbolic link that leads to nothing; …
R -o x.gif → 2 wrong-type x.gif: is of a type that is not written; …
R --animate pipe.csv → 3 unreadable pipe.csv: cannot be read: is not a regular file; check the path
batch pipe.toml -o out → 3 unreadable pipe.toml: cannot be read: is not a regular file; …
R -o p.png --outputs left,right → 2 contradiction --outputs: …
R -o p.png --preview → 2 contradiction --preview: …
R -o p.png --format jpg → 2 wrong-type p.png: …
compare rgb.exr nowhere.exr → 3 not-found nowhere.exr: no such file or directory; check the name
compare bare bare → 3 empty bare: …
C --region 1,2,0,3 → 2 malformed --region: '1,2,0,3' holds no pixel; write X,Y,WIDTH,HEIGHT in px
C --warn brightness>1 → 2 malformed --warn: 'brightness' is not a metric; …
C --over much → 2 malformed --over: 'much' is not a difference of 0 or more; write 0.01
C --thresholds nowhere.toml → 3 not-found nowhere.toml: cannot be read: No such file or directory; …
bench --truth nowhere → 3 empty nowhere: …
bench --quality best → 2 malformed --quality: …
R --spherical much → 2 malformed --spherical: …
R --squeeze 0.5 → 2 malformed --squeeze: …
R --blade-curvature 0.5 → 2 idle-option --blade-curvature: …
R --aperture-image x.png --blades 5 → 2 contradiction --blades: …
R --noise 100:1 --noise-seed -3 → 2 malformed --noise-seed: …
R --dp-model round → 2 malformed --dp-model: …
R --dp-crosstalk 0.6 → 2 malformed --dp-crosstalk: …
R --blades 6 --obstruction 0.95 → 2 contradiction --obstruction: …
R --obstruction 0.4 --cat-eye 0.3:0.1 → 2 contradiction --cat-eye: …
R --axial-color 0.2:0.2 → 2 malformed --axial-color: …
R --highlights 2 → 2 malformed --highlights: …
R --sharp-range 2.4m..1.8m → 2 malformed --sharp-range: …
render rgb.exr numbers.exr -o out BLUR --fnumber 2 → 2 contradiction --fnumber: …
render rgb.exr numbers.exr -o out BLUR --radial → 2 contradiction --radial: …
render rgb.exr numbers.exr -o out --blur 8px --focus-at 99,1 --invert → 2 out-of-range --focus-at: …
render rgb.exr numbers.exr -o out LENS --invert → 2 idle-option --invert: …
render rgb.exr numbers.exr -o out LENS --focus-value 2 → 2 idle-option --focus-value: …
"""
ROWS = [row.split(" → ") for row in LINES.replace("\\\n", "").strip().splitlines()]

# Files that are no pictures: the codes as colour and as depth, "-" where another test says it.
UNUSABLE = {
    "circle.exr": "not-found not-found",
    "lost.exr": "not-found not-found",
    "pipe.exr": "wrong-type wrong-type",  # whose first byte may never come
    "zero.exr": "wrong-type wrong-type",  # whose last byte never comes
    "socket.exr": "wrong-type wrong-type",
    "empty.exr": "empty empty",
    "empty.png": "empty empty",
    "text.exr": "wrong-type wrong-type",
    "text.png": "unreadable unreadable",
    "text.txt": "unreadable unreadable",
    "c.bmp": "wrong-type wrong-type",
    "c.dpx": "wrong-type wrong-type",
    "c.gif": "wrong-type wrong-type",
    "rgb05.exr": "damaged damaged",
    "rgb90.exr": "damaged damaged",
    "z90.exr": "- damaged",
    "c05.png": "damaged damaged",
    "c90.png": "damaged -",
}


def write_pictures(folder):
    """Files of each kind, and files that are no pictures."""
    color, depth = color_exr(folder / "rgb.exr"), depth_exr(folder / "z.exr")
    bytes_of_rgb = (texture() * 255).astype(np.uint8)
    for suffix in ("gif", "bmp", "dpx", "png"):
        save(folder / f"c.{suffix}", bytes_of_rgb)
    for path in (color, depth, folder / "c.png"):
        data = path.read_bytes()
        for percent in (5, 90):
            cut = folder / f"{path.stem}{percent:02}{path.suffix}"
            cut.write_bytes(data[: len(data) * percent // 100])
    for name in ("text.exr", "text.png", "text.txt"):
        (folder / name).write_text("This is not an image, whatever its name says.\n" * 20)
    for name in ("empty.exr", "empty.png"):
        (folder / name).touch()
    for name in ("pipe.exr", "pipe.toml", "pipe.csv"):
        os.mkfifo(folder / name)
    links = {"zero.exr": "/dev/zero", "self": ".", "circle": "circle", "lost": "none"}
    for name, target in {**links, "circle.exr": "circle.exr", "lost.exr": "none"}.items():
        (folder / ("link/self" if name == "self" else name)).symlink_to(target)
    save(folder / "z8.png", np.full((16, 24, 1), 9, np.uint8))
    np.save(folder / "z.npy", (ramp() * 1000).astype(np.uint16))
    write_deep(folder / "deep.exr")
    depth_exr(folder / "small.exr", ramp(12, 8))
    depth_exr(folder / "square.exr", ramp(5, 5))
    depth_exr(folder / "double.exr", ramp(48, 32))
    depth_exr(folder / "near.exr", ramp() / 100)
    write_exr(folder / "numbers.exr", Z=ramp() - 2)  # no metres
    write_exr(folder / "coc.exr", coc=ramp() * 2 - 5)
    write_exr(folder / "smallcoc.exr", coc=ramp(12, 8) * 2 - 5)
    write_exr(folder / "two.exr", near_Z=ramp(), depth_Z=ramp(), other_depth=ramp())
    write_exr(folder / "grey.exr", Y=ramp())
    write_exr(folder / "greypass.exr", pass_y=ramp())
    rgb = {channel: texture()[..., 0] for channel in "RGB"}
    multi_part(folder / "layers.exr", sun=rgb, lamp=rgb)
    for name, bad in (("holes", np.nan), ("tiny", 1e-18)):
        metres = ramp()
        metres[7, 5] = metres[8, 1] = bad
        depth_exr(folder / f"{name}.exr", metres)
    pixels = texture()
    pixels[3, 4, 1] = np.nan
    color_exr(folder / "nan.exr", pixels)


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder with one file of each kind."""
    folder = tmp_path_factory.mktemp("desk")
    for name in ("link", "held", "bare"):
        (folder / name).mkdir()
    (folder / "held" / "journal.jsonl").touch()
    for name, text in TOML.items():
        (folder / f"{name}.toml").write_bytes(text if isinstance(text, bytes) else text.encode())
    write_pictures(folder)
    depth_exr(folder / "done" / "coc" / "rgb.exr")
    (folder / "semicolons.csv").write_text("frame;focus\n1;2m\n")
    for frame in (1, 2, 3):
        color_exr(folder / f"rgb.{frame:04}.exr")
        if frame < 3:
            depth_exr(folder / f"z.{frame:04}.exr")
    with chdir(folder), socket.socket(socket.AF_UNIX) as made:  # whose name must be short
        made.bind("socket.exr")
    return folder


@pytest.fixture
def at_desk(desk):
    """There, where a test must leave what it found."""
    before = sorted(map(str, desk.rglob("*")))
    with chdir(desk):
        yield
    left = sorted(path for path in map(str, desk.rglob("*")) if "held" not in path)
    assert left == [path for path in before if "held" not in path]


def words_of(text):
    for short, words in WORDS.items():
        text = " ".join(words if word == short else word for word in text.split(" "))
    return shlex.split(text)


@pytest.mark.parametrize(("words", "wanted"), ROWS)
def test_what_a_user_sees(words, wanted, desk, at_desk):
    args = words_of(words)
    with locked(desk / "held"):
        ran = run(args[0], *(["--json"] if args[0] != "help" else []), *args[1:])
    exit_code, code, line = wanted.split(" ", 2)
    said = ran.err.removeprefix("defocus: ").removesuffix("\n")
    assert said == line or (line.endswith("…") and said.startswith(line[:-1]))
    assert "\n" not in said
    assert ran.code == int(exit_code)
    if args[0] != "help":  # which prints no document
        error = {"message": said, "exit_code": ran.code, "code": None if code == "-" else code}
        assert ran.json["error"] == error


@pytest.mark.parametrize("name", UNUSABLE)
def test_a_file_that_is_no_picture_is_refused_as_colour_as_depth_and_by_info(name, at_desk):
    files = (name, "z.exr"), ("rgb.exr", name)
    for words, code in zip(files, UNUSABLE[name].split(), strict=True):
        if code == "-":
            continue
        refused_input(render(*words, "-o", "out"), Path(name), code)
        refused_input(run("info", name), Path(name), "unreadable", code)
        if code in ("not-found", "empty") or name.startswith(("pipe", "zero", "socket")):
            assert render(*words, "-o", "out", "--dry-run").code == 3


def test_pictures_of_other_formats_alone_in_a_folder_are_none(tmp_path, depth, out):
    for name in ("c.bmp", "c.dpx"):
        path = save(tmp_path / name[2:] / name, (texture() * 255).astype(np.uint8))
        refused_input(render(path.parent, depth.parent, "-o", out), path.parent, "empty")


def test_a_link_in_a_folder_that_leads_in_a_circle(tmp_path, out):
    for stem in "ab":
        color, depth = pair(tmp_path, stem)
    color.unlink()
    color.symlink_to(color.name)
    ran = render(color.parent, depth.parent, "-o", out, "--outputs", "coc")
    assert ran.code == 1
    assert f"defocus: {color}: is a symbolic link that leads to nothing" in ran.err
    assert files_under(out) == {"coc/a.exr"}


def test_names_that_would_steer_a_terminal_are_told_escaped(color, depth, out):
    odd = color.rename(color.with_name("a\n\x1b[31mb\u3000é.exr"))
    told = "a\\n\\x1b[31mb\u3000é"
    refused(render(odd.with_suffix(".png"), depth, "-o", out), 3, "not-found", f"{told}.png")
    refused(render(odd, odd, "-o", out), 3, "no-depth", f"{told}.exr")
    for ran in (render(odd, depth, "-o", out, "-v"), render(odd, depth, "-o", out)):
        assert ran.code == 0
        assert f"{told}: " in ran.err
        assert f"/{told}.exr" in ran.err
        assert "\x1b" not in ran.err
    for ran in (run("info", odd), render(odd, depth, "-o", "new", "--dry-run")):
        assert told in ran.out
        assert "\x1b" not in ran.out


@pytest.mark.skipif(sys.platform != "linux", reason="not on this system: names are Unicode")
def test_a_name_that_is_not_utf_8(color, depth, out):
    odd = color.rename(color.with_name(os.fsdecode(b"\xff.exr")))
    for files in ((odd, depth), (odd,)):
        refused(render(*files, "-o", out), 3, "not-utf-8", "\\udcff.exr")


@pytest.mark.parametrize(
    "stem", ["photo – ünï.v2.final", "-dash", "{a,b} %d", "new\nline", "🎞" * 50]
)
def test_any_other_name_will_do(stem, color, depth, out):
    named = color.rename(color.with_name(f"{stem}.exr"))
    photograph("-o", out, "--preview", "--format", "png", "--", named, depth)
    assert files_under(out) == {f"render/{stem}.png", f"render/{stem}.preview.png"}


def test_no_arguments_show_help():
    ran = succeed()
    assert "render" in ran.out


@pytest.mark.skipif(torch.cuda.is_available(), reason="not on this system: it has a GPU")
def test_cuda_that_is_not_there(color, depth, out):
    refused(render(color, depth, "-o", out, "--device", "cuda"), 2, "no-gpu", "device")
    photograph(color, depth, "-o", out, "--device", "auto")


def test_the_module_of_the_command_line_is_the_command():
    words = [sys.executable, "-m", "defocus_cli.main", "--version"]
    ran = subprocess.run(words, capture_output=True, text=True, check=True)
    assert ran.stdout.startswith("defocus ")


def test_quiet_says_only_what_is_wrong(tmp_path, out):
    for loud, words in ((False, ("-q",)), (False, ("-q",)), (True, ())):
        ran = render(*pair(tmp_path), "-o", out, "--outputs", "coc", *words)
        assert (ran.err != "") == loud


def test_a_batch_blames_the_jobs_file_for_a_focus_that_it_has(desk, tmp_path):
    jobs = tmp_path / "focus.toml"
    jobs.write_text(HEAD.replace('= "', f'= "{desk}/', 2) + "focus-at = [24, 0]\n")
    assert f"defocus: {jobs}: [lens] focus-at: " in run("batch", jobs, "-o", tmp_path / "o").err
