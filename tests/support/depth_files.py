"""Depth files as their formats' own rules say, written without the code under test."""

import base64
import struct

import numpy as np
from image_files import save


def png(path, values, dtype=np.uint16):
    """A PNG of integers [H, W] or [H, W, C]."""
    samples = np.asarray(values)
    samples = samples if samples.ndim == 3 else samples[:, :, None]
    return save(path, np.ascontiguousarray(samples.astype(dtype)))


def pfm(path, values, *, big=False):
    """A grey PFM, rows from bottom to top."""
    height, width = values.shape
    head = f"Pf\n{width} {height}\n{'1.0' if big else '-1.0'}\n".encode()
    path.write_bytes(head + np.asarray(values)[::-1].astype(">f4" if big else "<f4").tobytes())
    return path


def npy(path, values, dtype=np.float32):
    """An NPY file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, np.asarray(values, dtype))
    return path


def dpt(path, values):
    """Sintel's depth: tag, width, height, rows."""
    height, width = values.shape
    head = struct.pack("<fii", 202021.25, width, height)
    path.write_bytes(head + np.asarray(values).astype("<f4").tobytes())
    return path


def colmap(path, values):
    """COLMAP's dense map."""
    height, width = values.shape
    path.write_bytes(f"{width}&{height}&1&".encode() + np.asarray(values).astype("<f4").tobytes())
    return path


def gdepth(path, depth_png, *, turn=1, picture=None, sharp=b"", **properties):
    """A JPEG whose XMP has GDepth, its image in two parts of the extended XMP."""
    picture = np.full((2, 3, 3), 128, np.uint8) if picture is None else picture
    save(path, picture, Orientation=turn)
    jpeg = path.read_bytes()
    digest = b"0123456789ABCDEF0123456789ABCDEF"
    told = " ".join(f'GDepth:{key}="{value}"' for key, value in properties.items())
    main = f"<x:xmpmeta><rdf:Description {told}/></x:xmpmeta>".encode()
    original = f' GImage:Data="{base64.b64encode(sharp).decode()}"' if sharp else ""
    data = base64.b64encode(depth_png).decode()
    more = f'<rdf:Description GDepth:Data="{data}"{original}/>'.encode()
    half = len(more) // 2
    bodies = [b"http://ns.adobe.com/xap/1.0/\0" + main]
    for offset, part in ((half, more[half:]), (0, more[:half])):  # in any order
        head = digest + struct.pack(">II", len(more), offset)
        bodies.append(b"http://ns.adobe.com/xmp/extension/\0" + head + part)
    segments = b"".join(b"\xff\xe1" + struct.pack(">H", len(b) + 2) + b for b in bodies)
    path.write_bytes(jpeg[:2] + segments + jpeg[2:])
    return path


def dynamic_depth(path, depth, *, picture, by_elements, **properties):
    """A JPEG with Dynamic Depth: the depth image lies behind it, before another file."""

    def told(space, values):
        if by_elements:
            inner = "".join(f"<{space}:{k}>{v}</{space}:{k}>" for k, v in values.items())
            return f' rdf:parseType="Resource">{inner}</'
        return " " + " ".join(f'{space}:{k}="{v}"' for k, v in values.items()) + "/></"

    items = (
        {"Mime": "image/jpeg", "Length": 0, "Padding": 5, "DataURI": "primary"},
        {"Mime": "image/png", "Length": len(depth), "Padding": 3, "DataURI": "android/depthmap"},
        {"Mime": "text/plain", "Length": 7, "DataURI": "other"},
    )
    seq = "".join(f"<rdf:li><Container:Item{told('Item', item)}rdf:li>" for item in items)
    properties["DepthURI"] = "android/depthmap"
    xmp = f"<x:xmpmeta>{seq}<Camera:DepthMap{told('DepthMap', properties)}x:xmpmeta>"
    body = b"http://ns.adobe.com/xap/1.0/\0" + xmp.encode()
    jpeg = save(path, picture).read_bytes()
    segment = b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body
    path.write_bytes(jpeg[:2] + segment + jpeg[2:] + bytes(5) + depth + bytes(3) + b"another")
    return path


def multi_picture(path, picture, further, **saved):
    """A JPEG in the Multi-Picture Format: its further pictures are (XMP, samples)."""
    save(path, picture, **saved)
    first, files = path.read_bytes(), []
    for n, (xmp, samples) in enumerate(further):
        jpeg = save(path.with_name(f"further{n}.jpg"), samples).read_bytes()
        body = b"http://ns.adobe.com/xap/1.0/\0" + xmp.encode()
        files.append(jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:])
    fields = struct.pack(">HHI4s", 0xB000, 7, 4, b"0100")
    fields += struct.pack(">HHII", 0xB001, 4, 1, 1 + len(files))
    fields += struct.pack(">HHII", 0xB002, 7, 16 * (1 + len(files)), 8 + 2 + 3 * 12 + 4)
    size = 4 + 4 + 8 + len(fields) + 6 + 16 * (1 + len(files))
    place, entries = len(first) + size - 2 - 8, struct.pack(">IIIHH", 0x30000, 0, 0, 0, 0)
    for file in files:
        entries += struct.pack(">IIIHH", 0, len(file), place, 0, 0)
        place += len(file)
    head = b"MM\0*" + struct.pack(">IH", 8, 3) + fields + bytes(4) + entries
    body = b"MPF\0" + head
    segment = b"\xff\xe2" + struct.pack(">H", len(body) + 2) + body
    assert len(segment) == size
    path.write_bytes(first[:2] + segment + first[2:] + b"".join(files))
    return path


def of_apple(kind, *, by_elements=False, **properties):
    """The XMP of an auxiliary picture of Apple's."""
    told = {"AuxiliaryImageType": kind, **properties}
    if by_elements:
        inner = "".join(f"<apdi:{name}>{value}</apdi:{name}>" for name, value in told.items())
        return f"<x:xmpmeta><rdf:Description>{inner}</rdf:Description></x:xmpmeta>"
    inner = " ".join(f'apdi:{name}="{value}"' for name, value in told.items())
    return f"<x:xmpmeta><rdf:Description {inner}/></x:xmpmeta>"
