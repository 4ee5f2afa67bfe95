// What a tracker reports, and where it errs; these are methods of the scene.

const TRAIL_SECONDS = 3;
const SWITCH_SECONDS = 1;

const trackMarks = {
  trail(tracker, row, colour) {
    const c = this.context;
    const times = this.data.times;
    const now = times[tracker.frame[row]];
    c.save();
    c.strokeStyle = colour;
    c.lineWidth = 1.6;
    c.lineCap = "round";
    // Rows are sorted by track, then frame: the past lies just before.
    for (let r = row; r > 0 && tracker.object[r - 1] === tracker.object[row]; r--) {
      const age = now - times[tracker.frame[r - 1]];
      if (age > TRAIL_SECONDS) break;
      c.globalAlpha = 0.55 * (1 - age / TRAIL_SECONDS);
      c.setLineDash(tracker.frame[r] - tracker.frame[r - 1] > 1 ? [2, 4] : []);
      c.beginPath();
      c.moveTo(...this.camera.toScreen(tracker.x[r], tracker.y[r]));
      c.lineTo(...this.camera.toScreen(tracker.x[r - 1], tracker.y[r - 1]));
      c.stroke();
    }
    c.restore();
  },

  trackBox(tracker, row, colour) {
    const c = this.context;
    c.save();
    c.beginPath();
    this.path(boxCorners(tracker, row));
    c.globalAlpha = 0.1;
    c.fillStyle = colour;
    c.fill();
    c.globalAlpha = 0.4 + 0.6 * tracker.score[row];
    c.strokeStyle = colour;
    c.lineWidth = 2;
    c.lineJoin = "round";
    c.stroke();
    c.restore();
  },

  // Ids above their boxes; one that would cover another moves up.
  trackLabels(tracker, rows, paint) {
    if (this.camera.scale < 1.5) return;
    const taken = [];
    for (const row of rows) {
      const corners = boxCorners(tracker, row).map(([x, y]) => this.camera.toScreen(x, y));
      const words = tracker.ids[tracker.object[row]];
      const [x] = this.camera.toScreen(tracker.x[row], tracker.y[row]);
      const half = 4 * words.length;
      let y = Math.min(...corners.map((p) => p[1])) - 5;
      const covers = (other) => Math.abs(other.x - x) < other.half + half && Math.abs(other.y - y) < 12;
      for (let tries = 0; tries < 3 && taken.some(covers); tries++) y -= 12;
      taken.push({ x, y, half });
      this.text(words, x, y, paint(row), 12, "center", 650);
    }
  },

  ellipse(tracker, row, colour) {
    const c = this.context;
    const [a, b] = [tracker.sx[row] ** 2, tracker.sy[row] ** 2];
    const d = Math.sign(tracker.sxy[row]) * tracker.sxy[row] ** 2;
    const middle = (a + b) / 2;
    const spread = Math.hypot((a - b) / 2, d);
    const [x, y] = this.camera.toScreen(tracker.x[row], tracker.y[row]);
    const radius = (variance) => 2 * Math.sqrt(Math.max(variance, 1e-4)) * this.camera.scale;
    c.save();
    c.strokeStyle = colour;
    c.lineWidth = 1.2;
    c.setLineDash([2, 2]);
    c.beginPath();
    c.ellipse(x, y, radius(middle + spread), radius(middle - spread), -Math.atan2(2 * d, a - b) / 2, 0, 2 * Math.PI);
    c.stroke();
    c.restore();
  },

  arrow(tracker, row, colour) {
    const [vx, vy] = [tracker.vx[row], tracker.vy[row]];
    const [x, y] = this.camera.toScreen(tracker.x[row], tracker.y[row]);
    const [tx, ty] = this.camera.toScreen(tracker.x[row] + vx, tracker.y[row] + vy);
    const length = Math.hypot(tx - x, ty - y);
    if (length < 6) return;
    const c = this.context;
    const [ux, uy] = [(tx - x) / length, (ty - y) / length];
    c.save();
    c.strokeStyle = c.fillStyle = colour;
    c.globalAlpha = 0.85;
    c.lineWidth = 1.4;
    c.beginPath();
    c.moveTo(x, y);
    c.lineTo(tx - 5 * ux, ty - 5 * uy);
    c.stroke();
    c.beginPath();
    c.moveTo(tx, ty);
    c.lineTo(tx - 7 * ux - 3 * uy, ty - 7 * uy + 3 * ux);
    c.lineTo(tx - 7 * ux + 3 * uy, ty - 7 * uy - 3 * ux);
    c.closePath();
    c.fill();
    c.restore();
  },

  errors(tracker, frame) {
    const { truth } = this.data;
    const c = this.context;
    c.save();
    c.strokeStyle = this.colours.error;
    c.lineWidth = 2;
    const rowOf = new Map(truth.at[frame].map((row) => [truth.object[row], row]));
    for (const entry of tracker.missed.at[frame]) {
      const row = rowOf.get(tracker.missed.object[entry]);
      const [x, y] = this.camera.toScreen(truth.x[row], truth.y[row]);
      const radius = (Math.hypot(truth.length[row], truth.width[row]) / 2) * this.camera.scale + 5;
      c.beginPath();
      c.arc(x, y, radius, 0, 2 * Math.PI);
      c.stroke();
    }
    for (const row of tracker.at[frame]) {
      if (!tracker.false[row]) continue;
      const [x, y] = this.camera.toScreen(tracker.x[row], tracker.y[row]);
      const arm = Math.max(5, 0.9 * this.camera.scale);
      c.beginPath();
      c.moveTo(x - arm, y - arm);
      c.lineTo(x + arm, y + arm);
      c.moveTo(x - arm, y + arm);
      c.lineTo(x + arm, y - arm);
      c.stroke();
    }
    c.restore();
  },

  // For a second after an object changed its track id: the old and the new one.
  switches(tracker, frame) {
    const { truth, times } = this.data;
    for (const [at, object, old, now] of tracker.switches) {
      if (at > frame || times[frame] - times[at] > SWITCH_SECONDS) continue;
      const row = truth.at[frame].find((r) => truth.ids[truth.object[r]] === object);
      if (row === undefined) continue;
      const [x, y] = this.camera.toScreen(truth.x[row], truth.y[row]);
      const rise = (Math.hypot(truth.length[row], truth.width[row]) / 2) * this.camera.scale + 16;
      this.text(`${old} → ${now}`, x, y - rise, this.colours.error, 12, "center", 650);
    }
  },
};
