"""Numbers that the laws are about."""

import math

import numpy as np


def worst(a, b):
    """Greatest difference."""
    return float((a.double() - b).abs().max())


def centroid(light):
    """Column and row of the middle of light [..., H, W]."""
    light = np.asarray(light, np.float64).reshape(-1, *light.shape[-2:]).sum(0)
    return [float(np.arange(len(x)) @ x / x.sum()) for x in (light.sum(0), light.sum(1))]


def psnr(a, b):
    """Peak signal to noise in dB, for a peak of 1."""
    return -10 * math.log10(float((a.double() - b).square().mean().clamp(min=1e-30)))


def inner(image, border):
    """Without a border."""
    return image[..., border : image.shape[-2] - border, border : image.shape[-1] - border]
