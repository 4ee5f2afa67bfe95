"""The catalogue of metrics: the families, and every metric by name."""

from __future__ import annotations

from typing import Final

from pmbm.errors import InputError, nearest_hint
from pmbm.metrics.core.family import Family
from pmbm.metrics.core.result import OBSERVABLE, Metric
from pmbm.metrics.families import (
    cardinality,
    clear,
    consistency,
    existence,
    gospa,
    hota,
    identity,
    motion,
    objects,
    occlusion,
    ospa,
    ospa2,
    siap,
    tgospa,
)

FAMILIES: Final = (
    gospa.FAMILY,
    ospa.FAMILY,
    ospa2.FAMILY,
    clear.FAMILY,
    identity.FAMILY,
    hota.FAMILY,
    cardinality.FAMILY,
    motion.FAMILY,
    objects.FAMILY,
    occlusion.FAMILY,
    consistency.FAMILY,
    existence.FAMILY,
    tgospa.FAMILY,
    siap.FAMILY,
)
"""In the order of `evaluate`'s tables."""

_FAMILY_OF: Final = {metric.name: family for family in FAMILIES for metric in family.metrics}
_BY_NAME: Final = {metric.name: metric for family in FAMILIES for metric in family.metrics}

DEFAULT_METRICS: Final = tuple(
    name
    for metric in _BY_NAME.values()
    if metric.default
    for name in (metric.name, metric.name + OBSERVABLE)
)
"""What `evaluate` gives unless told otherwise."""


def definition(name: str) -> Metric:
    """The metric of a name, which may end in "_observable".

    Raises InputError, with the nearest valid name, where there is none.
    """
    metric = _BY_NAME.get(name.removesuffix(OBSERVABLE))
    if metric is None:
        raise InputError(f"no metric '{name}'", hint=nearest_hint(name, names(), "metric"))
    return metric


def family_of(metric: Metric) -> Family:
    """The family that counts for a metric of the catalogue."""
    return _FAMILY_OF[metric.name]


def names() -> list[str]:
    """Every name that `evaluate` knows."""
    return [name + suffix for suffix in ("", OBSERVABLE) for name in _BY_NAME]
