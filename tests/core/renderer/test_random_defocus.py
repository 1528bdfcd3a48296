"""A random lens for each picture: seeded, within its ranges, and a lens like any other."""

from __future__ import annotations

import math

import pytest
import torch
from tolerances import RENDERED
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from defocus_core import Aperture, DefocusLens, Distribution, RandomDefocus, render
from defocus_core.optics.distributions import ATTEMPTS
from defocus_core.renderer.random_defocus import OPTIONS, Lenses

SIZE = (12, 18)  # H, W


def image(batch=3):
    return torch.rand(batch, 3, *SIZE, generator=torch.Generator().manual_seed(1))


def depth(batch=3):
    ramp = torch.linspace(1000.0, 4000.0, SIZE[1]).expand(batch, 1, *SIZE)
    return ramp * torch.arange(1, batch + 1)[:, None, None, None]


def test_a_sample_is_the_same_in_any_batch():
    def tensors(views, lenses):
        return [*views.images, views.trust, *lenses]

    whole = tensors(*RandomDefocus(left_right=True)(image(), depth(), [5, 6, 7]))
    alone = tensors(*RandomDefocus(left_right=True)(image()[1:2], depth()[1:2], torch.tensor([6])))
    for together, single in zip(whole, alone, strict=True):
        torch.testing.assert_close(together[1:2], single, rtol=0, atol=0)


def test_other_seeds_draw_other_lenses_and_a_generator_draws_seeds():
    same = [x.expand(3, -1, -1, -1) for x in (image(1), depth(1))]
    (first, lenses), (second, _) = (
        RandomDefocus()(*same, torch.Generator().manual_seed(4)) for _ in range(2)
    )
    assert len(set(lenses.fnum.tolist())) == len(set(lenses.foclen.tolist())) == 3
    torch.testing.assert_close(first.render, second.render, rtol=0, atol=0)
    other = RandomDefocus()(*same, torch.Generator().manual_seed(5))[1]
    assert not torch.equal(lenses.fnum, other.fnum)


def test_what_is_rendered_is_what_the_lens_drawn_takes():
    views, drawn = RandomDefocus(left_right=True)(image(), depth(), [5, 6, 7])
    for index in range(3):
        lens = DefocusLens(
            float(drawn.foclen[index]), float(drawn.fnum[index]), (36.0, 24.0), (SIZE[1], SIZE[0])
        )
        lens.refocus(float(drawn.foc_dist[index]))
        radius = lens.signed_radius(depth()[index])
        torch.testing.assert_close(drawn.signed_radius[index], radius)
        aperture = Aperture(int(drawn.blades[index]), float(drawn.blade_rotation[index]))
        wanted = render(image()[index], radius[0], aperture=aperture)
        torch.testing.assert_close(views.render[index], wanted.render)
    torch.testing.assert_close((views.left + views.right) / 2, views.render)


def test_anti_aliased_depth_is_one_of_distances_here_too():
    size = (64, 96)
    y, x = ((torch.arange(8 * n) + 0.5) / 8 for n in size)
    fine = torch.where(x + 0.37 * y[:, None] < 60.2, 1000.0, 4000.0)
    averaged = torch.nn.functional.avg_pool2d(fine[None], 8)[None]
    picture = torch.rand(1, 3, *size, generator=torch.Generator().manual_seed(2))
    views, drawn = RandomDefocus(foclen=85, fnum=1.4, blades=0)(picture, averaged, [3])
    lens = DefocusLens(85.0, 1.4, (36.0, 24.0), (96, 64))
    lens.refocus(float(drawn.foc_dist))
    torch.testing.assert_close(views.render, lens.render_rgbd(picture, averaged))


def test_lenses_are_spread_over_their_ranges_and_stay_within():
    tiny = torch.ones(100, 1, 1, 100), torch.linspace(1000, 2000, 100).expand(100, 1, 1, 100)
    defocus = RandomDefocus(
        foclen=Distribution("loguniform", (20, 80)),
        fnum=Distribution("loguniform", (1, 16)),
        blades=Distribution("choice", (0, 6)),
    )
    _, lenses = defocus(*tiny, range(100))
    shares = torch.stack(
        [
            (lenses.foclen / 20).log() / math.log(4),
            lenses.fnum.log() / math.log(16),
            ((lenses.foc_dist - 1000) / 1000 - 0.05) / 0.9,
            lenses.blades / 6,
            lenses.blade_rotation / 360,
        ]
    )
    assert shares.min() >= -1e-6
    assert shares.max() <= 1 + 1e-6
    assert bool(((shares.mean(1) - 0.5).abs() < 3 * shares.std(1) / math.sqrt(100)).all())
    assert set(lenses.blades.tolist()) == {0, 6}
    together = torch.corrcoef(shares) - torch.eye(5)
    assert together.abs().max() < 4 / math.sqrt(100)


def test_numbers_and_equal_ends_fix_the_lens():
    nearest = Distribution("percentile", (0, 0))
    fixed = RandomDefocus(
        foclen=50.0, fnum=Distribution("loguniform", (2, 2)), foc_dist=nearest, blades=0
    )
    _, lenses = fixed(image(), depth(), [1, 2, 3])
    assert lenses.foclen.tolist() == [50, 50, 50]
    assert lenses.fnum.tolist() == [2, 2, 2]
    assert lenses.foc_dist.tolist() == [1000, 2000, 3000]


def test_sky_is_not_focused_on_unless_there_is_nothing_else():
    far = depth(2).clone()
    far[0, :, :, 9:] = math.inf
    far[1] = math.inf
    defocus = RandomDefocus(foc_dist=Distribution("percentile", (100, 100)))
    views, lenses = defocus(image(2), far, [1, 2])
    assert lenses.foc_dist[0] == far[0, 0, 0, 8]
    assert lenses.foc_dist[1] == math.inf
    torch.testing.assert_close(views.render[1], image(2)[1], rtol=0, atol=RENDERED[torch.float32])


def test_a_lens_that_blurs_too_much_is_drawn_again_and_the_others_stay():
    _, free = RandomDefocus()(image(), depth(), [1, 2, 3])
    maximum = free.signed_radius.abs().amax((1, 2, 3))
    bound = float(maximum.median()) * (1 + 1e-5)
    _, bounded = RandomDefocus(max_radius=bound)(image(), depth(), [1, 2, 3])
    assert bounded.signed_radius.abs().max() <= bound * (1 + 1e-5)
    assert (bounded.fnum == free.fnum).tolist() == (maximum <= bound).tolist()
    assert int((maximum <= bound).sum()) == 2
    assert bool(((bounded.fnum >= 1.4) & (bounded.fnum <= 16)).all())


def test_where_no_lens_drawn_suits_a_picture_it_is_refused():
    with pytest.raises(ValueError, match=f"max_radius must allow some lens.* {ATTEMPTS} lenses"):
        RandomDefocus(max_radius=1e-9)(image(), depth(), [1, 2, 3])


@pytest.mark.parametrize(
    ("kind", "values", "words"),
    [
        ("normal", (1, 2), "must be one of uniform, .*, got 'normal'"),
        ("uniform", (1,), "must have two numbers as ends, got 1"),
        ("uniform", ("1m", 2), "must have two numbers as ends"),
        ("uniform", (2, 1), "must begin at the lower end, got 2 and 1"),
        ("uniform", (1, math.nan), "must begin at the lower end"),
        ("loguniform", (0, 1), "must have ends above 0"),
        ("loguniform", (1, math.inf), "must have finite ends"),
        ("percentile", (5, 101), "must lie between 0 and 100"),
        ("choice", (), "must have values to choose from"),
    ],
)
def test_what_nothing_can_be_drawn_from_is_refused(kind, values, words):
    with pytest.raises(ValueError, match=words):
        Distribution(kind, values)


def test_gradients_reach_image_and_depth():
    sharp, planes = image(1).requires_grad_(), depth(1).requires_grad_()
    RandomDefocus(fnum=0.25)(sharp, planes, [3])[0].render.square().sum().backward()
    assert sharp.grad.abs().max() > 0
    assert planes.grad.abs().max() > 0


class Frames(Dataset[dict[str, Tensor]]):
    """A training set: each sample has its own lens, the same one whenever it is asked for."""

    def __init__(self):
        self.defocus = RandomDefocus(fnum=Distribution("loguniform", (1.4, 4.0)))

    def __len__(self):
        return 4

    def __getitem__(self, index):
        views, lenses = self.defocus(image(4)[index, None], depth(4)[index, None], [index])
        return {"index": torch.tensor(index), "render": views.render[0], "fnum": lenses.fnum[0]}


def test_a_data_loader_gets_each_sample_with_its_own_lens():
    samples = Frames()
    shuffled = DataLoader(samples, batch_size=3, shuffle=True)
    renders = {int(i): x for b in shuffled for i, x in zip(b["index"], b["render"], strict=True)}
    assert sorted(renders) == [0, 1, 2, 3]
    for index, rendered in renders.items():
        torch.testing.assert_close(rendered, samples[index]["render"], rtol=0, atol=0)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_the_lens_does_not_depend_on_the_device():
    cpu, on_cpu = RandomDefocus()(image(), depth(), [1, 2, 3])
    gpu, on_gpu = RandomDefocus()(image().cuda(), depth().cuda(), [1, 2, 3])
    assert gpu.render.is_cuda
    torch.testing.assert_close(on_gpu.foc_dist, on_cpu.foc_dist, rtol=0, atol=0)
    torch.testing.assert_close(gpu.render.cpu(), cpu.render, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("words", "arguments"),
    [
        ("foclen must be one number", {"foclen": (24.0, 50.0)}),
        ("fnum must be positive", {"fnum": Distribution("uniform", (0, 2))}),
        ("fnum must not be drawn from a disp", {"fnum": Distribution("disparity", (1, 2))}),
        ("foc_dist must be positive", {"foc_dist": Distribution("choice", (1000, 0))}),
        ("sensor_width must be", {"sensor_width": 0.0}),
        ("max_radius must be", {"max_radius": 0.0}),
        ("blades must be whole", {"blades": Distribution("uniform", (5, 9))}),
        ("blades must be 0 or at least 3", {"blades": Distribution("choice", (0, 2))}),
        ("quality must", {"quality": "best"}),
    ],
)
def test_what_makes_no_sense_is_refused_when_the_ranges_are_given(words, arguments):
    with pytest.raises(ValueError, match=words):
        RandomDefocus(**arguments)


@pytest.mark.parametrize(
    ("words", "arguments"),
    [
        ("image must be", (image()[0], depth(), [1, 2, 3])),
        ("depth must be", (image(), depth()[..., 1:], [1, 2, 3])),
        ("seeds must be one .*, a list of 3, got one of 2;", (image(), depth(), [1, 2])),
        ("seeds must be one", (image(), depth(), [1.5, 2, 3])),
        ("seeds must be one", (image(), depth(), 7)),
        ("depth must be positive, got -", (image(), -depth(), [1, 2, 3])),
        ("depth must be positive, got 0.0 in 648 of 648", (image(), 0 * depth(), [1, 2, 3])),
        (
            "depth must be farther in focus .* last of 100 .* foclen=",
            (image(), depth() / 1000, [1, 2, 3]),
        ),
    ],
)
def test_what_does_not_fit_together_is_refused(words, arguments):
    with pytest.raises(ValueError, match=words):
        RandomDefocus()(*arguments)


LOOK = {
    "curvature": (0.2, 0.9),
    "obstruction": (0.1, 0.5),
    "spherical": (-0.8, 0.8),
    "squeeze": (1.2, 2.0),
    "cat_eye_size": (0.9, 1.1),
    "cat_eye_shift": (0.2, 0.6),
    "crosstalk": (0.05, 0.3),
}


@pytest.mark.parametrize("name", LOOK)
def test_each_option_of_the_look_is_drawn_within_its_range_and_shows(name):
    near = torch.full((2, 1, *SIZE), 700.0)
    known = {"foclen": 85.0, "fnum": 1.4, "foc_dist": 3000.0, "blades": 6, "left_right": True}
    plain, _ = RandomDefocus(**known)(image(2), near, [4, 10])
    views, lenses = RandomDefocus(**known, **{name: Distribution("uniform", LOOK[name])})(
        image(2), near, [4, 10]
    )
    drawn = getattr(lenses, name).tolist()
    assert len(set(drawn)) == 2
    assert all(LOOK[name][0] <= value <= LOOK[name][1] for value in drawn)
    shown = "left" if name == "crosstalk" else "render"
    apart = (getattr(views, shown) - getattr(plain, shown)).abs().amax((1, 2, 3))
    assert float(apart.min()) > 1e-3


def test_blades_that_are_drawn_away_have_no_curvature():
    blades = Distribution("choice", (0, 6))
    _, lenses = RandomDefocus(blades=blades, curvature=0.5)(
        image(1).expand(8, -1, -1, -1), depth(8), range(8)
    )
    assert {(0.0, 0.0), (6.0, 0.5)} == set(
        zip(lenses.blades.tolist(), lenses.curvature.tolist(), strict=True)
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"obstruction": Distribution("uniform", (0.0, 1.0))}, "obstruction must be"),
        ({"squeeze": 0.0}, "squeeze must be"),
        (
            {"cat_eye_shift": Distribution("uniform", (0.0, 0.9)), "cat_eye_size": 0.9},
            "shift must be",
        ),
        ({"crosstalk": 0.5}, "crosstalk must be"),
    ],
)
def test_a_look_that_makes_no_sense_is_refused(options, words):
    with pytest.raises(ValueError, match=words):
        RandomDefocus(**options)


def test_lenses_have_each_option_and_another_is_refused():
    assert Lenses._fields == ("signed_radius", *OPTIONS)
    with pytest.raises(TypeError, match="no option fnumber; choose from foclen"):
        RandomDefocus(fnumber=2.0)
