"""Laws of the cost of a rendering: its work grows with what is done, and tells seconds."""

import time

import pytest
import torch

from defocus_core.evaluation.cost import cost
from defocus_core.evaluation.synthetic_scenes import KINDS, scenery
from defocus_core.renderer.engine.renderer import Renderer
from defocus_core.renderer.engine.scene import Scene
from defocus_core.renderer.engine.settings import Settings

SIZE = (200, 300)


def prepared(kind, radius=8.8, **options):
    image, signed_radius = scenery(kind, *SIZE, radius)[:2]
    return Renderer(Scene(image, signed_radius), Settings(**options))


def test_work_grows_with_blur_views_quality_and_hidden_content():
    plane = cost(prepared("plane"))
    assert cost(prepared("plane", radius=0.2)) < plane
    assert cost(prepared("plane", left_right=True)) > plane
    floor, cards = (cost(prepared(kind)) for kind in ("floor", "cards"))
    assert min(floor, cards) > plane
    assert cost(prepared("floor", quality="high")) > floor


@pytest.mark.bench
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("quality", ["standard", "high"])
def test_work_tells_seconds_within_a_factor_of_two(kind, quality):
    torch.set_num_threads(1)

    def seconds_per_unit(kind, quality):
        image, radius = scenery(kind, 540, 960, 16.0)[:2]
        settings = Settings(quality=quality)
        picture = Renderer(Scene(image, radius), settings)
        times = []
        for _ in range(3):
            start = time.process_time()
            for _ in Renderer(Scene(image, radius), settings).tiles():
                pass
            times.append(time.process_time() - start)
        return min(times) / cost(picture)

    ratio = seconds_per_unit(kind, quality) / seconds_per_unit("thin", "standard")
    assert 0.5 < ratio < 2
