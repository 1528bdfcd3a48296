"""Files pair up by stem, and a job writes nothing that it should not."""

from jobs_files import touch
from refusals import refuses

from defocus_core.request.job import PictureFiles
from defocus_core.request.pairing import find_pictures


def test_directories_pair_by_stem_in_order(tmp_path):
    color = touch(tmp_path / "c", "2.png", "1.JPG", ".1.png", "notes.txt")
    depth = touch(tmp_path / "d", "1.exr", "2.npy", ".hidden.exr", "readme.md")
    assert find_pictures(color, depth) == [
        PictureFiles("1", color / "1.JPG", depth / "1.exr"),
        PictureFiles("2", color / "2.png", depth / "2.npy"),
    ]


def test_a_photograph_is_depth_of_what_has_no_other(tmp_path):
    color = touch(tmp_path / "c", "1.png", "2.png")
    depth = touch(tmp_path / "d", "1.png", "1.jpg", "2.jpg", "sheet.jpg")
    assert find_pictures(color, depth) == [
        PictureFiles("1", color / "1.png", depth / "1.png"),
        PictureFiles("2", color / "2.png", depth / "2.jpg"),
    ]
    both = touch(tmp_path / "both", "1.jpg", "2.jpg", "1.npy")
    with refuses("empty"):
        find_pictures(both, both)


def test_a_file_does_not_pair_with_a_directory(tmp_path):
    folder = touch(tmp_path / "c", "1.png")
    for one, other in ((folder, folder / "1.png"), (folder / "1.png", folder)):
        with refuses("wrong-type"):
            find_pictures(one, other)


def test_a_lone_file_that_holds_no_depth_is_refused(tmp_path):
    with refuses("no-depth"):
        find_pictures(touch(tmp_path, "a.png") / "a.png", None)
