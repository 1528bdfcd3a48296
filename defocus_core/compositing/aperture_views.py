"""The view of a tile from each part of the aperture, composited front to back."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from defocus_core.blur.layer_blur import Shown
from defocus_core.compositing.saturating_sum import add_within, filled_up_to, is_full, share_behind
from defocus_core.images.box import Box


class Fronts:
    """The views of all parts, as far as they are composited.

    Attributes:
        seen: For each group of m parts [m, C + 1, h, w]: colour times coverage, then coverage.
        moved: [m, C, h, w], colours that sub-pixel shifts add to the last group; None if there are
            no shifts.
        invented: [m, h, w], the invented share of the coverage of the first group; None if there is
            none.
    """

    def __init__(
        self, blank: list[Tensor], full: list[Tensor | float], doubt: float | None
    ) -> None:
        """Begin without a layer.

        Args:
            blank: As `seen`: zeros, which are overwritten.
            full: Greatest coverage, for each group.
            doubt: Share of a part up to which gaps between visible surfaces may be errors.
        """
        self.seen = blank
        self.moved: Tensor | None = None
        self.invented: Tensor | None = None
        self._full = full
        self._doubt = doubt

    def add(self, layers: list[dict[int, Shown]]) -> None:
        """Add visible layers of each group, in the order of their numbers."""
        for group, (of_group, full) in enumerate(zip(layers, self._full, strict=True)):
            seen = self.seen[group]
            for number in sorted(of_group):
                box, layer, shift = of_group[number]
                within = box.of(full) if isinstance(full, Tensor) else full
                share = share_behind(box.of(seen), layer, within)
                seen = add_within(seen, box, layer, share)
                if shift is not None:
                    moved = torch.zeros_like(seen[:, :-1]) if self.moved is None else self.moved
                    self.moved = add_within(moved, box, shift, share)
            self.seen[group] = seen

    def are_full(self, *, known: bool) -> bool:
        """Whether no group has coverage left for hidden layers, known or invented."""
        return all(is_full(seen, self._most(i, known)) for i, seen in enumerate(self.seen))

    def fill(
        self,
        hidden: list[Tensor | None],
        *,
        known: bool,
        before: Sequence[list[Tensor | None]] = (),
    ) -> None:
        """Add hidden layers.

        Args:
            hidden: For each group a layer [m, C + 1, h, w] over the tile; None for no layer.
            known: Whether the layers are known, not invented.
            before: Hidden layers that lie in front of these, but are added later.
        """
        for group, layer in enumerate(hidden):
            seen, most = self.seen[group], self._most(group, known)
            if layer is None or is_full(seen, most):
                continue
            covered = seen
            for nearer_layers in before:
                nearer = nearer_layers[group]
                if nearer is not None:
                    covered = covered + share_behind(covered, nearer, most) * nearer
            whole, share = Box(0, 0, *seen.shape[-2:]), share_behind(covered, layer, most)
            if group == 0 and not known:
                added = (share * layer[:, -1:])[:, 0]
                self.invented = added if self.invented is None else self.invented + added
            self.seen[group] = add_within(seen, whole, layer, share)

    def _most(self, group: int, known: bool) -> Tensor | float:
        """The greatest coverage that hidden layers may fill a group to."""
        if known or self._doubt is None:
            return self._full[group]
        return filled_up_to(self.seen[group], self._full[group], self._doubt)
