"""Pictures change only with RENDERER_VERSION: finished batches are known by it."""

import golden
import pytest
import torch
from measures import worst
from renderers import NEEDS_LOOPS

CHANGED = (
    "{scene}: {name} differs by {by:.2g} from the picture that is stored. If that is meant, raise "
    f"RENDERER_VERSION in defocus_core/renderer_version.py and run '{golden.COMMAND}'"
)
# Rounding and the last bits of depth change these scenes by 2e-6 at most.
SAME = 1e-5
NO_NUMBA = pytest.mark.skipif(**NEEDS_LOOPS)
CARRIED = [pytest.param(scene, marks=NO_NUMBA) for scene in golden.CARRIED]


@pytest.mark.parametrize("scene", [*golden.SCENES, *CARRIED])
def test_pictures_are_those_of_the_renderer_s_version(scene):
    pictures, stored = golden.rendered(scene), golden.stored(scene)
    assert pictures.keys() == stored.keys()
    for name, picture in pictures.items():
        by = worst(picture, stored[name])
        assert by <= SAME, CHANGED.format(scene=scene, name=name, by=by)


@pytest.mark.parametrize("scene", [*golden.SCENES, *CARRIED])
def test_no_scene_lies_where_rounding_decides(scene):
    """Else a machine that rounds otherwise would seem to have another renderer."""
    pictures, others = golden.rendered(scene), [golden.rendered(scene, nudge=3e-7)]
    if scene in golden.SCENES:  # the compiled back has float32 alone
        others.append(golden.rendered(scene, torch.float64))
    for other in others:
        assert max(worst(picture, other[name]) for name, picture in pictures.items()) < SAME / 2
