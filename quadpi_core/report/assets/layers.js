// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Layers of the figures of written pages as SVG, from the records of figure.py: colours follow the style sheet, in print
// too. All text from elsewhere is set as textContent, so a name is never markup.

export const DASHES = {"": "", dashed: "6 4", dotted: "1.5 3", dashdot: "8 3 2 3"};
const APART_PX = 3;
let hatches = 0;
export const ink = (name) => name.startsWith("#") ? name : `var(--${name})`;

export function node(name, attributes = {}, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) if (value !== undefined) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

// The figures of one script element, with their arrays in place of their numbers.
export function readFigures(text) {
  const {figures, arrays} = JSON.parse(text), kept = [];
  const array = (place) => kept[place] ??= unpacked(arrays[place]);
  const filled = (value) => Array.isArray(value) ? value.map(filled)
    : value === null || typeof value !== "object" ? value
      : "array" in value ? array(value.array)
        : Object.fromEntries(Object.entries(value).map(([key, part]) => [key, filled(part)]));
  return Object.fromEntries(Object.entries(figures).map(([name, figure]) => [name, filled(figure)]));
}

function unpacked(array) {
  if (Array.isArray(array)) return array.map((value) => value ?? NaN);
  if ("count" in array) return Float64Array.from({length: array.count}, (_, k) => array.from + (array.to - array.from) * k / Math.max(1, array.count - 1));
  const bytes = Uint8Array.from(atob(array.data), (letter) => letter.charCodeAt(0)), codes = new DataView(bytes.buffer);
  return Float64Array.from({length: bytes.length / 2}, (_, k) => {
    const code = codes.getUint16(2 * k, true);
    return code === 65535 ? NaN : array.low + code * array.step;
  });
}

const reach = (layer) => ({
  line: [[layer.x], [layer.y, layer.high ?? layer.y]], band: [[layer.x], [layer.low, layer.high]],
  points: [[layer.x, ...(layer.vertical ? [] : layer.error ?? [])], [layer.y, ...(layer.vertical ? layer.error ?? [] : [])]],
  boxes: [[layer.left, layer.right], [layer.bottom, layer.top]], shapes: [[layer.x], [layer.y]],
  cells: [[layer.x], [layer.y]], limit: layer.vertical ? [[[layer.at]], []] : [[], [[layer.at]]],
})[layer.kind];

// Lowest and highest value of one axis over layers, of samples within a range of the other where one is given.
export function extent(layers, axis, within, least = -Infinity) {
  let low = Infinity, high = -Infinity;
  for (const layer of layers) {
    const sampled = within && ["line", "band", "shapes"].includes(layer.kind);
    for (const values of reach(layer)[axis]) {
      for (let k = 0; k < values.length; k++) {
        const value = values[k];
        if (!(value > least) || (sampled && (layer.x[k] < within[0] || layer.x[k] > within[1]))) continue;
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
  }
  return high >= low ? [low, high] : null;
}

// Runs without a gap of [x, low, high] between two pixels, at most one per pixel.
function runs(layer, from, to, place, low, high) {
  const {x} = layer, found = [];
  let run = null, pixel = NaN;
  const dense = x.length > 3 * (place(to) - place(from));
  for (let k = 0; k < x.length; k++) {
    if ((k + 1 < x.length && x[k + 1] < from) || (k && x[k - 1] > to)) continue;
    if (Number.isNaN(x[k] + low[k] + high[k])) { run = null; continue; }
    if (!run) found.push(run = []);
    const at = place(x[k]), last = run[run.length - 1];
    if (dense && last && Math.floor(at) === pixel) {
      last[1] = Math.min(last[1], low[k]);
      last[2] = Math.max(last[2], high[k]);
    } else {
      pixel = Math.floor(at);
      run.push([at, low[k], high[k]]);
    }
  }
  return found;
}

export const f = (value) => Math.round(10 * value) / 10;
const held = (run, index) => run.flatMap((point, k) => k ? [[point[0], run[k - 1][index]], [point[0], point[index]]] : [[point[0], point[index]]]);
const path = (points, y) => `M${points.map(([x, value]) => `${f(x)},${f(y(value))}`).join("L")}`;

export function stroke(d, layer, width = layer.width ?? 1.5, dash = layer.dash ?? "") {
  return node("path", {d, fill: "none", "stroke-width": width, "stroke-dasharray": DASHES[dash], "stroke-linejoin": "round", style: `stroke: ${ink(layer.colour)}`});
}

// An area in the colour of a layer, even or hatched.
export function filled(d, layer) {
  const style = `fill: ${ink(layer.colour)}`, found = [node("path", {d, style, "fill-opacity": layer.pattern ? 0.10 : layer.opacity ?? 1, stroke: "none"})];
  if (layer.pattern) {
    const id = `h${hatches++}`;
    const hatch = node("pattern", {id, width: 7, height: 7, patternUnits: "userSpaceOnUse", patternTransform: `rotate(${[0, 45, -45, 90][layer.pattern]})`},
      node("path", {d: "M0 0V7", "stroke-width": 2, style: `stroke: ${ink(layer.colour)}`}));
    found.push(node("defs", {}, hatch), node("path", {d, fill: `url(#${id})`, "fill-opacity": 0.8, stroke: "none"}));
  }
  return found;
}

function outline(run, y) {
  const back = [...run].reverse();
  return `${path(run.map(([x, , most]) => [x, most]), y)}L${path(back.map(([x, least]) => [x, least]), y).slice(1)}Z`;
}

export function mark(layer, x, y) {
  const d = [`M${f(x - 4.5)} ${f(y)}a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0`, `M${f(x - 4)} ${f(y - 4)}h8v8h-8Z`,
    `M${f(x)} ${f(y - 6)}l6 6l-6 6l-6 -6Z`, `M${f(x)} ${f(y - 5.5)}l5.5 9.5h-11Z`, `M${f(x - 22)} ${f(y - 1)}h44v2h-44Z`][layer.symbol ?? 0];
  const fill = layer.hollow ? "var(--paper)" : ink(layer.colour);
  return node("path", {d, "stroke-width": 1.5, style: `stroke: ${ink(layer.colour)}; fill: ${fill}`});
}

// How each kind of layer is drawn in a panel with its scales.
export const LAYERS = {
  line(one, layer) {
    const low = layer.y, high = layer.high ?? layer.y, found = [];
    const parts = runs(layer, ...one.x, one.atX, low, high);
    const spread = high !== low || parts.some((run) => run.some(([, least, most]) => most > least));
    if (layer.stepped) return [stroke(parts.map((run) => path(held(run, 1), one.atY)).join(""), layer)];
    if (!spread) return [stroke(parts.map((run) => path(run, one.atY)).join(""), layer)];
    // Extremes in the order that makes the shortest way; what is dashed, or blocks that are apart, has a line through the middle.
    const [first] = parts, apart = first?.length > 1 && (first[first.length - 1][0] - first[0][0]) / first.length > APART_PX;
    if (layer.dash || apart) {
      found.push(...filled(parts.map((run) => outline(run, one.atY)).join(""), {...layer, opacity: 0.3, pattern: 0}));
      return [...found, stroke(parts.map((run) => path(run.map(([x, least, most]) => [x, (least + most) / 2]), one.atY)).join(""), layer)];
    }
    const points = (run) => {
      let last = NaN;
      return run.flatMap(([x, least, most]) => {
        if (least === most) { last = least; return [[x, least]]; }
        const [first, second] = Math.abs(last - most) < Math.abs(last - least) ? [most, least] : [least, most];
        last = second;
        return [[x, first], [x, second]];
      });
    };
    return [stroke(parts.map((run) => path(points(run), one.atY)).join(""), layer)];
  },

  band(one, layer) {
    const parts = runs(layer, ...one.x, one.atX, layer.low, layer.high);
    const stepped = (run) => held(run, 1).map(([x, least], k) => [x, least, held(run, 2)[k][1]]);
    const shapes = layer.stepped ? parts.map(stepped) : parts;
    const found = filled(shapes.map((run) => outline(run, one.atY)).join(""), layer);
    for (const index of [1, 2]) found.push(stroke(shapes.map((run) => path(run.map((point) => [point[0], point[index]]), one.atY)).join(""), layer, 1));
    return found;
  },

  points(one, layer) {
    const found = [], marks = Array.from(layer.x, (x, k) => [one.atX(x), one.atY(layer.y[k])]);
    if (layer.joined) found.push(stroke(path(marks, (y) => y), layer, 1));
    if (layer.error) {
      const bars = marks.map(([x, y], k) => {
        const [from, to] = layer.error.map((end) => layer.vertical ? one.atY(end[k]) : one.atX(end[k]));
        return layer.vertical ? `M${f(x)} ${f(from)}V${f(to)}` : `M${f(from)} ${f(y)}H${f(to)}`;
      });
      found.push(stroke(bars.join(""), layer, 2, ""));
    }
    return [...found, ...marks.map(([x, y]) => mark(layer, x, y))];
  },

  boxes(one, layer) {
    const side = (value, at, edge) => Number.isNaN(value) ? edge : at(value), found = [];
    let d = "", edges = "";
    for (let k = 0; k < layer.left.length; k++) {
      const left = side(layer.left[k], one.atX, one.left), right = side(layer.right[k], one.atX, one.right);
      const bottom = side(layer.bottom[k], one.atY, one.bottom), top = side(layer.top[k], one.atY, one.top);
      d += `M${f(left)} ${f(bottom)}V${f(top)}H${f(Math.max(right, left + 1))}V${f(bottom)}Z`;
      edges += `M${f(left)} ${f(bottom)}V${f(top)}M${f(right)} ${f(bottom)}V${f(top)}`;
    }
    found.push(...filled(d, layer));
    if (layer.outlined) found.push(stroke(edges, {colour: "soft"}, 1, "dotted"));
    return found;
  },

  shapes(one, layer) {
    const places = {x: Float64Array.from(layer.x, (_, k) => k)};
    const parts = runs(places, 0, layer.x.length, (k) => k, layer.x, layer.y).map((run) => path(run.map(([, x, y]) => [one.atX(x), y]), one.atY));
    return layer.closed ? filled(parts.map((d) => `${d}Z`).join(""), layer) : [stroke(parts.join(""), layer)];
  },

  cells(one, layer) {
    const found = [], across = layer.x.length - 1;
    layer.values.forEach((value, k) => {
      if (Number.isNaN(value)) return;
      const [left, right] = [0, 1].map((side) => one.atX(layer.x[k % across + side]));
      const [bottom, top] = [0, 1].map((side) => one.atY(layer.y[Math.floor(k / across) + side]));
      const share = Math.min(1, Math.abs(value) / layer.largest), dye = value > 0 ? "--miss" : "--band";
      found.push(node("rect", {x: f(left), y: f(top), width: f(right - left), height: f(bottom - top),
        style: `fill: color-mix(in srgb, var(${dye}) ${Math.round(90 * share)}%, var(--paper))`}));
      if (share > 0.2 && right - left > 9) found.push(node("text", {x: f((left + right) / 2), y: f((top + bottom) / 2 + 4), "text-anchor": "middle", class: share > 0.55 ? "sign on" : "sign"}, value > 0 ? "+" : "−"));
    });
    return found;
  },

  limit(one, layer) {
    const at = layer.vertical ? one.atX(layer.at) : one.atY(layer.at);
    const found = [stroke(layer.vertical ? `M${f(at)} ${f(one.top)}V${f(one.bottom)}` : `M${f(one.left)} ${f(at)}H${f(one.right)}`, layer, 1, layer.dash ?? "")];
    if (layer.label) found.push(node("text", layer.vertical ? {x: f(at - 4), y: f(one.top + 11), "text-anchor": "end"} : {x: f(one.right - 4), y: f(at - 4), "text-anchor": "end"}, layer.label));
    return found;
  }
};
