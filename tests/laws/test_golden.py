"""Pictures change only with RENDERER_VERSION: finished batches are known by it."""

import golden
import pytest
import torch
from measures import worst

CHANGED = (
    "{scene}: {name} differs by {by:.2g} from the picture that is stored. If that is meant, raise "
    f"RENDERER_VERSION in defocus_core/renderer_version.py and run '{golden.COMMAND}'"
)
# Rounding and the last bits of depth change these scenes by 2e-6 at most.
SAME = 1e-5


@pytest.mark.parametrize("scene", golden.SCENES)
def test_pictures_are_those_of_the_renderer_s_version(scene):
    pictures, stored = golden.rendered(scene), golden.stored(scene)
    assert pictures.keys() == stored.keys()
    for name, picture in pictures.items():
        by = worst(picture, stored[name])
        assert by <= SAME, CHANGED.format(scene=scene, name=name, by=by)


@pytest.mark.parametrize("scene", golden.SCENES)
def test_no_scene_lies_where_rounding_decides(scene):
    """Else a machine that rounds otherwise would seem to have another renderer."""
    pictures = golden.rendered(scene)
    for other in (golden.rendered(scene, torch.float64), golden.rendered(scene, nudge=3e-7)):
        assert max(worst(picture, other[name]) for name, picture in pictures.items()) < SAME / 2
