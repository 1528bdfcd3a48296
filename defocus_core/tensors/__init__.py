"""Pictures as tensors and windows of them: tiling, pyramids, resampling, neighbourhoods.

box: a rectangle of a picture. span: a range of rows or columns. window: the pixels in a box.
band: full rows of a picture.
tile: a square of the fixed grid. region: neighbouring tiles that share work. block: 16 x 16 px.
coarse pixel: a pixel of a halved picture. middle: the middle of the frame, about which coarse
pixels lie symmetrically.
"""
