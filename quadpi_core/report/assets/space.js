// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// A path in space, drawn as SVG from the records of page.py: to be turned by dragging or by keys.

import {DASHES, element, node, short, ticks} from "./drawing.js";

const STEPS = 9, HEIGHT = 600, POINTED_PX = 14;

export class SpaceView {
  constructor(place) {
    this.place = place;
    this.turn = -0.62;
    this.tilt = 0.5;
    this.zoom = 1;
    this.drawing = element("div", {class: "drawing space", tabindex: "0", role: "group"});
    this.legend = element("div", {class: "legend"});
    this.readout = element("div", {class: "readout", hidden: ""});
    place.append(this.legend, this.drawing, this.readout);
    let from = null;
    this.drawing.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; this.drawing.setPointerCapture(event.pointerId); });
    this.drawing.addEventListener("pointerup", () => { from = null; });
    this.drawing.addEventListener("pointermove", (event) => {
      if (!from) { this.point(event); return; }
      this.rotate(0.01 * (event.clientX - from[0]), 0.01 * (event.clientY - from[1]));
      from = [event.clientX, event.clientY];
    });
    // A wheel scrolls the page; with Ctrl, as in maps, it zooms.
    this.drawing.addEventListener("wheel", (event) => { if (event.ctrlKey) { event.preventDefault(); this.magnify(Math.exp(-0.002 * event.deltaY)); } }, {passive: false});
    this.drawing.addEventListener("keydown", (event) => {
      const keys = {ArrowLeft: () => this.rotate(-0.1, 0), ArrowRight: () => this.rotate(0.1, 0), ArrowUp: () => this.rotate(0, -0.1), ArrowDown: () => this.rotate(0, 0.1), "+": () => this.magnify(1.2), "-": () => this.magnify(1 / 1.2)};
      if (event.ctrlKey || event.metaKey || event.altKey || !keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
    let width = 0;
    new ResizeObserver(([{contentRect}]) => {
      if (Math.abs(contentRect.width - width) > 1 && this.figure) { width = contentRect.width; this.draw(); }
    }).observe(place);
  }

  show(figure) {
    this.figure = figure;
    this.drawing.setAttribute("aria-label", `${figure.label}. Arrow keys turn it, plus and minus zoom.`);
    this.legend.replaceChildren(...figure.lines.filter((line) => line.name).map((line) => {
      const drawn = node("svg", {width: 30, height: 14, "aria-hidden": "true"});
      drawn.append(node("path", {d: "M1 7H29", fill: "none", "stroke-width": line.width ?? 2, "stroke-dasharray": DASHES[line.dash ?? ""].join(" "), style: `stroke: var(--${line.colour})`}));
      return element("span", {}, drawn, line.name);
    }));
    const ramp = figure.lines.find((line) => line.values);
    if (ramp) {
      const values = Array.from(ramp.values), [low, high] = [Math.min(...values), Math.max(...values)];
      this.legend.append(element("span", {}, short(low), element("i", {class: "ramp", "aria-hidden": "true"}), `${short(high)}  ${figure.of_values}`));
    }
    this.draw();
  }

  // Time and value of the path where it is pointed at.
  point(event) {
    const line = this.figure?.lines.find((one) => one.times), box = this.drawing.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    let best = POINTED_PX, found = -1;
    for (let k = 0; k < (line?.times.length ?? 0); k++) {
      const [left, top] = this.project([line.points[0][k], line.points[1][k], line.points[2][k]]), far = Math.hypot(left - x, top - y);
      if (far < best) { best = far; found = k; }
    }
    this.readout.hidden = found < 0;
    if (found < 0) return;
    this.readout.textContent = `${line.times[found].toFixed(1)} s, ${this.figure.of_values.replace(/ \[.*/, "")} ${short(line.values[found])}`;
    this.readout.style.left = `${x + 14}px`;
    this.readout.style.top = `${this.drawing.offsetTop + y + 4}px`;
  }

  rotate(turn, tilt) {
    this.turn += turn;
    this.tilt = Math.min(1.55, Math.max(0.02, this.tilt + tilt));
    this.draw();
  }

  magnify(factor) {
    this.zoom = Math.min(8, Math.max(0.4, this.zoom * factor));
    this.draw();
  }

  draw({width} = {width: this.place.clientWidth}) {
    if (!width || !this.figure) return;
    const {low, high, lines} = this.figure, height = Math.min(HEIGHT, Math.max(300, 0.66 * width));
    const middle = low.map((value, k) => (value + high[k]) / 2), sides = low.map((value, k) => high[k] - value);
    const [sin, cos, down, level] = [Math.sin(this.turn), Math.cos(this.turn), Math.sin(this.tilt), Math.cos(this.tilt)];
    const flat = ([x, y, z]) => {
      const [e, n, u] = [x - middle[0], y - middle[1], z - middle[2]];
      return [e * cos + n * sin, -u * level - (n * cos - e * sin) * down];
    };
    // As large as fits, its labels included.
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => flat([k & 1 ? high[0] : low[0], k & 2 ? high[1] : low[1], k & 4 ? high[2] : low[2]]));
    const span = [0, 1].map((axis) => [Math.min(...corners.map((one) => one[axis])), Math.max(...corners.map((one) => one[axis]))]);
    const scale = this.zoom * Math.min((width - 90) / (span[0][1] - span[0][0]), (height - 80) / (span[1][1] - span[1][0]));
    const centre = span.map(([least, most]) => (least + most) / 2);
    const place = (point) => flat(point).map((value, axis) => (axis ? height : width) / 2 + scale * (value - centre[axis]));
    this.project = place;
    const write = (points) => `M${points.map((point) => place(point).map((value) => value.toFixed(1)).join(",")).join("L")}`;
    const svg = node("svg", {viewBox: `0 0 ${width} ${height}`, width, height, "aria-hidden": "true"});
    this.axes(svg, low, high, sides, place, write);
    for (const line of lines) svg.append(...this.line(line, write));
    this.drawing.replaceChildren(svg);
  }

  // Grid on the ground, and heights on the edge that is farthest to the left.
  axes(svg, low, high, sides, place, write) {
    const longest = Math.max(...sides), text = (words, point, shift) => {
      const [x, y] = place(point);
      svg.append(node("text", {x: x + shift[0], y: y + shift[1], "text-anchor": "middle"}, words));
    };
    const grid = (from, to) => svg.append(node("path", {class: "grid", d: write([from, to])}));
    const round = (k) => ticks(low[k], high[k], Math.max(2, 7 * sides[k] / longest));
    // The near sides of the ground, where labels are in front of it.
    const east = place([high[0], low[1], low[2]])[1] + place([high[0], high[1], low[2]])[1] > place([low[0], low[1], low[2]])[1] + place([low[0], high[1], low[2]])[1] ? high[0] : low[0];
    const north = place([low[0], high[1], low[2]])[1] + place([high[0], high[1], low[2]])[1] > place([low[0], low[1], low[2]])[1] + place([high[0], low[1], low[2]])[1] ? high[1] : low[1];
    for (const x of round(0)) { grid([x, low[1], low[2]], [x, high[1], low[2]]); text(short(x), [x, north, low[2]], [0, 17]); }
    for (const y of round(1)) { grid([low[0], y, low[2]], [high[0], y, low[2]]); text(short(y), [east, y, low[2]], [0, 17]); }
    const edge = [[low[0], low[1]], [low[0], high[1]], [high[0], low[1]], [high[0], high[1]]].sort((one, other) => place([...one, low[2]])[0] - place([...other, low[2]])[0])[0];
    grid([...edge, low[2]], [...edge, high[2]]);
    for (const z of round(2)) text(short(z), [...edge, z], [-18, 4]);
    text("east [m]", [(low[0] + high[0]) / 2, north, low[2]], [0, 34]);
    text("north [m]", [east, (low[1] + high[1]) / 2, low[2]], [0, 34]);
    text("height [m]", [...edge, high[2]], [0, -10]);
  }

  line(line, write) {
    const points = Array.from(line.points[0], (x, k) => [x, line.points[1][k], line.points[2][k]]);
    if (line.values) return this.ramp(line, points, write);
    const parts = [[]];
    for (const point of points) if (point.includes(null)) parts.push([]); else parts[parts.length - 1].push(point);
    return [node("path", {d: parts.filter((part) => part.length).map(write).join(""), fill: "none", "stroke-width": line.width ?? 2, "stroke-dasharray": DASHES[line.dash ?? ""].join(" "), "stroke-linejoin": "round", style: `stroke: var(--${line.colour})`})];
  }

  // Runs of one step of the colours: the faster, the wider.
  ramp(line, points, write) {
    const values = Array.from(line.values), low = Math.min(...values), high = Math.max(...values) || 1;
    const step = (value) => Math.min(STEPS - 1, Math.floor(STEPS * (value - low) / ((high - low) || 1)));
    const paths = Array.from({length: STEPS}, () => "");
    for (let k = 1, begin = 0; k < points.length; k++) {
      if (k + 1 < points.length && step(values[k + 1]) === step(values[k])) continue;
      paths[step(values[k])] += write(points.slice(begin, k + 1));
      begin = k;
    }
    return paths.map((d, k) => [d, k]).filter(([d]) => d).map(([d, k]) => node("path", {d, fill: "none", "stroke-width": 2 + 3 * k / (STEPS - 1), "stroke-linejoin": "round",
      style: `stroke: color-mix(in oklab, var(--fast) ${Math.round(100 * k / (STEPS - 1))}%, var(--slow))`}));
  }
}
