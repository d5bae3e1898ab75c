// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// What leaves the page: a sound, the charts as a picture, and what they show as a table.

import {ink} from "./drawing.js";

const WIDTH = 1600, MARGIN = 12, LINE = 24;
const TONES_HZ = [880, 660, 880], TONE_S = 0.18;
let audio = null;

// Browsers allow sounds from the first click or key on; not from a touch that moves, nor from Escape.
export function allowSound(then) { (audio ??= new AudioContext()).resume().then(then); }
export const soundAllowed = () => audio?.state === "running";

export function sound() {
  TONES_HZ.forEach((hertz, k) => {
    if (!audio) return;
    const tone = audio.createOscillator(), volume = audio.createGain(), begin = audio.currentTime + k * TONE_S;
    tone.frequency.value = hertz;
    volume.gain.value = 0.2;
    tone.connect(volume).connect(audio.destination);
    tone.start(begin);
    tone.stop(begin + 0.9 * TONE_S);
  });
}

function save(blob, name) {
  const link = Object.assign(document.createElement("a"), {href: URL.createObjectURL(blob), download: name});
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

const leaves = (one) => one.childNodes.length ? [...one.childNodes].flatMap(leaves) : [one];

// Charts in rows, below lines of text of which the first is on a field of a colour.
export function savePicture(name, words, colour, rows) {
  const canvas = document.createElement("canvas"), heights = rows.map((charts) => Math.max(...charts.map(({chart}) => chart.ctx.canvas.height / chart.ctx.canvas.width)) * WIDTH / charts.length);
  Object.assign(canvas, {width: WIDTH, height: 2 * MARGIN + LINE * (words.length + 1 + rows.length) + heights.reduce((sum, one) => sum + one, 0)});
  const draw = canvas.getContext("2d");
  const text = (line, x, y, style, font) => { Object.assign(draw, {fillStyle: style, font: `${font} system-ui, sans-serif`}); draw.fillText(line, x, y); };
  Object.assign(draw, {fillStyle: ink("paper")});
  draw.fillRect(0, 0, canvas.width, canvas.height);
  Object.assign(draw, {fillStyle: colour});
  draw.fillRect(0, 0, 8, MARGIN + LINE * words.length);
  words.forEach((line, k) => text(line, 2 * MARGIN, MARGIN + LINE * (k + 0.7), ink("ink"), k ? "16px" : "bold 22px"));
  let y = MARGIN + LINE * (words.length + 1);
  rows.forEach((charts, k) => {
    charts.forEach(({chart, place}, at) => {
      const {canvas: source} = chart.ctx, wide = WIDTH / charts.length, title = place.previousElementSibling;
      let x = at * wide + MARGIN;
      for (const leaf of title?.tagName === "H2" ? leaves(title) : []) {
        text(leaf.textContent, x, y + 0.7 * LINE, getComputedStyle(leaf.parentElement).color, "14px");
        x += draw.measureText(leaf.textContent).width + MARGIN;
      }
      draw.drawImage(source, at * wide, y + LINE, wide, source.height * wide / source.width);
    });
    y += LINE + heights[k];
  });
  canvas.toBlob((blob) => save(blob, `${name}.png`));
}

// Blocks of a range, a line each, under the names of their columns.
export function saveTable(name, store, first, last, parts) {
  const titles = Object.entries(store.columns).sort(([, one], [, other]) => one[0] - other[0]).flatMap(([quantity, [, count]]) =>
    Array.from({length: count}, (_, k) => count > 1 ? `${quantity}.${parts(quantity)?.[k] ?? k + 1}` : quantity));
  const quoted = (text) => /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text, lines = [titles.map(quoted).join(",")];
  for (let block = Math.max(0, first); block <= last; block++) {
    const place = store.at(block);
    if (place) lines.push([...place[0].subarray(place[1], place[1] + store.width)].map((value) => Number.isNaN(value) ? "" : Number(value.toPrecision(7))).join(","));
  }
  save(new Blob([lines.join("\n") + "\n"], {type: "text/csv"}), `${name}.csv`);
}
