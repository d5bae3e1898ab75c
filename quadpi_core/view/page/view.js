// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// The page: its connection, the moment that it shows, and what it says of that moment. All text from elsewhere is set
// as textContent, so a name is never markup.

import {drawEnvelope, flightInSpace, stateColour, TimeChart, Timeline, WINDOW_S} from "./charts.js";
import {element, ink} from "./drawing.js";
import {allowSound, savePicture, saveTable, sound, soundAllowed} from "./export.js";
import {SpaceView} from "./space.js";
import {Store} from "./store.js";

const AXES = [["Fx", "forward force", "N"], ["Fy", "force to the right", "N"], ["Fz", "downward force", "N"],
  ["Mx", "roll moment", "Nm"], ["My", "pitch moment", "Nm"], ["Mz", "yaw moment", "Nm"]];
const WORDS = ["TRUSTED", "WARNING", "ALARM", "NO DATA", "NOT JUDGED"], SIGNS = ["✓", "!", "✕", "?", "–"];
const ALARM = 2, NO_DATA = 3;
// Reasons in the banner, the strongest; the others are in its title.
const REASONS = 3;
// The longest coverage: all that is drawn lies in it.
const COVERED_S = 60;
const COVERAGE_EVERY_MS = 250;
const RETRY_MS = 500, RETRY_MOST_MS = 2000, CONNECT_MS = 3000;

const $ = (id) => document.getElementById(id);
const store = new Store();
const page = {
  socket: null, retry: RETRY_MS, live: true, follow: true, playing: true, cursor: 0, selected: null, chosen: 0,
  vehicles: new Map(), overview: {events: [], track: [], codes: "", health: []}, wanted: true, before: 0, coveredAt: 0,
  frames: 0, rate: 0, rateAt: 0, drawMs: 0, urgent: false, said: {}, named: null, sound: localStorage.getItem("sound") !== "off", sounded: new Map(), sounds: 0,
};
// For those who measure the page: what it shows, and when it was drawn.
window.quadpi = {page, store, drawn: null};

// Set a text only where it changes: a page that is read aloud says what is new.
function say(id, text) {
  if (page.said[id] === text) return;
  page.said[id] = text;
  $(id).textContent = text;
}

const percent = (share) => Number.isNaN(share) ? "–" : share >= 1 ? "100 %" : `${Math.min(99.9, 100 * share).toFixed(1)} %`;
const seconds = (value) => `${value.toFixed(2)} s`;
const here = () => page.vehicles.get(page.selected);
const block = (cursor = page.cursor) => Math.floor(cursor / store.blockS);
const newest = () => here()?.newest ?? -1;
const end = () => Math.max(0, (newest() + 1) * store.blockS);
const redraw = () => { page.wanted = true; };

// --- connection ---

function send(wish) {
  if (page.socket?.readyState === WebSocket.OPEN) page.socket.send(JSON.stringify(wish));
}

function connect() {
  const socket = page.socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`);
  socket.binaryType = "arraybuffer";
  const given = setTimeout(() => socket.close(), CONNECT_MS);
  socket.onopen = () => { clearTimeout(given); page.retry = RETRY_MS; lost(false); };
  socket.onmessage = ({data}) => {
    if (typeof data === "string") take(JSON.parse(data));
    else if (store.take(data)) followNewest();
    redraw();
  };
  socket.onclose = () => {
    clearTimeout(given);
    lost(true);
    setTimeout(connect, page.retry);
    page.retry = Math.min(RETRY_MOST_MS, 2 * page.retry);
  };
}

function lost(is) {
  $("link").textContent = is ? "server lost, trying again" : "connected";
  $("link").classList.toggle("lost", is);
  document.body.classList.toggle("lost", is);
  page.lost = is;
  redraw();
}

function take(message) {
  if (message.type === "hello") {
    page.live = message.live;
    page.vehicles.clear();
    store.clear();
    say("title", message.title);
    $("live").hidden = !page.live;
    document.querySelectorAll("label select").forEach((one) => { one.parentElement.hidden = page.live; });
    page.follow = page.live;
    if (page.selected !== null) send({select: page.selected});
  } else if (message.type === "state") {
    const before = here()?.state;
    page.vehicles = new Map(message.vehicles.map((one) => [one.id, one]));
    // Not where it is drawn: a hidden page draws nothing.
    if (page.live) message.vehicles.forEach((one) => soundAlarm(one.id, one.state));
    page.urgent = here()?.state !== before;
    if (!page.vehicles.has(page.selected) && page.vehicles.size) select([...page.vehicles.keys()][0]);
    showVehicles();
    followNewest();
    approach();
  } else if (message.type === "vehicle" && message.id === page.selected) {
    store.describe(message);
    page.chosen = Math.min(page.chosen, Math.max(0, message.models.length - 1));
    showModels();
  } else if (message.type === "overview" && message.id === page.selected) {
    page.overview = message;
    showEvents();
    showHealth();
  }
}

function select(id) {
  if (page.selected !== id) store.clear();
  page.selected = id;
  page.overview = {events: [], track: [], codes: "", health: []};
  showEvents();
  send({select: id});
  redraw();
}

function followNewest() {
  if (!page.live || !page.follow || !page.playing) return;
  const time = store.recent(newest(), "time", 0, 2);
  page.cursor = Number.isNaN(time) ? end() : time;
}

// --- time ---

// The moment that the address names, such as #t=12.3: it is shown once the bag has been read that far.
function takeAddress() {
  const named = new URLSearchParams(location.hash.slice(1)).get("t"), time = Number(named);
  page.named = named && time >= 0 && Number.isFinite(time) ? time : null;
  approach();
}

function approach() {
  if (page.named === null || newest() < 0) return;
  const time = page.named, reached = time <= end();
  page.playing = false;
  seek(time);
  page.named = reached ? null : time;
}

function seek(time) {
  page.named = null;
  page.cursor = Math.min(Math.max(0, time), end());
  if (page.live) page.follow = page.cursor >= end() - 0.2;
  redraw();
}

function play(playing) {
  page.named = null;
  page.playing = playing;
  if (playing && !page.live && page.cursor >= end() - store.blockS) page.cursor = 0;
  redraw();
}

function alarm(direction) {
  const starts = page.overview.events.map((event) => event.start).sort((a, b) => a - b);
  const found = direction > 0 ? starts.find((start) => start > page.cursor - 0.9) : starts.reverse().find((start) => start < page.cursor - 1.1);
  if (found !== undefined) jump(found);
}

// To a moment, with what follows it still to come: a second later, so that it is on the charts.
function jump(start) {
  page.named = null;
  page.playing = false;
  if (page.live) page.follow = false;
  page.cursor = Math.min(end(), start + 1);
  redraw();
}

function follow() {
  page.named = null;
  page.follow = page.playing = true;
  followNewest();
  redraw();
}

function advance(now) {
  const passed = Math.min(0.25, (now - page.before) / 1000);
  page.before = now;
  if (page.live ? page.follow || !page.playing : !page.playing) return;
  if (page.cursor >= end()) return;
  page.cursor = Math.min(end(), page.cursor + passed * (page.live ? 1 : Number($("speed").value)));
  if (page.live && page.cursor >= end() - 0.2) page.follow = true;
  redraw();
}

function fetchBlocks() {
  if (!store.vehicle || (page.live && page.follow)) return;
  const at = block(), ahead = Math.round(10 * Math.max(1, Number($("speed").value)) / store.blockS);
  for (const range of store.missing(at - Math.round(60 / store.blockS), at + ahead, newest())) send({id: store.vehicle.id, blocks: range});
}

// --- what it says ---

function showVehicles() {
  const list = $("vehicles"), ids = [...page.vehicles.keys()];
  if (ids.length < 2) { list.replaceChildren(); return; }
  const text = JSON.stringify([...page.vehicles.values()].map((one) => [one.id, one.state]).concat(page.selected));
  if (page.said.vehicles === text) return;
  page.said.vehicles = text;
  list.replaceChildren(...ids.map((id) => {
    const state = page.vehicles.get(id).state;
    const made = element("button", {type: "button", "aria-current": String(id === page.selected)}, `${SIGNS[state]} ${id || "/"}: ${WORDS[state]}`);
    made.addEventListener("click", () => select(id));
    return made;
  }));
}

function showModels() {
  const models = store.vehicle?.models ?? [];
  $("models").tBodies[0].replaceChildren(...models.map((model, k) => {
    const made = element("button", {type: "button", "aria-pressed": String(k === page.chosen)}, model.identity || model.name);
    made.addEventListener("click", () => { page.chosen = k; showModels(); redraw(); });
    // The colour of its lines, where they are drawn beside the chosen one's.
    made.style.borderColor = `var(--${k === page.chosen ? "band" : modelColour(k)})`;
    return element("tr", {}, element("td", {}, made), ...["–", "–", percent(model.confidence)].map((text) => element("td", {}, text)));
  }));
  page.coveredAt = 0;
  const first = models[page.chosen];
  say("model", first ? `${first.identity || first.name}${page.chosen ? " (shown, not the one that gives the alarm)" : ""}` : "–");
  $("model").title = first?.identity ?? "";
}

function showEvents() {
  const text = JSON.stringify(page.overview.events);
  if (page.said.events === text) return;
  page.said.events = text;
  $("events").replaceChildren(...page.overview.events.slice().sort((one, other) => other.start - one.start).map((event) => {
    const made = element("button", {type: "button", title: event.reasons.join("\n")});
    const lasted = event.end === null ? "still on" : seconds(event.end - event.start);
    made.append(element("b", {}, event.cause), ` at ${seconds(event.start)}, ${lasted}: ${event.reasons[0] ?? ""}`);
    made.addEventListener("click", () => jump(event.start));
    return element("li", {}, made);
  }));
}

function showHealth() {
  const rows = [...page.overview.health, ["page", "ok", `${page.rate.toFixed(0)} frames/s`]];
  $("health").tBodies[0].replaceChildren(...rows.map(([about, level, text]) => {
    const sign = {ok: "", warn: "! "}[level] ?? "✕ ";
    return element("tr", {}, element("td", {}, about), element("td", {class: level}, `${sign}${text}`));
  }));
}

function moment() {
  if (page.lost) return {state: NO_DATA, reasons: ["the page has lost its server and is trying again"]};
  const vehicle = here();
  if (!vehicle) return {state: NO_DATA, reasons: [page.live ? "no vehicle publishes predictions or an alarm in this ROS domain" : "reading the bag"]};
  if (page.live && page.follow && page.playing) return vehicle;
  const state = store.recent(block(), "state", 0, 1), [reasons, told] = store.words(block());
  if (Number.isNaN(state)) return {state: NO_DATA, reasons: newest() < 0 ? vehicle.reasons : ["nothing is known of this moment"]};
  return {state, reasons, told};
}

// The time of day at a moment of the flight, where its stamps tell it: those since the start of a computer do not.
function timeOfDay(moment) {
  const [, start] = store.vehicle?.starts.findLast(([begin]) => begin <= moment) ?? [0, 0];
  return start > 1e9 ? new Date(1000 * (start + moment)).toLocaleTimeString([], {hour12: false}) : "";
}

// Live of every vehicle as it comes, of a bag where it is played.
function soundAlarm(id, state) {
  if (state === ALARM && page.sounded.get(id) !== ALARM && (page.live || page.playing) && page.sound) { sound(); page.sounds++; }
  page.sounded.set(id, state);
}

// What battery, autopilot and link say of themselves.
function showTold(told) {
  const text = JSON.stringify(told);
  if (page.said.told === text) return;
  page.said.told = text;
  $("told").replaceChildren(...Object.entries(told).map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value))));
}

function showBanner() {
  const {state, reasons, told} = moment();
  if (!page.live) soundAlarm(page.selected, state);
  say("sound", page.sound ? soundAllowed() ? "Sound on" : "Sound on, once you click" : "Sound off");
  showTold(told ?? {});
  if ($("banner").dataset.state !== String(state)) $("banner").dataset.state = state;
  say("state", WORDS[state]);
  say("sign", SIGNS[state]);
  const words = reasons.length ? reasons : state === 0 ? ["inside what was flown in training"] : [];
  const text = JSON.stringify(words);
  if (page.said.reasons !== text) {
    page.said.reasons = text;
    const shown = words.slice(0, REASONS).map((one) => element("li", {}, one));
    if (words.length > REASONS) shown[REASONS - 1].textContent += `, and ${words.length - REASONS} more`;
    $("reasons").title = words.join("\n");
    $("reasons").replaceChildren(...shown);
  }
  document.title = `${WORDS[state]} · quadpi`;
  say("since", since(state));
  say("time", [seconds(page.cursor), timeOfDay(page.cursor)].filter(Boolean).join(" · "));
  say("play", page.playing ? "Pause" : "Play");
  $("live").setAttribute("aria-pressed", String(page.live && page.follow && page.playing));
}

// How long the state has been this one, by the timeline's bins.
function since(state) {
  const {codes, bin_s: bin} = page.overview;
  let at = Math.min(codes.length - 1, Math.floor(page.cursor / bin));
  if (at < 0 || codes[at] !== String(state)) return "now";
  while (at > 0 && (codes[at - 1] === String(state) || codes[at - 1] === "-")) at--;
  return `${(page.cursor - at * bin).toFixed(0)} s`;
}

function showCoverage(now) {
  // What stands still is drawn once, and has to be right then.
  if (page.playing && now - page.coveredAt < COVERAGE_EVERY_MS) return;
  page.coveredAt = now;
  const models = store.vehicle?.models ?? [], at = block();
  // The axis that is inside least often; of all axes together a bad one would not be seen.
  const worst = ({inside, count}, model) => {
    const held = AXES.map(([name, words], k) => [inside[k], words, name]).filter(([, , name]) => model.axes.includes(name));
    if (!count || !held.length) return "–";
    const [share, words] = held.reduce((least, one) => one[0] < least[0] ? one : least);
    return `${percent(share)} of ${words}`;
  };
  models.forEach((model, number) => {
    const [ten, sixty] = [store.coverage(at, number, 10), store.coverage(at, number, 60)];
    const cells = $("models").tBodies[0].rows[number]?.cells;
    const least = [ten, sixty].map((one) => worst(one, model));
    if (cells) least.forEach((text, k) => { cells[k + 1].textContent = text; });
    if (number !== page.chosen) return;
    say("covered10", least[0]);
    AXES.forEach(([name], k) => {
      const chip = axes[k].covered;
      if (!model.axes.includes(name)) { chip.textContent = "not in this model"; return; }
      chip.textContent = `10 s ${percent(ten.inside[k])} · 60 s ${percent(sixty.inside[k])}`;
      chip.classList.toggle("short", sixty.inside[k] < model.confidence || ten.inside[k] < model.confidence);
    });
  });
}

// --- drawing ---

const axes = AXES.map(([name, words, unit]) => {
  const covered = element("span", {}, "–"), plot = element("div", {class: "plot", role: "img", "aria-label": `${name}, ${words}: measured in its prediction interval`});
  $("axes").append(element("div", {class: "axis"}, element("h2", {}, `${name}  ${words} [${unit}]`, covered), plot));
  return {chart: new TimeChart(plot), covered};
});
const strips = Object.fromEntries(["speed", "height", "rotor"].map((name) => [name, new TimeChart($(`${name}_chart`))]));
const residual = new TimeChart($("residual_chart")), timeline = new Timeline($("timeline")), flight = new SpaceView($("flight"));
const column = (name, k = 0) => store.columns[name][0] + k;
const modelColour = (number) => `model-${1 + number % 6}`;

// Of each axis: measured less the middle of its interval, over half of its width.
function drawResidual() {
  const model = store.vehicle.models[page.chosen], held = AXES.map(([name], k) => [name, k]).filter(([name]) => model?.axes.includes(name));
  const text = held.map(([name]) => name).join();
  if (page.said.residual !== text) {
    page.said.residual = text;
    $("residual_legend").replaceChildren("in half widths: outside ±1 it is a miss", ...held.map(([, k]) => {
      const key = element("b", {}, AXES[k][1]);
      key.style.color = `var(--${modelColour(k)})`;
      return key;
    }));
  }
  const [lower, upper, measured] = [`${page.chosen}.lower`, `${page.chosen}.upper`, "measured"].map((name) => store.columns[name]?.[0]);
  residual.draw(store, page.cursor, [-1, 1].map((edge) => ({of: () => edge, colour: "band", width: 1})).concat(held.map(([, k]) => ({colour: modelColour(k), width: 1.25, of: (rows, at) => {
    const low = rows[at + lower + k], high = rows[at + upper + k], found = (2 * rows[at + measured + k] - low - high) / (high - low);
    return Number.isFinite(found) ? found : null;
  }}))), {band: true, least: 3});
}

function drawAxes() {
  const models = store.vehicle.models, m = page.chosen;
  axes.forEach(({chart}, k) => {
    const measured = {column: column("measured", k), colour: "measured"};
    if (!models[m]?.axes.includes(AXES[k][0])) { chart.draw(store, page.cursor, [measured]); return; }
    const bounds = (model, colour) => ["lower", "upper"].map((name) => ({column: column(`${model}.${name}`, k), colour, width: 1}));
    const others = models.flatMap((_, other) => other === m ? [] : bounds(other, modelColour(other))), predicted = {column: column(`${m}.predicted`, k), colour: "predicted", width: 1.75};
    chart.draw(store, page.cursor, [...bounds(m, "band"), ...others, measured, predicted],
      {band: true, misses: {count: column(`${m}.misses`, k), measured: measured.column, middle: predicted.column}});
  });
}

function drawStrips() {
  const at = block(), value = (name, k = 0) => store.recent(at, name, k, 0.5);
  strips.speed.draw(store, page.cursor, [{column: column("speed"), colour: "model-1"}], {least: 1});
  // Height is up, position is down.
  strips.height.draw(store, page.cursor, [{column: column("position", 2), colour: "model-1", sign: -1}], {least: 1});
  const rotors = [...Array(store.columns.rotors[1]).keys()];
  strips.rotor.draw(store, page.cursor, rotors.map((k) => ({column: column("rotors", k), colour: modelColour(k)})), {least: 20});
  const text = (number, unit, digits) => Number.isNaN(number) ? "" : `${number.toFixed(digits)} ${unit}`;
  say("speed_now", text(value("speed"), "m/s", 1));
  say("height_now", text(-value("position", 2), "m", 1));
  const speeds = rotors.map((k) => value("rotors", k));
  say("rotor_now", speeds.some(Number.isNaN) ? "" : `${speeds.map((speed) => speed.toFixed(0)).join(" · ")} rad/s`);
}

function draw(now) {
  showBanner();
  timeline.draw(page.overview, end(), page.cursor);
  $("timeline").setAttribute("aria-valuemax", end().toFixed(1));
  $("timeline").setAttribute("aria-valuenow", page.cursor.toFixed(1));
  $("picture").disabled = $("csv").disabled = !store.vehicle || !store.width;
  if ($("csv").disabled) return;
  store.prepare(block() - Math.round(COVERED_S / store.blockS), block());
  drawResidual();
  drawAxes();
  drawStrips();
  const farthest = drawEnvelope($("envelope"), store, page.cursor);
  const out = farthest ? Math.round(100 * farthest.out) : 0;
  say("farthest", out > 0 ? `farthest: ${farthest.input.words}, ${out} % of the range outside` : "");
  const flown = flightInSpace(store, page.cursor, page.overview.track.filter(([time]) => time <= page.cursor));
  if (flown) flight.show(flown);
  showCoverage(now);
  store.prepare(0, -1);
  window.quadpi.drawn = {newest: store.recent(block(), "time", 0, 1), state: moment().state, at: Date.now()};
}

function frame(now) {
  advance(now);
  fetchBlocks();
  if (page.urgent) {
    // Another state is painted at once; the figures follow in the next frame.
    page.urgent = false;
    showBanner();
  } else if (page.wanted) {
    page.wanted = false;
    const begun = performance.now();
    draw(now);
    page.drawMs = performance.now() - begun;
    page.frames++;
  }
  if (now - page.rateAt > 2000) {
    page.rate = 1000 * page.frames / (now - page.rateAt);
    page.frames = 0;
    page.rateAt = now;
  }
  requestAnimationFrame(frame);
}

// --- wishes of the user ---

function changeSpeed(step) {
  const list = $("speed");
  list.selectedIndex = Math.min(list.options.length - 1, Math.max(0, list.selectedIndex + step));
}

function theme(name) {
  document.documentElement.dataset.theme = name;
  redraw();
}

$("play").addEventListener("click", () => play(!page.playing));
$("previous").addEventListener("click", () => alarm(-1));
$("next").addEventListener("click", () => alarm(1));
$("live").addEventListener("click", follow);
$("sound").addEventListener("click", () => {
  if (page.sound && !soundAllowed()) { allowSound(redraw); return; }
  page.sound = !page.sound;
  localStorage.setItem("sound", page.sound ? "on" : "off");
  redraw();
});
const called = () => `${page.selected.replaceAll("/", "_").replace(/^_/, "") || "flight"}-${page.cursor.toFixed(1)}s`;
$("picture").addEventListener("click", () => {
  const {state, reasons} = moment();
  const words = [`${WORDS[state]} · ${page.said.title} · ${page.said.time} · ${page.said.model}`, ...reasons];
  savePicture(called(), words, ink(stateColour(state)), [[timeline], [residual], ...[0, 1, 2].map((k) => [axes[k].chart, axes[k + 3].chart]), Object.values(strips)]);
});
$("csv").addEventListener("click", () => {
  const parts = {inputs: store.vehicle.inputs.map(({name}) => name), position: ["north", "east", "down"], attitude: ["w", "x", "y", "z"]};
  saveTable(called(), store, block() - Math.round(WINDOW_S / store.blockS), block(), (quantity) => parts[quantity] ?? (quantity === "rotors" ? null : AXES.map(([name]) => name)));
});
// The button's own gesture is its click's.
for (const gesture of ["pointerup", "keydown"]) addEventListener(gesture, ({key, target}) => { if (!soundAllowed() && key !== "s" && target !== $("sound")) allowSound(redraw); });
$("theme").addEventListener("click", () => theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
let dragging = false;
const seekTo = (event) => {
  const box = $("timeline").getBoundingClientRect();
  seek(end() * (event.clientX - box.left) / box.width);
};
$("timeline").addEventListener("pointerdown", (event) => { dragging = true; $("timeline").setPointerCapture(event.pointerId); seekTo(event); });
$("timeline").addEventListener("pointermove", (event) => { if (dragging) seekTo(event); });
$("timeline").addEventListener("pointerup", () => { dragging = false; });
addEventListener("resize", redraw);
addEventListener("hashchange", takeAddress);
addEventListener("keydown", (event) => {
  if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
  const step = event.shiftKey ? 10 : 1;
  const keys = {
    " ": () => play(!page.playing), ArrowLeft: () => seek(page.cursor - step), ArrowRight: () => seek(page.cursor + step),
    p: () => alarm(-1), n: () => alarm(1), l: () => page.live && follow(), "[": () => changeSpeed(-1), "]": () => changeSpeed(1),
    t: () => $("theme").click(), s: () => $("sound").click(), g: () => $("picture").click(), c: () => $("csv").click(), Home: () => seek(0), End: () => seek(end()),
  };
  const number = Number(event.key);
  if (number >= 1 && number <= page.vehicles.size) select([...page.vehicles.keys()][number - 1]);
  else if (keys[event.key] && !(event.key === " " && event.target.tagName === "BUTTON")) keys[event.key]();
  else return;
  event.preventDefault();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", ({matches}) => theme(matches ? "dark" : "light"));
theme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
takeAddress();
connect();
requestAnimationFrame(frame);
