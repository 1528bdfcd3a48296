"""What pictures look like: the opening of the lens, noise of the sensor, previews, contact sheets.

opening: the hole that lets light in, the pupil of the core. rim: the end of the barrel before it.
preview: a PNG to look at. sheet: pictures side by side. false colour: near, sharp and far.
"""
