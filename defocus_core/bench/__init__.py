"""Error and time of each quality and of a baseline, on shots with known truth.

A shot is here one photograph of a scene, not a sequence of frames.
"""
