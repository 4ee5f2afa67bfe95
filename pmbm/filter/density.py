"""The PMBM density: a Poisson process of undetected objects and, in product form over independent
clusters, a multi-Bernoulli mixture of detected ones (Pang & Radha 2021, Sec. 2.4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pmbm.types import ABSENT, BoolArray, FloatArray, GaussianMixture, IntArray, unchecked
from pmbm.wording import counted

Index = NDArray[np.intp]

STATE = 4
"""Size of a state, [x, y, vx, vy]: the position comes first, then the velocity, then what else a
motion model may follow."""
MISSED = -1
"""In association histories: the object was not detected at that step."""
BEFORE = -2
"""In association histories: the track did not exist yet, or longer ago than is kept."""


@dataclass(frozen=True, eq=False, slots=True)
class RecycledFrom:
    """The tracks that the weight of PPP components was recycled from.

    It says nothing about where objects are and how many: a label, kept so that an object that is
    seen again may have its old id.

    track (P,) : id of the track that most of a component's recycled weight comes from, ABSENT where
        none does.  share (P,) : of its weight that does, in [0, 1].
    recycled (P,) : share of its weight that comes from any track, in [share, 1]: objects that were
        detected before, where the rest never was.
    """

    track: NDArray[np.int64]
    share: FloatArray
    recycled: FloatArray

    def columns(self) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """The fields, as the kernels take them."""
        return self.track, self.share, self.recycled

    def take(self, rows: Index) -> RecycledFrom:
        return RecycledFrom(self.track[rows], self.share[rows], self.recycled[rows])

    @staticmethod
    def of(track: NDArray[np.int64]) -> RecycledFrom:
        """Components that are recycled weight and nothing else."""
        return RecycledFrom(track, np.ones(len(track)), np.ones(len(track)))

    @staticmethod
    def joined(parts: list[tuple[RecycledFrom | None, int]]) -> RecycledFrom | None:
        """Origins of components one on another, and how many there are of each, or None where all
        have none."""
        if all(one is None for one, _ in parts):
            return None
        each = [
            RecycledFrom(np.full(n, ABSENT, np.int64), np.zeros(n), np.zeros(n))
            if one is None
            else one
            for one, n in parts
        ]
        return RecycledFrom(
            np.concatenate([one.track for one in each]),
            np.concatenate([one.share for one in each]),
            np.concatenate([one.recycled for one in each]),
        )

    def diluted(self, by: FloatArray) -> RecycledFrom:
        """Scale down the shares of the first n components, a fraction `by` (n,) of whose weight is
        newly born."""
        left = np.ones(len(self.share))
        left[: len(by)] -= by
        return RecycledFrom(self.track, self.share * left, self.recycled * left)

    def merged(self, order: Index, first: Index, weight: FloatArray) -> RecycledFrom | None:
        """Of groups of components: runs of `order` (P,) that begin at `first` (N,), where the
        components weigh `weight` (P,), in that order.

        A group is recycled from the track that most of its weight is of; of what others had, only
        the share is kept.
        """
        track, own = self.track[order], weight * self.share[order]
        if not self.recycled.any():
            return None
        known = np.flatnonzero((track != ABSENT) & (own > 0))
        group = np.repeat(np.arange(len(first)), np.diff(first, append=len(order)))
        known = known[np.lexsort((track[known], group[known]))]
        begin = np.flatnonzero(
            (np.diff(group[known], prepend=-1) != 0) | (np.diff(track[known], prepend=ABSENT) != 0)
        )
        mass, head = np.add.reduceat(own[known], begin), known[begin]
        # The heaviest of each group comes last, and so is what stays written.
        heaviest = np.lexsort((mass, group[head]))
        total = np.add.reduceat(weight, first)
        result = RecycledFrom(
            np.full(len(first), ABSENT, np.int64),
            np.zeros(len(first)),
            np.add.reduceat(weight * self.recycled[order], first) / total,
        )
        result.track[group[head[heaviest]]] = track[head[heaviest]]
        result.share[group[head[heaviest]]] = mass[heaviest]
        result.share[:] /= total
        return result


MixtureColumns: TypeAlias = tuple[
    FloatArray,
    FloatArray,
    FloatArray,
    tuple[NDArray[np.int64], FloatArray, FloatArray] | None,
]
"""The fields of a `Mixture` and of its `RecycledFrom`."""


@dataclass(frozen=True, eq=False, slots=True)
class Mixture:
    """`pmbm.types.GaussianMixture` without its checks, for use between the steps of the filter.

    log_weight (P,), mean (P,4), cov (P,4,4).
    recycled_from : whose weight it was before it was recycled; None where none was.
    """

    log_weight: FloatArray
    mean: FloatArray
    cov: FloatArray
    recycled_from: RecycledFrom | None = None

    def __len__(self) -> int:
        return len(self.log_weight)

    def columns(self) -> MixtureColumns:
        """The fields and those of `recycled_from`, as the kernels take them."""
        recycled = self.recycled_from
        return (
            self.log_weight,
            self.mean,
            self.cov,
            None if recycled is None else recycled.columns(),
        )

    @staticmethod
    def of_columns(columns: MixtureColumns) -> Mixture:
        log_weight, mean, cov, recycled = columns
        return Mixture(log_weight, mean, cov, None if recycled is None else RecycledFrom(*recycled))

    def never_detected(self) -> FloatArray:
        """(P,) expected objects of each component that no detection has ever shown."""
        weight = np.exp(self.log_weight)
        return weight if self.recycled_from is None else weight * (1 - self.recycled_from.recycled)

    def take(self, rows: Index) -> Mixture:
        return Mixture(
            self.log_weight.take(rows, axis=0),
            self.mean.take(rows, axis=0),
            self.cov.take(rows, axis=0),
            None if self.recycled_from is None else self.recycled_from.take(rows),
        )

    def public(self) -> GaussianMixture:
        """The same to whom is not of the filter; the arrays become read-only."""
        return unchecked(GaussianMixture, log_weight=self.log_weight, mean=self.mean, cov=self.cov)

    @staticmethod
    def joined(*parts: Mixture) -> Mixture:
        return Mixture(
            np.concatenate([part.log_weight for part in parts]),
            np.concatenate([part.mean for part in parts]),
            np.concatenate([part.cov for part in parts]),
            RecycledFrom.joined([(part.recycled_from, len(part)) for part in parts]),
        )

    @staticmethod
    def empty() -> Mixture:
        return Mixture(np.zeros(0), np.zeros((0, STATE)), np.zeros((0, STATE, STATE)))


@dataclass(frozen=True, eq=False, slots=True)
class Marks:
    """The memories of the score and detection models for H local hypotheses.

    source (H,K) : P(class of the source), adding up to one; K = 1 where scores tell none apart.
    confidence (H,) : running mean of the scores of past detections; 0 where P_D does not depend on
        it.
    detectable (H,) : P(the detector can find it at present); 1 where misses are independent.
    Of S sensors these two are (H,S), see `DetectionBySensor`.
    """

    source: FloatArray
    confidence: FloatArray
    detectable: FloatArray

    def __len__(self) -> int:
        return len(self.confidence)

    def take(self, rows: Index) -> Marks:
        return Marks(
            self.source.take(rows, axis=0),
            self.confidence.take(rows, axis=0),
            self.detectable.take(rows, axis=0),
        )

    @staticmethod
    def joined(*parts: Marks) -> Marks:
        return Marks(
            np.concatenate([part.source for part in parts]),
            np.concatenate([part.confidence for part in parts]),
            np.concatenate([part.detectable for part in parts]),
        )

    @staticmethod
    def of_source(source: FloatArray) -> Marks:
        """Marks of sources of these classes (H,K), and neutral besides."""
        return Marks(source, np.zeros(len(source)), np.ones(len(source)))

    @staticmethod
    def neutral(rows: int, classes: int = 1) -> Marks:
        """All classes alike."""
        return Marks.of_source(np.full((rows, classes), 1 / classes))


@dataclass(frozen=True, eq=False, slots=True)
class Locals:
    """Local (single-object) hypotheses: one Bernoulli a row, H rows, in no particular order.

    track (H,) : row of the track table (`Density.track_id`) that this is a hypothesis about.
    existence (H,) : r, in [0, 1].
    mean (H,4), cov (H,4,4) : of [x, y, vx, vy] given that the object exists.
    box (H,5) : z, length, width, height, yaw of the last detection.
    label (H,) : int8, of the last detection.
    newest (H,) : int64, which detection each took last, in the numbers that `detections_seen`
        counts.
    shown (H,) : bool, whether the last report showed its track as it has it, or as what became it.
    history (H,L) : int32, measurement taken at each of the last L steps, MISSED or BEFORE; L is
        the configuration's `history`, of which `IdInheritance` reads the last.
    marks : what the models of scores and of detection remember of each.
    record (H,R) : running sums of what its detections said; R = 0 where the scores' model keeps
        none.
    """

    track: Index
    existence: FloatArray
    mean: FloatArray
    cov: FloatArray
    box: FloatArray
    label: NDArray[np.int8]
    newest: IntArray
    shown: BoolArray
    history: NDArray[np.int32]
    marks: Marks
    record: FloatArray

    def __len__(self) -> int:
        return len(self.track)

    def take(self, rows: Index) -> Locals:
        return Locals(
            self.track.take(rows, axis=0),
            self.existence.take(rows, axis=0),
            self.mean.take(rows, axis=0),
            self.cov.take(rows, axis=0),
            self.box.take(rows, axis=0),
            self.label.take(rows, axis=0),
            self.newest.take(rows, axis=0),
            self.shown.take(rows, axis=0),
            self.history.take(rows, axis=0),
            self.marks.take(rows),
            self.record.take(rows, axis=0),
        )

    @staticmethod
    def joined(*parts: Locals) -> Locals:
        return Locals(
            np.concatenate([part.track for part in parts]),
            np.concatenate([part.existence for part in parts]),
            np.concatenate([part.mean for part in parts]),
            np.concatenate([part.cov for part in parts]),
            np.concatenate([part.box for part in parts]),
            np.concatenate([part.label for part in parts]),
            np.concatenate([part.newest for part in parts]),
            np.concatenate([part.shown for part in parts]),
            np.concatenate([part.history for part in parts]),
            Marks.joined(*[part.marks for part in parts]),
            np.concatenate([part.record for part in parts]),
        )

    @staticmethod
    def empty(history: int = 0, classes: int = 1, sums: int = 0) -> Locals:
        """No rows; `history` steps of associations are kept, classes of sources told apart, and
        so many sums of what detections said."""
        return Locals(
            np.zeros(0, np.intp),
            np.zeros(0),
            np.zeros((0, STATE)),
            np.zeros((0, STATE, STATE)),
            np.zeros((0, 5)),
            np.zeros(0, np.int8),
            np.zeros(0, np.int64),
            np.zeros(0, bool),
            np.zeros((0, history), np.int32),
            Marks.neutral(0, classes),
            np.zeros((0, sums)),
        )


@dataclass(frozen=True, eq=False, slots=True)
class Globals:
    """Global hypotheses of all clusters: G rows, sorted by cluster; E members in total.

    cluster (G,) : 0 .. C-1, every cluster at least once.
    log_weight (G,) : the weights of one cluster's rows add up to one.
    start (G+1,) : row g is made of the local hypotheses member[start[g]:start[g+1]].
    member (E,) : rows of the local table, at most one of each track; a track that none of them
        belongs to is absent from that global hypothesis.
    """

    cluster: Index
    log_weight: FloatArray
    start: Index
    member: Index

    def __len__(self) -> int:
        return len(self.log_weight)

    @property
    def clusters(self) -> int:
        return int(self.cluster[-1]) + 1 if len(self.cluster) else 0

    def columns(self) -> tuple[Index, FloatArray, Index, Index]:
        """The fields, as the kernels take them."""
        return self.cluster, self.log_weight, self.start, self.member

    def row_of_member(self) -> Index:
        """(E,) the global hypothesis that each member entry belongs to."""
        return np.repeat(np.arange(len(self.log_weight)), np.diff(self.start))

    @staticmethod
    def one_empty() -> Globals:
        """A table of one cluster with one hypothesis: that nothing was detected yet."""
        return Globals(
            np.zeros(1, np.intp), np.zeros(1), np.zeros(2, np.intp), np.zeros(0, np.intp)
        )

    @staticmethod
    def none() -> Globals:
        """No cluster at all."""
        return Globals(
            np.zeros(0, np.intp), np.zeros(0), np.zeros(1, np.intp), np.zeros(0, np.intp)
        )


@dataclass(frozen=True, eq=False)
class Density:
    """The PMBM density at one time.

    undetected : the PPP, an intensity over objects that were never detected.
    local : Bernoullis of detected objects, under every association hypothesis.
    hypotheses : which Bernoullis hold together, with weights, cluster by cluster.  Clusters are
        independent: the mixture over the whole scene is the product of theirs.
    track_id (T,) : int64; a track's id is the running number, over the whole run, of the detection
        that started it, so it names (time, measurement).  No other object ever has it; an object
        that was given up and is detected again may resume it (`pmbm.filter.identity.recycling`),
        and one that was reported keeps it when a second explanation of it wins
        (`pmbm.filter.identity.inheritance`).
    detections_seen : how many detections came before; the id of the next one.
    undetected_settled : components of the PPP when it was last merged.
    held : None, or the tables as a compiled step left them, for the next to go on from: arrays are
        made of those alone that somebody looks at.
    """

    undetected: Mixture
    local: Locals
    hypotheses: Globals
    track_id: NDArray[np.int64]
    detections_seen: int = 0
    undetected_settled: int = 0
    held: ClassVar[Any] = None

    @staticmethod
    def of_held(held: Any, detections_seen: int) -> Density:
        density = object.__new__(Density)
        density.__dict__.update(
            held=held, detections_seen=detections_seen, undetected_settled=held.settled
        )
        return density

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """A table that nobody has looked at yet."""
            if self.held is None or name not in _OF_HELD:
                raise AttributeError(f"a density has no '{name}'")
            table = self.__dict__[name] = _OF_HELD[name](self.held)
            return table

    def __reduce__(self) -> tuple[Any, ...]:
        return Density, tuple(getattr(self, one.name) for one in fields(self))

    @staticmethod
    def initial(
        undetected: Mixture, *, clustering: bool = True, local: Locals | None = None
    ) -> Density:
        """The density before the first detection; `clustering=False` keeps all tracks in one
        cluster for ever.

        local : an empty table with the columns to keep; default, those of `Locals.empty()`.
        """
        return Density(
            undetected=undetected,
            local=local if local is not None else Locals.empty(),
            hypotheses=Globals.none() if clustering else Globals.one_empty(),
            track_id=np.zeros(0, np.int64),
        )

    def __repr__(self) -> str:
        return (
            f"Density({counted(len(self.track_id), 'track')}, "
            f"{counted(len(self.local), 'local hypothesis', 'local hypotheses')}, "
            f"{counted(len(self.undetected), 'undetected component')})"
        )

    def hypothesis_probability(self) -> FloatArray:
        """(H,) marginal probability of each local hypothesis: its global hypotheses' weights."""
        return probability_of_members(self.hypotheses, len(self.local))

    def with_undetected(self, undetected: Mixture) -> Density:
        return replace(self, undetected=undetected)

    def public_undetected(self) -> GaussianMixture:
        """The undetected objects to whom is not of the filter; the arrays become read-only."""
        if "undetected" in self.__dict__:
            return self.undetected.public()
        log_weight, mean, cov = self.held.undetected()
        return unchecked(GaussianMixture, log_weight=log_weight, mean=mean, cov=cov)


_OF_HELD: dict[str, Callable[[Any], Any]] = {
    "undetected": lambda held: Mixture.of_columns((*held.undetected(), held.recycled_from())),
    "local": lambda held: Locals(*(*held.local(), Marks(*held.marks()), held.record())),
    "hypotheses": lambda held: Globals(*held.hypotheses()),
    "track_id": lambda held: held.track_id(),
}
"""Tables of a `Density` of what a compiled step left."""


def probability_of_members(table: Globals, locals_: int) -> FloatArray:
    """(locals_,) the weights of the global hypotheses that each local hypothesis is a member of."""
    return summed(np.exp(table.log_weight)[table.row_of_member()], table.member, locals_)


def ragged(start: Index, count: Index) -> Index:
    """start[i], start[i] + 1, ... (count[i] of them) for all i, one after another."""
    offset = np.cumsum(count) - count
    return np.arange(int(count.sum())) + np.repeat(start - offset, count)


def starts(count: Index) -> Index:
    """Row starts (N+1,) of a ragged table from the rows' lengths (N,)."""
    result = np.zeros(len(count) + 1, np.intp)
    np.cumsum(count, out=result[1:])
    return result


def summed(value: FloatArray, row: Index, rows: int) -> FloatArray:
    """(rows,) the sum of the values (n,) that belong to each row (n,)."""
    return np.bincount(row, value, minlength=rows).astype(np.float64, copy=False)
