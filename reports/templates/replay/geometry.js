// Boxes, shadows and regions, in metres.

function boxCorners(table, row) {
  const [x, y, yaw] = [table.x[row], table.y[row], table.yaw[row]];
  const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
  const [l, w] = [table.length[row] / 2, table.width[row] / 2];
  const corner = (a, b) => [x + a * cos - b * sin, y + a * sin + b * cos];
  return [corner(l, w), corner(-l, w), corner(-l, -w), corner(l, -w)];
}

// Distance in metres from a point to a box, 0 inside.
function boxDistance(table, row, x, y) {
  const [dx, dy] = [x - table.x[row], y - table.y[row]];
  const [cos, sin] = [Math.cos(table.yaw[row]), Math.sin(table.yaw[row])];
  const along = Math.abs(dx * cos + dy * sin) - table.length[row] / 2;
  const across = Math.abs(dy * cos - dx * sin) - table.width[row] / 2;
  return Math.hypot(Math.max(along, 0), Math.max(across, 0));
}

// The region behind a convex polygon, seen from a point, out to `reach`; null around the point.
function shadowOf(polygon, eye, reach) {
  const start = Math.atan2(polygon[0][1] - eye[1], polygon[0][0] - eye[0]);
  let low = 0, high = 0, first = polygon[0], last = polygon[0];
  for (const point of polygon) {
    const raw = Math.atan2(point[1] - eye[1], point[0] - eye[0]) - start;
    const turn = raw - 2 * Math.PI * Math.round(raw / (2 * Math.PI));
    if (turn < low) [low, first] = [turn, point];
    if (turn > high) [high, last] = [turn, point];
  }
  if (high - low >= Math.PI || high - low === 0) return null;
  if (insideConvex(polygon, eye)) return null;
  const shape = [first];
  const arcs = Math.max(2, Math.ceil((high - low) / 0.05));
  for (let i = 0; i <= arcs; i++) {
    const angle = start + low + ((high - low) * i) / arcs;
    shape.push([eye[0] + reach * Math.cos(angle), eye[1] + reach * Math.sin(angle)]);
  }
  shape.push(last);
  return shape;
}

function insideConvex(polygon, [x, y]) {
  let sign = 0;
  for (let i = 0; i < polygon.length; i++) {
    const [ax, ay] = polygon[i];
    const [bx, by] = polygon[(i + 1) % polygon.length];
    const cross = Math.sign((bx - ax) * (y - ay) - (by - ay) * (x - ax));
    if (cross && sign && cross !== sign) return false;
    sign = sign || cross;
  }
  return true;
}

// The part of a polygon (simple, any turn) on one side of a line: axis 0 is x, sign 1 keeps what is above.
function clipped(ring, axis, at, sign) {
  const kept = [];
  ring.forEach((p, i) => {
    const q = ring[(i + 1) % ring.length];
    const [a, b] = [sign * (p[axis] - at), sign * (q[axis] - at)];
    if (a >= 0) kept.push(p);
    if ((a > 0 && b < 0) || (a < 0 && b > 0)) kept.push(mix(p, q, a / (a - b)));
  });
  return kept;
}

// Area in square metres: of a ring whose way round is not known, and what clipping folds flat is none.
function areaOf(ring) {
  let twice = 0;
  ring.forEach(([x, y], i) => {
    const [u, v] = ring[(i + 1) % ring.length];
    twice += x * v - u * y;
  });
  return Math.abs(twice) / 2;
}

function insideRing(ring, x, y) {
  let inside = false;
  ring.forEach(([ax, ay], i) => {
    const [bx, by] = ring[(i + 1) % ring.length];
    if (ay > y !== by > y && x < ax + ((y - ay) / (by - ay)) * (bx - ax)) inside = !inside;
  });
  return inside;
}

function bounds(ring) {
  const [x, y] = [ring.map((p) => p[0]), ring.map((p) => p[1])];
  return [Math.min(...x), Math.min(...y), Math.max(...x), Math.max(...y)];
}
