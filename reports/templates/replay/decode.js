// Reads what reports/encode.py wrote: columns of zigzag-coded differences in byte planes, deflated.

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function readColumn(bytes, offset, rows, resolution) {
  const values = new Float32Array(rows);
  let sum = 0;
  for (let i = 0; i < rows; i++) {
    const at = offset + i;
    const code =
      (bytes[at] | (bytes[at + rows] << 8) | (bytes[at + 2 * rows] << 16) |
        (bytes[at + 3 * rows] << 24)) >>> 0;
    sum += (code >>> 1) ^ -(code & 1);
    values[i] = sum * resolution;
  }
  return values;
}

// A table has one typed array per column, and `at[f]` lists the rows of frame f.
function readTable(bytes, description, frames) {
  const table = { ...description };
  for (const [name, [offset, resolution]] of Object.entries(description.columns)) {
    table[name] = readColumn(bytes, offset, description.rows, resolution);
  }
  if (table.frame) {
    table.at = Array.from({ length: frames }, () => []);
    for (let row = 0; row < table.rows; row++) table.at[table.frame[row]].push(row);
  }
  return table;
}

async function decode(data) {
  const bytes = await inflate(data.blob);
  const frames = data.times.length;
  const read = (description) => description && readTable(bytes, description, frames);
  const site = { ...data.site };
  const pairs = (ring) => ring.reduce((p, v, i) => (i % 2 ? p[p.length - 1].push(v) : p.push([v]), p), []);
  site.occluders = site.occluders.map(pairs);
  site.drivable = site.drivable && site.drivable.map(pairs);
  return {
    ...data,
    blob: null,
    frames,
    site,
    poses: read(data.poses),
    truth: read(data.truth),
    detections: read(data.detections),
    trackers: data.trackers.map((tracker) => ({
      ...read(tracker),
      missed: read(tracker.missed),
      undetected: tracker.undetected && new HiddenGrid(bytes, tracker.undetected, frames),
    })),
  };
}
