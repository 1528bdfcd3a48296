"""Error and time of qualities and a baseline on shots with known truth."""
