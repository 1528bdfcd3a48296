"""The lens: circle of confusion, sensor, pupil and kernels."""
