"""A random lens for each picture: seeded, within its ranges, and a lens like any other."""

import math

import pytest
import torch
from tolerances import RENDERED

from defocus_core import Aperture, DefocusLens, Distribution, RandomDefocus, mirrored, render
from defocus_core.renderer.random_defocus import OPTIONS, Lenses
from defocus_core.renderer.samples import planes_of

SIZE = (12, 18)  # H, W


def image(batch=3):
    return torch.rand(batch, 3, *SIZE, generator=torch.Generator().manual_seed(1))


def depth(batch=3):
    ramp = torch.linspace(1000.0, 4000.0, SIZE[1]).expand(batch, 1, *SIZE)
    return ramp * torch.arange(1, batch + 1)[:, None, None, None]


@pytest.mark.parametrize("first", [0, *(pytest.param(n, marks=pytest.mark.bench) for n in (1, 2))])
@pytest.mark.parametrize("back", ["compiled", "torch"])
def test_a_picture_of_any_batch_is_what_it_is_alone(back, first):
    """By the compiled back to the last bit; of random sizes, lenses, contents and places."""
    for seed in range(12) if first == 0 else range(12 + 250 * (first - 1), 12 + 250 * first):
        generator = torch.Generator().manual_seed(seed)
        height, width = torch.randint(9, 50, (2,), generator=generator).tolist()
        k = int(torch.randint(8, (1,), generator=generator))
        light = torch.rand(8, 3, height, width, generator=generator)
        slope = torch.linspace(0, 2000, width) * torch.rand(8, 1, 1, 1, generator=generator)
        cards = torch.rand(8, 1, height, width, generator=generator).round()
        metric = 1000 + slope + 3000 * cards * torch.rand(8, 1, 1, 1, generator=generator)
        light.requires_grad_(back == "torch")
        render_all, seeds = RandomDefocus(left_right=bool(seed % 2)), [*range(seed, seed + 8)]
        whole, _ = render_all(light, metric, seeds)
        alone, _ = render_all(light[k : k + 1], metric[k : k + 1], seeds[k : k + 1])
        within = 0.0 if back == "compiled" else 1e-5
        for together, single in zip(whole.images, alone.images, strict=True):
            torch.testing.assert_close(together[k : k + 1], single, rtol=0, atol=within)


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


def test_lenses_are_spread_over_their_ranges_and_stay_within():
    tiny = torch.ones(100, 1, 1, 100), torch.linspace(1000, 2000, 100).expand(100, 1, 1, 100)
    foclen, fnum = (Distribution("loguniform", ends) for ends in ((20, 80), (1, 16)))
    defocus = RandomDefocus(foclen=foclen, fnum=fnum, blades=Distribution("choice", (0, 6)))
    _, lenses = defocus(*tiny, range(100))
    shares = [
        (lenses.foclen / 20).log() / math.log(4),
        lenses.fnum.log() / math.log(16),
        ((lenses.foc_dist - 1000) / 1000 - 0.05) / 0.9,
        lenses.blades / 6,
        lenses.blade_rotation / 360,
    ]
    shares = torch.stack(shares)
    assert shares.min() >= -1e-6
    assert shares.max() <= 1 + 1e-6
    assert bool(((shares.mean(1) - 0.5).abs() < 3 * shares.std(1) / math.sqrt(100)).all())
    assert set(lenses.blades.tolist()) == {0, 6}
    together = torch.corrcoef(shares) - torch.eye(5)
    assert together.abs().max() < 4 / math.sqrt(100)


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
    known[name] = Distribution("uniform", LOOK[name])
    views, lenses = RandomDefocus(**known)(image(2), near, [4, 10])
    drawn = getattr(lenses, name).tolist()
    assert len(set(drawn)) == 2
    assert all(LOOK[name][0] <= value <= LOOK[name][1] for value in drawn)
    shown = "left" if name == "crosstalk" else "render"
    apart = (getattr(views, shown) - getattr(plain, shown)).abs().amax((1, 2, 3))
    assert float(apart.min()) > 1e-3


def test_lenses_have_each_option_and_another_is_refused():
    assert Lenses._fields == ("signed_radius", *OPTIONS)
    with pytest.raises(TypeError, match="no option fnumber; choose from foclen"):
        RandomDefocus(fnumber=2.0)


def dataset_sample():
    colors, metres = image(1)[0], depth(1)[0]
    return {"image": colors, "depth": metres, "masks": metres > 2000, "name": "a", "seed": 7}


def of_v2(sample):
    tv = pytest.importorskip("torchvision.tv_tensors", reason="not on this system: torchvision")
    masks = {name: tv.Mask(sample[name]) for name in ("depth", "masks")}
    return {**sample, "image": tv.Image(sample["image"]), **masks}


def of_albumentations(sample):
    arrays = {k: sample[k].movedim(0, -1).numpy() for k in ("image", "masks")}
    return {**sample, **arrays, "depth": sample["depth"][0].numpy()}


@pytest.mark.parametrize("made", [dict, of_v2, of_albumentations])
def test_a_sample_is_transformed_as_a_batch_of_one_and_stays_what_it_is(made):
    defocus, sample = RandomDefocus(left_right=True), made(dataset_sample())
    views, lenses = defocus(image(1), depth(1), [7])
    found = defocus(sample)
    assert found.keys() == {*sample, "left", "right", "coc", "lens"}
    assert found["masks"] is sample["masks"]
    for name, wanted in (("image", views.render), ("left", views.left), ("right", views.right)):
        assert type(found[name]) is type(sample["image"])
        torch.testing.assert_close(planes_of(name, found[name]), wanted[0], rtol=0, atol=0)
    assert type(found["coc"]) is type(sample["depth"])
    assert found["coc"].shape == sample["depth"].shape
    assert found["lens"]["fnum"] == lenses.fnum
    del sample["seed"]
    torch.manual_seed(1)
    first = defocus(sample)["lens"]
    assert first != defocus(sample)["lens"]
    torch.manual_seed(1)
    assert first == defocus(sample)["lens"]


def test_mirroring_needs_a_probability():
    with pytest.raises(ValueError, match="p must be a probability"):
        mirrored({}, p=2)


def test_a_mirrored_sample_is_that_of_the_mirrored_scene():
    known = {"left_right": True, "blades": 0, "fnum": 0.4}
    defocus, sample = RandomDefocus(**known), dataset_sample()
    found, wanted = mirrored(defocus(sample)), defocus(mirrored(sample))
    for name in ("image", "left", "right", "coc", "masks"):
        torch.testing.assert_close(found[name], wanted[name], rtol=0, atol=2e-3 * (name != "coc"))
    assert (found["left"] - found["right"]).abs().max() > 0.01
    assert (found["name"], found["lens"]) == ("a", wanted["lens"])


def test_noise_is_that_of_the_lens_drawn_and_no_part_of_gradients():
    electrons = Distribution("loguniform", (100.0, 1000.0))
    colors = image(1).expand(2, -1, -1, -1).clone().requires_grad_()
    options = {"left_right": True, "fnum": 8.0}
    clean, _ = RandomDefocus(**options)(colors, depth(2), [3, 4])
    noisy = RandomDefocus(**options, electrons=electrons, read_noise=2.0)
    views, lenses = noisy(colors, depth(2), [3, 4])
    for number in range(2):
        for view, halves in ((0, 1), (1, 2)):
            light, count = clean.images[view][number], lenses.electrons[number] / halves
            wanted = ((light / count + 4 / count**2).mean()).sqrt()
            noise = views.images[view][number] - light
            assert noise.std().item() == pytest.approx(wanted.item(), rel=0.1)
    assert torch.equal(*(torch.autograd.grad(v.render.sum(), colors)[0] for v in (clean, views)))
