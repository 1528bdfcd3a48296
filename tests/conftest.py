"""Makes the ray tracer of the sample scenes importable."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "sample_scenes"))
