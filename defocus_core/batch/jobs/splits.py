"""Splits of a dataset, as train and test: the scene of a picture decides, so that none leaks.

``[split]`` of a jobs file has a share for each split, which add up to 1, and may have ``scene``, a
regular expression whose first group, or else whole match, is the scene in the name of a picture.
Without it the name of a picture is its scene, and the frames of a shot are one. A scene stays in
its split when others are added, whatever machine decides.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import blake2b
from itertools import accumulate

from defocus_core.batch.jobs.job import Picture
from defocus_core.batch.jobs.toml_file import Table
from defocus_core.errors import CALLER, Place, UsageProblem

NAME = re.compile(r"[A-Za-z0-9_]{1,40}")
_SCENE = "scene"
_BYTES = 8  # of the hash of a scene
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Splits:
    """The shares of the splits by name, and where the scene is in the name of a picture."""

    shares: Mapping[str, float]
    scene: re.Pattern[str] | None = None
    where: Place = CALLER

    def of(self, picture: Picture) -> str:
        """The split of a picture; empty without splits.

        Raises:
            UsageProblem: the name of the picture has no scene in it.
        """
        if not self.shares:
            return ""
        digest = blake2b(self._scene_of(picture).encode(), digest_size=_BYTES).digest()
        place = int.from_bytes(digest) / (1 << 8 * _BYTES)
        ends = accumulate(self.shares.values())
        within = (name for name, end in zip(self.shares, ends, strict=True) if place < end)
        return next(within, list(self.shares)[-1])

    def _scene_of(self, picture: Picture) -> str:
        if self.scene is not None:
            match = self.scene.search(picture.stem)
            if match is None:
                problem = f"finds no scene in '{picture.stem}'"
                raise UsageProblem(
                    "no-scene", problem, "make it match the name of each picture", path=self.where
                )
            return match[1] if self.scene.groups else match[0]
        if picture.frame is not None:
            return re.sub(r"\d+$", "", picture.stem)
        return picture.stem


def read_splits(section: Table) -> Splits:
    """The splits of ``[split]``; none without it.

    Raises:
        UsageProblem: a share is no number above 0, they do not add up to 1, or a name is none.
    """
    shares = {}
    for name, value in section.values.items():
        if name == _SCENE:
            continue
        if not NAME.fullmatch(name):
            problem = "is no name of a split"
            raise UsageProblem(
                "malformed", problem, "use letters, digits and _", path=section.place(name)
            )
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= 1:
            problem = f"{value!r} is no share above 0, up to 1"
            raise UsageProblem("malformed", problem, "write train = 0.9", path=section.place(name))
        shares[name] = float(value)
    if shares and abs(sum(shares.values()) - 1) > _ROUNDING:
        problem = f"has shares that add up to {sum(shares.values()):g}"
        raise UsageProblem(
            "malformed", problem, "let them add up to 1", path=section.file, field="[split]"
        )
    text = section.text(_SCENE)
    if text is None:
        return Splits(shares)
    if not shares:
        raise UsageProblem(
            "missing-option", "stands without shares", "add train = 0.9", path=section.place(_SCENE)
        )
    try:
        return Splits(shares, re.compile(text), section.place(_SCENE))
    except re.error as error:
        problem = f"'{text}' is no regular expression: {error}"
        raise UsageProblem(
            "malformed", problem, "write it like '^(.*)_[0-9]+$'", path=section.place(_SCENE)
        ) from None
