"""What pictures look like: opening of the lens, clipped lights, noise, previews, false colour.

opening: the hole that lets light in, the pupil of the core. rim: the end of the barrel before it.
preview: a PNG to look at. false colour: near, sharp and far.
"""
