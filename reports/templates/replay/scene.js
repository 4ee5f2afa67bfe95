// The road from above: one drawing of one frame with one tracker's report.

// Of the boxes and the field of view of one sensor after the other.
const DASHES = [[], [5, 3], [2, 2], [7, 3, 2, 3]];
const dashesOf = (number) => DASHES[number % DASHES.length];
// Whether the centres of its boxes are rings: from afar dashes are not to be told apart.
const hollow = (number) => number % 2 === 1;

class Camera {
  constructor() {
    Object.assign(this, { x: 0, y: 0, scale: 6, width: 1, height: 1 });
  }
  toScreen(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }
  toWorld(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }
  zoom(factor, px, py) {
    const [x, y] = this.toWorld(px, py);
    this.scale = Math.min(120, Math.max(0.4, this.scale * factor));
    this.x = x - (px - this.width / 2) / this.scale;
    this.y = y + (py - this.height / 2) / this.scale;
  }
  // Shows the rectangle [x0, y0, x1, y1] whole.
  frame([x0, y0, x1, y1]) {
    [this.x, this.y] = [(x0 + x1) / 2, (y0 + y1) / 2];
    this.scale = Math.min(28, this.width / (x1 - x0), this.height / (y1 - y0));
  }
}

class Scene {
  constructor(canvas, camera, data, colours) {
    Object.assign(this, { canvas, camera, data, colours });
    this.context = canvas.getContext("2d");
    this.heat = document.createElement("canvas");
  }

  draw(state, trackerIndex) {
    const { context: c, camera, data } = this;
    const tracker = data.trackers[trackerIndex];
    const colour = this.colours.tracker(trackerIndex);
    const on = (layer) => state.layers.has(layer);
    const frame = state.frame;
    this.eye = [data.poses.x[frame], data.poses.y[frame], data.poses.yaw[frame]];
    c.clearRect(0, 0, camera.width, camera.height);
    if (on("site")) this.drivable();
    if (on("undetected") && tracker?.undetected) this.intensity(tracker.undetected, frame);
    if (on("view")) this.fieldOfView();
    if (on("shadows")) this.shadows(frame);
    if (on("view")) this.rings();
    if (on("site")) this.occluders();
    if (on("truth")) for (const row of data.truth.at[frame]) this.truthBox(row);
    this.sensor();
    if (on("detections")) for (const row of data.detections.at[frame]) this.detection(row);
    if (tracker) {
      const rows = tracker.at[frame];
      const paint = (row) => (on("identity") ? this.colours.identity(tracker.object[row]) : colour);
      if (on("trails")) for (const row of rows) this.trail(tracker, row, paint(row));
      if (on("tracks")) for (const row of rows) this.trackBox(tracker, row, paint(row));
      if (on("uncertainty") && tracker.sx) for (const row of rows) this.ellipse(tracker, row, paint(row));
      if (on("velocity")) for (const row of rows) this.arrow(tracker, row, paint(row));
      if (on("errors")) this.errors(tracker, frame);
      if (on("tracks")) this.trackLabels(tracker, rows, paint);
      if (on("errors")) this.switches(tracker, frame);
    }
    if (state.region) this.region(state.region, state.open, tracker, frame);
    if (state.hover?.view === trackerIndex) this.outline(state.hover);
    this.scaleBar();
    if (on("undetected") && tracker?.undetected) this.heatScale();
  }

  path(points) {
    const c = this.context;
    points.forEach(([x, y], i) => {
      const [px, py] = this.camera.toScreen(x, y);
      if (i) c.lineTo(px, py);
      else c.moveTo(px, py);
    });
    c.closePath();
  }

  drivable() {
    if (!this.data.site.drivable) return;
    const c = this.context;
    c.beginPath();
    for (const ring of this.data.site.drivable) this.path(ring);
    c.fillStyle = this.colours.road;
    c.fill("nonzero");
  }

  // What looks: the one sensor, or each of several from its own mount, with its dashes.
  views() {
    const { site } = this.data;
    if (!site.sensors.length) return [{ ...site, eye: this.eye, dashes: [] }];
    const [x, y, yaw] = this.eye;
    const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
    return site.sensors.map((sensor, number) => {
      const [ahead, left, turn] = sensor.mount;
      const eye = [x + ahead * cos - left * sin, y + ahead * sin + left * cos, yaw + turn];
      return { ...sensor, eye, dashes: dashesOf(number) };
    });
  }

  sector({ range, fovCentre, fovHalf } = this.data.site, eye = this.eye) {
    const [x, y] = this.camera.toScreen(eye[0], eye[1]);
    const c = this.context;
    const radius = range * this.camera.scale;
    if (fovHalf >= Math.PI - 1e-6) {
      c.moveTo(x + radius, y);
      c.arc(x, y, radius, 0, 2 * Math.PI);
    } else {
      const middle = -(eye[2] + fovCentre);
      c.moveTo(x, y);
      c.arc(x, y, radius, middle - fovHalf, middle + fovHalf);
      c.closePath();
    }
  }

  fieldOfView() {
    const c = this.context;
    c.beginPath();
    c.rect(0, 0, this.camera.width, this.camera.height);
    this.sector();
    c.fillStyle = this.colours.unseen;
    c.fill("evenodd");
    c.save();
    c.strokeStyle = this.colours.line;
    c.lineWidth = 1;
    for (const view of this.views()) {
      c.setLineDash(view.dashes);
      c.beginPath();
      this.sector(view, view.eye);
      c.stroke();
    }
    c.restore();
  }

  shadows(frame) {
    const { truth, site } = this.data;
    const c = this.context;
    const outlines = truth.at[frame].map((row) => boxCorners(truth, row)).concat(site.occluders);
    const views = this.views();
    for (const view of views) {
      c.save();
      // The darker, the fewer of the sensors see it.
      c.globalAlpha = 1 / views.length;
      c.beginPath();
      this.sector(view, view.eye);
      c.clip();
      c.beginPath();
      for (const outline of outlines) {
        const shade = shadowOf(outline, view.eye, view.range * 1.1);
        if (shade) this.path(shade);
      }
      c.fillStyle = this.colours.unseen;
      c.fill("nonzero");
      c.restore();
    }
  }

  rings() {
    const c = this.context;
    const step = [5, 10, 20, 50, 100, 200].find((s) => s * this.camera.scale > 90) ?? 500;
    const [x, y] = this.camera.toScreen(this.eye[0], this.eye[1]);
    c.save();
    c.strokeStyle = this.colours.line;
    c.fillStyle = this.colours.faint;
    c.font = this.colours.font(10);
    c.lineWidth = 1;
    c.setLineDash([1, 5]);
    c.textAlign = "center";
    for (let r = step; r < this.data.site.range; r += step) {
      c.beginPath();
      c.arc(x, y, r * this.camera.scale, 0, 2 * Math.PI);
      c.stroke();
      c.fillText(`${r}`, x, y - r * this.camera.scale - 3);
    }
    c.restore();
  }

  occluders() {
    const c = this.context;
    c.beginPath();
    for (const ring of this.data.site.occluders) this.path(ring);
    c.fillStyle = this.colours.building;
    c.fill();
  }

  sensor() {
    const c = this.context;
    const [x, y] = this.camera.toScreen(this.eye[0], this.eye[1]);
    const size = Math.max(7, 1.6 * this.camera.scale);
    c.save();
    c.translate(x, y);
    c.rotate(-this.eye[2]);
    c.beginPath();
    c.moveTo(size, 0);
    c.lineTo(-size * 0.7, size * 0.62);
    c.lineTo(-size * 0.35, 0);
    c.lineTo(-size * 0.7, -size * 0.62);
    c.closePath();
    c.fillStyle = this.colours.ink;
    c.fill();
    c.restore();
  }

  truthBox(row) {
    const { truth } = this.data;
    const c = this.context;
    const observable = truth.flags[row] & 1;
    const corners = boxCorners(truth, row);
    c.save();
    c.beginPath();
    this.path(corners);
    if (observable) {
      c.fillStyle = this.colours.truthFill;
      c.fill();
    } else c.setLineDash([4, 3]);
    c.strokeStyle = truth.flags[row] & 2 ? this.colours.error : this.colours.truth;
    c.lineWidth = 1;
    c.stroke();
    c.setLineDash([]);
    // A windscreen says which way it faces.
    const at = (share) => [
      mix(corners[0], corners[1], share),
      mix(corners[3], corners[2], share),
    ];
    if (truth.length[row] * this.camera.scale > 14) {
      const [a, b] = at(0.28).map(([px, py]) => this.camera.toScreen(px, py));
      c.beginPath();
      c.moveTo(...a);
      c.lineTo(...b);
      c.stroke();
    }
    c.restore();
  }

  detection(row) {
    const { detections } = this.data;
    const c = this.context;
    const score = detections.score[row];
    c.save();
    c.globalAlpha = 0.35 + 0.65 * score;
    c.strokeStyle = this.colours.detection;
    c.fillStyle = this.colours.detection;
    c.lineWidth = 1.4;
    if (detections.sensor) c.setLineDash(dashesOf(detections.sensor[row]));
    c.beginPath();
    this.path(boxCorners(detections, row));
    c.stroke();
    const [x, y] = this.camera.toScreen(detections.x[row], detections.y[row]);
    c.beginPath();
    c.setLineDash([]);
    if (detections.sensor && hollow(detections.sensor[row])) {
      c.arc(x, y, 2.6, 0, 2 * Math.PI);
      c.stroke();
    } else {
      c.arc(x, y, 1.8, 0, 2 * Math.PI);
      c.fill();
    }
    c.restore();
    if (this.camera.scale > 5) {
      const drop = (detections.width[row] / 2) * this.camera.scale + 13;
      this.text(score.toFixed(2).replace(/^0/, ""), x, y + drop, this.colours.detectionText, 10, "center");
    }
  }

  intensity(grid, frame) {
    const step = grid.step(frame);
    if (step === undefined) return;
    const key = [step, ...this.colours.heat].join();
    if (this.painted !== grid || this.heat.dataset.key !== key) grid.paint(this.heat, step, this.colours.heat);
    [this.painted, this.heat.dataset.key] = [grid, key];
    const [left, low] = grid.corner(step);
    const size = grid.side * grid.cell;
    const [px, py] = this.camera.toScreen(left, low + size);
    const c = this.context;
    c.save();
    c.imageSmoothingEnabled = true;
    c.drawImage(this.heat, px, py, size * this.camera.scale, size * this.camera.scale);
    c.restore();
  }

  region(ring, open, tracker, frame) {
    const c = this.context;
    c.save();
    c.beginPath();
    this.path(ring);
    c.strokeStyle = this.colours.ink;
    c.lineWidth = 1.5;
    c.setLineDash([5, 3]);
    c.stroke();
    if (open) {
      c.fillStyle = this.colours.ink;
      for (const [px, py] of ring.map((p) => this.camera.toScreen(...p))) c.fillRect(px - 3, py - 3, 6, 6);
    }
    c.restore();
    if (ring.length < 3) return;
    const { expected, there } = hiddenIn(this.data, tracker, frame, ring);
    const words = expected === null ? `there ${there}` : `expected ${expected.toFixed(2)}, there ${there}`;
    const [x0, , x1, y1] = bounds(ring);
    const [px, py] = this.camera.toScreen((x0 + x1) / 2, y1);
    this.text(words, px, Math.max(18, py - 7), this.colours.ink, 13, "center", 650);
  }

  // What the heat means, beside the scale bar.
  heatScale() {
    const c = this.context;
    const [x, y, width] = [this.camera.width - 128, this.camera.height - (this.low ?? 52), 84];
    const [red, green, blue] = this.colours.heat;
    for (let k = 0; k < width; k++) {
      const density = 10 ** ((3 * k) / (width - 1) - 5);
      c.fillStyle = `rgba(${red}, ${green}, ${blue}, ${heatOpacity(density)})`;
      c.fillRect(x + k, y, 1, 7);
    }
    this.text(".001", x - 4, y + 7, this.colours.soft, 10, "right");
    this.text("1 / 100 m²", x + width - 36, y - 5, this.colours.soft, 10, "left");
  }

  outline({ table, row }) {
    const c = this.context;
    c.save();
    c.beginPath();
    this.path(boxCorners(table, row));
    c.strokeStyle = this.colours.ink;
    c.lineWidth = 3;
    c.stroke();
    c.restore();
  }

  scaleBar() {
    const metres = [1, 2, 5, 10, 20, 50, 100, 200].find((m) => m * this.camera.scale > 60) ?? 500;
    const c = this.context;
    const [x, y] = [14, this.camera.height - 14];
    c.save();
    c.strokeStyle = this.colours.soft;
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(x, y - 4);
    c.lineTo(x, y);
    c.lineTo(x + metres * this.camera.scale, y);
    c.lineTo(x + metres * this.camera.scale, y - 4);
    c.stroke();
    c.restore();
    this.text(`${metres} m`, x + metres * this.camera.scale + 7, y + 1, this.colours.soft, 11, "left");
  }

  text(words, x, y, colour, size, align, weight = 500) {
    const c = this.context;
    c.save();
    c.font = this.colours.font(size, weight);
    c.textAlign = align;
    c.lineJoin = "round";
    c.lineWidth = 3;
    c.strokeStyle = this.colours.stage;
    c.strokeText(words, x, y);
    c.fillStyle = colour;
    c.fillText(words, x, y);
    c.restore();
  }
}

Object.assign(Scene.prototype, trackMarks);

function mix([ax, ay], [bx, by], share) {
  return [ax + (bx - ax) * share, ay + (by - ay) * share];
}
