// The intensity of undetected objects: a window of cells a step, one byte each, by the logarithm.

class HiddenGrid {
  constructor(bytes, description, frames) {
    const steps = readTable(bytes, description, frames);
    Object.assign(this, { cell: description.cell, side: description.side, steps });
    const size = this.side ** 2;
    // Written as changes from step to step, modulo 256.
    this.codes = bytes.slice(description.codes, description.codes + steps.rows * size);
    for (let k = size; k < this.codes.length; k++) this.codes[k] += this.codes[k - size];
    this.intensity = Float64Array.from({ length: 256 }, (_, code) =>
      code ? description.lowest * 10 ** (description.decades * (code - 1)) : 0,
    );
  }

  // The step that tells of a frame, or undefined.
  step(frame) {
    return this.steps.at[frame][0];
  }

  // Lower left corner of a step's window, m.
  corner(step) {
    return [this.steps.i[step] * this.cell, this.steps.j[step] * this.cell];
  }

  // Objects expected within a simple polygon: each cell by the share of it that lies inside.
  expected(frame, ring) {
    const step = this.step(frame);
    if (step === undefined) return null;
    const { cell, side, codes, intensity } = this;
    const [left, low] = this.corner(step);
    const [x0, y0, x1, y1] = bounds(ring);
    const index = (value) => Math.min(side - 1, Math.max(0, Math.floor(value / cell)));
    let total = 0;
    for (let j = index(y0 - low); j <= index(y1 - low); j++) {
      const bottom = low + j * cell;
      const strip = clipped(clipped(ring, 1, bottom, 1), 1, bottom + cell, -1);
      if (strip.length < 3) continue;
      for (let i = index(x0 - left); i <= index(x1 - left); i++) {
        const code = codes[(step * side + j) * side + i];
        if (!code) continue;
        const edge = left + i * cell;
        total += intensity[code] * areaOf(clipped(clipped(strip, 0, edge, 1), 0, edge + cell, -1));
      }
    }
    return total;
  }

  // The window as a picture, one pixel a cell, the top row first.
  paint(canvas, step, [red, green, blue]) {
    const { side, codes, intensity } = this;
    [canvas.width, canvas.height] = [side, side];
    const context = canvas.getContext("2d");
    const image = context.createImageData(side, side);
    const opacity = Array.from(intensity, (density) => 255 * heatOpacity(density));
    for (let j = 0; j < side; j++) {
      for (let i = 0; i < side; i++) {
        const at = 4 * ((side - 1 - j) * side + i);
        image.data.set([red, green, blue, opacity[codes[(step * side + j) * side + i]]], at);
      }
    }
    context.putImageData(image, 0, 0);
  }
}

// From a thousandth of an object per 100 m2 (clear) to one (0.85), by decades.
function heatOpacity(density) {
  if (density <= 0) return 0;
  return 0.85 * Math.min(1, Math.max(0, (Math.log10(density * 100) + 3) / 3));
}

// What the tracker expects in a polygon, how many never detected objects are there, and how many
// that cannot be seen now.
function hiddenIn(data, tracker, frame, ring) {
  const { truth } = data;
  const rows = truth.at[frame].filter((row) => insideRing(ring, truth.x[row], truth.y[row]));
  return {
    expected: tracker?.undetected?.expected(frame, ring) ?? null,
    there: rows.filter((row) => !(truth.flags[row] & 4)).length,
    hidden: rows.filter((row) => !(truth.flags[row] & 1)).length,
    area: areaOf(ring),
  };
}
