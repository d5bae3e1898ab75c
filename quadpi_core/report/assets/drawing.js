// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What the figures of all pages are drawn with: elements, colours of the style sheet, and how numbers are written. All text
// from elsewhere is set as textContent, so a name is never markup.

export const DASHES = {"": [], dashed: [6, 4], dotted: [1.5, 3], dashdot: [8, 3, 2, 3]};

function filled(made, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    // A style as an attribute is what the policy of the live page refuses.
    if (key === "style") made.style.cssText = value;
    else if (value !== undefined) made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

export const element = (name, attributes = {}, ...children) => filled(document.createElement(name), attributes, children);
export const node = (name, attributes = {}, ...children) => filled(document.createElementNS("http://www.w3.org/2000/svg", name), attributes, children);

// A colour for a canvas, #rrggbb: of the theme by its name, or as it is.
export const ink = (name) => name.startsWith("#") ? name : getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
export const faded = (colour, opacity) => colour + Math.round(255 * opacity).toString(16).padStart(2, "0");

export function short(value) {
  if (Math.abs(value) >= 100) return value.toFixed(0);
  const rounded = Number(value.toPrecision(3));
  return rounded && Math.abs(rounded) < 1e-3 ? rounded.toExponential() : String(rounded);
}

export function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].map((factor) => factor * power).find((one) => one >= raw);
  const found = [];
  for (let value = Math.ceil(low / step) * step; value <= high; value += step) found.push(Math.abs(value) < 1e-9 * step ? 0 : value);
  return found;
}

// A round value of an axis, however near the next one is.
function round(value) {
  const rounded = Number((value ?? NaN).toPrecision(6));
  return Number.isNaN(rounded) ? "" : rounded && Math.abs(rounded) < 1e-3 ? rounded.toExponential() : String(rounded);
}

// An axis of a uPlot chart in the colours and letters of the page.
export const axis = (more) => ({
  stroke: ink("soft"), font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", labelSize: 20, labelGap: 0, gap: 3,
  grid: {stroke: ink("rule"), width: 1}, ticks: {show: false}, values: (chart, splits) => splits.map(round), ...more,
});
