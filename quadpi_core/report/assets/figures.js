// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Figures of written pages: their panels and scales, their legend, and what answers pointer and keys.

import {DASHES, element, extent, f, filled, ink, LAYERS, mark, node} from "./layers.js";
import {short, ticks} from "./ticks.js";

export const PRINT = {width: 720, tallest: 640};
const NARROW = 420, PANEL_LEAST_PX = 190, SHARED_LEAST_PX = 110;
const ZOOM_LEAST_PX = 6, NEAR_PX = 14;

// Two figures of the same panels on the same axes; the second one is dashed and hatched.
export function overlaid(first, second, names) {
  const dye = first.panels.some((panel) => panel.layers.some((layer) => layer.colour === "model-2")) ? "model-1" : "model-2";
  const marked = (layer, which) => ({...layer, name: layer.name && `${layer.name}, ${names[which]}`,
    ...(which ? {colour: layer.kind === "line" && layer.colour === "measured" ? "model-5" : dye,
      dash: layer.colour === "measured" ? "dotted" : "dashed", pattern: 1} : {})});
  return {...first, panels: first.panels.map((panel) => {
    const other = second.panels.find((one) => one.y.title === panel.y.title);
    const layers = panel.layers.map((layer) => marked(layer, 0)), others = (other?.layers ?? []).map((layer) => marked(layer, 1));
    const own = (which) => (note) => `${names[which]}: ${note}`;
    return {...panel, layers: [...layers, ...others],
      notes: [...(panel.notes ?? []).map(own(0)), ...(other?.notes ?? []).map(own(1))]};
  })};
}

// One figure in its place: draws it, and answers pointer and keys.
export class FigureView {
  constructor(place, onMoment) {
    this.place = place;
    this.onMoment = onMoment;
    this.hidden = new Set();
    this.zoom = null;
    this.figure = null;
    this.cursor = null;
    this.row = 0;
    this.legend = element("div", {class: "legend"});
    this.canvas = element("div", {class: "drawing", tabindex: "0", role: "group"});
    this.readout = element("div", {class: "readout", role: "status", hidden: ""});
    place.append(this.legend, this.canvas, this.readout);
    this.listen();
    let width = 0;
    new ResizeObserver(([{contentRect}]) => {
      if (Math.abs(contentRect.width - width) > 1 && this.figure) { width = contentRect.width; this.draw(); }
    }).observe(place);
  }

  show(figure, flights = []) {
    this.figure = figure;
    this.flights = flights;
    this.zoom = this.cursor = null;
    this.canvas.setAttribute("aria-label", figure.over_time
      ? `${figure.label}. Left and right move through time, up and down choose a row, plus and minus zoom, Enter chooses the moment.` : figure.label);
    this.showLegend();
    this.draw();
  }

  showLegend() {
    const entries = new Map(), {panels} = this.figure;
    // What only one of several panels shows is explained there.
    this.own = new Map();
    for (const panel of panels) {
      const named = panel.layers.filter((layer) => layer.name && !(layer.kind === "boxes" && panel.y.ticks));
      const own = named.filter((layer) => panels.length > 1 && !panels.some((other) => other !== panel && other.layers.some((one) => one.name === layer.name)));
      this.own.set(panel, named.length > 1 ? own : []);
      for (const layer of named) if (!own.includes(layer) && !entries.has(layer.name)) entries.set(layer.name, layer);
    }
    this.legend.replaceChildren(...(entries.size < 2 ? [] : [...entries].map(([name, layer]) => {
      const made = element("button", {type: "button", "aria-pressed": String(!this.hidden.has(name)), title: "Show or hide"}, this.key(layer), name);
      made.addEventListener("click", () => {
        if (!this.hidden.delete(name)) this.hidden.add(name);
        made.setAttribute("aria-pressed", String(!this.hidden.has(name)));
        this.draw();
      });
      return made;
    })));
  }

  key(layer) {
    const drawn = node("svg", {width: 30, height: 14, "aria-hidden": "true"}), colour = ink(layer.colour);
    const line = (dash, width) => node("path", {d: "M1 7H29", style: `stroke: ${colour}`, "stroke-width": width, "stroke-dasharray": DASHES[dash], fill: "none"});
    if (layer.kind === "points") {
      if (layer.joined) drawn.append(line(layer.dash ?? "", 1));
      drawn.append(mark(layer, 15, 7));
    } else if (["line", "limit"].includes(layer.kind) || (layer.kind === "shapes" && !layer.closed)) drawn.append(line(layer.dash ?? "", layer.width ?? 1.5));
    else drawn.append(...filled("M1 1H29V13H1Z", layer));
    return drawn;
  }

  visible(panel) { return panel.layers.filter((layer) => !this.hidden.has(layer.name)); }

  // On paper, with its rows low enough for one sheet.
  draw({width, tallest} = {width: this.place.clientWidth, tallest: Infinity}) {
    const {figure} = this, columns = Math.max(...figure.panels.map((panel) => (panel.column ?? 0) + 1));
    if (!width) return;
    // Panels of a narrow page are below each other; those of one row stay together.
    const two = width >= NARROW && columns % 2 === 0 ? 2 : 1, noted = figure.panels.some((panel) => panel.notes?.length);
    const across = width / columns < (figure.shared && !noted ? SHARED_LEAST_PX : PANEL_LEAST_PX) ? Math.min(two, columns) : columns;
    const order = [...figure.panels].sort((one, other) => (one.row ?? 0) - (other.row ?? 0) || (one.column ?? 0) - (other.column ?? 0));
    const rewrapped = across !== columns;
    this.panels = order.map((panel, k) => ({panel, layers: this.visible(panel),
      row: rewrapped ? Math.floor(k / across) : panel.row ?? 0, column: rewrapped ? k % across : panel.column ?? 0,
      height: figure.heights[panel.row ?? 0]}));
    let bottom = this.arrange(width, across);
    if (bottom > tallest) {
      const rows = Math.max(...this.panels.map((one) => one.row)) + 1;
      const given = Array.from({length: rows}, (_, row) => Math.max(...this.panels.filter((one) => one.row === row).map((one) => one.height)));
      const fixed = bottom - given.reduce((sum, one) => sum + one, 0), share = Math.max(0.3, (tallest - fixed) / (bottom - fixed));
      for (const one of this.panels) one.height *= share;
      bottom = this.arrange(width, across);
    }
    this.svg = node("svg", {viewBox: `0 0 ${width} ${f(bottom)}`, width, height: f(bottom), "aria-hidden": "true"});
    this.panels.forEach((one, k) => this.svg.append(this.panel(one, k)));
    this.over = node("g");
    this.svg.append(this.over);
    this.canvas.replaceChildren(this.svg);
    this.point(this.cursor && {...this.cursor, x: this.panels[this.cursor.place].atX(this.cursor.value)});
  }

  // Places and scales of the panels; gives the height of them all.
  arrange(width, across) {
    const {figure} = this, gap = 14;
    const shared = figure.over_time && (this.zoom ?? extent(this.panels.flatMap((one) => one.layers), 0));
    for (const one of this.panels) {
      const {x, y} = one.panel;
      const wide = shared || extent(one.layers, 0) || [0, 1];
      one.x = this.zoom && !figure.over_time ? wide : [x.low ?? wide[0], x.high ?? wide[1]];
      if (!(one.x[1] > one.x[0])) one.x = [one.x[0] - 0.5, one.x[1] + 0.5];
      one.tall = extent(one.layers, 1, one.x, y.logarithmic ? 0 : -Infinity);
    }
    for (const one of this.panels) {
      const {y} = one.panel, row = figure.shared ? this.panels.filter((other) => other.row === one.row) : [one];
      const talls = row.map((other) => other.tall).filter(Boolean);
      let [low, high] = talls.length ? [Math.min(...talls.map(([least]) => least)), Math.max(...talls.map(([, most]) => most))] : [0, 1];
      const margin = y.logarithmic ? 0 : 0.05 * (high - low) || Math.abs(0.1 * high) || 0.5;
      one.y = [y.low ?? low - margin, y.high ?? high + margin];
      one.labelled = !figure.shared || one.column === 0;
    }
    const left = 66, inner = figure.shared ? 12 : left, share = (width - 6 - left - (across - 1) * (inner + gap)) / across;
    const rows = Math.max(...this.panels.map((one) => one.row)) + 1;
    const titled = this.panels.some(({panel}) => panel.title || panel.notes?.length || this.own.get(panel).length) ? 22 : 8;
    let top = 0;
    for (let row = 0; row < rows; row++) {
      const own = this.panels.filter((one) => one.row === row);
      const notes = Math.max(0, ...own.map(({panel}) => (panel.notes ?? []).length - (panel.title ? 0 : 1)));
      const above = titled + 14 * notes;
      for (const one of own) {
        one.left = left + one.column * (share + inner + gap);
        one.right = one.left + share;
        one.top = top + above;
        one.bottom = one.top + one.height;
        // Of panels on one time only the last row has labels.
        one.dated = !figure.over_time || row === rows - 1;
        one.slanted = one.panel.x.ticks?.some(([, label]) => 7 * label.length > share / one.panel.x.ticks.length);
        one.below = (one.dated ? 20 : 6) + (one.slanted ? 44 : 0) + (one.dated && one.panel.x.title ? 20 : 0);
      }
      top = Math.max(...own.map((one) => one.bottom + one.below));
    }
    for (const one of this.panels) {
      const scaled = (scale, range, from, to) => {
        const [low, high] = scale.logarithmic ? range.map(Math.log10) : range;
        return (value) => from + (to - from) * ((scale.logarithmic ? Math.log10(Math.max(value, 1e-300)) : value) - low) / (high - low);
      };
      one.atX = scaled(one.panel.x, one.x, one.left, one.right);
      one.atY = scaled(one.panel.y, one.y, one.bottom, one.top);
      one.fromX = (px) => one.x[0] + (one.x[1] - one.x[0]) * (px - one.left) / (one.right - one.left);
    }
    return top;
  }

  panel(one, k) {
    const {panel} = one, drawn = node("g"), clip = `${this.id ??= `f${FigureView.count = (FigureView.count ?? 0) + 1}`}-${k}`;
    drawn.append(node("clipPath", {id: clip}, node("rect", {x: one.left, y: one.top - 1, width: one.right - one.left, height: one.height + 2})));
    const text = (words, x, y, attributes = {}) => drawn.append(node("text", {x: f(x), y: f(y), ...attributes}, words));
    const inside = node("g", {"clip-path": `url(#${clip})`}), boxes = one.layers.filter((layer) => layer.kind === "boxes" && layer.outlined);
    for (const layer of boxes) inside.append(...LAYERS[layer.kind](one, layer));
    for (const [value, label] of this.marks(panel.y, one.y, Math.max(3, one.height / 20))) {
      const y = one.atY(value);
      drawn.append(node("path", {class: "grid", d: `M${f(one.left)} ${f(y)}H${f(one.right)}`}));
      if (one.labelled) text(label, one.left - 7, y + 4, {"text-anchor": "end"});
    }
    for (const [value, label] of this.marks(panel.x, one.x, (one.right - one.left) / 65)) {
      const x = one.atX(value);
      if (!panel.x.ticks) drawn.append(node("path", {class: "grid", d: `M${f(x)} ${f(one.top)}V${f(one.bottom)}`}));
      if (!one.dated) continue;
      if (one.slanted) text(label, x + 4, one.bottom + 14, {"text-anchor": "end", transform: `rotate(-30 ${f(x + 4)} ${f(one.bottom + 14)})`});
      else text(label, x, one.bottom + 16, {"text-anchor": "middle"});
    }
    for (const layer of one.layers) if (!boxes.includes(layer)) inside.append(...LAYERS[layer.kind](one, layer));
    drawn.append(inside);
    if (one.dated && panel.x.title) text(panel.x.title, (one.left + one.right) / 2, one.bottom + one.below - 4, {"text-anchor": "middle", class: "title"});
    if (one.labelled && panel.y.title) {
      const middle = (one.top + one.bottom) / 2;
      text(panel.y.title, 14 + one.left - 66, middle, {"text-anchor": "middle", class: "title", transform: `rotate(-90 ${f(14 + one.left - 66)} ${f(middle)})`});
    }
    if (panel.title) text(panel.title, (one.left + one.right) / 2, one.top - 6 - 14 * (panel.notes ?? []).length, {"text-anchor": "middle", class: "heading"});
    this.own.get(panel).reduce((x, layer) => {
      const key = this.key(layer);
      key.setAttribute("x", x);
      key.setAttribute("y", one.top - 18);
      drawn.append(key);
      text(layer.name, x + 35, one.top - 7);
      return x + 55 + 7 * layer.name.length;
    }, one.left);
    (panel.notes ?? []).forEach((note, line, all) => text(note, one.right, one.top - 5 - 14 * (all.length - 1 - line), {"text-anchor": "end", class: "note"}));
    return drawn;
  }

  marks(scale, [low, high], count) {
    if (scale.ticks) return scale.ticks.filter(([value]) => value >= low && value <= high);
    if (!scale.logarithmic) return ticks(low, high, Math.max(2, count)).map((value) => [value, short(value)]);
    const found = [];
    for (let power = Math.ceil(Math.log10(low) - 1e-9); power <= Math.log10(high) + 1e-9; power++) found.push([10 ** power, short(10 ** power)]);
    return found;
  }

  // --- pointer and keys ---

  listen() {
    let from = null, drawn = null;
    const at = (event) => {
      const box = this.canvas.getBoundingClientRect(), x = event.clientX - box.left, y = event.clientY - box.top;
      const place = this.panels?.findIndex((one) => x >= one.left - 3 && x <= one.right + 3 && y >= one.top - 10 && y <= one.bottom + 10) ?? -1;
      return place < 0 ? null : {x: Math.min(Math.max(x, this.panels[place].left), this.panels[place].right), y, place};
    };
    this.canvas.addEventListener("pointerdown", (event) => { from = event.button === 0 ? at(event) : null; });
    this.canvas.addEventListener("pointermove", (event) => {
      const here = at(event);
      if (from && here && here.place === from.place && this.figure.over_time && Math.abs(here.x - from.x) > ZOOM_LEAST_PX) {
        if (!drawn) this.canvas.setPointerCapture(event.pointerId);
        drawn = [from.x, here.x].sort((one, other) => one - other);
      }
      this.point(here && {...here, value: this.panels[here.place].fromX(here.x)}, drawn);
    });
    this.canvas.addEventListener("pointerup", () => {
      const one = from && this.panels[from.place];
      if (drawn) { this.zoom = drawn.map(one.fromX); this.draw(); } else if (one) this.choose(one.fromX(from.x));
      from = drawn = null;
    });
    this.canvas.addEventListener("pointercancel", () => { from = drawn = null; });
    this.canvas.addEventListener("pointerleave", () => { if (!from) this.point(null); });
    this.canvas.addEventListener("dblclick", () => this.magnify(null));
    this.canvas.addEventListener("blur", () => this.point(null));
    this.canvas.addEventListener("keydown", (event) => {
      if (!this.figure?.over_time || event.ctrlKey || event.metaKey || event.altKey) return;
      const [low, high] = this.panels[0].x, step = (high - low) / (event.shiftKey ? 10 : 100), now = this.cursor?.value ?? (low + high) / 2;
      const keys = {
        ArrowLeft: () => this.move(now - step), ArrowRight: () => this.move(now + step),
        ArrowUp: () => this.move(now, -1), ArrowDown: () => this.move(now, 1), Enter: () => this.choose(now),
        "+": () => this.magnify(0.5, now), "=": () => this.magnify(0.5, now), "-": () => this.magnify(2, now), Escape: () => this.magnify(null),
      };
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
  }

  choose(value) {
    if (this.figure.over_time && this.flights.length) this.onMoment(this.flights, value - (this.figure.begins_s ?? 0));
  }

  move(value, rows = 0) {
    const place = Math.min(this.panels.length - 1, Math.max(0, (this.cursor?.place ?? 0) + rows)), one = this.panels[place];
    const kept = Math.min(Math.max(value, one.x[0]), one.x[1]);
    this.point({value: kept, x: one.atX(kept), y: one.top + 20, place});
  }

  magnify(factor, about) {
    if (!this.figure.over_time) return;
    const [low, high] = this.panels[0].x;
    this.zoom = factor === null ? null : [about - factor * (about - low), about + factor * (high - about)];
    this.draw();
  }

  // A line through the moment, what is there, and the range that is dragged over.
  point(cursor, range = null) {
    this.cursor = cursor;
    this.over.replaceChildren();
    const one = cursor && this.panels[cursor.place];
    const said = one ? this.words(one, cursor) : [];
    this.readout.hidden = !said.length;
    if (!one) return;
    const linked = this.figure.over_time ? this.panels : [one];
    if (this.figure.over_time) for (const other of linked) {
      const x = other.atX(cursor.value);
      if (range) {
        const [from, to] = range.map((px) => other.atX(one.fromX(px)));
        this.over.append(node("rect", {x: f(from), y: f(other.top), width: f(to - from), height: f(other.height), class: "range"}));
      }
      this.over.append(node("path", {class: "cursor", d: `M${f(x)} ${f(other.top)}V${f(other.bottom)}`}));
    }
    if (!said.length) return;
    this.readout.replaceChildren(...said.map((words) => element("div", {}, words)));
    const left = this.canvas.offsetLeft + cursor.x, wide = this.readout.offsetWidth;
    this.readout.style.left = `${Math.max(0, left + 14 + wide > this.place.clientWidth ? left - 14 - wide : left + 14)}px`;
    this.readout.style.top = `${this.canvas.offsetTop + one.top + 4}px`;
  }

  words(one, {value, x, y}) {
    const found = [];
    for (const layer of one.layers) {
      if (layer.kind === "points") {
        const near = Array.from(layer.x, (_, k) => [Math.hypot(one.atX(layer.x[k]) - x, one.atY(layer.y[k]) - y), k]).sort((a, b) => a[0] - b[0])[0];
        if (near && near[0] < NEAR_PX) found.push(layer.texts?.[near[1]] ?? `${layer.name} ${short(layer.y[near[1]])}`);
      } else if (layer.kind === "cells") {
        const column = layer.x.findLastIndex((edge) => one.atX(edge) <= x), row = layer.y.findLastIndex((edge) => one.atY(edge) >= y);
        const held = layer.values[row * (layer.x.length - 1) + column];
        if (held !== undefined && !Number.isNaN(held)) found.push(short(held));
      } else if (layer.kind === "boxes" && layer.name && !layer.outlined) {
        for (let k = 0; k < layer.left.length; k++) {
          if (value >= layer.left[k] && value <= layer.right[k] && y <= one.atY(layer.bottom[k]) && y >= one.atY(layer.top[k])) found.push(`${layer.name}${this.figure.over_time ? ` ${short(layer.left[k])} to ${short(layer.right[k])} s` : ` ${short(layer.top[k])}`}`);
        }
      } else if (layer.name && (layer.kind === "line" || layer.kind === "band") && layer.x.length) {
        const k = nearest(layer.x, value, layer.stepped), low = layer.kind === "band" ? layer.low[k] : layer.y[k], high = layer.high?.[k] ?? low;
        if (!Number.isNaN(low)) found.push(`${layer.name} ${short(low) === short(high) ? short(low) : `${short(low)} to ${short(high)}`}`);
      }
    }
    const unit = one.panel.y.title ?? one.panel.title ?? "";
    return found.length && this.figure.over_time ? [`${value.toFixed(2)} s${unit ? `, ${unit}` : ""}`, ...found] : found;
  }
}

// Place of the nearest value, or of the last one before.
function nearest(values, wanted, before = false) {
  let low = 0, high = values.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] > wanted) high = middle; else low = middle;
  }
  if (before) return values[high] <= wanted ? high : low;
  return wanted - values[low] < values[high] - wanted ? low : high;
}
