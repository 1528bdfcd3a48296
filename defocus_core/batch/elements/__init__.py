"""Elements: pictures of some objects alone, with alpha; their overscan; the plates below them.

An element: a picture with nothing where its alpha is 0. A plate: the picture that an element lies
over. Overscan: pixels beyond the picture shown.
"""
