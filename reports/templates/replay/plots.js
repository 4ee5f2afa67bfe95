// Time series under the scene, with the scrubber's cursor.

const PLOT_MARGIN = { left: 44, right: 14, top: 22, bottom: 6 };
const PLOT_HEIGHT = 68;
const LEGEND_LINE = 14;

class Plots {
  constructor(canvas, data, colours) {
    Object.assign(this, { canvas, data, colours });
    this.context = canvas.getContext("2d");
    this.rows = this.describe();
  }

  get height() {
    return this.boxes().at(-1).bottom + PLOT_MARGIN.bottom + 20;
  }

  // Where each row is drawn: below the other, its legend above it in as many lines as it takes.
  boxes() {
    let y = 0;
    return this.rows.map((row) => {
      const { lines } = this.placed(this.longestTitle(row), this.names(row));
      const top = y + PLOT_MARGIN.top + LEGEND_LINE * (lines - 1);
      y = top + PLOT_HEIGHT + PLOT_MARGIN.bottom;
      return { top, bottom: top + PLOT_HEIGHT };
    });
  }

  names(row) {
    return row.components ? COMPONENTS.map(([, name]) => name) : row.lines.map((line) => line.name);
  }

  title(row, tracker) {
    return row.components && this.data.trackers.length > 1 ? `${row.title}: ${tracker.name}` : row.title;
  }

  longestTitle(row) {
    const titles = this.data.trackers.map((tracker) => this.title(row, tracker));
    return titles.reduce((a, b) => (b.length > a.length ? b : a), row.title);
  }

  // Where a legend's entries go: one after another, on a further line where they do not fit.
  placed(title, names) {
    const c = this.context;
    c.save();
    c.font = this.colours.font(11, 600);
    let x = PLOT_MARGIN.left + c.measureText(title).width + 14;
    c.font = this.colours.font(11);
    let line = 0;
    const places = names.map((name) => {
      const width = c.measureText(`${name} 88.88`).width;
      if (x + 14 + width > this.width) [x, line] = [PLOT_MARGIN.left, line + 1];
      const place = { x, line };
      x += width + 26;
      return place;
    });
    c.restore();
    return { places, lines: line + 1 };
  }

  describe() {
    const { data } = this;
    const scored = new Array(data.frames).fill(0);
    for (let f = 0; f < data.frames; f++) {
      for (const row of data.truth.at[f]) scored[f] += data.truth.flags[row] & 1;
    }
    const rows = [
      {
        title: "objects",
        switches: true,
        lines: [
          { name: "true", values: scored, truth: true },
          ...data.trackers.map((t, i) => ({ name: t.name, tracker: i, values: onFrames(data, t, t.steps.map((f) => t.at[f].length)) })),
        ],
        digits: 0,
      },
    ];
    if (data.trackers.some((t) => t.series.gospa)) {
      rows.push({
        title: "GOSPA, m",
        lines: data.trackers.map((t, i) => ({ name: t.name, tracker: i, values: onFrames(data, t, t.series.gospa ?? []) })),
        digits: 2,
      });
    }
    if (data.trackers.some((t) => COMPONENTS.every(([key]) => t.series[key]))) {
      rows.push({ title: "GOSPA² in parts, m²", components: true, digits: 1 });
    }
    return rows;
  }

  x(frame) {
    const span = this.width - PLOT_MARGIN.left - PLOT_MARGIN.right;
    return PLOT_MARGIN.left + (span * frame) / Math.max(1, this.data.frames - 1);
  }

  frameAt(px) {
    const span = this.width - PLOT_MARGIN.left - PLOT_MARGIN.right;
    const frame = Math.round(((px - PLOT_MARGIN.left) / span) * (this.data.frames - 1));
    return Math.min(this.data.frames - 1, Math.max(0, frame));
  }

  draw(state) {
    const c = this.context;
    c.clearRect(0, 0, this.width, this.height);
    const boxes = this.boxes();
    this.rows.forEach((row, i) => {
      const box = boxes[i];
      if (row.components) this.components(row, box, state);
      else this.lines(row, box, state);
    });
    this.timeAxis();
    const x = Math.round(this.x(state.frame)) + 0.5;
    c.strokeStyle = this.colours.ink;
    c.lineWidth = 1;
    c.beginPath();
    c.moveTo(x, PLOT_MARGIN.top - 6);
    c.lineTo(x, this.height - 20);
    c.stroke();
  }

  axis(box, top) {
    const c = this.context;
    c.save();
    c.font = this.colours.font(10);
    c.textAlign = "right";
    c.fillStyle = this.colours.soft;
    c.strokeStyle = this.colours.hair;
    const step = niceStep(top / 3);
    for (let v = 0; v <= top + 1e-9; v += step) {
      const y = Math.round(box.bottom - ((box.bottom - box.top) * v) / top) + 0.5;
      c.beginPath();
      c.moveTo(PLOT_MARGIN.left, y);
      c.lineTo(this.width - PLOT_MARGIN.right, y);
      c.stroke();
      c.fillText(String(+v.toPrecision(3)), PLOT_MARGIN.left - 7, y + 3);
    }
    c.restore();
  }

  // The row's title, then the values under the cursor in their own colours: legend and reading.
  heading(row, box, entries, title = row.title) {
    const c = this.context;
    c.save();
    c.textAlign = "left";
    c.font = this.colours.font(11, 600);
    c.fillStyle = this.colours.ink;
    const { places, lines } = this.placed(this.longestTitle(row), this.names(row));
    const first = box.top - 8 - LEGEND_LINE * (lines - 1);
    c.fillText(title, PLOT_MARGIN.left, first);
    c.font = this.colours.font(11);
    entries.forEach(({ name, value, colour }, i) => {
      const { x, line } = places[i];
      const y = first + LEGEND_LINE * line;
      c.fillStyle = colour;
      c.fillRect(x, y - 8, 8, 8);
      c.fillStyle = this.colours.soft;
      c.fillText(`${name} ${value === null ? "–" : value.toFixed(row.digits)}`, x + 12, y);
    });
    c.restore();
  }

  lines(row, box, state) {
    const c = this.context;
    const all = row.lines.flatMap((line) => line.values.map((v, frame) => [frame, v]));
    const top = topAfterStart(this.data.times, all);
    this.axis(box, top);
    const y = (v) => box.bottom - ((box.bottom - box.top) * Math.min(v, top)) / top;
    for (const line of row.lines) {
      c.save();
      c.strokeStyle = line.truth ? this.colours.truth : this.colours.tracker(line.tracker);
      const chosen = line.truth || state.compare || line.tracker === state.tracker;
      c.globalAlpha = chosen ? 1 : 0.45;
      c.lineWidth = line.truth ? 4 : chosen ? 1.7 : 1.2;
      if (line.truth) c.globalAlpha = 0.45;
      c.lineJoin = "round";
      c.beginPath();
      let open = false;
      const cut = [];
      line.values.forEach((v, frame) => {
        if (v > top) cut.push(frame);
        if (v === null) open = false;
        else if (open) c.lineTo(this.x(frame), y(v));
        else c.moveTo(this.x(frame), y(v));
        open = v !== null;
      });
      c.stroke();
      cut.forEach((frame) => this.cut(this.x(frame), box.top));
      c.restore();
    }
    if (row.switches) this.switches(box, state);
    this.heading(row, box, row.lines.map((line) => ({
      name: line.name,
      value: line.values[state.frame] ?? null,
      colour: line.truth ? this.colours.truth : this.colours.tracker(line.tracker),
    })));
  }

  // A diamond where an object changed its track id; with several trackers shown, a line for each.
  switches(box, state) {
    const c = this.context;
    const shown = state.compare ? this.data.trackers.map((_, i) => i) : [state.tracker];
    let y = box.bottom - 7;
    for (const index of shown) {
      c.fillStyle = state.compare ? this.colours.tracker(index) : this.colours.error;
      for (const [frame] of this.data.trackers[index]?.switches ?? []) {
        const x = this.x(frame);
        c.beginPath();
        c.moveTo(x, y - 4);
        c.lineTo(x + 4, y);
        c.lineTo(x, y + 4);
        c.lineTo(x - 4, y);
        c.fill();
      }
      y -= 9;
    }
  }

  components(row, box, state) {
    const c = this.context;
    const tracker = this.data.trackers[state.tracker];
    const parts = COMPONENTS.map(([key, name]) => ({
      name, colour: this.colours[key], values: onFrames(this.data, tracker, tracker.series[key] ?? []),
    }));
    const sums = this.data.trackers.flatMap((t) =>
      t.steps.map((frame, i) => [frame, COMPONENTS.reduce((s, [key]) => s + (t.series[key]?.[i] ?? 0), 0)]));
    const top = topAfterStart(this.data.times, sums);
    this.axis(box, top);
    const height = (box.bottom - box.top) / top;
    const width = Math.max(1, this.x(1) - this.x(0));
    c.save();
    c.beginPath();
    c.rect(PLOT_MARGIN.left, 0, this.width - PLOT_MARGIN.left - PLOT_MARGIN.right, this.height);
    c.clip();
    for (let f = 0; f < this.data.frames; f++) {
      let base = box.bottom;
      for (const part of parts) {
        const value = Math.min((part.values[f] ?? 0) * height, base - box.top);
        c.fillStyle = part.colour;
        c.fillRect(this.x(f) - width / 2, base - value, width + 0.3, value);
        base -= value;
      }
      const sum = parts.reduce((s, part) => s + (part.values[f] ?? 0), 0);
      if (sum > top) this.cut(this.x(f), box.top);
    }
    c.restore();
    const entries = parts.map((p) => ({ name: p.name, value: p.values[state.frame] ?? null, colour: p.colour }));
    this.heading(row, box, entries, this.title(row, tracker));
  }

  // A value beyond the axis: a notch at its top.
  cut(x, y) {
    const c = this.context;
    c.fillStyle = this.colours.ink;
    c.beginPath();
    c.moveTo(x - 3, y);
    c.lineTo(x + 3, y);
    c.lineTo(x, y - 4);
    c.fill();
  }

  timeAxis() {
    const c = this.context;
    const times = this.data.times;
    const span = times[times.length - 1] - times[0];
    const step = niceStep(span / Math.max(2, this.width / 110));
    c.save();
    c.font = this.colours.font(10);
    c.fillStyle = this.colours.soft;
    c.textAlign = "center";
    let frame = 0;
    for (let t = Math.ceil(times[0] / step) * step; t <= times[times.length - 1] + 1e-9; t += step) {
      while (frame < times.length - 1 && times[frame] < t - 1e-6) frame++;
      c.fillText(`${+t.toPrecision(6)} s`, this.x(frame), this.height - 4);
    }
    c.restore();
  }
}

const COMPONENTS = [
  ["gospa_localisation", "localisation"],
  ["gospa_missed", "missed"],
  ["gospa_false", "false"],
];

// A series has one value per step; frames that were not stepped have none.
function onFrames(data, tracker, values) {
  const all = new Array(data.frames).fill(null);
  tracker.steps.forEach((frame, i) => (all[frame] = values[i] ?? null));
  return all;
}

function niceStep(rough) {
  const power = 10 ** Math.floor(Math.log10(rough || 1));
  return [1, 2, 5, 10, 20].map((m) => m * power).find((step) => step >= rough * 0.999);
}

// The top of an axis for rows of (frame, value).  The first second of a run, when nothing is
// tracked yet, must not flatten the rest: what is larger only there is cut, and marked.
function topAfterStart(times, pairs) {
  const largest = (kept) => Math.max(0.1, ...kept.filter(([, v]) => v !== null).map(([, v]) => v));
  return niceTop(largest(afterStart(times, pairs)) * 1.05);
}

// Pairs of (frame, value) without the first second; all where there is nothing else.
function afterStart(times, pairs) {
  const later = pairs.filter(([frame]) => times[frame] > times[0] + 1);
  return later.length ? later : pairs;
}

function niceTop(value) {
  const step = niceStep(value / 3);
  return step * Math.ceil(value / step - 1e-9);
}
