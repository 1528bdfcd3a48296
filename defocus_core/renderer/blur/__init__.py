"""Layers blurred by the pupil's kernels: kernel bank, Fourier blur, reduced resolution.

window: the rectangle that a transform reads: a tile and the margin that kernels reach around it.
margin, reach: the distance in px from the middle of a kernel to its farthest pixel.
kernel: samples of the pupil's point spread. spectrum: its Fourier transform at a window's size.
leaning: a kernel times u.x and u.y, which a slice of several slopes needs. tilted: a kernel with
one slope already added, for a plane.
coarse pixel: a pixel of reduced resolution. piece: one layer in one tile at full resolution.
"""
