"""A job writes nothing that it should not."""

from pathlib import Path

from jobs_files import Job, Machine, Outputs, PictureFiles, Reading, lens_values, touch
from refusals import refuses

from defocus_core.batch.workers.run import refuse_misplaced

LENS = lens_values()


def jobs_for(pictures, outputs):
    return [Job(picture, LENS, Reading(), outputs, Machine()) for picture in pictures]


def test_an_input_is_never_overwritten_by_any_name_of_it(tmp_path):
    file = touch(tmp_path / "out" / "render", "a.exr") / "a.exr"
    (tmp_path / "linked").symlink_to(tmp_path / "out")
    (tmp_path / "a.exr").symlink_to(file)
    for root, color in (("out", file), ("linked", file), ("out", tmp_path / "a.exr")):
        outputs = Outputs(tmp_path / root, overwrite=True)
        with refuses("replaces-input"):
            refuse_misplaced(jobs_for([PictureFiles("a", color, color)], outputs))


def test_a_folder_of_outputs_that_leads_elsewhere_is_refused(tmp_path):
    """The next run would find records of files that do not lie in OUT."""
    pictures, out = [PictureFiles("a", tmp_path / "a", tmp_path / "z")], tmp_path / "out"
    for folder in ("elsewhere", "out/here"):
        (tmp_path / folder).mkdir(parents=True)
    (out / "render").symlink_to(tmp_path / "elsewhere")
    for place in (tmp_path / "elsewhere", Path("here")):
        (out / "render").unlink(missing_ok=True)
        (out / "render").symlink_to(place)
        with refuses("link"):
            refuse_misplaced(jobs_for(pictures, Outputs(out)))
    (tmp_path / "named").symlink_to("elsewhere")
    refuse_misplaced(jobs_for(pictures, Outputs(tmp_path / "named")))
