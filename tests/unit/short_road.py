"""A scenario's file that is quickly recorded: one car on a road, for tests of commands."""

_TEXT = """
name = "short"
stresses = "nothing, quickly"
duration = {duration}

[scene]
kind = "road"
sensor = {{ max_range = 60.0 }}

[scene.roads.main]
start = [-200.0, 0.0]
end = [200.0, 0.0]

[scene.actors.car]
road = "main"
position = 210.0
speed = 5.0

[detector]
profile = "nominal"
"""


def short_road(duration):
    """The file's text, for so many seconds."""
    return _TEXT.format(duration=duration)
