"""Tags of a photograph: its EXIF, GPS and IPTC metadata on camera and author."""

from __future__ import annotations

from itertools import accumulate
from typing import Any, NamedTuple

# OpenImageIO's names; other attributes describe how the file is encoded.
_TAG_GROUPS = ("Exif:", "GPS:", "IPTC:")
_TAGS = {
    *("Make", "Model", "Artist", "Copyright", "ImageDescription", "DateTime"),
    *("FNumber", "ExposureTime"),
}
# The output may differ from these, or they are of unknown structure.
_NO_TAGS = {
    *("Exif:PixelXDimension", "Exif:PixelYDimension", "Exif:ColorSpace", "Exif:MakerNote"),
}
# Of all tags, as text: JPEG has 64 KB for them, and its encoder ends the process if they are more.
_MAX_BYTES = 2**14


class Tag(NamedTuple):
    """An EXIF, GPS or IPTC attribute under OpenImageIO's name: text, a number or some numbers."""

    value: str | float | tuple[float, ...]


def tags_of(spec: Any) -> dict[str, Tag]:
    """The tags in an OpenImageIO ``spec``, by name, the shortest first, as many as fit a JPEG."""
    named = {
        attribute.name: attribute.value
        for attribute in spec.extra_attribs
        if (attribute.name in _TAGS or attribute.name.startswith(_TAG_GROUPS))
        and "rational" not in str(attribute.type)  # OpenImageIO makes floats of those of EXIF
    }
    tags = {
        name: Tag(_text(value) if isinstance(value, str) else value)
        for name, value in named.items()
        if name not in _NO_TAGS and isinstance(value, str | int | float | tuple)
    }
    sizes = {name: len(str(tag.value).encode()) for name, tag in tags.items()}
    shortest_first = sorted(tags, key=sizes.__getitem__)
    totals = accumulate(sizes[name] for name in shortest_first)
    fitting = [
        name for name, total in zip(shortest_first, totals, strict=True) if total <= _MAX_BYTES
    ]
    return {name: tags[name] for name in fitting}


def _text(text: str) -> str:
    """Text of a tag; what is not UTF-8 is taken for Latin-1, as older cameras write it."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return text.encode(errors="surrogateescape").decode("latin-1")
    return text


def set_tag(spec: Any, name: str, tag: Tag) -> None:
    """Set a tag in an OpenImageIO ``spec``."""
    import OpenImageIO as oiio  # noqa: N813 - its documentation's own name for it

    value = tag.value
    if isinstance(value, tuple):
        kind = "int" if all(isinstance(number, int) for number in value) else "float"
        spec.attribute(name, oiio.TypeDesc(f"{kind}[{len(value)}]"), value)
    else:
        spec.attribute(name, value)
