"""Words that several commands use."""

from __future__ import annotations


def duration(seconds: float) -> str:
    """A time as people say it: seconds, minutes, hours or days."""
    for size, unit in ((86400, "days"), (3600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"
