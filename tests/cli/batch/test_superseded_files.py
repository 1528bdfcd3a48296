"""What an earlier run left beside new pictures: its previews go, its other files are told."""

from __future__ import annotations

from pathlib import Path

from batches import again, folders
from command_line import render

__all__ = ["folders"]


def test_a_preview_goes_with_the_picture_that_it_shows(
    folders: tuple[Path, Path], out: Path
) -> None:
    previews = [out / "coc" / f"{stem}.preview.png" for stem in "abc"]
    again(folders, out, "--preview")
    assert again(folders, out).code == 0
    assert all(map(Path.exists, previews)), "they show what is there"
    previews[1].write_bytes(b"somebody's own")
    ran = again(folders, out, "--fnumber", "4")
    assert [path.exists() for path in previews] == [False, True, False]
    assert "removed 2 previews of pictures that were replaced" in ran.err
    assert "removed" not in again(folders, out, "--overwrite").err


def test_a_map_of_other_settings_beside_a_new_picture_is_told(
    folders: tuple[Path, Path], out: Path
) -> None:
    args = (*folders, "-o", out, "--outputs")
    render(*args, "disparity,coc")
    assert "warning" not in render(*args, "coc", "--overwrite").err
    ran = render(*args, "coc", "--fnumber", "4")
    assert f"{out / 'disparity' / 'a.exr'} and 2 more: warning: not replaced, of other" in ran.err
    assert (out / "disparity" / "a.exr").exists()
