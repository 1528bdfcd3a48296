"""Left and right: no darker than the picture, no more opaque than 1, and in the mean the centre."""

import pytest
import torch
from measures import worst
from renderers import QUALITIES
from tolerances import WHITE

from defocus_core import Aperture, render, render_layers

PUPILS = [Aperture(), Aperture(6, 10.0), Aperture(3), Aperture(5, 20.0)]
SIZE = (72, 96)


def spots(seed, share):
    """Random blobs [H, W], 1 within and 0 without."""
    noise = torch.rand(1, 1, *SIZE, generator=torch.Generator().manual_seed(seed))
    smooth = torch.nn.functional.avg_pool2d(noise, 9, 1, 4, count_include_pad=False)[0, 0]
    return (smooth > smooth.quantile(1 - share)).float()


@pytest.mark.parametrize("quality", QUALITIES[:2])
@pytest.mark.parametrize("darkest", [0.0, -1e-6, -0.02])
def test_a_half_is_no_darker_than_the_darkest_pixel(darkest, quality):
    """One negative pixel bounds the whole picture, and no more than by what it is."""
    near, fine = spots(1, 0.3), torch.rand(SIZE, generator=torch.Generator().manual_seed(2))
    image = (near * (fine > 0.5))[None].repeat(3, 1, 1)
    image[:, 40, 50] = darkest
    radius = torch.where(near > 0, -1.3, 0.9)
    views = render(image, radius, quality=quality, left_right=True)
    assert min(float(picture.min()) for picture in views.images) >= darkest - WHITE


@pytest.mark.parametrize("quality", QUALITIES[:2])
@pytest.mark.parametrize("aperture", PUPILS, ids=lambda a: f"{a.blades}-{a.rotation:g}")
@pytest.mark.parametrize("negative", [0.0, -1e-6])
def test_alpha_of_a_half_is_1_at_most(negative, aperture, quality):
    """White layers are as bright as they are opaque, in the halves too."""
    coverage = torch.stack([spots(3, 0.3), 0.8 * spots(4, 0.5), spots(5, 0.4)])
    radius = torch.tensor([-9.0, -2.0, 6.0])[:, None, None].expand(-1, *SIZE)
    white = coverage[:, None].repeat(1, 3, 1, 1)
    white[0, :, 40, 50] += negative
    views = render_layers(
        white, radius, coverage, aperture=aperture, quality=quality, left_right=True
    )
    for picture in views.images:
        assert picture.max() <= 1 + WHITE
        assert picture.min() >= negative - WHITE
        assert worst(picture[:3], picture[3:].expand(3, -1, -1)) < WHITE
