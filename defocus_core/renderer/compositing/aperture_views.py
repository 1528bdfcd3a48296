"""Colours and coverage of a tile through each part of the aperture, composited front to back.

Known surfaces follow three laws. First, slices of a layer, and visible samples of neighbouring
layers, add up (a saturating sum), because parts of one continuous surface are complementary.

Second, samples of one pixel occlude each other by their coverage (`over`), as they are
uncorrelated: the visible share of a sample is the share that nearer samples do not cover.

Third, surfaces out of focus cover each other by chance: behind a front of coverage A the lens sees
the share 1 - A of a layer. Where this exceeds the visible share of the layer, the lens looks past
the samples that hide the layer from the pinhole, and sees a part of its hidden share, too. In
focus, where A is the coverage of the pixel itself, both shares are equal. Nothing is seen behind
opaque samples unless one of their edges is in reach (`Openings`).
"""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import torch
from torch import Tensor

from defocus_core.renderer.blur.layer_blur import ShownLayer
from defocus_core.renderer.compositing.saturating_sum import shown_behind
from defocus_core.renderer.compositing.sight import Openings, Sight
from defocus_core.renderer.engine import limits
from defocus_core.tensors.device_plan import sent

# Coverage below which a hidden share is rounding.
_MINIMUM = 1e-6


def _fraction_hidden(
    before: tuple[Tensor, Tensor],  # [M, 1, h, w] each; both layers may be of one surface
    front: Tensor,  # [M, C + 1, h, w]
    shown: ShownLayer | None,
    behind: ShownLayer,
    full: Tensor | float,
    room: Tensor,  # [h, w]
) -> Tensor:
    """The share [M, 1, h, w] of the hidden part of a layer that the lens sees.

    `before`: coverage of the front before the previous layer, and before this one; `front`: with
    the visible part of this layer added; `shown`, `behind`: the visible and the hidden part of the
    layer; `full`: coverage of a pixel that is completely covered; `room`: the share of a gap
    through which the lens can see.
    """
    whole = coverage = behind.layer[:, -1:].clamp(min=0)
    if shown is not None:
        whole = whole + shown.layer[:, -1:].clamp(min=0)
    earlier, now = before
    gap = (full - earlier).clamp(min=0) * room
    expected = torch.minimum(gap * (whole / full).clamp(max=1), (full - now) * room)
    added = (expected - (front[:, -1:] - now)).clamp(min=0)
    added = torch.where(coverage > _MINIMUM, added, 0.0)
    return (added / coverage.clamp(min=_MINIMUM)).clamp(max=1)


# Gap between known surfaces that is not worth filling: dividing by the coverage makes up for it.
_NEGLIGIBLE = 0.05


class Aside(NamedTuple):
    """Surfaces that were set aside by `TileCompositor.set_aside`."""

    composited: Tensor  # [M, C + 1, h, w], all that was composited
    covered: Tensor  # [M, 1, h, w], the coverage with which compositing continued
    invented: Tensor | None  # [M, h, w], coverage by invented surfaces; None if there is none


class TileCompositor:
    """The surfaces of a tile composited so far, as seen through M parts of the aperture.

    Attributes:
        front: [M, C + 1, h, w], colour times coverage, then coverage.
        moved: [m, C, h, w], the change of the colours of left and right by shifts of less than a
            pixel; None if there is none.
        invented: [M, h, w], coverage by invented surfaces; None if there is none.
        sight: How far the lens sees at each pixel; None where nothing limits it.
    """

    def __init__(
        self, blank: Tensor, full: Tensor | float, sight: Sight | None, *, closed: bool
    ) -> None:
        """Begin without surfaces.

        `blank`: [M, C + 1, h, w], zeros; `full`: coverage of a pixel that is completely covered;
        `sight`: how far the lens sees at each pixel; `closed`: whether surfaces cover every pixel
        completely.
        """
        self.front = blank
        self.moved: Tensor | None = None
        self.invented: Tensor | None = None
        self.sight = sight
        self._full, self._closed = full, closed
        self._covered: dict[int, Tensor] = {}  # before each layer
        self._hidden: list[tuple[Tensor, Tensor]] = []  # parts not seen, and the room for them
        self._reserved: Tensor | None = None

    def add(self, number: int, shown: ShownLayer | None, behind: ShownLayer | None) -> None:
        """Add the visible part of layer `number`, and its known hidden part, behind the front."""
        full, sight = self._full, self.sight
        if isinstance(sight, Openings):
            self._covered[number] = self.coverage
        if shown is not None:
            layer, fraction = shown_behind(self.front, shown.layer, full)
            if sight:
                fraction = fraction * sight.to_layer(number)
            self.front = self.front.addcmul(layer, fraction)
            if shown.moved is not None:
                moved = shown.moved * fraction[-len(shown.moved) :]
                self.moved = moved if self.moved is None else self.moved + moved
        if behind is not None and isinstance(sight, Openings):
            room, now = sight.to_layer(number), self._covered[number]
            # of opaque surfaces the layer before may hold another part of the same one
            earlier = self._covered.get(number - 1, now) if self._closed else now
            fraction = _fraction_hidden((earlier, now), self.front, shown, behind, full, room)
            self.front = self.front.addcmul(behind.layer, fraction)
            self._hidden.append((behind.layer * (1 - fraction), room))

    def close(self) -> None:
        """Close gaps in opaque surfaces through which nothing can be seen: they are errors."""
        if not isinstance(self.sight, Openings):
            return
        for rest, room in self._hidden if self._closed else ():
            rest, left = shown_behind(self.front, rest, self._full)
            self.front = self.front.addcmul(rest, left * room)
        covered = self.front[:, -1:]
        gap = (self._full - covered).clamp(min=0) * (1 - self.sight.room)
        larger = 1 + gap / covered.clamp(min=limits.MIN_ROOM)
        self.front = self.front * larger
        self._enlarge_invented(larger)

    @property
    def coverage(self) -> Tensor:
        """The coverage [M, 1, h, w] composited so far."""
        return self.front[:, -1:]

    def set_aside(self, near: Tensor) -> Aside:
        """Set the surfaces nearer than focus aside, until `put_together`.

        `near`: the coverage [M, 1, h, w] of these surfaces.
        """
        front, full = self.front, sent(self._full, self.front)
        # where these cover all, nothing is seen behind: as if it were full
        covered = torch.where(near > full - limits.MIN_ROOM, full, front[:, -1:] - near)
        aside = Aside(front, covered, self.invented)
        self.front = torch.cat([torch.zeros_like(front[:, :-1]), covered], 1)
        self.invented = None
        return aside

    def close_gaps(self, aside: Aside) -> None:
        """Close gaps that are small compared with the coverage of the surfaces set aside.

        The surface that these hide is continued at half the resolution: together with its visible
        part it may not quite cover the pixel, and a bright sky behind both must not show.
        """
        gap = (self._full - self.front[:, -1:]).clamp(min=0)
        near = aside.composited[:, -1:] - aside.covered
        error = (limits.GAP_ERROR * near).clamp(min=limits.LEAST_ERROR)
        added = gap * (2 - gap / error).clamp(0, 1)
        room = (self._full - aside.covered).clamp(min=limits.MIN_ROOM)
        larger = 1 + added / (room - gap).clamp(min=limits.MIN_ROOM)
        self.front = _changed(self.front, added, larger)
        self._enlarge_invented(larger)

    def _enlarge_invented(self, larger: Tensor) -> None:
        if self.invented is not None:
            self.invented = self.invented * larger[:, 0]

    def put_together(self, aside: Aside) -> None:
        """Composite the surfaces set aside over those composited since then."""
        since, self.invented = self.invented, aside.invented
        layer = _changed(self.front, -aside.covered)
        layer, fraction = shown_behind(aside.composited, layer, self._full)
        self.front = torch.addcmul(aside.composited, layer, fraction)
        if since is not None:
            self._add_invented(since, fraction[:, 0])

    def _add_invented(self, covered: Tensor, share: Tensor) -> None:
        """Count the coverage [M, h, w] of a layer, times a share, as invented."""
        if self.invented is None:
            self.invented = covered * share
        else:
            self.invented = torch.addcmul(self.invented, covered, share)

    def fill(self, layer: Tensor) -> None:
        """Add an invented surface [M, C + 1, h, w] in the gaps of the front."""
        layer, fraction = shown_behind(self.front, layer, self._maximum)
        if self._negligible:  # in each pixel for itself, whatever else is in the tile
            gap = self._maximum - self.front[:, -1:]
            fraction = fraction * (gap / self._negligible - 1).clamp(0, 1)
        self._add_invented(layer[:, -1], fraction[:, 0])
        self.front = self.front.addcmul(layer, fraction)

    def reserve(self, surfaces: dict[int, ShownLayer]) -> None:
        """Reserve the coverage of layers, so that invented surfaces cannot take it."""
        parts = [shown.layer[:, -1:] for shown in surfaces.values()]
        self._reserved = reduce(torch.add, parts) if parts else None

    def leave_open(self) -> None:
        """Count the remaining gaps as covered, with nothing seen in them."""
        color, covered = self.front.tensor_split([-1], 1)
        whole = torch.maximum(covered, sent(self._full, covered))
        self.front = torch.cat([color, whole], 1)

    @property
    def _negligible(self) -> float:
        """The greatest gap in coverage that is not worth filling."""
        return _NEGLIGIBLE if isinstance(self.sight, Openings) else 0.0

    @property
    def _maximum(self) -> Tensor | float:
        """The greatest coverage up to which invented surfaces may fill a pixel."""
        return self._full if self._reserved is None else self._full - self._reserved


def _changed(front: Tensor, added: Tensor, factor: Tensor | float = 1.0) -> Tensor:
    """A front [m, C + 1, h, w] with `added` coverage, and with its colours times `factor`."""
    color, coverage = front.tensor_split([-1], 1)
    return torch.cat([color * factor, coverage + added], 1)
