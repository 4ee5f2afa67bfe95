"""Cutoffs, orders and gates of the metrics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from pmbm.errors import InputError

_AT_LEAST_ONE: Final = ("gospa_order", "ospa_order", "tgospa_order", "occlusion_frames")


@dataclass(frozen=True, kw_only=True)
class MetricParameters:
    """The parameters of `evaluate`; the defaults are those of the project's tables.

    gospa_cutoff, gospa_order : c in m, p (alpha is 2).
    ospa_cutoff, ospa_order : c in m, p; of OSPA and OSPA(2).
    ospa2_window : s.
    gate : centres strictly nearer than this in (x, y, z), m, may match (CLEAR, IDF1, testbed).
    similarity_zero : HOTA's similarity is max(0, 1 - d / similarity_zero), m.
    tgospa_cutoff, tgospa_order, tgospa_switch : c in m, p, gamma in m.
    occlusion_frames : shortest spell of unobservable frames that is an occlusion.

    Raises InputError for orders and frames below 1, and for what is not above 0.
    """

    gospa_cutoff: float = 4.0
    gospa_order: float = 2.0
    ospa_cutoff: float = 10.0
    ospa_order: float = 2.0
    ospa2_window: float = 1.0
    gate: float = 2.0
    similarity_zero: float = 4.0
    tgospa_cutoff: float = 4.0
    tgospa_order: float = 2.0
    tgospa_switch: float = 2.0
    occlusion_frames: int = 5

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            least = 1.0 if name in _AT_LEAST_ONE else np.nextafter(0.0, 1.0)
            if not least <= value < np.inf:
                raise InputError(
                    "bad metric parameter",
                    field=name,
                    expected="at least 1" if name in _AT_LEAST_ONE else "above 0",
                    got=value,
                )
