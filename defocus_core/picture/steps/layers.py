"""Layers of a scene: what lies behind each other is known, of deep pixels or below an element."""

from __future__ import annotations

from dataclasses import replace

from defocus_core.io.arrays import times
from defocus_core.picture.radii import radii_of
from defocus_core.picture.scene import Pass, Passes, Surfaces
from defocus_core.picture.sources import map_windows, windows
from defocus_core.picture.take import Take


def radii(take: Take) -> Take:
    """The take with the radii of each layer."""
    assert take.inputs.layers is not None
    known, keeping = {id(take.inputs.depth): take.radii, **take.behind}, take.inputs.holding.keeping
    for depth in take.inputs.layers.depths:
        if id(depth) not in known:
            known[id(depth)] = radii_of(take.lens, depth, keeping)
    return replace(take, behind=known)


def scene(surfaces: Surfaces) -> Surfaces:
    """The surface of each layer."""
    take = surfaces.take
    layers, device = take.inputs.layers, take.device
    assert layers is not None
    every = tuple(take.behind[id(depth)] for depth in layers.depths)
    return replace(
        surfaces,
        colors=layers.pictures,
        radii=every,
        light=tuple(windows(light, device) for light in layers.light),
        px=tuple(map_windows(times(each.px, surfaces.longer), device) for each in every),
        coverage=windows(layers.alpha, device),
    )


def passes(whole: Passes) -> Passes:
    """The passes, whose light has no alpha, or that of a holdout at its end."""
    layers, alpha = whole.take.inputs.layers, len(whole.take.inputs.color.light)
    assert layers is not None
    held_out, last = layers.held_out, len(layers.light[0]) - 1

    def of_layers(each: Pass) -> Pass:
        light = [c - (c > alpha) for c in each.channels if c != alpha]
        if held_out and alpha in each.channels:
            light.append(last)
        end = len(light) - held_out
        order = (end if c == alpha else light.index(c - (c > alpha)) for c in each.channels)
        return each._replace(light=tuple(light), order=tuple(order))

    return replace(whole, every=tuple(map(of_layers, whole.every)))
