"""The depth of an element, which is empty where its alpha is 0."""

from __future__ import annotations

from defocus_core.picture.element import element_depth
from defocus_core.picture.pair import InputPair


def pair(given: InputPair) -> InputPair:
    """The pair of an element, whose depth knows where it is empty."""
    return given.with_depth(element_depth(given.depth, given.color, given.keeping))
