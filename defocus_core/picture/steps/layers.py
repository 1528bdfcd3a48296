"""Layers of a scene: what lies behind each other is known, of deep pixels or below an element."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.io.arrays import times
from defocus_core.picture.radii import radii_of
from defocus_core.picture.scene import Pass, Surfaces
from defocus_core.picture.sources import map_windows, windows


def scene(surfaces: Surfaces) -> Surfaces:
    """The surface of each layer."""
    take = surfaces.take
    layers, device, keeping = take.inputs.layers, take.device, take.inputs.holding.keeping
    assert layers is not None
    every = tuple(
        take.radii if depth is take.inputs.depth else radii_of(take.lens, depth, keeping)
        for depth in layers.depths
    )
    return replace(
        surfaces,
        colors=layers.pictures,
        radii=every,
        light=tuple(windows(light, device) for light in layers.light),
        px=tuple(map_windows(times(each.px, surfaces.longer), device) for each in every),
        coverage=windows(layers.alpha, device),
    )


def passes(every: tuple[Pass, ...]) -> tuple[Pass, ...]:
    """The passes, whose light has no alpha, or that of a holdout at its end."""
    inputs = every[0].take.inputs
    layers, alpha = inputs.layers, len(inputs.color.light)
    assert layers is not None
    held_out, last = layers.held_out, len(layers.light[0]) - 1

    def of_layers(each: Pass) -> Pass:
        light = [c - (c > alpha) for c in each.channels if c != alpha]
        if held_out and alpha in each.channels:
            light.append(last)
        end = len(light) - held_out
        order = (end if c == alpha else light.index(c - (c > alpha)) for c in each.channels)
        return each._replace(light=tuple(light), order=tuple(order))

    return tuple(map(of_layers, every))
