"""The density after a frame, before anything is reported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pmbm.filter.density import Density
from pmbm.filter.estimation import Marginals
from pmbm.filter.reduction import ReductionStats
from pmbm.types import FloatArray


@dataclass(frozen=True, eq=False)
class Advanced:
    """The filter after a frame.

    density : whose local hypotheses are `shown` as the marginals have their tracks.
    marginal : of its tracks.  inside (T,) : that each is where objects are followed.
    removed : by the reductions.  seconds : what each part took.
    """

    density: Density
    marginal: Marginals
    inside: FloatArray
    removed: ReductionStats
    seconds: Mapping[str, float]

    def number_in_view(self, object_share: FloatArray) -> float:
        """Expected number of objects in view, given P(object) (K,) of a source of each class."""
        return float(self.marginal.objects(object_share) @ self.inside)
