"""A page as one file: templates filled in, styles and scripts inside, nothing loaded from outside.

The content-security policy names the hashes of the page's own style and script; nothing else runs,
whatever a name from data may contain.
"""

from __future__ import annotations

import base64
import hashlib
import json
from functools import cache
from importlib import resources
from typing import Any

import jinja2
from markupsafe import Markup

from pmbm.reports.palette import DARK, LIGHT

REPLAY_SCRIPTS = (
    "decode",
    "geometry",
    "hidden",
    "tracks",
    "scene",
    "plots",
    "pointer",
    "player",
    "main",
)


def render_page(template: str, **values: Any) -> str:
    """The page made from `templates/<template>` with these values, every string escaped."""
    style, script = _style(), _script()
    policy = "; ".join(
        [
            "default-src 'none'",
            f"style-src '{_hash(style)}'",
            f"script-src '{_hash(script)}'",
            "img-src data:",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )
    return (
        _environment()
        .get_template(template)
        .render(policy=policy, style=Markup(style), script=Markup(script), **values)
    )


def script_json(value: Any) -> Markup:
    """JSON that is safe inside <script type="application/json">: no character there can end the
    element or the line."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FunctionLoader(_read),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def _read(name: str) -> str:
    return resources.files("pmbm.reports").joinpath("templates", name).read_text(encoding="utf-8")


@cache
def _style() -> str:
    def block(colours: dict[str, str]) -> str:
        return ":root{" + "".join(f"--{name}:{value};" for name, value in colours.items()) + "}"

    dark = "@media screen and (prefers-color-scheme: dark){" + block(DARK) + "}"
    return "\n".join([block(LIGHT), dark, _read("page.css")])


@cache
def _script() -> str:
    parts = [_read(f"replay/{name}.js") for name in REPLAY_SCRIPTS]
    return "\n".join(["(() => {", '"use strict";', *parts, "})();"])


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
