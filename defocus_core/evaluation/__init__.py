"""Laws of the lens and their checks, error metrics, baseline renderers, synthetic scenes, cost."""
