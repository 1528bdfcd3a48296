"""Rendering by compiled loops (Numba) instead of torch, for the CPU and without gradients."""
