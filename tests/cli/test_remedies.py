"""Mistakes that are easily made are noticed, and the remedy is what was meant."""

import os
import subprocess
import sys

import pytest
import torch
from command_line import LENS, color_exr, files_under, pair, refused, render, run, succeed

from defocus_core import Aperture, DefocusLens, PupilImage
from defocus_core import render as render_image

MAPS = ("--outputs", "coc")


def test_mistakes_that_are_easily_made(tmp_path, out):
    files = pair(tmp_path)
    frames = [color_exr(tmp_path / f"shot.{number}.exr") for number in (1001, 1002)]
    shipped = run("render", *files, "-o", out, "--lens", "portrait-85")
    refused(shipped, 2, "unknown-name", "lens")  # without its mark
    refused(render(*frames, "-o", out), 2, "contradiction", "shot.1002.exr")
    ran = render(tmp_path / "1001-1005#.exr", "-o", out)
    refused(ran, 3, "not-found", "1001-1005#.exr")


def test_quiet_says_only_what_is_wrong(tmp_path, out):
    files = pair(tmp_path)
    assert render(*files, "-o", out, *MAPS, "-q").err == ""
    assert render(*files, "-o", out, *MAPS, "-q").err == ""
    assert render(*files, "-o", out, *MAPS).err != ""
    refused(render(*files, "-o", out, *MAPS, "-q", "-v"), 2, "contradiction", "quiet")


def test_each_picture_of_a_folder_of_lenses_has_its_own(tmp_path, out):
    for stem, fnumber in (("a", 2), ("b", 4)):
        color, depth = pair(tmp_path, stem)
        text = f'focal-length = "50mm"\nfnumber = {fnumber}\nfocus = "2m"\n'
        (tmp_path / f"lenses/{stem}.toml").parent.mkdir(exist_ok=True)
        (tmp_path / f"lenses/{stem}.toml").write_text(text)
    folders = (color.parent, depth.parent)
    ran = run("render", *folders, "-o", out, *MAPS, "--lens", tmp_path / "lenses", "--json")
    assert [p["lens"]["fnumber"] for p in ran.json["pictures"]] == [2, 4]
    (tmp_path / "lenses/b.toml").unlink()
    assert run("render", *folders, "-o", out, *MAPS, "--lens", tmp_path / "lenses").code == 3


def test_a_list_may_begin_with_a_comment(tmp_path, out):
    color, depth = pair(tmp_path)
    (tmp_path / "list.csv").write_text(f"# list.csv\ncolor,depth\n{color},{depth}\n")
    lens = dict(zip(LENS[::2], LENS[1::2], strict=True))
    keys = "".join(f'{name[2:]} = "{value}"\n' for name, value in lens.items())
    jobs = tmp_path / "jobs.toml"
    jobs.write_text(f'[inputs]\nlist = "list.csv"\n[lens]\n{keys}[outputs]\nkinds = ["coc"]\n')
    succeed("batch", jobs, "-o", out)
    assert "coc/a.exr" in files_under(out)


def test_shells_complete_commands():
    environment = {**os.environ, "_DEFOCUS_COMPLETE": "bash_source"}
    done = subprocess.run(
        [sys.executable, "-m", "defocus_cli"], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0
    assert "_DEFOCUS_COMPLETE=bash_complete" in done.stdout


def test_an_opening_is_given_to_a_lens_or_to_an_aperture():
    image, depth = torch.rand(1, 3, 16, 24), torch.full((1, 1, 16, 24), 4000.0)
    sensor = {"sensor_size": (36.0, 24.0), "sensor_res": (24, 16)}
    lens = DefocusLens(50.0, 0.5, aperture=Aperture(obstruction=0.5), **sensor)
    plain = DefocusLens(50.0, 0.5, **sensor)
    for each in (lens, plain):
        each.refocus(1000.0)
    assert not torch.equal(lens.render_rgbd(image, depth), plain.render_rgbd(image, depth))
    pupil = PupilImage(torch.ones(5, 5))
    with pytest.raises(ValueError, match=r"Aperture\(image=…\)"):
        DefocusLens(50.0, 0.5, aperture=pupil, **sensor)
    with pytest.raises(ValueError, match=r"Aperture\(image=…\)"):
        render_image(image, depth, aperture=pupil)


def test_metres_given_as_millimetres_are_doubted():
    lens = DefocusLens(50.0, 2.0, sensor_size=(36.0, 24.0), sensor_res=(24, 16))
    with pytest.warns(UserWarning, match="metres"):
        lens.render_rgbd(torch.rand(1, 3, 16, 24), torch.full((1, 1, 16, 24), 4.0))
