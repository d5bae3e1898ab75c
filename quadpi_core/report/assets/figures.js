// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Figures of written pages: rows and columns of uPlot charts from the records of page.py, with one legend, one cursor and
// one zoom. Lines and bands are series of uPlot; other layers are painted on its scales.

import {axis, DASHES, element, faded, ink, node, short} from "./drawing.js";
/* global uPlot */

// Width and height of a sheet, and pixels of a canvas on each of its own.
export const PRINT = {width: 720, tallest: 640, ratio: 2};
const NARROW = 420, PANEL_LEAST_PX = 190, SHARED_LEAST_PX = 110, LABELS_PX = 68, GAP_PX = 14, SLANTED_PX = 44, TITLE_PX = 20;
const ZOOM_LEAST_PX = 6, NEAR_PX = 14;
const SYMBOLS = ["M-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0 -9 0", "M-4 -4h8v8h-8Z", "M0 -6l6 6l-6 6l-6 -6Z", "M0 -5.5l5.5 9.5h-11Z", "M-22 -1h44v2h-44Z"];
let drawnFigures = 0;

// Two figures of the same panels on the same axes; the second one is dashed and hatched.
export function overlaid(first, second, names) {
  const dye = first.panels.some((panel) => panel.layers.some((layer) => layer.colour === "model-2")) ? "model-1" : "model-2";
  const marked = (layer, which) => ({...layer, name: layer.name && `${layer.name}, ${names[which]}`,
    ...(which ? {colour: layer.kind === "line" && layer.colour === "measured" ? "model-5" : dye,
      dash: layer.colour === "measured" ? "dotted" : "dashed", pattern: 1} : {})});
  return {...first, panels: first.panels.map((panel) => {
    const other = second.panels.find((one) => one.y.title === panel.y.title);
    const own = (which) => (note) => `${names[which]}: ${note}`;
    return {...panel, layers: [...panel.layers.map((layer) => marked(layer, 0)), ...(other?.layers ?? []).map((layer) => marked(layer, 1))],
      notes: [...(panel.notes ?? []).map(own(0)), ...(other?.notes ?? []).map(own(1))]};
  })};
}

// Values of a layer along x and along y.
const reach = (layer) => ({
  line: [[layer.x], [layer.y, layer.high ?? []]], band: [[layer.x], [layer.low, layer.high]], cells: [[layer.x], [layer.y]],
  points: [[layer.x, ...(layer.vertical ? [] : layer.error ?? [])], [layer.y, ...(layer.vertical ? layer.error ?? [] : [])]],
  boxes: [[layer.left, layer.right], [layer.bottom, layer.top]], limit: layer.vertical ? [[[layer.at]], []] : [[], [[layer.at]]],
})[layer.kind];

// Lowest and highest value of layers along x (0) or y (1), there of the samples in a range of x.
function extent(layers, along, within) {
  let low = Infinity, high = -Infinity;
  for (const layer of layers) {
    const sampled = within && ["line", "band"].includes(layer.kind);
    for (const values of reach(layer)[along]) for (let k = 0; k < values.length; k++) {
      const value = values[k];
      if (value === null || (sampled && (layer.x[k] < within[0] || layer.x[k] > within[1]))) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  return high >= low ? [low, high] : null;
}

// Blocks of samples as two points each: low and high in turn, so that lines from block to block are short.
const apart = (x) => x.flatMap((at) => [at - (x[1] - x[0]) / 4, at + (x[1] - x[0]) / 4]);
const ends = (low, high) => low.flatMap((value, k) => k % 2 ? [high[k], value] : [value, high[k]]);

function hatch(colour, pattern, ratio) {
  const size = 7 * ratio, tile = element("canvas", {width: size, height: size}), context = tile.getContext("2d");
  context.fillStyle = faded(colour, 0.1);
  context.fillRect(0, 0, size, size);
  context.strokeStyle = faded(colour, 0.6);
  context.lineWidth = 1.5 * ratio;
  const ends = {1: [[-1, 1, 1, -1], [0, 7, 7, 0], [6, 8, 8, 6]], 2: [[-1, 6, 1, 8], [0, 0, 7, 7], [6, -1, 8, 1]], 3: [[0, 3.5, 7, 3.5]]}[pattern];
  for (const [left, top, right, bottom] of ends) context.stroke(new Path2D(`M${left * ratio} ${top * ratio}L${right * ratio} ${bottom * ratio}`));
  return context.createPattern(tile, "repeat");
}

// How layers are painted that are no series: `c` has the context, scales and sides of the chart in pixels of the canvas.
const PAINTED = {
  boxes(c, layer) {
    layer.left.forEach((_, k) => {
      const [left, right] = [layer.left[k] === null ? c.left : c.x(layer.left[k]), layer.right[k] === null ? c.right : c.x(layer.right[k])];
      const [top, bottom] = [layer.top[k] === null ? c.top : c.y(layer.top[k]), layer.bottom[k] === null ? c.bottom : c.y(layer.bottom[k])];
      c.context.fillStyle = faded(ink(layer.colour), layer.opacity ?? 1);
      c.context.fillRect(left, top, Math.max(c.ratio, right - left), bottom - top);
      if (layer.outlined) c.stroke(new Path2D(`M${left} ${c.top}V${c.bottom}M${right} ${c.top}V${c.bottom}`), {colour: "soft", width: 1, dash: "dotted"});
    });
  },

  cells(c, layer) {
    const across = layer.x.length - 1;
    layer.values.forEach((value, k) => {
      if (value === null) return;
      const [left, right] = [0, 1].map((side) => c.x(layer.x[k % across + side])), [bottom, top] = [0, 1].map((side) => c.y(layer.y[Math.floor(k / across) + side]));
      const share = Math.min(1, Math.abs(value) / layer.largest);
      c.context.fillStyle = faded(ink(value > 0 ? "miss" : "band"), 0.9 * share);
      c.context.fillRect(left, top, right - left, bottom - top);
      if (share > 0.2 && right - left > 9 * c.ratio) c.text(value > 0 ? "+" : "−", (left + right) / 2, (top + bottom) / 2 + 4 * c.ratio, "center", share > 0.55 ? "paper" : "ink");
    });
  },

  points(c, layer) {
    const places = layer.x.map((x, k) => [c.x(x), c.y(layer.y[k])]);
    if (layer.joined) c.stroke(new Path2D(`M${places.map((place) => place.join(" ")).join("L")}`), {...layer, width: 1});
    if (layer.error) places.forEach(([x, y], k) => {
      const [from, to] = layer.error.map((end) => layer.vertical ? c.y(end[k]) : c.x(end[k]));
      c.stroke(new Path2D(layer.vertical ? `M${x} ${from}V${to}` : `M${from} ${y}H${to}`), {...layer, width: 2, dash: ""});
    });
    for (const [x, y] of places) {
      const mark = new Path2D();
      mark.addPath(new Path2D(SYMBOLS[layer.symbol ?? 0]), new DOMMatrix([c.ratio, 0, 0, c.ratio, x, y]));
      c.context.fillStyle = layer.hollow ? ink("paper") : ink(layer.colour);
      c.context.fill(mark);
      c.stroke(mark, {...layer, width: 1.5, dash: ""});
    }
  },

  limit(c, layer) {
    const at = layer.vertical ? c.x(layer.at) : c.y(layer.at);
    c.stroke(new Path2D(layer.vertical ? `M${at} ${c.top}V${c.bottom}` : `M${c.left} ${at}H${c.right}`), {...layer, width: 1});
    if (layer.label) c.text(layer.label, (layer.vertical ? at : c.right) - 4 * c.ratio, layer.vertical ? c.top + 11 * c.ratio : at - 4 * c.ratio, "right", "soft");
  },
};

// Where an axis has labels, and which.
const labels = ({ticks}, shown) => ({
  ...(ticks ? {splits: () => ticks.map(([value]) => value), filter: (_, splits) => splits} : {}),
  ...(shown ? ticks ? {values: () => ticks.map(([, label]) => label)} : {} : {values: (_, splits) => splits.map(() => "")}),
});

// Paint some kinds of layers into a chart.
function paint(chart, layers, kinds) {
  const {ctx: context, bbox, pxRatio: ratio} = chart;
  const c = {
    context, ratio, left: bbox.left, right: bbox.left + bbox.width, top: bbox.top, bottom: bbox.top + bbox.height,
    x: (value) => chart.valToPos(value, "x", true), y: (value) => chart.valToPos(value, "y", true),
    stroke(path, {colour, width = 1.5, dash = ""}) {
      context.strokeStyle = ink(colour);
      context.lineWidth = width * ratio;
      context.setLineDash(DASHES[dash].map((length) => length * ratio));
      context.stroke(path);
    },
    text(words, x, y, align, colour) {
      Object.assign(context, {textAlign: align, textBaseline: "alphabetic", font: `${12 * ratio}px system-ui, sans-serif`, fillStyle: ink(colour)});
      context.fillText(words, x, y);
    },
  };
  context.save();
  context.beginPath();
  context.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  context.clip();
  for (const layer of layers) if (kinds.includes(layer.kind)) PAINTED[layer.kind](c, layer);
  context.restore();
}

// One figure in its place: draws it, and answers pointer and keys.
export class FigureView {
  constructor(place, onMoment) {
    Object.assign(this, {place, onMoment, hidden: new Set(), charts: [], figure: null, id: `figure ${drawnFigures++}`});
    this.legend = element("div", {class: "legend"});
    this.drawing = element("div", {class: "drawing", tabindex: "0", role: "group"});
    this.readout = element("div", {class: "readout", role: "status", hidden: ""});
    place.append(this.legend, this.drawing, this.readout);
    this.drawing.addEventListener("keydown", (event) => this.key(event));
    this.drawing.addEventListener("blur", () => { this.readout.hidden = true; });
    let width = 0;
    new ResizeObserver(([{contentRect}]) => {
      if (Math.abs(contentRect.width - width) > 1 && this.figure) { width = contentRect.width; this.draw(); }
    }).observe(place);
  }

  show(figure, flights = []) {
    Object.assign(this, {figure, flights, zoom: null, active: 0, value: undefined});
    this.drawing.setAttribute("aria-label", figure.over_time
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
      const made = element("button", {type: "button", "aria-pressed": String(!this.hidden.has(name)), title: "Show or hide"}, keyOf(layer), name);
      made.addEventListener("click", () => {
        if (!this.hidden.delete(name)) this.hidden.add(name);
        made.setAttribute("aria-pressed", String(!this.hidden.has(name)));
        this.draw();
      });
      return made;
    })));
  }

  // On paper, with its rows low enough for one sheet.
  draw({width, tallest, ratio} = {width: this.place.clientWidth, tallest: Infinity}) {
    const {figure} = this, columns = figure.columns, shown = figure.panels.map((panel, k) => [panel, k]).filter(([{layers}]) => layers.length);
    if (!width) return;
    // Panels of a narrow page are below each other; those of one row stay together.
    const two = width >= NARROW && columns % 2 === 0 ? 2 : 1, noted = figure.panels.some((panel) => panel.notes?.length);
    const across = width / columns < (figure.shared && !noted ? SHARED_LEAST_PX : PANEL_LEAST_PX) ? Math.min(two, columns) : columns;
    const inner = figure.shared ? 12 : LABELS_PX, share = (width - LABELS_PX - (across - 1) * (inner + GAP_PX)) / across;
    this.cells = shown.map(([panel, k]) => ({panel, layers: panel.layers.filter((layer) => !this.hidden.has(layer.name)), row: Math.floor(k / across), column: k % across}));
    const rows = Math.max(...this.cells.map((cell) => cell.row)) + 1;
    const lower = Math.min(1, Math.max(0.3, tallest / this.cells.reduce((sum, {column, panel}) => sum + (column ? 0 : panel.height + 24), 24)));
    for (const chart of this.charts) chart.destroy();
    this.drawing.style.gridTemplateColumns = Array.from({length: across}, (_, column) => `${share + (column ? inner : LABELS_PX)}px`).join(" ");
    this.drawing.replaceChildren();
    this.charts = this.cells.map((cell, k) => {
      cell.labelled = !figure.shared || cell.column === 0;
      // Of panels on one time only the last row has labels.
      cell.dated = !figure.over_time || cell.row === rows - 1;
      const {panel} = cell, place = element("div", {class: "panel"}, ...this.heading(cell));
      place.style.gridRow = cell.row + 1;
      place.style.gridColumn = cell.column + 1;
      const left = cell.column ? inner : LABELS_PX;
      place.style.setProperty("--left", `${left}px`);
      this.drawing.append(place);
      const chart = this.chart(cell, place, {share, left, height: lower * panel.height, ratio});
      chart.over.addEventListener("pointerenter", () => { this.active = k; });
      chart.over.addEventListener("pointerleave", () => { this.readout.hidden = true; });
      chart.over.addEventListener("click", () => this.choose(chart.posToVal(chart.cursor.left, "x")));
      return chart;
    });
    this.readout.hidden = true;
  }

  heading({panel}) {
    const found = [], own = this.own.get(panel);
    if (panel.title) found.push(element("div", {class: "heading"}, panel.title));
    if (own.length || panel.notes?.length) found.push(element("div", {class: "notes"}, ...own.map((layer) => element("span", {}, keyOf(layer), layer.name)),
      element("span", {class: "note"}, ...(panel.notes ?? []).flatMap((note, k) => k ? [element("br"), note] : [note]))));
    return found;
  }

  chart(cell, place, {share, left, height, ratio}) {
    const {panel, layers} = cell, {over_time: overTime} = this.figure, [data, series, bands] = seriesOf(layers, ratio ?? window.devicePixelRatio);
    const slanted = panel.x.ticks?.some(([, label]) => 7 * label.length > share / panel.x.ticks.length);
    const below = cell.dated ? 22 + (slanted ? SLANTED_PX : 0) : 6, title = cell.dated ? panel.x.title : undefined, aside = cell.labelled ? panel.y.title : undefined;
    return new uPlot({
      width: share + left, height: height + 8 + below + (title ? TITLE_PX : 0), padding: [8, 6, 0, 0], legend: {show: false}, pxRatio: ratio, series, bands,
      scales: {x: {time: false, range: () => this.within(cell)}, y: {distr: panel.y.logarithmic ? 3 : 1, range: () => this.tall(cell)}},
      axes: [
        axis({size: below, label: title, space: 65, rotate: slanted ? 30 : 0, ...labels(panel.x, cell.dated), ...(panel.x.ticks ? {grid: {show: false}} : {})}),
        axis({size: left - (aside ? TITLE_PX : 0), label: aside, space: 24, ...labels(panel.y, cell.labelled)}),
      ],
      cursor: {
        x: Boolean(overTime), y: false, points: {show: false}, drag: {x: Boolean(overTime), y: false, setScale: false, dist: ZOOM_LEAST_PX},
        ...(overTime ? {sync: {key: this.id, setSeries: false}} : {}), bind: {dblclick: () => () => this.magnify(null)},
      },
      hooks: {
        drawAxes: [(chart) => paint(chart, layers, ["boxes", "cells"])], draw: [(chart) => paint(chart, layers, ["points", "limit"])],
        setCursor: [(chart) => { if (this.charts[this.active] === chart) this.point(chart, cell); }],
        setSelect: [(chart) => this.select(chart)],
      },
    }, data, place);
  }

  // Limits along x and y of a panel, of all panels where they share one.
  within({panel, layers}) {
    const found = this.figure.over_time ? this.zoom ?? extent(this.cells.flatMap((cell) => cell.layers), 0) : extent(layers, 0);
    const [low, high] = this.zoom ?? [panel.x.low ?? found?.[0] ?? 0, panel.x.high ?? found?.[1] ?? 1];
    return high > low ? [low, high] : [low - 0.5, high + 0.5];
  }

  tall(cell) {
    const {y} = cell.panel, together = this.figure.shared ? this.cells.filter((other) => other.row === cell.row) : [cell];
    const found = together.map((other) => extent(other.layers, 1, this.within(other))).filter(Boolean);
    const [low, high] = found.length ? [Math.min(...found.map(([least]) => least)), Math.max(...found.map(([, most]) => most))] : [0, 1];
    const margin = y.logarithmic ? 0 : 0.05 * (high - (y.low ?? low)) || Math.abs(0.1 * high) || 0.5;
    return [y.low ?? low - margin, y.high ?? high + margin];
  }

  // --- pointer and keys ---

  select(chart) {
    const {left, width} = chart.select;
    if (!width) return;
    chart.setSelect({left: 0, width: 0, top: 0, height: 0}, false);
    if (this.charts[this.active] === chart) this.rescale([chart.posToVal(left, "x"), chart.posToVal(left + width, "x")]);
  }

  rescale(zoom) {
    this.zoom = zoom;
    for (const [k, chart] of this.charts.entries()) { const [min, max] = this.within(this.cells[k]); chart.setScale("x", {min, max}); }
  }

  magnify(factor, about) {
    if (!this.figure.over_time) return;
    const {min, max} = this.charts[0].scales.x;
    this.rescale(factor === null ? null : [about - factor * (about - min), about + factor * (max - about)]);
  }

  choose(value) {
    if (this.figure.over_time && this.flights.length) this.onMoment(this.flights, value - (this.figure.begins_s ?? 0));
  }

  key(event) {
    if (!this.figure.over_time || event.ctrlKey || event.metaKey || event.altKey) return;
    const {min, max} = this.charts[this.active].scales.x, step = (max - min) / (event.shiftKey ? 10 : 100), now = this.value ?? (min + max) / 2;
    const keys = {
      ArrowLeft: () => this.move(now - step), ArrowRight: () => this.move(now + step), ArrowUp: () => this.move(now, -1), ArrowDown: () => this.move(now, 1),
      Enter: () => this.choose(now), "+": () => this.magnify(0.5, now), "=": () => this.magnify(0.5, now), "-": () => this.magnify(2, now), Escape: () => this.magnify(null),
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  }

  move(value, rows = 0) {
    this.active = Math.min(this.charts.length - 1, Math.max(0, this.active + rows));
    const {min, max} = this.charts[this.active].scales.x;
    this.value = Math.min(Math.max(value, min), max);
    for (const chart of this.charts) chart.setCursor({left: chart.valToPos(this.value, "x"), top: 20}, true, false);
  }

  // What is where the cursor of a chart points.
  point(chart, cell) {
    const {left} = chart.cursor;
    const said = left >= 0 ? this.words(chart, cell, chart.posToVal(left, "x")) : [];
    this.readout.hidden = !said.length;
    if (!said.length) return;
    this.readout.replaceChildren(...said.map((words) => element("div", {}, words)));
    const box = this.place.getBoundingClientRect(), over = chart.over.getBoundingClientRect(), x = over.left - box.left + left, wide = this.readout.offsetWidth;
    this.readout.style.left = `${Math.max(0, x + 14 + wide > box.width ? x - 14 - wide : x + 14)}px`;
    this.readout.style.top = `${over.top - box.top + 4}px`;
  }

  words(chart, {panel, layers}, value) {
    const {left: x, top: y} = chart.cursor, at = (layer, k) => Math.hypot(chart.valToPos(layer.x[k], "x") - x, chart.valToPos(layer.y[k], "y") - y);
    const overTime = this.figure.over_time, found = [];
    this.value = value;
    for (const layer of layers) {
      if (layer.kind === "points") {
        const near = layer.x.map((_, k) => [at(layer, k), k]).sort(([one], [other]) => one - other)[0];
        if (near?.[0] < NEAR_PX) found.push(layer.texts?.[near[1]] ?? `${layer.name} ${short(layer.y[near[1]])}`);
      } else if (layer.kind === "cells") {
        const height = chart.posToVal(y, "y"), column = layer.x.findLastIndex((edge) => edge <= value), row = layer.y.findLastIndex((edge) => edge <= height);
        const held = layer.values[row * (layer.x.length - 1) + column];
        if (held !== undefined && held !== null) found.push(short(held));
      } else if (layer.kind === "boxes" && layer.name && !layer.outlined) {
        const height = chart.posToVal(y, "y");
        layer.left.forEach((left, k) => {
          if (value >= left && value <= layer.right[k] && height >= layer.bottom[k] && height <= layer.top[k]) found.push(`${layer.name} ${overTime ? `${short(left)} to ${short(layer.right[k])} s` : short(layer.top[k])}`);
        });
      } else if (layer.name && (layer.kind === "line" || layer.kind === "band") && layer.x.length) {
        const k = nearest(layer.x, value, layer.stepped), low = layer.kind === "band" ? layer.low[k] : layer.y[k], high = layer.high?.[k] ?? low;
        if (low !== null) found.push(`${layer.name} ${short(low) === short(high) ? short(low) : `${short(low)} to ${short(high)}`}`);
      }
    }
    const unit = panel.y.title ?? panel.title ?? "";
    return found.length && overTime ? [`${value.toFixed(2)} s${unit ? `, ${unit}` : ""}`, ...found] : found;
  }
}

// Lines and bands as data, series and bands of uPlot; samples of several flights are joined on one time.
function seriesOf(layers, ratio) {
  const tables = new Map(), series = [{}], bands = [];
  for (const layer of layers) if (layer.kind === "line" || layer.kind === "band") {
    if (!tables.has(layer.x)) tables.set(layer.x, []);
    tables.get(layer.x).push(layer);
  }
  const drawn = [...tables].map(([x, own]) => {
    const blocks = own.some((layer) => layer.kind === "line" && layer.high), columns = [];
    const add = (layer, low, high, width) => {
      columns.push(blocks ? ends(low, high) : low);
      return series.push({stroke: ink(layer.colour), width, dash: DASHES[layer.dash ?? ""], points: {show: false}, ...(layer.stepped ? {paths: uPlot.paths.stepped({align: 1})} : {})}) - 1;
    };
    for (const layer of own) {
      if (layer.kind === "line") add(layer, layer.y, layer.high ?? layer.y, layer.width ?? 1.5);
      else {
        const [low, high] = [add(layer, layer.low, layer.low, 1), add(layer, layer.high, layer.high, 1)];
        bands.push({series: [high, low], fill: layer.pattern ? hatch(ink(layer.colour), layer.pattern, ratio) : faded(ink(layer.colour), layer.opacity ?? 0.25)});
      }
    }
    return [blocks ? apart(x) : x, ...columns];
  });
  // 2: a gap lasts until the next sample of its own.
  return [drawn.length > 1 ? uPlot.join(drawn, drawn.map((table) => table.map(() => 2))) : drawn[0] ?? [[0, 1]], series, bands];
}

function keyOf(layer) {
  const drawn = node("svg", {width: 30, height: 14, "aria-hidden": "true"}), style = `stroke: ${layer.colour.startsWith("#") ? layer.colour : `var(--${layer.colour})`}`, fill = style.replace("stroke", "fill");
  const line = (dash, width) => node("path", {d: "M1 7H29", style, "stroke-width": width, "stroke-dasharray": DASHES[dash ?? ""].join(" "), fill: "none"});
  if (layer.kind === "points") {
    if (layer.joined) drawn.append(line(layer.dash, 1));
    drawn.append(node("path", {d: SYMBOLS[layer.symbol ?? 0], transform: "translate(15 7)", "stroke-width": 1.5, style: `${style}; ${layer.hollow ? "fill: var(--paper)" : fill}`}));
  } else if (layer.kind === "line" || layer.kind === "limit") drawn.append(line(layer.dash, layer.width ?? 1.5));
  else {
    drawn.append(node("path", {d: "M1 1H29V13H1Z", style: fill, "fill-opacity": layer.pattern ? 0.1 : layer.opacity ?? (layer.kind === "band" ? 0.25 : 1)}));
    if (layer.pattern) drawn.append(node("path", {d: "M3 13L13 1M11 13L21 1M19 13L29 1", style, class: "hatch"}));
  }
  return drawn;
}

// Place of the nearest value, or of the last one before.
function nearest(values, wanted, before = false) {
  const after = values.findIndex((value) => value > wanted), k = after < 0 ? values.length - 1 : Math.max(0, after - 1);
  return !before && k + 1 < values.length && values[k + 1] - wanted < wanted - values[k] ? k + 1 : k;
}
