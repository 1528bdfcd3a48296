"""Words and JSON for what was done, planned, measured or found in a file."""
