"""The same rendering by compiled loops (Numba), for the CPU and without gradients."""
