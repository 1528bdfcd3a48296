"""Goldens: pictures that were accepted, which later renders must be like.

Terms: a golden is an accepted picture; a folder of goldens has the pictures of a jobs file, as a
batch writes them, and golden.json, which says how each was made. A planted fault is a change that
a threshold must notice.
"""
