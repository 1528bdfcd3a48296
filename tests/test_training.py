"""A network learns from drawn samples and from those of a finished batch."""

import pytest
from training import make_batch, train


@pytest.mark.bench
def test_the_error_on_held_out_scenes_falls_by_half(tmp_path):
    before, after = train(make_batch(tmp_path, scenes=12), steps=90, size=3)
    assert after <= before / 2
