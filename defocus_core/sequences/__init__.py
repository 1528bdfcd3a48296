"""Sequences of frames: one repair for all their depth."""
