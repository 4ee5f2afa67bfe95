#!/usr/bin/env bash
# Package: sumolib 1.28.0 (October 2026).
# Expected: line2boundary is to "expand center line by width/2 on both sides to obtain a (closed) boundary shape (i.e.
#   for an edge or lane)": every point of it is width/2 or more from the centre line, and the mirror image of a lane
#   has the mirrored boundary.
# Seen: move2side leaves out a corner whose next segment is short against the shift, although on the outside of a bend
#   there is room for it, and does so only for a shift to the right. On a left bend of two 45 degree corners 1.4 m
#   apart the right boundary of a lane of 4 m passes the first corner at .33 m instead of 2 m; the lane has 69.9 m2,
#   and its mirror image 80.9 m2. shapely's offset keeps 2 m on both.
# Why it matters: a turn drawn by many short segments loses corners of its right boundary, and a car in the middle of
#   its lane is partly off the road on left turns alone.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps sumolib==1.28.0 shapely==2.2.0 numpy==2.4.6
"$work/venv/bin/python" - <<'EOF'
from shapely import LineString, Point, Polygon
from sumolib.geomhelper import line2boundary, move2side

width = 4.0
left_bend = [(0.0, 0.0), (10.0, 0.0), (11.0, 1.0), (11.0, 10.0)]
right_bend = [(x, -y) for x, y in left_bend]
corner = Point(10.0, 0.0)
areas, distances = [], []

for name, lane, outside in (("left bend", left_bend, 1), ("right bend", right_bend, -1)):
    seen = LineString(move2side(lane, outside * width / 2))  # a positive amount moves to the right
    right = LineString(lane).offset_curve(-outside * width / 2, join_style="mitre")
    area = Polygon(line2boundary(lane, width)).area
    near, far = seen.distance(corner), right.distance(corner)
    print(f"{name}: outer boundary {near:.2f} m from the corner, by shapely {far:.2f}")
    print(f"{name}: {[(round(x, 2), round(y, 2)) for x, y in seen.coords]}, lane area {area:.2f} m2")
    areas.append(area)
    distances.append(near)
    assert abs(far - width / 2) < 1e-9
assert distances[0] < 0.4 and abs(distances[1] - width / 2) < 1e-9
assert areas[1] - areas[0] > 10
EOF
