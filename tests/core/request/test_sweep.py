"""Sweeps and random lenses: which lenses there are, what they are named, and that they stay."""

import math
from itertools import pairwise
from statistics import mean

import pytest
from jobs_files import LENS, jobs, names, touch
from refusals import refuses

from defocus_core.request.parameters import LENS_OPTIONS
from defocus_core.request.resolver import value_of


def swept(folder, text, lens=""):
    return jobs(folder, f"{LENS}{lens}\n[sweep]\n{text}\n")


def sampled(folder, sample, lens="", *, inputs=""):
    return jobs(folder, f"{LENS}{lens}\n[sample]\n{sample}\n", inputs=inputs)


def test_lists_make_a_grid_whose_names_say_what_is_swept(tmp_path):
    found = swept(tmp_path, 'fnumber = [1.4, 2.8]\nfocus = ["50cm", "2m", "inf", "percentile(5)"]')
    focuses = ("focus500mm", "focus2m", "focusinf", "focusp5")
    assert names(found)[:5] == [*(f"a_f1.4_{focus}" for focus in focuses), "a_f2.8_focus500mm"]
    assert [job.lens.fnum for job in found] == [1.4] * 4 + [2.8] * 4
    assert [job.lens.foc_dist for job in found[:4]] == [500, 2000, math.inf, None]
    assert found[3].lens.focus_percentile == 5


def test_blades_are_turned_where_there_are_any(tmp_path):
    turn = "blade-rotation = 10\n"
    found = swept(tmp_path, "blades = [0, 6]", f'fnumber = 2\nfocus = "2m"\n{turn}')
    assert [job.lens.blade_rotation for job in found] == [0, 10]
    for sweep in ("blades = [0, 6]\nblade-rotation = [0, 10]", "blade-rotation = [10]"):
        with refuses("idle-option", field="blade-rotation"):
            swept(tmp_path, sweep, 'fnumber = 2\nfocus = "2m"\n')


@pytest.mark.parametrize("row", LENS_OPTIONS.values(), ids=lambda row: row.name)
def test_every_option_of_a_lens_can_be_swept(tmp_path, row):
    fixed = {"focal-length": "50mm", "fnumber": "2", "focus": "2m"}
    fixed |= {row.needs: LENS_OPTIONS[row.needs].example} if row.needs else {}
    if "blur" in (row.name, row.needs):
        fixed = {"blur": "40px", "focus-at": "3,4"}
    named = {k: v for k, v in fixed.items() if k not in (row.name, row.instead_of)}
    lens = "".join(f'{name} = "{value}"\n' for name, value in named.items())
    found = jobs(tmp_path, f'[lens]\n{lens}[sweep]\n{row.name} = ["{row.example}"]\n')
    assert names(found) == [f"a_{row.file_tag(value_of(row.name, row.example))}"]
    tags = {each.tag for each in LENS_OPTIONS.values()}
    assert len(tags) == len(LENS_OPTIONS)


def test_lenses_that_belong_together_are_no_grid(tmp_path):
    sets = 'lenses = [{focus = "1m", fnumber = 2}, {focus = "2m", fnumber = 4}]\nblades = [0, 6]'
    lenses = ("f2_focus1m", "f4_focus2m")
    assert names(swept(tmp_path, sets)) == [f"a_{a}_blades{n}" for a in lenses for n in (0, 6)]


def steps(values):
    return [b - a for a, b in pairwise(values)]


@pytest.mark.parametrize(
    ("scale", "law"), [("disparity", lambda z: 1 / z), ("depth", lambda z: z), ("log", math.log)]
)
def test_a_focal_stack_has_equal_steps_in_what_it_says(tmp_path, scale, law):
    found = swept(tmp_path, f'focus = "0.5m..8m @ 12 in {scale}"', "fnumber = 2")
    distances = [job.lens.foc_dist for job in found]
    assert len(found) == 12
    assert (distances[0], distances[-1]) == (500, 8000)
    between = steps([law(z) for z in distances])
    assert between == pytest.approx([mean(between)] * 11, rel=1e-4)


SAMPLE = 'n = 200\nseed = 7\nfnumber = "loguniform(1.4, 16)"\nfocus = "percentile(5, 95)"\n'


def test_draws_are_of_their_distributions(tmp_path):
    more = 'blades = "choice(0, 6)"\nblade-rotation = "uniform(-10, 20)"\n'
    lenses = [job.lens for job in sampled(tmp_path, SAMPLE + more)]
    stops = [math.log(lens.fnum / 1.4) / math.log(16 / 1.4) for lens in lenses]
    percents = [(lens.focus_percentile or 0) / 90 - 5 / 90 for lens in lenses]
    turns = [(lens.blade_rotation + 10) / 30 for lens in lenses]
    deviation = 1 / math.sqrt(12 * len(lenses))
    for shares in (stops, percents, turns):
        assert min(shares) >= 0
        assert max(shares) <= 1
        assert abs(mean(shares) - 0.5) < 3 * deviation
    assert 70 < [lens.blades for lens in lenses].count(6) < 130
    assert {lens.blades for lens in lenses} == {0, 6}


def test_draws_of_an_option_do_not_follow_those_of_another(tmp_path):
    text = 'n = 200\nseed = 7\nfnumber = "uniform(1, 2)"\nfocus = "disparity(2m, inf)"\n'
    lenses = [job.lens for job in sampled(tmp_path, text)]
    stops, shares = ([each.fnum - 1 for each in lenses], [2000 / each.foc_dist for each in lenses])
    assert 0 <= min(shares) <= max(shares) <= 1
    assert abs(mean(shares) - 0.5) < 3 / math.sqrt(12 * 200)
    assert not follows(stops, shares)


def follows(some, others):
    """Whether numbers from 0 to 1 have to do with others."""
    products = [(a - 0.5) * (b - 0.5) * 12 for a, b in zip(some, others, strict=True)]
    return abs(mean(products)) > 3 / math.sqrt(len(products))


def test_a_draw_depends_on_seed_name_and_index_alone(tmp_path):
    touch(tmp_path, "1.exr", "2.exr", "3.exr")
    all_three = sampled(tmp_path, SAMPLE, inputs='color = "*.exr"')
    one = sampled(tmp_path, SAMPLE.replace("200", "9"), "blades = 0", inputs='color = "2.exr"')
    alike = {job.sample_id: job.lens.fnum for job in all_three}
    assert {job.sample_id: job.lens.fnum for job in one}.items() <= alike.items()
    assert len(set(alike.values())) > 590
    other = sampled(tmp_path, SAMPLE.replace("7", "8"), inputs='color = "*.exr"')
    assert sum(job.lens.fnum == alike[job.sample_id] for job in other) < 5


def test_the_numbers_drawn_are_these_for_ever(tmp_path):
    """A published data set must come out of its jobs file again."""
    found = sampled(tmp_path, SAMPLE.replace("200", "2"))
    assert names(found) == ["a_s000", "a_s001"]
    drawn = [(job.lens.fnum, job.lens.focus_percentile) for job in found]
    assert drawn == [(1.72343, 67.126), (1.94229, 33.485)]


def test_draws_are_taken_for_each_lens_of_a_sweep_and_follow_no_other(tmp_path):
    found = jobs(tmp_path, f"{LENS}[sweep]\nblades = [0, 6]\n[sample]\n{SAMPLE}")
    assert names(found)[199:201] == ["a_blades0_s199", "a_blades6_s000"]
    stops = [math.log(job.lens.fnum / 1.4) / math.log(16 / 1.4) for job in found]
    assert len(set(stops)) == 400
    assert not follows(stops[:200], stops[200:])


def test_a_lens_that_is_listed_wins_over_those_of_all_and_it_is_said(tmp_path, caplog):
    lens = 'fnumber = 2\nfocus = "2m"'
    found = swept(tmp_path, 'lenses = [{focus = "3m"}, {blades = 6}]', lens)
    assert [(job.lens.foc_dist, job.lens.blades) for job in found] == [(3000, 0), (2000, 6)]
    (told,) = caplog.messages
    assert told.endswith("jobs.toml: [lens] focus: has no effect on lenses of [sweep] that set it")
