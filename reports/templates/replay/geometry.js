// Boxes, shadows and the intensity of undetected objects, in metres.

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

// Objects per square metre on a grid; `box` is [x0, y0, x1, y1].
function intensityGrid(mixture, rows, box, columns, lines) {
  const grid = new Float32Array(columns * lines);
  const [dx, dy] = [(box[2] - box[0]) / columns, (box[3] - box[1]) / lines];
  for (const row of rows) {
    const [mx, my] = [mixture.x[row], mixture.y[row]];
    const [xx, yy, xy] = regular(mixture, row);
    const det = xx * yy - xy * xy;
    const peak = Math.exp(mixture.weight[row]) / (2 * Math.PI * Math.sqrt(det));
    const [rx, ry] = [4 * Math.sqrt(xx), 4 * Math.sqrt(yy)];
    const i0 = Math.max(0, Math.floor((mx - rx - box[0]) / dx));
    const i1 = Math.min(columns - 1, Math.ceil((mx + rx - box[0]) / dx));
    const j0 = Math.max(0, Math.floor((my - ry - box[1]) / dy));
    const j1 = Math.min(lines - 1, Math.ceil((my + ry - box[1]) / dy));
    for (let j = j0; j <= j1; j++) {
      const v = box[1] + (j + 0.5) * dy - my;
      for (let i = i0; i <= i1; i++) {
        const u = box[0] + (i + 0.5) * dx - mx;
        const square = (yy * u * u - 2 * xy * u * v + xx * v * v) / det;
        if (square < 16) grid[j * columns + i] += peak * Math.exp(-square / 2);
      }
    }
  }
  return grid;
}

// Covariances are rounded to the page's resolution: keep them positive.
function regular(mixture, row) {
  const xx = Math.max(mixture.xx[row], 0.05);
  const yy = Math.max(mixture.yy[row], 0.05);
  const limit = 0.999 * Math.sqrt(xx * yy);
  return [xx, yy, Math.min(limit, Math.max(-limit, mixture.xy[row]))];
}

// Expected number of objects in a rectangle: the x marginal by Gauss-Legendre quadrature on pieces
// no wider than a standard deviation, times the exact probability of y given x.
function expectedCount(mixture, rows, [x0, y0, x1, y1]) {
  let total = 0;
  for (const row of rows) {
    const [xx, yy, xy] = regular(mixture, row);
    const [mx, my, sx] = [mixture.x[row], mixture.y[row], Math.sqrt(xx)];
    const [low, high] = [Math.max(x0, mx - 6 * sx), Math.min(x1, mx + 6 * sx)];
    if (low >= high) continue;
    const slope = xy / xx;
    const sy = Math.sqrt(yy - xy * slope);
    const pieces = Math.ceil((high - low) / sx);
    const width = (high - low) / pieces;
    let share = 0;
    for (let piece = 0; piece < pieces; piece++) {
      for (const [node, weight] of GAUSS_LEGENDRE) {
        const x = low + (piece + (node + 1) / 2) * width;
        const mean = my + slope * (x - mx);
        const density = Math.exp(-((x - mx) ** 2) / (2 * xx)) / (sx * Math.sqrt(2 * Math.PI));
        const inside = normalCdf((y1 - mean) / sy) - normalCdf((y0 - mean) / sy);
        share += (weight / 2) * width * density * inside;
      }
    }
    total += Math.exp(mixture.weight[row]) * share;
  }
  return total;
}

const GAUSS_LEGENDRE = [
  [-0.8611363115940526, 0.3478548451374538],
  [-0.3399810435848563, 0.6521451548625461],
  [0.3399810435848563, 0.6521451548625461],
  [0.8611363115940526, 0.3478548451374538],
];

// Standard normal distribution function (Abramowitz and Stegun 7.1.26, error below 1.5e-7).
function normalCdf(z) {
  const t = 1 / (1 + (0.3275911 * Math.abs(z)) / Math.SQRT2);
  const poly =
    t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
  const erf = 1 - poly * Math.exp((-z * z) / 2);
  return z >= 0 ? (1 + erf) / 2 : (1 - erf) / 2;
}
