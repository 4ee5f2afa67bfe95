"""The output of `pmbm run --explain`: one track's life in a trial."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmbm.errors import InputError

if TYPE_CHECKING:
    from pmbm.study import Source
    from pmbm.tracking import TrackerFactory

_HISTORY = 10
"""Steps of association history that the story ends with."""


def story_of(
    source: Source, tracker: str, factory: TrackerFactory, seed: int, trial: int, track_id: int
) -> str:
    """The life of the tracker's track in this trial of the source.

    Raises InputError where the tracker cannot be asked, or never had the track.
    """
    from pmbm.filter import PMBMTracker
    from pmbm.filter.explain.story import tell
    from pmbm.seeding import seeded, tracker_seed
    from pmbm.study import recorded
    from pmbm.tracking import make_tracker, run

    recording = recorded(source, seed, trial)
    own = tracker_seed(seed, trial)
    with seeded(own):
        made = make_tracker(factory, recording.site, own)
    if not isinstance(made, PMBMTracker):
        raise InputError(
            f"tracker '{tracker}' has no inspect(), which --explain needs",
            field="--explain",
            expected="a PMBMTracker as the first tracker",
            got=type(made).__name__,
        )
    history = max(_HISTORY, made.config.report.history)
    config = made.config.changed({"report.history": history})
    sequence = run(PMBMTracker(config, recording.site), recording, record=True)
    # Of the deliveries of a frame, the last that was taken in: the report is what followed it.
    given = recording.handed_over()
    last = dict(zip(recording.frame[given].tolist(), given.tolist(), strict=True))
    story = tell(
        track_id,
        sequence.inspections or (),
        sequence.steps,
        [recording.detections[last[frame]] for frame in sequence.frame.tolist()],
        recycle_below=config.reduction.recycle_below,
    )
    return f"{tracker}, {source.name}, trial {trial} of seed {seed}\n{story}"
