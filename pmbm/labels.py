"""Labels of objects."""

from __future__ import annotations

import enum
from typing import Final


class Label(enum.IntEnum):
    """The kind of an object, which adapters map their datasets' classes to."""

    CAR = 0
    TRUCK = 1
    BUS = 2
    MOTORCYCLIST = 3
    CYCLIST = 4
    PEDESTRIAN = 5
    OTHER = 6

    @property
    def default_height(self) -> float:
        """Height in metres where a source gives none."""
        return _DEFAULT_HEIGHT[self]

    @property
    def default_size(self) -> tuple[float, float, float]:
        """Length, width and height in metres where a source gives none."""
        return (*_DEFAULT_BASE[self], self.default_height)


OBSERVABLE_SHARE: Final = 0.1
"""An object less visible than this share counts as hidden."""
_DEFAULT_BASE: Final = {
    Label.CAR: (5.0, 2.0),
    Label.TRUCK: (14.0, 2.6),
    Label.BUS: (12.0, 2.55),
    Label.MOTORCYCLIST: (2.2, 0.8),
    Label.CYCLIST: (1.8, 0.6),
    Label.PEDESTRIAN: (0.6, 0.6),
    Label.OTHER: (5.0, 2.0),
}
"""Length and width, m."""
_DEFAULT_HEIGHT: Final = {
    Label.CAR: 1.6,
    Label.TRUCK: 3.5,
    Label.BUS: 3.2,
    Label.MOTORCYCLIST: 1.6,
    Label.CYCLIST: 1.7,
    Label.PEDESTRIAN: 1.75,
    Label.OTHER: 1.6,
}
