"""Laws of the lens and their measurement, error metrics, and a baseline renderer."""
