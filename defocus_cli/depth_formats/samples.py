"""The numbers of a depth file as they stand in it, and the type of the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Samples:
    """The numbers of a depth file.

    Attributes:
        values: [H, W], or [H, W, C] of pixels that are bits; of the type they have in the file,
            an array or something else that rows can be cut from.
        type: of the file and its numbers, as the rows of the table have it.
        words: type of the file and of its numbers, for people.
        channel: name in the file; empty where it has none.
        metadata: of the file, by key.
        nothing: pixels of an alpha of 0, where that means sky, [H, W].
        holes: pixels without depth by another array of the file, [H, W].
    """

    values: Any
    type: str
    words: str
    channel: str = ""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    nothing: NDArray[np.bool_] | None = None
    holes: NDArray[np.bool_] | None = None

    @property
    def width(self) -> int:
        """Of the map in px."""
        return int(self.values.shape[1])

    @property
    def top(self) -> float:
        """The greatest number of the type: 255, 65535, …; 1 of floats."""
        import numpy as np

        dtype = np.dtype(self.values.dtype)
        return 1.0 if dtype.kind == "f" else float(np.iinfo(dtype).max)

    @property
    def is_integer(self) -> bool:
        """Whether the numbers are integers."""
        return self.values.dtype.kind in "iu"
