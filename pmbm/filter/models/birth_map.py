"""Births place by place, on the map of undetected objects (Pang & Radha 2021, Sec. 2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pmbm.filter.density import Mixture
from pmbm.filter.models.motion import Survival
from pmbm.filter.models.undetected_map import MapCells, reduce_map
from pmbm.filter.models.view import View
from pmbm.types import Site
from pmbm.validation import COUNT, NOT_NEGATIVE, POSITIVE, Bounds, check_fields


@dataclass(frozen=True, kw_only=True)
class BirthMap:
    """Undetected objects kept place by place, on drivable ground where the site names it: swept out
    where the sensor sees, preserved where other objects or occluders hide them.  Half of the births
    arise at the edge of the view.

    rate : expected new objects per second over the field of view.
    initial : expected number of objects in view before the first frame.
    spacing : of the map's lattice, m.
    speed_sd : standard deviation of a new object's velocity, per axis, m/s.
    max_components : components kept, besides those that a frame recycles.
    negligible : components lighter than this share of a cell's births over the survival's interval,
        and than the reduction's `prune_undetected`, are dropped.
    fine_above : cells that hold more than this many times those births keep classes of velocity
        apart.
    """

    rate: Annotated[float, NOT_NEGATIVE] = 0.5
    initial: Annotated[float, NOT_NEGATIVE] = 3.0
    spacing: Annotated[float, Bounds(1.0, 4.0)] = 3.5
    speed_sd: Annotated[float, POSITIVE] = 10.0
    max_components: Annotated[int, COUNT] = 4000
    negligible: Annotated[float, NOT_NEGATIVE] = 0.03
    fine_above: Annotated[float, NOT_NEGATIVE] = 6.0

    def __post_init__(self) -> None:
        check_fields(self, "birth map")

    @property
    def place_by_place(self) -> bool:
        return True

    def births(
        self, site: Site, view: View, dt: float | None, survival: Survival, memory: MapCells | None
    ) -> tuple[Mixture, MapCells]:
        """The births over an interval, and those in cells that the map newly covers."""
        cells = MapCells.of(site, view, self.spacing, memory)
        expected = 0.0 if dt is None else survival.alive(dt, self.rate)
        weight = expected * cells.births()
        weight += self.initial * cells.newly_covered(memory)
        return cells.mixture(weight, self.spacing, self.speed_sd), cells

    def joined(self, survivors: Mixture, births: Mixture) -> Mixture:
        return Mixture.joined(survivors, births)

    def reduced(
        self, predicted: Mixture, view: View, survival: Survival, memory: MapCells, prune: float
    ) -> tuple[Mixture, float]:
        each = survival.alive(survival.interval, self.rate) / max(1, memory.cells)
        return reduce_map(
            predicted,
            view,
            self.spacing,
            most=self.max_components,
            negligible=min(prune, self.negligible * each),
            fine_above=self.fine_above * each,
        )

    def thresholds(self, prune: float) -> tuple[float, float]:
        """Neither: undetected objects are merged and dropped with the prediction."""
        return 0.0, 0.0
