"""Files of a shot: numbered frames, and metadata of a moving lens.

A shot is a sequence of frames, files that a frame pattern numbers. A gap is a missing frame of a
regular numbering. A key is a frame and the value of an option there; between keys, values are
interpolated.
"""
