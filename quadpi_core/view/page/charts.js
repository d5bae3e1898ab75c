// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Figures of the live page: quantities over time and the timeline by uPlot, inputs in their ranges, the flight in space.

import {axis, element, ink} from "./drawing.js";
/* global uPlot */

export const WINDOW_S = 30;
// A flight that has just begun is not stretched further than this span over the width of a chart.
const BEGIN_S = 5;
const STATES = ["trusted-line", "warning-line", "alarm-line", "none-line", "none-line"];
// The higher, the worse.
const HEIGHTS = [0.3, 0.65, 1, 0.15, 0.2];
export const stateColour = (state) => STATES[state] ?? "none-line";

const sized = (place) => ({width: Math.max(50, place.clientWidth), height: Math.max(40, place.clientHeight)});

// A chart in its place, made anew where its series, the theme or its size have changed.
class Chart {
  constructor(place) {
    this.place = place;
    this.made = "";
  }

  renew(key, options) {
    const size = sized(this.place), made = JSON.stringify([key, size, ink("paper")]);
    if (made === this.made) return;
    this.made = made;
    this.chart?.destroy();
    this.chart = new uPlot({...size, legend: {show: false}, ...options()}, [[0, 1]], this.place);
  }
}

// Quantities over the last 30 s: `series` of {column, colour, width, sign}, or {of, …} with a function of rows and the place of
// a block in them; a band lies between the first two.
export class TimeChart extends Chart {
  draw(store, cursor, series, {band = false, misses = null, least = 0} = {}) {
    this.renew(series.map(({colour, width}) => [colour, width]).concat(band), () => ({
      padding: [6, 2, 0, 0],
      scales: {x: {time: false, range: () => [Math.max(0, this.cursor - WINDOW_S), Math.max(this.cursor, BEGIN_S)]}, y: {range: (_, low, high) => this.fit(low, high, least)}},
      axes: [axis({size: 20, grid: {show: false}, space: 70, values: (_, splits) => splits.map((value) => `${Number(value.toFixed(1))} s`)}), axis({size: 52, space: 26})],
      series: [{}, ...series.map(({colour, width}) => ({stroke: ink(colour), width: width ?? 1.5, points: {show: false}}))],
      bands: band ? [{series: [2, 1], fill: ink("band-fill")}] : [],
      cursor: {y: false, points: {size: 7}, drag: {x: false, y: false}, sync: {key: "page"}},
      hooks: {draw: [() => this.mark()]},
    }));
    const last = Math.floor(cursor / store.blockS), first = Math.max(0, last - Math.round(WINDOW_S / store.blockS)), data = [[], ...series.map(() => [])];
    Object.assign(this, {cursor, missed: []});
    for (let block = first; block <= last; block++) {
      const place = store.at(block), value = (column) => place && Number.isFinite(place[0][place[1] + column]) ? place[0][place[1] + column] : null;
      data[0].push((block + 0.5) * store.blockS);
      series.forEach(({column, sign, of}, k) => { const found = of ? place && of(...place) : value(column); data[k + 1].push(found !== null && sign ? sign * found : found); });
      if (misses && value(misses.count) > 0) this.missed.push([(block + 0.5) * store.blockS, value(misses.measured), value(misses.measured) > value(misses.middle)]);
    }
    this.chart.setData(data);
  }

  // Grows at once, shrinks slowly: a scale that jumps cannot be read. Another moment has a scale of its own.
  fit(low, high, least) {
    if (low === null || high === null) { this.range = null; return [0, 1]; }
    if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
    const margin = 0.06 * (high - low) || 0.5;
    [low, high] = [low - margin, high + margin];
    if (this.range && Math.abs(this.cursor - this.before) < 2) {
      low = Math.min(low, this.range[0] + 0.04 * (low - this.range[0]));
      high = Math.max(high, this.range[1] + 0.04 * (high - this.range[1]));
    }
    this.before = this.cursor;
    this.range = [low, high];
    return this.range;
  }

  // Where the measured wrench left its interval.
  mark() {
    const {ctx, bbox, pxRatio: ratio} = this.chart;
    ctx.fillStyle = ink("miss");
    for (const [time, value, above] of this.missed) {
      const x = this.chart.valToPos(time, "x", true), tip = this.chart.valToPos(value, "y", true), side = above ? -ratio : ratio;
      if (x >= bbox.left) ctx.fill(new Path2D(`M${x} ${tip + side}L${x - 4 * ratio} ${tip + 8 * side}H${x + 4 * ratio}Z`));
    }
  }
}

// The whole session: its states, the window of the charts, and the moment shown.
export class Timeline extends Chart {
  draw(overview, end, cursor) {
    Object.assign(this, {cursor, end: Math.max(1e-9, end)});
    this.renew([], () => ({
      padding: [0, 0, 0, 0],
      scales: {x: {time: false, range: () => [0, this.end]}, y: {range: [0, 1]}},
      axes: [axis({size: 18, grid: {show: false}, space: 90, values: (_, splits) => splits.map((value) => value ? `${Number(value.toFixed(2))} s` : "")}), {show: false}],
      series: [{}, ...STATES.map((colour) => ({stroke: "transparent", width: 0, fill: ink(colour), paths: uPlot.paths.stepped({align: 1}), points: {show: false}}))],
      cursor: {show: false},
      hooks: {drawAxes: [(chart) => this.box(chart, Math.max(0, this.cursor - WINDOW_S), this.cursor, ink("training"))], draw: [(chart) => this.box(chart, this.cursor, this.cursor, ink("ink"))]},
    }));
    // A bar ends where the next one begins.
    const {bin_s: bin = 1, codes = ""} = overview, bins = [...codes, "-"];
    this.chart.setData([bins.map((_, k) => k * bin), ...STATES.map((_, state) => bins.map((code, k) => [code, bins[k - 1]].includes(String(state)) ? HEIGHTS[state] : null))]);
  }

  box(chart, from, to, colour) {
    const {ctx, bbox, pxRatio: ratio} = chart, left = chart.valToPos(from, "x", true);
    ctx.fillStyle = colour;
    ctx.fillRect(Math.min(left, bbox.left + bbox.width - 2 * ratio), bbox.top, Math.max(2 * ratio, chart.valToPos(to, "x", true) - left), bbox.height);
  }
}

// How far an input lies in its training range: 0 at the lower end, 1 at the upper end.
const placed = (value, input) => (value - input.lower) / ((input.upper - input.lower) || 1);
// The training range is the middle half; what is a range away from it is at the edge.
const across = (place) => `${100 * Math.min(1, Math.max(0, 0.25 + 0.5 * place))}%`;

// Inputs, each in a row: what was flown in training, the last 30 s, and now. Gives the one that is farthest out.
export function drawEnvelope(place, store, cursor) {
  const inputs = store.vehicle?.inputs ?? [], known = inputs.length && inputs[0].lower !== null;
  if (place.childElementCount !== (known ? inputs.length : 1)) {
    place.replaceChildren(...(known ? inputs.map(() => element("div", {class: "input"}, element("span"), element("div", {class: "range"}, element("i"), element("b")))) : [
      element("p", {}, "Training ranges are not known here: add --model MODEL to quadpi view")]));
  }
  if (!known) return null;
  const last = Math.floor(cursor / store.blockS), first = Math.max(0, last - Math.round(WINDOW_S / store.blockS));
  const rows = inputs.map((input, k) => {
    let low = Infinity, high = -Infinity;
    for (let block = first; block <= last; block++) {
      const value = store.value(block, "inputs", k);
      if (value < low) low = value;
      if (value > high) high = value;
    }
    const now = placed(store.recent(last, "inputs", k, 0.5), input);
    return {input, low: placed(low, input), high: placed(high, input), now, out: Math.max(-now, now - 1)};
  });
  const farthest = rows.filter((row) => Number.isFinite(row.out)).reduce((best, row) => !best || row.out > best.out ? row : best, null);
  rows.forEach((row, k) => {
    const [label, range] = place.children[k].children, [line, dot] = range.children, is = row === farthest;
    label.textContent = label.title = `${is ? "▶ " : ""}${row.input.words}${row.input.angle ? ` (${row.input.angle})` : ""}`;
    place.children[k].className = `input${row.out > 0 ? " outside" : ""}${is ? " farthest" : ""}`;
    line.hidden = !(row.high >= row.low);
    dot.hidden = !Number.isFinite(row.now);
    Object.assign(line.style, {left: across(row.low), right: `calc(100% - ${across(row.high)})`});
    dot.style.left = across(row.now);
  });
  return farthest;
}

// The flight as lines in space, east, north and up: its track, the last 30 s by trust, and the vehicle.
export function flightInSpace(store, cursor, track) {
  const last = Math.floor(cursor / store.blockS), first = Math.max(0, last - Math.round(WINDOW_S / store.blockS)), recent = [];
  let state = NaN;
  for (let block = first; block <= last; block++) {
    const given = store.value(block, "state");
    if (!Number.isNaN(given)) state = given;
    const point = [0, 1, 2].map((k) => store.value(block, "position", k));
    if (point.every(Number.isFinite)) recent.push({point, state, block});
  }
  const past = track.map(([, ...point]) => point), points = [...past, ...recent.map(({point}) => point)];
  if (!points.length) return null;
  const inSpace = (some) => [some.map(([, east]) => east), some.map(([north]) => north), some.map(([, , down]) => -down)];
  const line = (some, colour, width) => ({name: "", points: inSpace(some), colour, width}), lines = [line(past, "none-line", 1)];
  for (let k = 0, begin = 0; k < recent.length; k++) {
    if (k + 1 < recent.length && recent[k + 1].state === recent[begin].state) continue;
    lines.push(line(recent.slice(begin, k + 2).map(({point}) => point), stateColour(recent[begin].state), {1: 3.5, 2: 5}[recent[begin].state] ?? 2));
    begin = k + 1;
  }
  const [low, high] = [Math.min, Math.max].map((most) => inSpace(points).map((values) => values.reduce((one, other) => most(one, other))));
  // No side is shorter than a fifth of the longest, nor than a metre.
  const side = Math.max(1, 0.2 * Math.max(...low.map((value, k) => high[k] - value)));
  low.forEach((value, k) => { const more = Math.max(0, side - (high[k] - value)) / 2; low[k] -= more; high[k] += more; });
  if (recent.length) lines.push(...vehicle(store, recent[recent.length - 1], 0.06 * Math.hypot(...low.map((value, k) => high[k] - value))).map((some) => line(some, "ink", 2.5)));
  return {label: "Flight, coloured by trust", lines, low, high, of_values: ""};
}

// Arms to as many rotors as there are, two of them in front, and a longer line forward.
function vehicle(store, {point, block}, arm) {
  const [w, x, y, z] = [0, 1, 2, 3].map((k) => store.value(block, "attitude", k)), rotors = store.columns.rotors[1];
  const body = ([a, b]) => [(1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b, 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b,
    2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b].map((value, k) => point[k] + arm * value);
  const tips = Array.from({length: rotors}, (_, k) => [Math.cos((2 * k + 1) * Math.PI / rotors), Math.sin((2 * k + 1) * Math.PI / rotors)]);
  return [[1.5, 0], ...tips].map((tip) => [point, body(tip)]);
}
