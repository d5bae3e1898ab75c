// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// A written page: its menus, figures of the chosen flights and models, a chosen moment, light and dark, print.

import {FigureView, overlaid, PRINT} from "./figures.js";
import {element} from "./drawing.js";
import {SpaceView} from "./space.js";

const $ = (id) => document.getElementById(id);
const VIEW_ADDRESS = "http://127.0.0.1:8710/";
const kept = new Map(), views = new Map();
// For those who test the page: its figures by their places.
window.quadpi = views;

// The figures of one script element, with their arrays, null for none, in place of their numbers.
function readFigures(text) {
  const {figures, arrays} = JSON.parse(text), read = [];
  const array = (place) => read[place] ??= unpacked(arrays[place]);
  const filled = (value) => Array.isArray(value) ? value.map(filled)
    : value === null || typeof value !== "object" ? value
      : "array" in value ? array(value.array)
        : Object.fromEntries(Object.entries(value).map(([key, part]) => [key, filled(part)]));
  return Object.fromEntries(Object.entries(figures).map(([name, figure]) => [name, filled(figure)]));
}

function unpacked(array) {
  if (Array.isArray(array)) return array;
  if ("count" in array) return Array.from({length: array.count}, (_, k) => array.from + (array.to - array.from) * k / Math.max(1, array.count - 1));
  const bytes = Uint8Array.from(atob(array.data), (letter) => letter.charCodeAt(0)), codes = new DataView(bytes.buffer);
  return Array.from({length: bytes.length / 2}, (_, k) => {
    const code = codes.getUint16(2 * k, true);
    return code === 65535 ? null : array.low + code * array.step;
  });
}

// Figures of a flight, or of the page, read when they are first wanted.
function figures(flight) {
  if (!kept.has(flight)) {
    const held = [...document.querySelectorAll("script[data-figures]")].find((one) => (one.dataset.flight ?? null) === flight);
    kept.set(flight, readFigures(held.textContent));
  }
  return kept.get(flight);
}

function show(place, figure, flights) {
  const made = figure.lines ? SpaceView : FigureView;
  if (!views.has(place)) views.set(place, new made(place, chooseMoment));
  views.get(place).show(figure, flights);
}

const value = (id) => $(id)?.value ?? "";

// The figure of a place that follows the menus; of two flights or two models, both on the same axes.
function chosen(kind) {
  const flight = value("flight"), beside = value("beside");
  if (kind === "intervals" && value("model")) {
    const model = value("model"), own = figures(flight)[`model ${model}`];
    return beside && beside !== model ? overlaid(own, figures(flight)[`model ${beside}`], [model, beside]) : own;
  }
  const own = figures(flight)[kind];
  return kind === "history" && beside && beside !== flight ? overlaid(own, figures(beside)[kind], [flight, beside]) : own;
}

function drawFlight() {
  const flight = value("flight"), beside = value("beside");
  for (const place of document.querySelectorAll("[data-kind]")) {
    const flights = place.dataset.kind === "history" && beside ? [...new Set([flight, beside])] : [flight];
    show(place, chosen(place.dataset.kind), flights);
  }
  for (const place of document.querySelectorAll("[data-chosen]")) place.textContent = $("model") ? flight : [...new Set([flight, beside])].filter(Boolean).join(", ");
  if ($("beside") && $("model")) $("beside").disabled = !value("model");
}

// --- a moment ---

const commands = JSON.parse($("commands").textContent);

function chooseMoment(flights, time) {
  const at = Number(Math.max(0, time).toFixed(2)), known = flights.filter((flight) => commands[flight]);
  if (!known.length) return;
  $("moments").replaceChildren(...known.map((flight) => {
    const command = `${commands[flight]} --at ${at}`;
    const copy = element("button", {type: "button"}, "Copy"), link = `${VIEW_ADDRESS}#t=${at}`;
    copy.addEventListener("click", () => copied(command, copy));
    return element("div", {}, element("b", {}, `${flight}, ${at} s`), element("code", {}, command), copy,
      element("span", {}, "and then "), element("a", {href: link, target: "_blank", rel: "noopener"}, link));
  }));
  $("moment").hidden = false;
}

// Pages from a file may have no clipboard: then the command is selected, ready for the keys.
function copied(text, button) {
  const said = () => { button.textContent = "Copied"; setTimeout(() => { button.textContent = "Copy"; }, 1500); };
  const select = () => getSelection().selectAllChildren(button.previousElementSibling);
  if (navigator.clipboard) navigator.clipboard.writeText(text).then(said, select);
  else select();
}

$("close").addEventListener("click", () => { $("moment").hidden = true; });

// --- light and dark, menus, print ---

function theme(name) {
  document.documentElement.dataset.theme = name;
  for (const view of views.values()) view.draw();
}

const dark = matchMedia("(prefers-color-scheme: dark)");
theme(dark.matches ? "dark" : "light");
dark.addEventListener("change", ({matches}) => theme(matches ? "dark" : "light"));
$("theme").addEventListener("click", () => theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
for (const id of ["flight", "beside", "model"]) $(id)?.addEventListener("change", drawFlight);
for (const button of document.querySelectorAll("button[data-flight]")) {
  button.addEventListener("click", () => {
    $("flight").value = button.dataset.flight;
    drawFlight();
    $("flight").scrollIntoView({behavior: "smooth", block: "center"});
  });
}

// On paper everything is open, and figures and tables have the width of the sheet at most: letters of tables are
// smaller there, and a browser would shrink the whole page for one that is wider.
const PRINTED_LETTERS = 0.85;
let folded = [], shown = "light";
addEventListener("beforeprint", () => {
  shown = document.documentElement.dataset.theme;
  document.documentElement.dataset.theme = "light";
  folded = [...document.querySelectorAll("details:not([open])")];
  for (const one of folded) one.open = true;
  for (const view of views.values()) view.draw(PRINT);
  for (const table of document.querySelectorAll(".scroll table")) table.style.zoom = Math.min(1, PRINT.width / (PRINTED_LETTERS * table.offsetWidth));
});
addEventListener("afterprint", () => {
  for (const one of folded) one.open = false;
  theme(shown);
  for (const table of document.querySelectorAll(".scroll table")) table.style.zoom = "";
});

for (const place of document.querySelectorAll("[data-figure]")) {
  const figure = figures(null)[place.dataset.figure];
  show(place, figure, figure.flight ? [figure.flight] : []);
}
if ($("flight")) drawFlight();
