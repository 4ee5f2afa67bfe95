"""The named errors of the project, and its one warning.

Everything that a user can get wrong ends in one `InputError` at the door, whose message is one
line that says what, where, expected, got, and what to do.  Inside the door nothing is re-checked.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any, Final

_LONGEST_VALUE = 80


class InputError(ValueError):
    """Input that cannot be used.

    Parameters
    ----------
    problem : what is wrong, in a few words, without a full stop.
    run, file, frame, object_id, field, rows : where; whatever is known (`run` is a trial or a
        sequence, `field` may be a dotted key).
    expected, got : what would have been right, and what came.
    hint : what to do, for example the nearest valid name.
    """

    def __init__(
        self,
        problem: str,
        *,
        run: str | None = None,
        file: object = None,
        frame: object = None,
        object_id: object = None,
        field: str | None = None,
        rows: Iterable[int] = (),
        expected: object = None,
        got: object = None,
        hint: str | None = None,
    ) -> None:
        self.problem = problem
        self.run = run
        self.file = None if file is None else str(file)
        self.frame = frame
        self.object_id = object_id
        self.field = field
        self.rows = tuple(int(row) for row in rows)
        self.expected = expected
        self.got = got
        self.hint = hint
        super().__init__(self._message())

    def _message(self) -> str:
        rows = ", ".join(map(str, self.rows[:5])) + (", ..." if len(self.rows) > 5 else "")
        where = [
            f"{name} {value}".lstrip()
            for name, value in (
                ("", self.run),
                ("file", self.file),
                ("frame", self.frame),
                ("object", self.object_id),
                ("field", self.field),
                ("rows", rows or None),
            )
            if value is not None
        ]
        text = self.problem + (f" ({', '.join(where)})" if where else "")
        if self.expected is not None:
            text += f": expected {self.expected}"
        if self.got is not None:
            text += f"{',' if self.expected is not None else ':'} got {_short(self.got)}"
        if self.hint is not None:
            text += f"; {self.hint}"
        return text

    def located(self, **where: Any) -> InputError:
        """The same error with more of its place known (`file=`, `frame=`, ...) or with `problem=`
        in other words, for readers that build values far from where the file's name is known."""
        known = {
            "problem": self.problem,
            "run": self.run,
            "file": self.file,
            "frame": self.frame,
            "object_id": self.object_id,
            "field": self.field,
            "rows": self.rows,
            "expected": self.expected,
            "got": self.got,
            "hint": self.hint,
        }
        return _noted(type(self)(**{**known, **where}), notes_of(self))

    def __reduce__(self) -> tuple[Any, ...]:
        # Exceptions pickle by their positional arguments alone; workers must hand on the whole.
        state = {name: value for name, value in self.__dict__.items() if name != "__notes__"}
        return _rebuild, (type(self), state, notes_of(self))


_NEAR: Final = 0.56
"""Likeness from which on a name may be what another was meant to be."""


class InputWarning(UserWarning):
    """Input that is used as it is, though it may not be what was meant."""


class Verbatim(str):
    """A text that an error shows as it is, without quotes."""

    __slots__ = ()
    __repr__ = str.__str__


NOT_YET_CONFIRMED: Final = "negative ids usually mean 'not yet confirmed': leave those tracks out"
"""What to do about them."""


class BaselineMismatch(InputError):
    """Stored values belong to other recordings or another version than those at hand."""


def nearest_hint(name: object, valid: Iterable[str], what: str = "name") -> str:
    """The hint for an unknown name: the nearest valid one, or the list of all."""
    choices = sorted(valid)
    near = difflib.get_close_matches(str(name), choices, n=1, cutoff=_NEAR)
    if near:
        return f"did you mean '{near[0]}'?"
    many = f"{what}es" if what.endswith("s") else f"{what}s"
    return f"valid {many}: {', '.join(choices) or 'none'}"


def _short(value: object) -> str:
    text = " ".join((repr(value) if isinstance(value, str) else str(value)).split())
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."


def notes_of(error: BaseException) -> tuple[str, ...]:
    """The notes added to an error for people (`BaseException.add_note`), which are no part of its
    message."""
    return tuple(getattr(error, "__notes__", ()))


def _noted(error: InputError, notes: Iterable[str]) -> InputError:
    for note in notes:
        error.add_note(note)
    return error


def _rebuild(kind: type[InputError], state: dict[str, Any], notes: tuple[str, ...]) -> InputError:
    return _noted(kind(**state), notes)
