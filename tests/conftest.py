"""Makes the ray tracer of the sample scenes importable, and torch use one thread."""

import sys
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parents[1] / "sample_scenes"))

# Small tensors gain nothing from a second thread, and lose much where the machine is busy.
torch.set_num_threads(1)
