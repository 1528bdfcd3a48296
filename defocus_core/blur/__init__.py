"""Layers blurred by the pupil's kernels: kernel bank, Fourier blur, reduced resolution."""
