"""Hypothesis strategies that spoil a good file in the ways that real files go bad."""

from hypothesis import strategies as st

NASTY = (
    *(
        "nan",
        "NaN",
        "inf",
        "-inf",
        "Infinity",
        "1e308",
        "-1e308",
        "1e-308",
        "0",
        "-0",
        "-1",
        "-1.5",
    ),
    *(
        "1e400",
        "99999999999999999999",
        "9223372036854775808",
        "1_0",
        "0x10",
        "١",
        "1,5",
        "--1",
        ".",
    ),
    *("", "None", "null", "true", "{}", "[]", '"', "Car", "Carr", "DontCare", "VEHICLE", "..", "/"),
    *("../../etc/passwd", "\x00", "\ud7ff", "a" * 3000, "3.14", "-10", "7", "2", "1", "0.5", "1e3"),
)
_NASTY_BYTES = (
    b"\xff\xfe",
    b"\x00",
    b"\xc3",
    b"\xed\xa0\x80",
    b"\r",
    b"\n",
    b" ",
    b",",
    b"{",
    b"9",
)


@st.composite
def spoiled_bytes(draw, content):
    """The content cut, doubled, or with bytes put in, taken out or changed."""
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(content)))
        kind = draw(st.sampled_from(["cut", "insert", "drop", "flip", "double"]))
        if kind == "cut":
            content = content[:at]
        elif kind == "insert":
            content = content[:at] + draw(st.sampled_from(_NASTY_BYTES)) + content[at:]
        elif kind == "drop":
            content = content[:at] + content[at + draw(st.integers(1, 8)) :]
        elif kind == "flip" and at < len(content):
            changed = content[at] ^ (1 << draw(st.integers(0, 7)))
            content = content[:at] + bytes([changed]) + content[at + 1 :]
        elif kind == "double":
            content = content + content[at:]
    return content


@st.composite
def spoiled_lines(draw, text, separator):
    """The text with tokens replaced, added or taken out, or lines doubled, moved or taken out."""
    lines = [line.split(separator) for line in text.splitlines()]
    glue = separator or " "
    for _ in range(draw(st.integers(1, 3))):
        if not lines:
            break
        at = draw(st.integers(0, len(lines) - 1))
        kind = draw(st.sampled_from(["token", "token", "token", "add", "remove", "double", "swap"]))
        column = draw(st.integers(0, max(0, len(lines[at]) - 1)))
        if kind == "token" and lines[at]:
            lines[at] = [*lines[at]]
            lines[at][column] = draw(st.sampled_from(NASTY))
        elif kind == "add":
            lines[at] = [*lines[at], draw(st.sampled_from(NASTY))]
        elif kind == "remove" and draw(st.booleans()):
            del lines[at]
        elif kind == "remove":
            lines[at] = lines[at][:column]
        elif kind == "double":
            lines.insert(draw(st.integers(0, len(lines))), lines[at])
        else:
            other = draw(st.integers(0, len(lines) - 1))
            lines[at], lines[other] = lines[other], lines[at]
    return "\n".join(glue.join(line) for line in lines).encode("utf-8", "surrogatepass")


_JSON_VALUES = (
    *(None, True, False, 0, -1, 1.5, 1e308, -1e308, 1e-308, float("nan"), float("inf"), 10**30),
    *(
        "",
        "..",
        "../../x",
        "a\x00b",
        "\ud800",
        "VEHICLE",
        "VEHICEL",
        "car",
        [],
        {},
        [[]],
        [0, 0, 0],
    ),
    *([0, 0, 0, 0], [2, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], {"w": 0, "x": 0, "y": 0, "z": 0}),
    *(315970000000000000, 315970000000000001, 3.1597e17, "315970000000000000", [1] * 2000, -0.0, 2),
)


@st.composite
def spoiled_json(draw, value):
    """The value with parts replaced, renamed, doubled or taken out."""
    for _ in range(draw(st.integers(1, 3))):
        value = _spoil(draw, value, draw(st.integers(0, 7)))
    return value


def _spoil(draw, value, depth):
    if depth > 0 and isinstance(value, dict) and value:
        key = draw(st.sampled_from(sorted(value)))
        kind = draw(st.sampled_from(["deeper", "deeper", "deeper", "remove", "rename"]))
        rest = {k: v for k, v in value.items() if k != key}
        if kind == "remove":
            return rest
        if kind == "rename":
            return {**rest, key[:-1] + "_": value[key]}
        return {**value, key: _spoil(draw, value[key], depth - 1)}
    if depth > 0 and isinstance(value, list) and value:
        at = draw(st.integers(0, len(value) - 1))
        kind = draw(st.sampled_from(["deeper", "deeper", "deeper", "remove", "double", "swap"]))
        if kind == "remove":
            return value[:at] + value[at + 1 :]
        if kind == "double":
            return [*value, value[at]]
        if kind == "swap":
            return value[at:] + value[:at]
        return [*value[:at], _spoil(draw, value[at], depth - 1), *value[at + 1 :]]
    return draw(st.sampled_from(_JSON_VALUES))
