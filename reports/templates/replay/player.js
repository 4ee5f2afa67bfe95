// One replay: the state, what changes it, and what shows it.

const LAYERS_OFF_AT_FIRST = new Set(["uncertainty", "identity"]);

class Player {
  constructor(root, data, colours) {
    Object.assign(this, { root, data, colours });
    this.find = (selector) => root.querySelector(selector);
    this.camera = new Camera();
    this.state = {
      frame: data.start,
      tracker: 0,
      compare: false,
      playing: false,
      speed: 1,
      follow: this.travels() ? "sensor" : "none",
      layers: new Set(),
      region: null,
      open: false,
      hover: null,
      measuring: false,
    };
    this.plots = new Plots(this.find(".plots canvas"), data, colours);
    this.prepareLayers();
    this.buildStages();
    this.listen();
    new ResizeObserver(() => this.resize()).observe(this.find(".stages"));
    this.atHome = true;
    this.resize();
    root.classList.add("ready");
    root.player = this;
  }

  // Whether the sensor drives: then the picture goes along.
  travels() {
    const { poses } = this.data;
    const last = poses.rows - 1;
    return last > 0 && Math.hypot(poses.x[last] - poses.x[0], poses.y[last] - poses.y[0]) > 25;
  }

  prepareLayers() {
    const { data } = this;
    const possible = {
      undetected: data.trackers.some((t) => t.undetected),
      uncertainty: data.trackers.some((t) => t.sx),
      site: data.site.drivable || data.site.occluders.length,
    };
    for (const button of this.root.querySelectorAll("[data-layer]")) {
      const layer = button.dataset.layer;
      if (layer in possible && !possible[layer]) button.remove();
      else if (!LAYERS_OFF_AT_FIRST.has(layer)) this.state.layers.add(layer);
      button.setAttribute("aria-pressed", this.state.layers.has(layer));
    }
    if (!possible.undetected) this.find("[data-do=measure]").remove();
    if (data.site.sensors.length) this.nameSensors(this.find("[data-layer=detections]"));
  }

  // The switch of the detections says how the boxes of each sensor are drawn.
  nameSensors(button) {
    const glyph = button.querySelector(".glyph");
    const entries = this.data.site.sensors.flatMap(({ name }, number) => {
      const own = glyph.cloneNode(true);
      own.querySelector("rect").setAttribute("stroke-dasharray", dashesOf(number).join(" "));
      if (hollow(number)) own.querySelector("circle").setAttribute("fill", "none");
      own.querySelector("circle").setAttribute("stroke", "var(--detection)");
      return [own, name];
    });
    button.replaceChildren("detections", ...entries);
  }

  buildStages() {
    const { data, state } = this;
    const shown = state.compare ? data.trackers.map((_, i) => i) : [Math.min(state.tracker, data.trackers.length - 1)];
    const stages = this.find(".stages");
    stages.replaceChildren();
    stages.dataset.count = shown.length;
    this.views = shown.map((tracker) => {
      const stage = element("div", "stage");
      const canvas = element("canvas");
      canvas.setAttribute("role", "img");
      const name = data.trackers[tracker]?.name ?? "no tracker";
      canvas.setAttribute("aria-label", `Traffic from above, with the tracks of ${name}`);
      stage.append(canvas);
      const caption = element("div", "caption");
      stage.append(caption);
      stages.append(stage);
      this.point(canvas, tracker);
      return { tracker, canvas, caption, scene: new Scene(canvas, this.camera, data, this.colours) };
    });
  }

  listen() {
    const { root, state } = this;
    root.addEventListener("click", (event) => {
      const button = event.target.closest("button");
      if (!button) return;
      if (button.dataset.do) this.act(button.dataset.do);
      // Pressed by a key: there is no pointer to draw with.
      if (button.dataset.do === "measure" && state.measuring && !event.detail) this.placeRegion();
      if (button.dataset.layer) this.toggleLayer(button.dataset.layer);
      if (button.dataset.tracker) this.choose(button.dataset.tracker);
    });
    this.slider = this.find("input[type=range]");
    this.slider.max = this.data.frames - 1;
    this.slider.addEventListener("input", () => this.seek(Number(this.slider.value)));
    this.find("select").addEventListener("change", (e) => (state.speed = Number(e.target.value)));
    root.addEventListener("keydown", (event) => this.key(event));
    const canvas = this.plots.canvas;
    const scrub = (event) => {
      if (event.type === "pointerdown") canvas.setPointerCapture(event.pointerId);
      if (event.buttons) this.seek(this.plots.frameAt(event.offsetX));
    };
    canvas.addEventListener("pointerdown", scrub);
    canvas.addEventListener("pointermove", scrub);
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const typing = event.target.matches("select, input[type=range]");
    const big = event.shiftKey ? 10 : 1;
    const keys = {
      " ": () => this.act("play"),
      ArrowRight: () => this.step(big),
      ArrowLeft: () => this.step(-big),
      Home: () => this.seek(0),
      End: () => this.seek(this.data.frames - 1),
      "+": () => this.act("in"),
      "=": () => this.act("in"),
      "-": () => this.act("out"),
      0: () => this.home(),
      f: () => this.act("follow"),
      w: () => this.act("worst"),
      e: () => this.act("error"),
      E: () => this.act("error", true),
      s: () => this.act("switch"),
      S: () => this.act("switch", true),
      h: () => this.countByKey(),
      c: () => this.data.trackers.length > 1 && this.choose("compare"),
    };
    if (this.state.measuring) Object.assign(keys, this.countingKeys(event.shiftKey));
    const digit = Number(event.key);
    const act = keys[event.key] ?? (digit >= 1 && digit <= this.data.trackers.length ? () => this.choose(digit - 1) : null);
    if (!act || (typing && event.key.startsWith("Arrow")) || ([" ", "Enter"].includes(event.key) && event.target.matches("button"))) return;
    event.preventDefault();
    act();
  }

  // While hidden objects are counted, the arrows move the region and, with shift, resize it.
  countingKeys(resize) {
    const keys = { Escape: () => this.act("measure"), Enter: () => this.closeRegion() };
    if (!this.state.region || this.state.open) return keys;
    const arrows = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    for (const [key, [dx, dy]] of Object.entries(arrows)) keys[key] = () => this.moveRegion(dx, dy, resize);
    return keys;
  }

  act(what, back = false) {
    const { camera, state } = this;
    const middle = [camera.width / 2, camera.height / 2];
    const acts = {
      play: () => this.play(!state.playing),
      back: () => this.step(-1),
      forward: () => this.step(1),
      in: () => this.zoom(1.3, ...middle),
      out: () => this.zoom(1 / 1.3, ...middle),
      home: () => this.home(),
      follow: () => this.follow(),
      worst: () => this.seek(this.worstFrame()),
      error: () => this.jump(this.errorFrames(), back),
      switch: () => this.jump(this.switchFrames(), back),
      measure: () => this.measure(!state.measuring),
    };
    acts[what]();
    this.refresh();
  }

  // The button goes along with the sensor; a click on an object, with that object.
  follow(whom = this.state.follow === "none" ? "sensor" : "none") {
    this.state.follow = whom;
    this.keepOffset();
  }

  // Where what is followed is now, or null: it is not there in every frame.
  followed() {
    const { state, data } = this;
    if (state.follow === "none") return null;
    if (state.follow === "sensor") return [data.poses.x[state.frame], data.poses.y[state.frame]];
    const { table, object } = state.follow;
    const row = table.at[state.frame].find((r) => table.object[r] === object);
    return row === undefined ? null : [table.x[row], table.y[row]];
  }

  keepOffset() {
    const place = this.followed();
    if (place) this.offset = [this.camera.x - place[0], this.camera.y - place[1]];
  }

  countByKey() {
    if (!this.find("[data-do=measure]")) return;
    this.act("measure");
    if (this.state.measuring) this.placeRegion();
  }

  measure(on) {
    this.state.measuring = on;
    if (!on) [this.state.region, this.state.open] = [null, false];
    this.find("[data-do=measure]").setAttribute("aria-pressed", on);
    this.find(".stages").classList.toggle("measuring", on);
  }

  toggleLayer(layer) {
    const { layers } = this.state;
    if (!layers.delete(layer)) layers.add(layer);
    this.find(`[data-layer=${layer}]`).setAttribute("aria-pressed", layers.has(layer));
    this.refresh();
  }

  choose(which) {
    const { state } = this;
    const wasComparing = state.compare;
    state.compare = which === "compare";
    if (!state.compare) state.tracker = Number(which);
    if (state.compare || wasComparing || this.views[0].tracker !== state.tracker) {
      this.buildStages();
      this.resize();
    }
    for (const button of this.root.querySelectorAll("[data-tracker]")) {
      const on = button.dataset.tracker === (state.compare ? "compare" : String(state.tracker));
      button.setAttribute("aria-pressed", on);
    }
    this.refresh();
  }

  // The frame where the shown tracker's GOSPA is largest, the first second left out: nothing is
  // tracked yet then.
  worstFrame() {
    const { times, trackers } = this.data;
    const { steps = [], series = {} } = trackers[this.state.tracker] ?? {};
    const pairs = steps.map((frame, i) => [frame, series.gospa?.[i] ?? -1]);
    const later = afterStart(times, pairs);
    return later.reduce((best, pair) => (pair[1] > best[1] ? pair : best), later[0] ?? [0, -1])[0];
  }

  // Frames where the shown tracker begins to miss an object or to report a false track.
  errorFrames() {
    const { data, state } = this;
    const tracker = data.trackers[state.tracker];
    if (!tracker) return [];
    const wrong = (frame) =>
      new Set([
        ...tracker.missed.at[frame].map((row) => `missed ${tracker.missed.object[row]}`),
        ...tracker.at[frame].filter((row) => tracker.false[row]).map((row) => `false ${tracker.object[row]}`),
      ]);
    const frames = [];
    let before = new Set();
    for (const frame of tracker.steps) {
      const now = wrong(frame);
      if ([...now].some((error) => !before.has(error))) frames.push(frame);
      before = now;
    }
    return frames;
  }

  switchFrames() {
    return (this.data.trackers[this.state.tracker]?.switches ?? []).map(([frame]) => frame);
  }

  // The next of these frames, or the one before; where there is none, nothing moves.
  jump(frames, back) {
    const { frame } = this.state;
    const found = back ? frames.filter((f) => f < frame).pop() : frames.find((f) => f > frame);
    if (found === undefined) return;
    this.play(false);
    this.seek(found);
  }

  play(on) {
    const { state, data } = this;
    state.playing = on;
    const button = this.find("[data-do=play]");
    button.setAttribute("aria-label", on ? "Pause" : "Play");
    button.classList.toggle("playing", on);
    if (!on) return;
    if (state.frame === data.frames - 1) this.seek(0);
    let clock = data.times[state.frame];
    let last = performance.now();
    const tick = (now) => {
      if (!state.playing) return;
      if (this.jumped) [clock, this.jumped] = [data.times[state.frame], false];
      clock += ((now - last) / 1000) * state.speed;
      last = now;
      let frame = state.frame;
      while (frame < data.frames - 1 && data.times[frame + 1] <= clock) frame++;
      if (frame !== state.frame) this.show(frame);
      if (frame === data.frames - 1) this.play(false);
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  step(by) {
    this.play(false);
    this.seek(this.state.frame + by);
  }

  seek(frame) {
    this.jumped = true;
    this.show(Math.min(this.data.frames - 1, Math.max(0, frame)));
  }

  show(frame) {
    this.state.frame = frame;
    this.state.hover = null;
    this.find(".tip").hidden = true;
    this.refresh();
  }

  zoom(factor, px, py) {
    this.camera.zoom(factor, px, py);
    this.atHome = false;
    this.keepOffset();
    this.refresh();
  }

  // The whole traffic if the sensor stands; its surroundings if it drives.
  home() {
    const { data, state, camera } = this;
    const { truth, poses } = data;
    const moving = this.travels();
    const [dx, dy] = [[], []];
    for (let row = 0; row < truth.rows; row++) {
      const f = truth.frame[row];
      const x = truth.x[row] - (moving ? poses.x[f] : 0);
      const y = truth.y[row] - (moving ? poses.y[f] : 0);
      if (Math.hypot(truth.x[row] - poses.x[f], truth.y[row] - poses.y[f]) <= data.site.range) {
        dx.push(x);
        dy.push(y);
      }
    }
    const here = [moving ? 0 : poses.x[0], moving ? 0 : poses.y[0]];
    const extent = (values, centre) => {
      values.sort((a, b) => a - b);
      const at = (share) => values[Math.round(share * (values.length - 1))] ?? centre;
      return [Math.min(at(0.02), centre), Math.max(at(0.98), centre)];
    };
    const [x0, x1] = extent(dx, here[0]);
    const [y0, y1] = extent(dy, here[1]);
    camera.frame([x0 - 12, y0 - 12, x1 + 12, y1 + 12]);
    this.offset = [camera.x - here[0], camera.y - here[1]];
    state.follow = moving ? "sensor" : "none";
    this.atHome = true;
    this.refresh();
  }

  resize() {
    for (const { canvas } of this.views) fitCanvas(canvas);
    const first = this.views[0].canvas;
    [this.camera.width, this.camera.height] = [first.clientWidth, first.clientHeight];
    this.plots.width = this.plots.canvas.clientWidth;
    this.plots.canvas.style.height = `${this.plots.height}px`;
    fitCanvas(this.plots.canvas);
    if (this.atHome) this.home();
    // At once: a printer waits for no animation frame, and would see canvases that were cleared.
    this.draw();
  }

  refresh() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      this.draw();
    });
  }

  draw() {
    const { data, state, camera } = this;
    const place = this.followed();
    if (place) [camera.x, camera.y] = [place[0] + this.offset[0], place[1] + this.offset[1]];
    for (const { scene, tracker, caption } of this.views) {
      scene.draw(state, tracker);
      caption.textContent = this.caption(tracker);
    }
    this.find(".counted").textContent = this.counted();
    this.plots.draw(state);
    this.slider.value = state.frame;
    const last = data.times[data.frames - 1];
    this.slider.setAttribute("aria-valuetext", `${data.times[state.frame].toFixed(1)} seconds`);
    this.find(".clock").textContent = `${data.times[state.frame].toFixed(1)} / ${last.toFixed(1)} s`;
    this.find(".frame").textContent = `frame ${state.frame}`;
    this.find("[data-do=follow]").setAttribute("aria-pressed", state.follow !== "none");
  }

  caption(index) {
    const { data, state } = this;
    const tracker = data.trackers[index];
    if (!tracker) return "";
    const rows = tracker.at[state.frame];
    const wrong = rows.filter((row) => tracker.false[row]).length;
    const counts = `${rows.length} tracks · ${tracker.missed.at[state.frame].length} missed · ${wrong} false`;
    const switches = tracker.switches.filter(([frame]) => frame <= state.frame).length;
    const words = `${counts} · ${switches} switched so far`;
    return state.compare ? `${tracker.name}: ${words}` : words;
  }

  // Expected and true number of undetected objects in a polygon of points, for the shown tracker.
  hidden(ring) {
    return hiddenIn(this.data, this.data.trackers[this.state.tracker], this.state.frame, ring);
  }

  // What is under way, or found, in words.
  counted() {
    const { region, open, measuring } = this.state;
    if (!measuring) return "";
    if (!region) return "Drag a rectangle, or click the corners of a polygon.";
    if (open) return "Click the first corner again, or press Enter, to close the polygon.";
    const { expected, there, hidden, area } = this.hidden(region);
    const guess = expected === null ? "" : `${expected.toFixed(2)} undetected objects expected, `;
    return `In ${Math.round(area)} m²: ${guess}${there} there; ${hidden} out of sight, found before or not.`;
  }
}

Object.assign(Player.prototype, pointerWork);

function element(tag, className = "", text = "") {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text) made.textContent = text;
  return made;
}

function fitCanvas(canvas) {
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.round(canvas.clientWidth * ratio);
  canvas.height = Math.round(canvas.clientHeight * ratio);
  canvas.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
}
