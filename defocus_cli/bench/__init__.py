"""Error and time of the renderer on scenes with known truth."""
