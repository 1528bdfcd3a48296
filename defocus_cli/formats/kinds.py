"""Kinds of output, the types of their files, and which of them are rendered."""

from __future__ import annotations

IMAGE_KINDS = ("render", "left", "right")


MAP_KINDS = ("coc", "disparity", "trust")


RENDERED_KINDS = (*IMAGE_KINDS, "trust")


KINDS = IMAGE_KINDS + MAP_KINDS


SUFFIXES = {"exr": ".exr", "png": ".png", "png16": ".png", "tiff": ".tif", "jpg": ".jpg"}


PREVIEW = ".preview"


FORMAT_ALIASES = {"jpeg": "jpg", "tif": "tiff"}
