"""Numbers that the laws are about."""

import math

import torch


def worst(a, b):
    """Greatest difference."""
    return float((a.double() - b).abs().max())


def psnr(a, b):
    """Peak signal to noise in dB, for a peak of 1."""
    return -10 * math.log10(float((a.double() - b).square().mean().clamp(min=1e-30)))


def inner(image, border):
    """Without a border."""
    return image[..., border : image.shape[-2] - border, border : image.shape[-1] - border]


def centred(length):
    """Coordinates of pixels from the middle one."""
    return torch.arange(length, dtype=torch.float64) - length // 2


def centroid(image):
    """Column and row of the first channel's centre of mass, from the middle pixel."""
    share = image[0].double() / image[0].double().sum()
    H, W = share.shape
    return float((share.sum(0) * centred(W)).sum()), float((share.sum(1) * centred(H)).sum())
