"""The lens: circle of confusion, sensor, pupil and its kernels.

aperture (pupil): the opening, in units of its radius. outline: its border, a disc or a polygon.
part: a rectangle of lens coordinates within the pupil, such as its LEFT half. share: a fraction of
the area or the light of the pupil, or of a part. lens point: u, a point of the pupil.
kernel: samples of the blur of one point, at pixels. CoC: the circle of confusion, a diameter in mm;
signed radius: half of it in px, negative nearer than the plane in focus.
"""
