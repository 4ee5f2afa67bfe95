// What the mouse or a finger does on a stage; these are methods of the player.

const pointerWork = {
  // Pointer work on one stage: pan, pinch, zoom, hover, and the measuring rectangle.
  point(canvas, tracker) {
    const { state, camera } = this;
    const down = new Map();
    const here = (event) => [event.offsetX, event.offsetY];
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.root.focus({ preventScroll: true });
      down.set(event.pointerId, here(event));
      this.dragged = false;
      this.corner = state.measuring ? camera.toWorld(...here(event)) : null;
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!down.has(event.pointerId)) {
        this.hover(canvas, tracker, ...here(event));
        return;
      }
      const before = down.get(event.pointerId);
      const now = here(event);
      if (now[0] === before[0] && now[1] === before[1]) return;
      this.dragged = true;
      if (this.corner) {
        const [x, y] = camera.toWorld(...now);
        const [u, v] = this.corner;
        [state.region, state.open] = [[[u, v], [x, v], [x, y], [u, y]], false];
      } else if (down.size === 2) {
        const other = [...down].find(([id]) => id !== event.pointerId)[1];
        const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
        this.zoom(apart(now) / Math.max(1, apart(before)), ...other);
      } else {
        state.follow = "none";
        this.atHome = false;
        camera.x -= (now[0] - before[0]) / camera.scale;
        camera.y += (now[1] - before[1]) / camera.scale;
      }
      down.set(event.pointerId, now);
      this.refresh();
    });
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => down.delete(event.pointerId));
    }
    canvas.addEventListener("click", (event) => {
      if (state.measuring) {
        if (!this.dragged) this.addCorner(...here(event));
        return;
      }
      const hit = state.hover;
      if (!hit?.table.object || this.dragged) return;
      this.follow({ table: hit.table, object: hit.table.object[hit.row] });
      this.refresh();
    });
    canvas.addEventListener("pointerleave", () => this.hover(canvas, tracker, -1e6, -1e6));
    canvas.addEventListener("dblclick", () => (state.measuring ? this.closeRegion() : this.home()));
    canvas.addEventListener("wheel", (event) => {
      // A page that scrolls must not stick here: the wheel zooms once the replay has the focus.
      if (!event.ctrlKey && !this.root.contains(document.activeElement)) return;
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0016), ...here(event));
    }, { passive: false });
  },

  // A click while counting: one more corner of a polygon; on its first corner, the last one.
  addCorner(px, py) {
    const { state, camera } = this;
    const near = (p) => Math.hypot(p[0] - px, p[1] - py) < 12;
    const corner = camera.toWorld(px, py);
    if (!state.open) [state.region, state.open] = [[corner], true];
    else if (near(camera.toScreen(...state.region[0]))) this.closeRegion();
    else if (!near(camera.toScreen(...state.region.at(-1)))) state.region.push(corner);
    this.refresh();
  },

  closeRegion() {
    const { state } = this;
    if (state.region?.length < 3) state.region = null;
    state.open = false;
    this.refresh();
  },

  // Counting without a pointer: a region in the middle of the picture, to be moved and resized.
  placeRegion() {
    const { state, camera } = this;
    const [x, y] = [camera.width / camera.scale / 8, camera.height / camera.scale / 8];
    const corner = (a, b) => [camera.x + a * x, camera.y + b * y];
    state.region = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
    state.open = false;
    this.refresh();
  },

  // By metres; or, about its middle, wider and higher by twice that.
  moveRegion(dx, dy, resize) {
    const [x0, y0, x1, y1] = bounds(this.state.region);
    const grown = (value, low, high, by) =>
      high - low + 2 * by < 1 ? value : value + by * ((2 * (value - low)) / (high - low || 1) - 1);
    this.state.region = this.state.region.map(([x, y]) =>
      resize ? [grown(x, x0, x1, dx), grown(y, y0, y1, dy)] : [x + dx, y + dy],
    );
    this.refresh();
  },

  hover(canvas, view, px, py) {
    const { state, camera, data } = this;
    const [x, y] = camera.toWorld(px, py);
    const tables = [];
    if (state.layers.has("tracks") && data.trackers[view]) tables.push(data.trackers[view]);
    if (state.layers.has("truth")) tables.push(data.truth);
    if (state.layers.has("detections")) tables.push(data.detections);
    const reach = 6 / camera.scale;
    const found = [];
    for (const table of tables) {
      const near = table.at[state.frame]
        .map((row) => ({ table, row, view, distance: boxDistance(table, row, x, y) }))
        .filter((hit) => hit.distance <= reach)
        .sort((a, b) => a.distance - b.distance);
      if (near.length) found.push(near[0]);
    }
    const tip = this.find(".tip");
    const changed = state.hover?.row !== found[0]?.row || state.hover?.table !== found[0]?.table;
    state.hover = found[0] ?? null;
    tip.hidden = !found.length;
    if (found.length) {
      tip.replaceChildren(...found.map((hit) => this.describe(hit)));
      const frame = this.root.getBoundingClientRect();
      const stage = canvas.getBoundingClientRect();
      const left = stage.left - frame.left + px + 16;
      tip.style.left = `${Math.min(left, frame.width - tip.offsetWidth - 4)}px`;
      tip.style.top = `${stage.top - frame.top + py + 16}px`;
    }
    if (changed) this.refresh();
  },

  describe({ table, row }) {
    const { data } = this;
    const lines = [];
    const label = data.labels[table.label[row]];
    const speed = () => `${Math.hypot(table.vx[row], table.vy[row]).toFixed(1)} m/s`;
    const at = (axis, values) => (values[row] + data.centre[axis]).toFixed(1);
    const place = `x ${at(0, table.x)}, y ${at(1, table.y)} m`;
    let title;
    if (table === data.truth) {
      const name = table.names[table.object[row]];
      title = `object ${table.ids[table.object[row]]}${name ? ` (${name})` : ""}`;
      const seen = table.flags[row] & 1 ? `${Math.round(100 * table.visibility[row])} % visible` : "not observable";
      lines.push(`${label}, ${speed()}, ${seen}`);
      if (table.flags[row] & 2) lines.push("has crashed");
    } else if (table === data.detections) {
      const sensor = table.sensor ? ` of ${data.site.sensors[table.sensor[row]].name}` : "";
      title = `detection${sensor}, score ${table.score[row].toFixed(2)}`;
      const origin = table.origin[row];
      if (table.origins) lines.push(origin < 0 ? `${label}; in truth: clutter` : `${label}; in truth: object ${table.origins[origin]}`);
      else lines.push(label);
    } else {
      title = `track ${table.ids[table.object[row]]}`;
      lines.push(`${label}, ${speed()}, existence ${table.score[row].toFixed(2)}`);
      if (table.sx) lines.push(`σ ${table.sx[row].toFixed(2)} m, ${table.sy[row].toFixed(2)} m`);
      if (table.false[row]) lines.push("false: no object within reach");
    }
    const box = element("div");
    box.append(element("strong", "", title), ...[...lines, place].map((line) => element("span", "", line)));
    return box;
  },
};
