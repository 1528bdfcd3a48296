import math
from pathlib import Path

import pytest
from jobs_files import PictureFiles, option
from refusals import refuses

from defocus_core.request.animation import read_animation, read_keys
from defocus_core.request.picture_lenses import PictureLenses


def animation(folder, text, name="pull.csv"):
    file = folder / name
    file.write_text(text)
    return read_animation([str(file)])


def values(shot, frame):
    return {name: each.value for name, each in shot.options_at(frame).items()}


def key(shot, frame, name):
    return shot.options_at(frame)[name].text


def test_values_go_evenly_in_the_variable_in_which_blur_is_smooth(tmp_path):
    text = "frame,focus,fnumber,focal-length,blade-rotation\n1,1m,1,20mm,0\n3,3m,4,80mm,30\n"
    middle = values(animation(tmp_path, text), 2)
    assert middle["focus"] == pytest.approx(1500)  # in disparity
    assert middle["fnumber"] == pytest.approx(2)  # in stops
    assert middle["focal-length"] == pytest.approx(40)
    assert middle["blade-rotation"] == pytest.approx(15)
    far = animation(tmp_path, "frame,focus,sharp-range\n1,1m,1m..3m\n3,inf,3m..inf\n")
    assert values(far, 2)["focus"] == pytest.approx(2000)
    assert values(far, 2)["sharp-range"] == pytest.approx((1500, 6000))
    assert values(far, 3)["focus"] == math.inf


def test_a_key_is_taken_as_it_is_written_and_the_ends_hold(tmp_path):
    shot = animation(tmp_path, "frame,focus\n10,1.3m\n20,2.3m\n")
    assert [key(shot, frame, "focus") for frame in (5, 10, 20, 99)] == [
        *("1.3m", "1.3m", "2.3m", "2.3m")
    ]


def test_a_tracked_point_is_a_focus_and_blades_hold(tmp_path):
    shot = animation(tmp_path, "frame,x,y,blades\n1,10,20,6\n3,21,20,8\n")
    assert values(shot, 2) == {"focus-at": (16, 20), "blades": 6}


@pytest.mark.parametrize(
    ("option", "first", "last", "middle"),
    [
        ("cat-eye", "1:1", "1.2:2", (1.1, 1.5)),
        ("noise", "400:3", "800:6", (600, 4.5)),
        ("axial-color", "0.1mm:0.2mm", "0.3mm:-0.1mm", (0.2, 0.05)),
        ("highlights", "0.9:3", "0.8:5", (0.85, 4)),
        ("vignetting", "on", "off", True),
        ("noise-seed", "1", "8", 1),
        ("dp-model", "split", "smooth", "split"),
    ],
)
def test_pairs_go_evenly_and_words_and_seeds_hold(tmp_path, option, first, last, middle):
    shot = animation(tmp_path, f"frame,{option}\n1,{first}\n3,{last}\n")
    found = values(shot, 2)[option]
    assert found == (pytest.approx(middle) if isinstance(middle, tuple) else middle)


def test_bare_numbers_are_metres_of_focus_and_millimetres_of_lenses(tmp_path):
    shot = animation(tmp_path, "frame,focus,focal-length\n1,2,35\n")
    assert values(shot, 1) == {"focus": 2000, "focal-length": 35}


def test_a_frame_has_one_key_however_it_is_written(tmp_path):
    with refuses("duplicate"):
        animation(tmp_path, '[animate]\nfocus = {1 = "1m", 01 = "4m"}\n', "pull.toml")


def test_between_percentiles_there_is_nothing(tmp_path):
    shot = animation(tmp_path, "frame,focus\n1,percentile(5)\n3,percentile(50)\n")
    assert key(shot, 1, "focus") == "percentile(5)"
    with refuses("idle-option", field="focus"):
        shot.options_at(2)


def test_one_option_is_animated_once(tmp_path):
    (tmp_path / "a.csv").write_text("frame,focus\n1,1m\n")
    (tmp_path / "b.csv").write_text("frame,focus\n1,1m\n")
    with refuses("contradiction"):
        read_animation([str(tmp_path / "a.csv"), str(tmp_path / "b.csv")])
    with refuses("malformed", field="animate"):
        read_animation([f"focus={tmp_path / 'pull.txt'}"])


def test_flags_complete_keys_and_may_not_contradict_them(tmp_path):
    shot = animation(tmp_path, "frame,focus,fnumber\n1,1m,2\n2,2m,2\n")
    picture = PictureFiles("a", Path("a.exr"), Path("b.exr"), frame=2)
    own = {"focal-length": option("focal-length", "50mm")}
    lens, _ = PictureLenses(own, animation=shot).lens_of(picture)
    assert (lens.foclen, lens.fnum, lens.foc_dist) == (50, 2, 2000)
    for name in ("focus", "focus-at"):
        with refuses("contradiction", "pull.csv", field=name):
            PictureLenses(
                {**own, name: option(name, "1,1" if name == "focus-at" else "1m")}, animation=shot
            )
    with refuses("idle-option", field="animate"):
        PictureLenses(own, animation=shot).lens_of(PictureFiles("a", *[Path("a.exr")] * 2))


def test_columns_of_csv_are_options_and_empty_cells_no_keys(tmp_path):
    (tmp_path / "pull.csv").write_text(
        "# a pull\nframe,focus,focal_length,x,y\n1001,1.2m,50mm,3,4\n1005,,55mm,5,6\n"
    )
    keys = read_keys(tmp_path / "pull.csv")
    assert {n: {frame: key.text for frame, key in each.items()} for n, each in keys.items()} == {
        "focus": {1001: "1.2m"},
        "focal-length": {1001: "50mm", 1005: "55mm"},
        "focus-at": {1001: "3,4", 1005: "5,6"},
    }
    with refuses("not-found", path=tmp_path / "none.csv"):
        read_keys(tmp_path / "none.csv")
