"""Error and time of each quality and of a baseline, on shots with known truth."""
