"""The colours of pages and pictures, light and dark.

Trackers and identities are told apart with every common colour vision (hues after Okabe and Ito,
"Color Universal Design", 2008); what carries meaning also differs in form or lightness.
"""

from __future__ import annotations

LIGHT = {
    "page": "#f7f8f9",
    "card": "#ffffff",
    "stage": "#fdfdfe",
    "ink": "#16202b",
    "soft": "#556270",
    "faint": "#98a3ae",
    "hair": "#e6eaee",
    "line": "#c9d1d9",
    "accent": "#0067a5",
    "accent-wash": "#e8f1f8",
    "road": "#eef1f4",
    "building": "#8794a1",
    "unseen": "#283a4e21",
    "truth": "#6d7985",
    "truth-fill": "#dfe4e9",
    "detection": "#d08a00",
    "detection-text": "#8a5c00",
    "error": "#c2185b",
    "tracker-0": "#0072b2",
    "tracker-1": "#d55e00",
    "tracker-2": "#008a64",
    "tracker-3": "#6a51c7",
    "tracker-4": "#86662a",
    "identity-0": "#0072b2",
    "identity-1": "#d55e00",
    "identity-2": "#008a64",
    "identity-3": "#a3358f",
    "identity-4": "#6a51c7",
    "identity-5": "#86662a",
    "identity-6": "#2b8a9c",
    "localisation": "#9fb6c8",
    "missed": "#c2185b",
    "false": "#e9a3bf",
    "heat": "#623ca8",
    "good": "#00704f",
    "bad": "#b3261e",
    "unsure": "#6d7985",
}

DARK = {
    "page": "#0e1216",
    "card": "#151a20",
    "stage": "#12171c",
    "ink": "#e6ebf0",
    "soft": "#9eabb8",
    "faint": "#66737f",
    "hair": "#252c34",
    "line": "#3a444e",
    "accent": "#62b3e6",
    "accent-wash": "#17293a",
    "road": "#1b2229",
    "building": "#5d6a76",
    "unseen": "#00000061",
    "truth": "#98a5b1",
    "truth-fill": "#2c353e",
    "detection": "#e5b13d",
    "detection-text": "#e5b13d",
    "error": "#ff6f9f",
    "tracker-0": "#57b4ea",
    "tracker-1": "#f58b4c",
    "tracker-2": "#35c79d",
    "tracker-3": "#aa98f5",
    "tracker-4": "#cfae6c",
    "identity-0": "#57b4ea",
    "identity-1": "#f58b4c",
    "identity-2": "#35c79d",
    "identity-3": "#e48ad2",
    "identity-4": "#aa98f5",
    "identity-5": "#cfae6c",
    "identity-6": "#6fcbdc",
    "localisation": "#55697a",
    "missed": "#ff6f9f",
    "false": "#8f4763",
    "heat": "#ac80ff",
    "good": "#4fd0a3",
    "bad": "#ff8a80",
    "unsure": "#98a5b1",
}

TRACKERS = 5


def tracker_colour(colours: dict[str, str], index: int) -> str:
    """The colour of the tracker in this place of a report's order."""
    return colours[f"tracker-{index % TRACKERS}"]
