"""The words of errors: what a user sees, in one table. Other tests assert codes, files and keys."""

import shlex

import numpy as np
import pytest
from command_line import color_exr, depth_exr, ramp, run, texture, write_exr
from image_files import multi_part, save, write_deep

from defocus_core.batch.journal.lock import locked

LENS = "--focal-length 50mm --fnumber 2 --focus 2m"
HEAD = """[inputs]
color = "rgb.exr"
depth = "z.exr"
[lens]
focal-length = "50mm"
fnumber = 2
"""
JOBS = {
    "jobs": HEAD + 'focus = "2m"\n',
    "sweep": HEAD + "[sweep]\nfnumbr = [2]\n",
    "match": HEAD + '[sample]\nn = 2\nseed = 1\nmatch = "set"\n',
    "twice": HEAD + '[reading]\ndepth-repair = "off"\n[machine]\ndepth-repair = "auto"\n',
    "idle": HEAD + '[reading]\ndepth-repair = "off"\nedge-width = "4px"\n',
    "wide": HEAD + "[reading]\nedge-width = 101\n",
    "self": '[inputs]\ncolor = "link/**/*.exr"\ndepth = "z.exr"\n',
    "radii": HEAD.replace("z.exr", "coc.exr") + '[reading]\ndepth-format = "coc"\n',
}

# The command, the code, and the line, or where it depends on the machine, how it begins and "…".
# R stands for `render rgb.exr z.exr -o out` and the options of a lens, B for `batch -o out`.
LINES = """
R --focus-at 1,1
contradiction --focus: contradicts --focus-at; give one of them
R --aperture-diameter 25mm
contradiction --fnumber: contradicts --aperture-diameter; give one of them
R --edge-width 4 --depth-repair off
contradiction --edge-width: of 4px contradicts depth-repair off; leave one of them out
B twice.toml
contradiction twice.toml: [machine] depth-repair: stands in [reading], too; keep one of them
B idle.toml
contradiction idle.toml: [reading] edge-width: of 4px contradicts depth-repair off; \
leave one of them out
R --blade-rotation 10deg
idle-option --blade-rotation: turns blades; this aperture has none; \
add --blades 6, or leave it out
R --vignetting on
idle-option --vignetting: has no effect without a rim; add --cat-eye 1.05:1.5, or leave it out
R --noise-seed 3
idle-option --noise-seed: has no effect without noise; add --noise 4000:3, or leave it out
R --format jpg --exr-type half
idle-option --exr-type: has no effect on jpg; leave it out, or write the format exr
R --format png --jpeg-quality 80
idle-option --jpeg-quality: has no effect on png; leave it out, or write the format jpg
fit rgb.exr z.exr rgb.exr --side-shading
idle-option --side-shading: has no effect without the right picture; \
add --right FILE, or leave it out
render rgb.exr coc.exr -o out --depth-format coc --focus-at 3,3
idle-option --focus-at: has no effect: with depth-format coc, the files hold the radii; …
render rgb.exr z.exr -o out --fnumber 2 --focus 2m
missing-option --focal-length: is missing; run: defocus render --json rgb.exr z.exr -o out \
--fnumber 2 --focus 2m --lens @portrait-85
render rgb.exr z.exr -o out
missing-option --focal-length: is missing, as are --fnumber and --focus; \
run: defocus render --json rgb.exr z.exr -o out --lens @portrait-85 --focus-at 6,7
info z.exr --focal-length 50mm
missing-option --fnumber: is missing, as is --focus; add --fnumber 1.4 or --aperture-diameter, \
--focus 2m or --focus-at, or a --lens FILE that has them
R -o a.hdr
wrong-type a.hdr: is of a type that is not written; end its name in .exr, .png, .tif, .jpg, .webp
R --lens @portrait-58
unknown-name --lens: no lens @portrait-58 ships with defocus; did you mean @portrait-85?
R --lens underscored.toml
unknown-name underscored.toml: unknown key 'Focal_Length'; did you mean focal-length?
R --lens misspelt.toml
unknown-name misspelt.toml: unknown key 'focal-lenght'; did you mean focal-length?
B match.toml
unknown-name match.toml: [sample]: unknown key 'match'; [sample] knows n, seed, max-coc, …
B sweep.toml
unknown-name sweep.toml: [sweep]: unknown key 'fnumbr'; did you mean fnumber?
rendr
unknown-name rendr: no such command; did you mean render?
bokeh
unknown-name bokeh: no such command; see 'defocus --help'
help lenses
unknown-name lenses: no such topic; topics are conventions, look, photo, …
R --focus 2
malformed --focus: '2' has no unit; write it with a unit, like 2m or 50mm
R --fnumber 0
malformed --fnumber: '0' is not positive and finite; give one that is, like 1.4
R --outputs coc,rendr
unknown-name --outputs: 'rendr' is not known; did you mean render?
R --blades 2
malformed --blades: 2 blades make no opening; give 0 (round) or 3 and more
R --obstruction 2
malformed --obstruction: '2' is not a share of the radius; give 0 to 0.95, like 0.4
R --noise 1000
malformed --noise: '1000' is not a noise of a sensor; write ELECTRONS:READ, like 4000:3
R --depth-repair of
malformed --depth-repair: 'of' is not known; did you mean off?
R --depth-format kiti
malformed --depth-format: 'kiti' is not a depth format; did you mean kitti or vkitti or vkitti2? \
'defocus help depth' lists all of them
B wide.toml
malformed wide.toml: [reading] edge-width: 101 px is a surface, and no edge; give 100px or less
compare rgb.exr rgb.exr --fail psnr>45
malformed --fail: 'psnr>45' is met by the better pictures: higher psnr is better; \
write psnr<45
compare rgb.exr rgb.exr --region 1,2,3
malformed --region: '1,2,3' is not a region; write X,Y,WIDTH,HEIGHT in px, like 0,0,64,64
R --focus 30mm
out-of-range --focus: 30mm is not farther than the focal length 50mm; \
focus farther away than that, or give a shorter focal length
render rgb.exr z.exr -o out --focal-length 50mm --fnumber 2 --focus-at 24,0
out-of-range --focus-at: 24,0 lies outside z.exr of 24x16 px; give X from 0 to 23 and Y from 0 to 15
render none.exr z.exr -o out LENS
not-found none.exr: no such file or directory; check the name
B none.toml
not-found none.toml: cannot be read: No such file or directory; \
give a jobs file, with tables [inputs] and [lens]
render lost z.exr -o out LENS
not-found lost: is a symbolic link that leads to nothing; make the link anew, or name another path
B self.toml
circular-link link/self: is a symbolic link to a folder that it is in; \
remove it, or use a narrower pattern
info link
wrong-type link: is a directory, not an image; name a file in it
render rgb.exr z.exr -o out.png LENS --outputs coc
wrong-type out.png: cannot hold coc; give it another suffix
compare link rgb.exr
wrong-type link: is a directory but rgb.exr is a file; name two files, or two directories
render c.gif z.exr -o out LENS
wrong-type c.gif: …
render empty.exr z.exr -o out LENS
empty empty.exr: …
render rgb.exr text.exr -o out LENS
wrong-type text.exr: …
info text.png
unreadable text.png: is not an image that can be read (…
status link
empty link: has no journal; name the directory that a batch writes to
bench --truth link
empty link: holds no <scene>/camera.json; name a directory of such scenes
R --lens ''
empty --lens: is empty; give a path
render rgb.exr rgb.exr -o out LENS
no-depth rgb.exr: has no depth channel, only B, G, R; \
if one of them is the depth, say --depth-channel NAME
render deep.exr z.exr -o out LENS
no-color deep.exr: has no colour channels (R, G, B or Y), only Z; name a file that has them
render rgb.exr two.exr -o out LENS
ambiguous two.exr: has 2 candidates for the depth channel: depth.Z, other.depth; \
choose one, like --depth-channel depth.Z, or a part with --part
render layers.exr z.exr -o out LENS
ambiguous layers.exr: has 2 candidates for the colour layer: sun/RGB, lamp/RGB; \
choose one, like --color-layer sun/RGB, or a part with --part
info layers.exr --part 2
no-such-part layers.exr: has no part 2, only 2; --part counts from 0 to 1
info rgb.exr --part 1
no-such-part rgb.exr: has no part 1, only 1; leave --part out
info z.exr --depth-channel W
no-such-channel z.exr: has no channel W; it has Z; check --depth-channel
R --view left
no-such-view rgb.exr: has no views, and so no view left; leave --view out
render rgb.exr square.exr -o out LENS
wrong-size square.exr: is 5x5 px but its colour is 24x16 px; \
give depth of the size of the colour, or say --resize-depth guided, or nearest
render rgb.exr square.exr -o out LENS --resize-depth guided
wrong-size square.exr: is 5x5 px, of another aspect than the colour, 24x16 px; \
give depth of the view that the colour shows, all of it
render rgb.exr holes.exr -o out LENS
invalid-depth holes.exr: is NaN or ≤ 0 in 2 pixels, the first at 5,7; \
fill the holes, and write inf for sky; or say --invalid far, or fill
render nan.exr z.exr -o out LENS
not-finite nan.exr: is NaN or infinite in 1 pixel, the first at 4,3; \
render or save it again with finite values
render rgb.exr tiny.exr -o out LENS
too-blurred tiny.exr: has a depth of 1e-18 m, which is blurred by 4.3e+17 px; \
check --depth-unit and --focus
info z.npy
unknown-unit z.npy: holds uint16 numbers, whose unit is unknown; say --depth-unit mm
render rgb.exr z8.png -o out LENS
unknown-unit z8.png: has 8 bits, too few for depth and without a metric scale; \
save depth as EXR, PFM, NPY or float TIFF, or 16-bit PNG in millimetres; \
or say --depth-range NEAR FAR and --depth-kind; or take it as relative \
with --blur 20px --focus-at X,Y instead of a lens
render rgb.exr smallcoc.exr -o out --depth-format coc --resize-depth nearest
radii smallcoc.exr: holds radii in px of a picture of 12x8 px; \
give radii of the size of the colour
depth coc.exr --depth-format coc -o z2.exr
radii --depth-format: holds radii of a lens, and no depth; give such files to 'defocus render'
depth z.exr coc.exr -o z2.exr
one-file --out: is one file, and there are 2 to convert; name a directory, without .exr
depth z.exr -o small.exr
exists small.exr: is there already; say --overwrite, or name another output
render rgb.exr z.exr -o done LENS --outputs coc
exists done/coc/rgb.exr: exists already, and the journal does not know it; \
move it away, choose another -o, or add --overwrite to render all again
render rgb.exr z.exr -o rgb.exr LENS --overwrite
replaces-input rgb.exr: is an input and would be overwritten; choose another -o
render rgb.####.exr z.####.exr -o out LENS
missing-frames z.####.exr: lacks 1 frame, 3; \
say --missing skip to leave them out, or name others with --frames
B jobs.toml --shards-size 1GB --shard 1/2
whole-batch --shards-size: needs the whole batch; give it to 'defocus merge'
B jobs.toml --scheduler head
malformed --scheduler: 'head' is not a scheduler; …
merge held
in-use held/.journal.lock: held is being written by process …
R --quality best
unknown-name --quality: 'best' is not known; choose from draft, standard, high, reference
R --threads 0
- --threads: 0 is not in the range 1<=x<=1024; see 'defocus render --help'
R --focal-lenght 50mm
- --focal-lenght: no such option; did you mean --focal-length or …
R more
- command line: Got unexpected extra argument (more); see 'defocus render --help'
R --fnumber
- --fnumber: requires an argument; see 'defocus render --help'
--nonsense
- --nonsense: no such option; see 'defocus --help'
render
- COLOR: is missing; see 'defocus render --help'
info
- FILE...: is missing; see 'defocus info --help'
render rgb.exr z.exr
- --out: is missing; see 'defocus render --help'
B jobs.toml --quality high
- --quality: no such option; write quality below [machine] of the jobs file
"""
ROWS = LINES.replace("\\\n", "").strip().splitlines()


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder with one file of each kind."""
    folder = tmp_path_factory.mktemp("desk")
    color_exr(folder / "rgb.exr")
    depth_exr(folder / "z.exr")
    for name, text in JOBS.items():
        (folder / f"{name}.toml").write_text(text)
    (folder / "misspelt.toml").write_text('focal-lenght = "50mm"\n')
    (folder / "underscored.toml").write_text('Focal_Length = "50mm"\n')
    (folder / "link").mkdir()
    (folder / "link" / "self").symlink_to(".")
    (folder / "lost").symlink_to("none")
    (folder / "empty.exr").touch()
    for name in ("text.exr", "text.png"):
        (folder / name).write_text("This is not an image, whatever its name says.\n" * 20)
    save(folder / "c.gif", (texture() * 255).astype(np.uint8))
    save(folder / "z8.png", np.full((16, 24, 1), 9, np.uint8))
    np.save(folder / "z.npy", (ramp() * 1000).astype(np.uint16))
    write_deep(folder / "deep.exr")
    depth_exr(folder / "small.exr", ramp(12, 8))
    depth_exr(folder / "square.exr", ramp(5, 5))
    write_exr(folder / "coc.exr", coc=ramp() * 2 - 5)
    write_exr(folder / "smallcoc.exr", coc=ramp(12, 8) * 2 - 5)
    write_exr(folder / "two.exr", near_Z=ramp(), depth_Z=ramp(), other_depth=ramp())
    rgb = {channel: texture()[..., 0] for channel in "RGB"}
    multi_part(folder / "layers.exr", sun=rgb, lamp=rgb)
    for name, bad in (("holes", np.nan), ("tiny", 1e-18)):
        metres = ramp()
        metres[7, 5] = metres[8, 1] = bad
        depth_exr(folder / f"{name}.exr", metres)
    pixels = texture()
    pixels[3, 4, 1] = np.nan
    color_exr(folder / "nan.exr", pixels)
    depth_exr(folder / "done" / "coc" / "rgb.exr")
    for frame in (1, 2, 3):
        color_exr(folder / f"rgb.{frame:04}.exr")
        if frame < 3:
            depth_exr(folder / f"z.{frame:04}.exr")
    (folder / "held").mkdir()
    (folder / "held" / "journal.jsonl").touch()
    return folder


@pytest.mark.parametrize(("words", "wanted"), list(zip(ROWS[::2], ROWS[1::2], strict=True)))
def test_what_a_user_sees(words, wanted, desk, monkeypatch):
    monkeypatch.chdir(desk)
    before = sorted(map(str, desk.rglob("*")))
    first, _, rest = words.partition(" ")
    start = {"R": f"render rgb.exr z.exr -o out {LENS}", "B": "batch -o out"}.get(first, first)
    args = shlex.split(f"{start} {rest}".replace("LENS", LENS))
    with locked(desk / "held"):
        ran = run(args[0], *(["--json"] if first != "help" else []), *args[1:])
    code, _, line = wanted.partition(" ")
    said = ran.err.removeprefix("defocus: ").removesuffix("\n")
    assert said == line or (line.endswith("…") and said.startswith(line[:-1]))
    assert ran.code in (2, 3)
    if first == "help":  # which prints no document
        return
    error = {"message": said, "exit_code": ran.code, "code": None if code == "-" else code}
    assert ran.json["error"] == error
    left = sorted(path for path in map(str, desk.rglob("*")) if "held" not in path)
    assert left == [path for path in before if "held" not in path]
