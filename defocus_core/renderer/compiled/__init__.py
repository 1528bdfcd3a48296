"""The same picture by compiled loops (Numba), for the CPU without gradients."""
