"""Deep EXR files, written by OpenImageIO: in scan lines or tiles, of half or float."""

import OpenImageIO as oiio  # noqa: N813


def write_deep_samples(
    path,
    pixels,
    names=("R", "G", "B", "A", "Z"),
    *,
    light="half",
    tile=0,
    corner=(0, 0),
    full=None,
    views=(),
):
    """Write rows of pixels, each a list of samples by name of the channel, in any order."""
    height, width = len(pixels), len(pixels[0])
    spec = oiio.ImageSpec(width, height, len(names), "float")
    spec.channelnames = tuple(names)
    kinds = ["float" if name.startswith("Z") else light for name in names]
    spec.channelformats = tuple(oiio.TypeDesc(kind) for kind in kinds)
    spec.deep = True
    spec.x, spec.y = corner
    spec.full_width, spec.full_height = full or (width, height)
    spec.tile_width = spec.tile_height = tile
    if views:
        spec.attribute("multiView", oiio.TypeDesc(f"string[{len(views)}]"), views)
    data = oiio.DeepData()
    data.init(width * height, len(names), [oiio.TypeDesc(kind) for kind in kinds], names)
    flat = [samples for row in pixels for samples in row]
    for number, samples in enumerate(flat):
        data.set_samples(number, len(samples))
        for k, sample in enumerate(samples):
            for index, name in enumerate(names):
                data.set_deep_value(number, index, k, sample[name])
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec), output.geterror()
    assert output.write_deep_image(data), output.geterror()
    assert output.close()
    return path


def from_layers(colors, depth, coverage):
    """Samples of layers [L, 3, H, W] that have coverage [L, H, W], in order of the layers."""
    count, height, width = coverage.shape
    return [
        [
            [
                {
                    **dict(zip("RGB", colors[k, :, y, x].tolist(), strict=True)),
                    "A": float(coverage[k, y, x]),
                    "Z": float(depth[k, y, x]),
                }
                for k in range(count)
                if coverage[k, y, x] > 0
            ]
            for x in range(width)
        ]
        for y in range(height)
    ]
