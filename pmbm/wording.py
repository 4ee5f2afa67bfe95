"""Numbers of things, times, and what a validator found, in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """A number of things: '1 box', '2 boxes'."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"


def four_digits(value: float) -> float:
    """A value to the four significant digits that a file is given."""
    return float(f"{value:.4g}")


def duration(seconds: float) -> str:
    """A time as people say it: seconds, minutes, hours or days."""
    for size, unit in ((86400, "days"), (3600, "h"), (60, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"


def expected_of(problem: Mapping[str, Any]) -> str:
    """The expectation, in our words, behind one of pydantic's `errors()`."""
    found = problem.get("ctx", {})
    match problem["type"]:
        case "too_short":
            return f"a list of at least {found['min_length']}"
        case "too_long":
            return f"a list of at most {found['max_length']}"
        case "string_too_short":
            return f"a text of at least {counted(found['min_length'], 'character')}"
        case "string_pattern_mismatch":
            return f"a text of the pattern {found['pattern']}"
        case "greater_than":
            return f"above {found['gt']:g}"
        case "greater_than_equal":
            return f"at least {found['ge']:g}"
        case "less_than":
            return f"below {found['lt']:g}"
        case "less_than_equal":
            return f"at most {found['le']:g}"
        case "list_type":
            return "a list"
        case "dict_type" | "model_type" | "dataclass_type":
            return "a table"
        case "string_type":
            return "a text"
        case "bool_type":
            return "true or false"
        case "int_type" | "int_from_float":
            return "a whole number"
        case "float_type":
            return "a number"
    return str(problem["msg"]).removeprefix("Input should be ").removeprefix("a valid ")
