"""Layers composited to a picture: saturating sum, views of the aperture, highlights, frame border.

coverage: the share of an aperture part that sees a layer at a pixel, in [0, 1].
part: a region of the aperture, such as its left half.
share: the fraction of a layer, a part or a pixel that counts.
front: the colours and the coverage composited so far, from the nearest layer on.
highlight (light): a pixel far brighter than the rest, drawn as a separate disc.
square: a piece of a disc that is drawn, and tested for nearer surfaces, at once.
occluded: hidden from a part of the lens by a nearer surface.
"""
