"""Colours and coverage of a tile through each part of the aperture, composited front to back.

Three laws hold for known surfaces in three places. Slices of a layer, and visible samples of
neighbouring layers, add up, for parts of one continuous surface are complementary: a saturating
sum. Samples of one pixel occlude each other by their coverage, uncorrelated (`over`); what shows of
them is their visible share. Surfaces out of focus cover each other by chance: behind a front of
coverage A a layer of coverage a, visible or hidden, is seen by a (1 - A). Where this is more than
its visible share, the lens looks behind what hides the layer from the pinhole, and the hidden share
adds the difference. In focus, where A and a are those of the pixel, the difference is 0. Nothing is
seen past opaque samples where none of their edges is in reach (`Openings`).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from defocus_core.renderer.blur.layer_blur import ShownLayer
from defocus_core.renderer.compositing.saturating_sum import (
    add_within,
    is_full,
    shown_behind,
    summed,
)
from defocus_core.renderer.compositing.sight import Openings, SightLimits
from defocus_core.tensors.box import Box
from defocus_core.tensors.device_plan import sent

# Coverage below which a hidden share is rounding.
_MINIMUM = 1e-6


def add_known(
    front: Tensor,  # [M, C + 1, h, w], zeros; overwritten unless gradients are enabled
    visible: dict[int, ShownLayer],
    hidden: dict[int, ShownLayer],
    full: Tensor | float,
    openings: Openings,
    *,
    closed: bool,
) -> tuple[Tensor, Tensor | None]:
    """Composite the layers of one group of aperture parts over a tile."""
    moved, hidden_fractions = None, []
    for number in sorted({*visible, *hidden}):
        shown, behind = visible.get(number), hidden.get(number)
        before = None if behind is None else behind.box.of(front)[:, -1:].clone()
        if shown is not None:
            within = _of(full, shown.box)
            layer, fraction = shown_behind(shown.box.of(front), shown.layer, within)
            fraction = fraction * openings.over(shown.box).to(number)
            front = add_within(front, shown.box, layer, fraction)
            if shown.moved is not None:
                moved = torch.zeros_like(front[:, :-1]) if moved is None else moved
                moved = add_within(moved, shown.box, shown.moved, fraction)
        if behind is not None and before is not None:
            room = openings.over(behind.box).to(number)
            fraction = _fraction_hidden(before, front, shown, behind, full, room)
            front = add_within(front, behind.box, behind.layer, fraction)
            hidden_fractions.append((behind, fraction, room))
    for behind, fraction, room in hidden_fractions if closed else ():
        within, window = _of(full, behind.box), behind.box.of(front)
        if not is_full(window, within):
            rest = behind.layer * (1 - fraction)
            rest, left = shown_behind(window, rest, within)
            front = add_within(front, behind.box, rest, left * room)
    return front, moved


def _of(full: Tensor | float, box: Box) -> Tensor | float:
    """The greatest coverage in a box."""
    return box.of(full) if isinstance(full, Tensor) else full


def _fraction_hidden(
    before: Tensor,  # [M, 1, h, w], coverage of the front in this box before the layer
    front: Tensor,  # [M, C + 1, H, W], the front with what is visible of the layer
    shown: ShownLayer | None,
    behind: ShownLayer,
    full: Tensor | float,
    room: Tensor,  # [h, w], the share of a gap in this box that is no error
) -> Tensor:
    """The share [M, 1, h, w] of a hidden layer that is seen, in its box."""
    box, maximum = behind.box, _of(full, behind.box)
    coverage = behind.layer[:, -1:].clamp(min=0)
    whole = coverage
    if shown is not None:
        both = shown.box.grown(0, box)
        if both.height > 0 and both.width > 0:
            visible = both.seen_from(shown.box).of(shown.layer)[:, -1:].clamp(min=0)
            whole = add_within(coverage.clone(), both.seen_from(box), visible)
    gap = (maximum - before).clamp(min=0) * room
    expected = gap * (whole / maximum).clamp(max=1)
    added = (expected - (box.of(front)[:, -1:] - before)).clamp(min=0)
    added = torch.where(coverage > _MINIMUM, added, 0.0)
    return (added / coverage.clamp(min=_MINIMUM)).clamp(max=1)


# Gap in coverage that is not worth filling: dividing by the coverage makes up for it.
_NEGLIGIBLE = 0.05
# Share of the aperture that is too small to see anything through.
_MIN_ROOM = 1e-4
# Gap beside what a near surface covers, as a share of this, that is an error of what it hides.
_ERROR = 0.2
_LEAST_ERROR = 1e-12  # whose square is a number of float32, too


class Aside(NamedTuple):
    """Surfaces that were set aside."""

    composited: list[Tensor]  # for each group [m, C + 1, h, w], all that was composited
    # For each group the coverage [m, 1, h, w] that the composition went on with
    covered: list[Tensor]
    invented: Tensor | None  # as that of `TileCompositor`


class TileCompositor:
    """The surfaces of a tile composited so far.

    Attributes:
        by_group: The front of each group of m parts, [m, C + 1, h, w]: colour times coverage, then
            coverage.
        moved: [m, C, h, w], the change of the last group's colours by shifts of less than a pixel;
            None if there is none.
        invented: [m, h, w], coverage of the first group by invented surfaces; None if there is
            none.
    """

    def __init__(
        self, blank: list[Tensor], full: list[Tensor | float], sight: SightLimits | None
    ) -> None:
        """Begin without surfaces.

        `sight`: how far the lens sees at each pixel; None where nothing limits it.
        """
        self.by_group = blank
        self.moved: Tensor | None = None
        self.invented: Tensor | None = None
        self._full = full
        self._reserved: list[Tensor | None] = [None for _ in full]
        self.sight = sight

    def add(self, layers: list[dict[int, ShownLayer]]) -> None:
        """Add visible surfaces, given for each group as layers by their numbers."""
        for group, (surfaces, maximum) in enumerate(zip(layers, self._full, strict=True)):
            front = self.by_group[group]
            for number in sorted(surfaces):
                box, layer, by = surfaces[number]
                within = box.of(maximum) if isinstance(maximum, Tensor) else maximum
                layer, fraction = shown_behind(box.of(front), layer, within)
                if self.sight and (seen := self.sight.over(box).to(number)) is not None:
                    fraction = fraction * seen
                front = add_within(front, box, layer, fraction)
                if by is not None:
                    moved = torch.zeros_like(front[:, :-1]) if self.moved is None else self.moved
                    self.moved = add_within(moved, box, by, fraction)
            self.by_group[group] = front

    def add_known(
        self,
        visible: list[dict[int, ShownLayer]],
        hidden: list[dict[int, ShownLayer]],
        openings: Openings,
        *,
        closed: bool,
    ) -> None:
        """Add known surfaces, given for each group as layers by their numbers."""
        for group, layers in enumerate(zip(visible, hidden, self._full, strict=True)):
            front = self.by_group[group]
            self.by_group[group], moved = add_known(front, *layers, openings, closed=closed)
            self.moved = self.moved if moved is None else moved

    def close(self, openings: Openings) -> None:
        """Close the gaps in opaque surfaces through which nothing is seen: they are errors."""
        closed = 1 - openings.room
        for group, maximum in enumerate(self._full):
            front = self.by_group[group]
            covered = front[:, -1:]
            gap = (maximum - covered).clamp(min=0) * closed
            larger = 1 + gap / covered.clamp(min=_MIN_ROOM)
            self.by_group[group] = front * larger
            if group == 0 and self.invented is not None:
                self.invented = self.invented * larger[:, 0]

    def coverage(self) -> list[Tensor]:
        """A copy of the coverage [m, 1, h, w] of each group."""
        return [front[:, -1:].clone() for front in self.by_group]

    def set_aside(self, near: list[Tensor]) -> Aside:
        """Go on as if the surfaces nearer than focus were not there, up to `put_together`.

        `near`: the coverage [m, 1, h, w] of these for each group.
        """
        aside = Aside(self.by_group, [], self.invented)
        self.by_group, self.invented = [], None
        for front, covered_near, maximum in zip(aside.composited, near, self._full, strict=True):
            full = sent(maximum, front)
            # where these cover all, nothing is seen behind: as if it were full
            filled = covered_near > full - _MIN_ROOM
            covered = torch.where(filled, full, front[:, -1:] - covered_near)
            aside.covered.append(covered)
            blank = [0, 0] * (front.dim() - 2) + [front.shape[1] - 1, 0]
            self.by_group.append(pad(covered, blank))
        return aside

    def close_gaps(self, aside: Aside, pictures: Tensor | None = None) -> None:
        """Close gaps that are small beside what the surfaces that were set aside cover.

        What these hide is continued at half the resolution: with what is visible of the same
        surface it may not quite cover all, and a bright sky behind both must not show.

        `pictures`: [B, 1, 1], 0 for pictures of a batch whose gaps stay; None to close all.
        """
        for group, covered in enumerate(aside.covered):
            front, full = self.by_group[group], self._full[group]
            gap = (full - front[:, -1:]).clamp(min=0)
            near = aside.composited[group][:, -1:] - covered
            error = (_ERROR * near).clamp(min=_LEAST_ERROR)
            added = gap * (2 - gap / error).clamp(0, 1)
            added = added if pictures is None else added * pictures
            room = (full - covered).clamp(min=_MIN_ROOM)
            larger = 1 + added / (room - gap).clamp(min=_MIN_ROOM)
            self.by_group[group] = _changed(front, added, larger)
            if group == 0 and self.invented is not None:
                self.invented = self.invented * larger[:, 0]

    def put_together(self, aside: Aside) -> None:
        """Put the surfaces that were set aside before those composited since."""
        before, self.invented, since = aside.invented, aside.invented, self.invented
        for group, (front, covered) in enumerate(zip(aside.composited, aside.covered, strict=True)):
            layer = _changed(self.by_group[group], -covered)
            layer, fraction = shown_behind(front, layer, self._full[group])
            self.by_group[group] = torch.addcmul(front, layer, fraction)
            if group == 0 and since is not None:
                share = fraction[:, 0]
                self.invented = (
                    since * share if before is None else torch.addcmul(before, since, share)
                )

    def are_full(self, *, known: bool) -> bool:
        """Whether no gap is left that a hidden surface, known or invented, may fill."""
        return all(is_full(front, self._maximum(i, known)) for i, front in enumerate(self.by_group))

    def fill(self, hidden: list[Tensor | None], *, known: bool) -> None:
        """Add a hidden surface.

        `hidden`: the surface over the tile for each group, [m, C + 1, h, w]; None where it is
        absent.
        """
        for group, layer in enumerate(hidden):
            front, maximum = self.by_group[group], self._maximum(group, known)
            if layer is None or is_full(front, maximum):
                continue
            whole = Box(0, 0, *front.shape[-2:])
            layer, fraction = shown_behind(front, layer, maximum)
            if group == 0 and not known:
                share, covered = fraction[:, 0], layer[:, -1]
                self.invented = (
                    share * covered
                    if self.invented is None
                    else torch.addcmul(self.invented, share, covered)
                )
            self.by_group[group] = add_within(front, whole, layer, fraction)

    def reserve(self, layers: list[dict[int, ShownLayer]]) -> None:
        """Keep invented surfaces out of the coverage of layers, given for each group."""
        for group, surfaces in enumerate(layers):
            size = self.by_group[group].shape[-2], self.by_group[group].shape[-1]
            parts = ((shown.box, shown.layer[:, -1:]) for shown in surfaces.values())
            self._reserved[group] = summed(parts, size)

    def are_nearly_full(self) -> bool:
        """Whether the gaps that are left are not worth filling."""
        gaps = zip(self.by_group, self._full, strict=True)
        return all(is_full(front, maximum, _NEGLIGIBLE) for front, maximum in gaps)

    def add_alpha(self) -> None:
        """Add to the colours a last channel that is the coverage."""
        for group, front in enumerate(self.by_group):
            self.by_group[group] = torch.cat([front, front[:, -1:]], 1)
        if self.moved is not None:
            self.moved = torch.cat([self.moved, torch.zeros_like(self.moved[:, :1])], 1)

    def leave_open(self) -> None:
        """Count the gaps that are left as covered: nothing is seen there."""
        for group, maximum in enumerate(self._full):
            color, covered = self.by_group[group].tensor_split([-1], 1)
            whole = torch.maximum(covered, sent(maximum, covered))
            self.by_group[group] = torch.cat([color, whole], 1)

    def _maximum(self, group: int, known: bool) -> Tensor | float:
        """Greatest coverage of a group once a hidden surface is added."""
        maximum, reserved = self._full[group], self._reserved[group]
        if known:
            return maximum
        if reserved is not None:
            maximum = maximum - reserved
        return maximum


def _changed(front: Tensor, added: Tensor, factor: Tensor | None = None) -> Tensor:
    """A front [m, C + 1, h, w] with more coverage, its colours times a factor if there is one.

    `front` is overwritten by the result unless gradients are enabled.
    """
    color, coverage = front.tensor_split([-1], 1)
    if torch.is_grad_enabled():
        color = color if factor is None else color * factor
        return torch.cat([color, coverage + added], 1)
    if factor is not None:
        color.mul_(factor)
    coverage.add_(added)
    return front
