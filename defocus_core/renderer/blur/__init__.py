"""Layers blurred by the pupil's kernels: kernel bank, Fourier blur, reduced resolution.

window: the rectangle that a transform reads: a tile and a margin as wide as the kernels' reach.
margin, reach: the distance in px from the middle of a kernel to its farthest pixel.
kernel: the pupil's point spread function, sampled. spectrum: its Fourier transform at the size of a
window.
leaning kernel: a kernel times u.x or u.y, needed for a slice with several slopes.
tilted kernel: a kernel that includes one slope, for a plane.
coarse pixel: a pixel of reduced resolution. piece: one layer in one tile at full resolution.
"""
