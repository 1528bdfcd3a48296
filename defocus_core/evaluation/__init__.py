"""Laws of the lens and their checks, error metrics, a baseline."""
