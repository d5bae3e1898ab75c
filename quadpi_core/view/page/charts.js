// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Figures drawn on canvas: quantities over time, the envelope, the flight, the timeline.

import {short, ticks} from "./ticks.js";

export const WINDOW_S = 30;
const STATE_LINES = ["--trusted-line", "--warning-line", "--alarm-line", "--none-line", "--none-line"];
let colours = {};

// Colours of the theme, read once after it changes.
export function readTheme() {
  const style = getComputedStyle(document.documentElement);
  colours = new Proxy({}, {get: (kept, name) => kept[name] ??= style.getPropertyValue(name).trim()});
}

export const stateColour = (state) => colours[STATE_LINES[state] ?? "--none-line"];
export const colour = (name) => colours[name];

// A canvas cleared at the resolution of the screen: [context, width, height].
export function cleared(canvas) {
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "12px system-ui, sans-serif";
  return [context, width, height];
}

// Quantities over the last 30 s. A series: {low, high} columns, drawn as a line through the middle of its extremes;
// a band is filled between its columns.
export class TimeChart {
  constructor(canvas) {
    this.canvas = canvas;
    this.range = null;
    this.last = 0;
  }

  draw(store, cursor, series, {band = null, outlines = [], misses = null, least = 0} = {}) {
    const [context, width, height] = cleared(this.canvas);
    const left = 46, top = 7, bottom = height - 16, span = width - left;
    const last = Math.floor(cursor / store.blockS), first = Math.max(0, last - Math.round(WINDOW_S / store.blockS));
    const x = (block) => left + span * (1 - (cursor - block * store.blockS) / WINDOW_S);
    const [low, high] = this.fit(store, first, last, [...series, ...(band ? [band] : [])], least), y = (value) => bottom - (bottom - top) * (value - low) / (high - low);
    context.strokeStyle = colours["--rule"];
    context.fillStyle = colours["--soft"];
    context.lineWidth = 1;
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const value of ticks(low, high, 5)) {
      context.beginPath(); context.moveTo(left, y(value)); context.lineTo(width, y(value)); context.stroke();
      context.fillText(short(value), left - 5, y(value));
    }
    context.textAlign = "center";
    for (const value of ticks(cursor - WINDOW_S, cursor, 6)) {
      if (value >= 0) context.fillText(`${short(value)} s`, Math.min(width - 16, x(value / store.blockS)), height - 6);
    }
    context.save();
    context.beginPath(); context.rect(left, 0, span, bottom + 2); context.clip();
    if (band) this.band(context, store, first, last, band, x, y, span);
    for (const one of outlines) this.edges(context, store, first, last, one, x, y, span);
    for (const one of series) {
      if (one.low === one.high) this.edges(context, store, first, last, {edges: [one.low], colour: one.colour, width: 1.75}, x, y, span);
      else this.line(context, store, first, last, one, x, y, span);
    }
    // Above what was measured: noise would hide them.
    if (band) this.edges(context, store, first, last, {edges: [band.low, band.high], colour: band.colour}, x, y, span);
    if (misses) this.mark(context, store, first, last, misses, x, y);
    context.restore();
  }

  fit(store, first, last, series, least) {
    let low = Infinity, high = -Infinity;
    for (let block = first; block <= last; block++) {
      const place = store.at(block);
      if (!place) continue;
      for (const one of series) {
        const bottom = place[0][place[1] + one.low], top = place[0][place[1] + one.high];
        if (bottom < low && bottom > -1e9) low = bottom;
        if (top > high && top < 1e9) high = top;
      }
    }
    if (!(high >= low)) { this.range = null; return [0, 1]; }
    if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
    const margin = 0.06 * (high - low) || 0.5;
    low -= margin; high += margin;
    // Grows at once, shrinks slowly: a scale that jumps cannot be read. Another moment has a scale of its own.
    if (this.range && Math.abs(last - this.last) * store.blockS < 2) {
      low = Math.min(low, this.range[0] + 0.04 * (low - this.range[0]));
      high = Math.max(high, this.range[1] + 0.04 * (high - this.range[1]));
    }
    this.range = [low, high];
    this.last = last;
    return this.range;
  }

  // Runs without a gap of [x, low, high], at most one per pixel: extremes of the blocks that share it.
  runs(store, first, last, one, x, span) {
    const step = Math.max(1, Math.ceil(WINDOW_S / store.blockS / span)), runs = [];
    let run = null, group = NaN;
    for (let block = first; block <= last; block++) {
      const place = store.at(block);
      const low = place ? place[0][place[1] + one.low] : NaN, high = place ? place[0][place[1] + one.high] : NaN;
      if (!(Number.isFinite(low) && Number.isFinite(high))) { run = null; continue; }
      if (!run) runs.push(run = []);
      const point = run[run.length - 1];
      if (point && Math.floor(block / step) === group) {
        point[1] = Math.min(point[1], low);
        point[2] = Math.max(point[2], high);
      } else {
        group = Math.floor(block / step);
        run.push([x((group + 0.5) * step), low, high]);
      }
    }
    return runs;
  }

  // From low to high and half-way to the neighbours, in columns of whole pixels, at least as thick as a line: without
  // a GPU strokes and outlines of noise take three times as long.
  line(context, store, first, last, one, x, y, span) {
    context.fillStyle = one.colour;
    const fraction = 1 / context.getTransform().a, snapped = (value) => Math.round(value / fraction) * fraction;
    for (const run of this.runs(store, first, last, one, x, span)) {
      for (let k = 0; k < run.length; k++) {
        const [at, low, high] = run[k], before = run[k - 1], after = run[k + 1];
        const least = Math.min(low, before ? (before[2] + low) / 2 : low, after ? (after[2] + low) / 2 : low);
        const most = Math.max(high, before ? (before[1] + high) / 2 : high, after ? (after[1] + high) / 2 : high);
        const left = snapped(before ? (before[0] + at) / 2 : at - 0.5), right = snapped(after ? (at + after[0]) / 2 : at + 1);
        const middle = y((least + most) / 2), tall = Math.max(2, y(least) - y(most));
        context.fillRect(left, middle - tall / 2, Math.max(fraction, right - left), tall);
      }
    }
  }

  // One value per block: strokes, of a pixel unless it says more; those need no outline.
  edges(context, store, first, last, one, x, y, span) {
    context.strokeStyle = one.colour;
    context.lineWidth = one.width ?? 1;
    context.beginPath();
    for (const edge of one.edges) {
      for (const run of this.runs(store, first, last, {low: edge, high: edge}, x, span)) {
        context.moveTo(run[0][0], y(run[0][1]));
        for (const [at, , value] of run) context.lineTo(at, y(value));
      }
    }
    context.stroke();
  }

  band(context, store, first, last, band, x, y, span) {
    context.fillStyle = band.fill;
    context.beginPath();
    for (const run of this.runs(store, first, last, band, x, span)) this.outline(context, run, y, 0);
    context.fill();
  }

  outline(context, run, y, half) {
    context.moveTo(run[0][0] - half, y(run[0][2]) - half);
    for (const [at, , high] of run) context.lineTo(at, y(high) - half);
    context.lineTo(run[run.length - 1][0] + half, y(run[run.length - 1][2]) - half);
    context.lineTo(run[run.length - 1][0] + half, y(run[run.length - 1][1]) + half);
    for (let k = run.length - 1; k >= 0; k--) context.lineTo(run[k][0], y(run[k][1]) + half);
    context.lineTo(run[0][0] - half, y(run[0][1]) + half);
    context.closePath();
  }

  mark(context, store, first, last, misses, x, y) {
    context.fillStyle = colours["--miss"];
    context.beginPath();
    for (let block = first; block <= last; block++) {
      const place = store.at(block);
      if (!place || !(place[0][place[1] + misses.count] > 0)) continue;
      const above = place[0][place[1] + misses.high] > place[0][place[1] + misses.upper];
      const at = x(block + 0.5), tip = y(place[0][place[1] + (above ? misses.high : misses.low)]), side = above ? -1 : 1;
      context.moveTo(at, tip + side);
      context.lineTo(at - 4, tip + side * 8);
      context.lineTo(at + 4, tip + side * 8);
    }
    context.fill();
  }
}

// How far an input lies in its training range: 0 at the lower end, 1 at the upper end.
const placed = (value, input) => (value - input.lower) / ((input.upper - input.lower) || 1);

export function drawEnvelope(canvas, store, cursor) {
  const [context, width, height] = cleared(canvas), inputs = store.vehicle?.inputs ?? [];
  context.textBaseline = "middle";
  if (!inputs.length || inputs[0].lower === null) {
    context.fillStyle = colours["--soft"];
    context.fillText("Training ranges are not known here: add --model MODEL to quadpi view", 8, 20);
    return null;
  }
  const last = Math.floor(cursor / store.blockS), first = Math.max(0, last - Math.round(WINDOW_S / store.blockS));
  const rows = inputs.map((input, k) => {
    let low = Infinity, high = -Infinity;
    for (let block = first; block <= last; block++) {
      const bottom = store.value(block, "inputs_min", k), top = store.value(block, "inputs_max", k);
      if (bottom < low) low = bottom;
      if (top > high) high = top;
    }
    const bottom = placed(store.recent(last, "inputs_min", k, 0.5), input), top = placed(store.recent(last, "inputs_max", k, 0.5), input);
    const now = top - 1 > -bottom ? top : bottom;
    return {input, low: placed(low, input), high: placed(high, input), bottom, top, now, out: Math.max(-bottom, top - 1)};
  });
  const known = rows.filter((row) => Number.isFinite(row.out));
  const farthest = known.reduce((best, row) => !best || row.out > best.out ? row : best, null);
  const labels = Math.min(210, 0.44 * width), left = labels + 10, span = width - left - 8, step = height / rows.length;
  // The training range is the middle half; what is a range away from it is at the edge.
  const x = (place) => left + span * Math.min(1, Math.max(0, 0.25 + 0.5 * place));
  rows.forEach((row, k) => {
    const y = step * (k + 0.5), outside = row.out > 0;
    context.fillStyle = colours["--training"];
    context.fillRect(x(0), y - 6, x(1) - x(0), 12);
    if (row.high >= row.low) {
      context.fillStyle = colours["--none-line"];
      context.fillRect(x(row.low), y - 1.5, Math.max(1, x(row.high) - x(row.low)), 3);
    }
    context.fillStyle = outside ? colours["--miss"] : colours["--ink"];
    context.textAlign = "right";
    context.font = `${row === farthest ? "bold " : ""}12px system-ui, sans-serif`;
    const angle = row.input.angle ? ` (${row.input.angle})` : "";
    context.fillText(`${row === farthest ? "▶ " : ""}${row.input.words}${angle}`, labels, y, labels - 2);
    if (!Number.isFinite(row.now)) return;
    const at = x(row.now);
    context.beginPath();
    if (outside) {
      context.moveTo(at, y - 8); context.lineTo(at + 8, y); context.lineTo(at, y + 8); context.lineTo(at - 8, y);
    } else context.arc(at, y, 5, 0, 7);
    context.fill();
  });
  return farthest;
}

// The flight seen from a side that can be turned: north, east and up.
export class FlightFigure {
  constructor(canvas, redraw) {
    this.canvas = canvas;
    this.turn = 0.7;
    this.tilt = 0.45;
    this.zoom = 1;
    let from = null;
    canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", () => { from = null; });
    canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.turn += 0.01 * (event.clientX - from[0]);
      this.tilt = Math.min(1.5, Math.max(0.02, this.tilt + 0.01 * (event.clientY - from[1])));
      from = [event.clientX, event.clientY];
      redraw();
    });
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom = Math.min(8, Math.max(0.4, this.zoom * Math.exp(-0.001 * event.deltaY))); redraw(); }, {passive: false});
  }

  draw(store, cursor, track) {
    const [context, width, height] = cleared(this.canvas);
    const last = Math.floor(cursor / store.blockS), first = Math.max(0, last - Math.round(WINDOW_S / store.blockS));
    const recent = [];
    let state = NaN;
    for (let block = first; block <= last; block++) {
      const given = store.value(block, "state");
      if (!Number.isNaN(given)) state = given;
      const point = [0, 1, 2].map((k) => store.value(block, "position", k));
      if (point.every(Number.isFinite)) recent.push([point, state, block]);
    }
    const past = track.map(([, ...point]) => point), points = [...past, ...recent.map(([point]) => point)];
    if (!points.length) return;
    const low = [0, 1, 2].map((k) => points.reduce((least, point) => Math.min(least, point[k]), Infinity));
    const high = [0, 1, 2].map((k) => points.reduce((most, point) => Math.max(most, point[k]), -Infinity));
    const middle = low.map((value, k) => (value + high[k]) / 2);
    const size = Math.max(2, Math.hypot(...low.map((value, k) => high[k] - value)));
    const scale = 0.92 * this.zoom * Math.min(width, 1.6 * height) / size;
    const [sin, cos, down, level] = [Math.sin(this.turn), Math.cos(this.turn), Math.sin(this.tilt), Math.cos(this.tilt)];
    const project = ([north, east, below]) => {
      const n = north - middle[0], e = east - middle[1], d = below - middle[2];
      return [width / 2 + scale * (e * cos - n * sin), height / 2 + scale * (d * level - (n * cos + e * sin) * down)];
    };
    this.ground(context, project, low, high);
    context.strokeStyle = colours["--none-line"];
    context.lineWidth = 1;
    context.beginPath();
    past.forEach((point, k) => { if (k) context.lineTo(...project(point)); else context.moveTo(...project(point)); });
    context.stroke();
    for (let k = 1; k < recent.length; k++) {
      const [point, trust] = recent[k];
      context.strokeStyle = stateColour(trust);
      context.lineWidth = trust === 2 ? 5 : trust === 1 ? 3.5 : 2;
      context.beginPath(); context.moveTo(...project(recent[k - 1][0])); context.lineTo(...project(point)); context.stroke();
    }
    if (recent.length) this.vehicle(context, store, recent[recent.length - 1], project, size);
  }

  ground(context, project, low, high) {
    const step = [0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1e3, 1e4, 1e5].find((one) => (high[0] - low[0] + high[1] - low[1]) / one < 14) ?? 1e6;
    const [north, east] = [0, 1].map((k) => [Math.floor(low[k] / step) * step, Math.ceil(high[k] / step + 1e-9) * step]);
    context.strokeStyle = colours["--rule"];
    context.fillStyle = colours["--soft"];
    context.lineWidth = 1;
    context.beginPath();
    for (let n = north[0]; n <= north[1] + 1e-9; n += step) { context.moveTo(...project([n, east[0], high[2]])); context.lineTo(...project([n, east[1], high[2]])); }
    for (let e = east[0]; e <= east[1] + 1e-9; e += step) { context.moveTo(...project([north[0], e, high[2]])); context.lineTo(...project([north[1], e, high[2]])); }
    context.stroke();
    context.textAlign = "left";
    context.fillText(`grid ${step} m`, 6, 12);
    context.textAlign = "center";
    context.fillText("N", ...project([north[1] + 0.4 * step, (east[0] + east[1]) / 2, high[2]]));
    context.fillText("E", ...project([(north[0] + north[1]) / 2, east[1] + 0.4 * step, high[2]]));
  }

  vehicle(context, store, [position, state, block], project, size) {
    const [w, x, y, z] = [0, 1, 2, 3].map((k) => store.value(block, "attitude", k));
    const arm = 0.06 * size / this.zoom;
    const body = ([a, b, c]) => [
      (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c,
      2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c,
      2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c].map((value, k) => position[k] + arm * value);
    context.strokeStyle = context.fillStyle = colours["--ink"];
    context.lineWidth = 2.5;
    // Arms to as many rotors as there are, two of them in front, and a longer line forward.
    const rotors = store.columns.rotor_min[1], ends = [[1.5, 0, 0]];
    for (let k = 0; k < rotors; k++) ends.push([Math.cos((2 * k + 1) * Math.PI / rotors), Math.sin((2 * k + 1) * Math.PI / rotors), 0]);
    for (const tip of ends) {
      context.beginPath(); context.moveTo(...project(position)); context.lineTo(...project(body(tip))); context.stroke();
    }
    context.fillStyle = stateColour(state);
    context.beginPath(); context.arc(...project(position), 5, 0, 7); context.fill();
  }
}

const HEIGHTS = {0: 0.3, 4: 0.2, 3: 0.15, 1: 0.65, 2: 1};

// The whole session: higher is worse. Marks the window of the charts and the cursor.
export function drawTimeline(canvas, overview, end, cursor) {
  const [context, width, height] = cleared(canvas), floor = height - 14, scale = width / Math.max(1e-9, end);
  context.fillStyle = colours["--training"];
  context.fillRect(Math.max(0, (cursor - WINDOW_S) * scale), 0, Math.min(cursor, WINDOW_S) * scale, floor);
  const bin = overview.bin_s ?? 1;
  const codes = overview.codes ?? "";
  for (let k = 0, next; k < codes.length; k = next) {
    // Bars of one state are one: seams between them would be seen.
    for (next = k + 1; codes[next] === codes[k];) next++;
    if (codes[k] === "-") continue;
    context.fillStyle = stateColour(Number(codes[k]));
    const tall = floor * HEIGHTS[codes[k]];
    context.fillRect(k * bin * scale, floor - tall, Math.max(1, (next - k) * bin * scale + 0.3), tall);
  }
  context.fillStyle = colours["--soft"];
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (const value of ticks(0, end, Math.max(2, Math.min(10, width / 90)))) context.fillText(`${short(value)} s`, Math.min(width - 18, Math.max(14, value * scale)), height - 6);
  context.fillStyle = colours["--ink"];
  context.fillRect(Math.min(width - 2, cursor * scale - 1), 0, 2, floor + 3);
}
