// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Blocks of one vehicle as they come, in pages of which the browser keeps a bounded number.

const PAGE = 200;
const PAGES_KEPT = 20;
const LEAST_COVERED_S = 2;

export class Store {
  constructor() { this.clear(); }

  clear() {
    this.pages = new Map();
    this.vehicle = null;
    this.columns = {};
    this.width = 0;
    this.blockS = 0.05;
    this.asked = new Map();
    this.places = [];
    this.first = Infinity;
  }

  // Take the description of a vehicle; blocks of other columns are worth nothing.
  describe(vehicle) {
    const width = Math.max(...Object.values(vehicle.columns).map(([place, count]) => place + count));
    if (!this.vehicle || this.vehicle.id !== vehicle.id || width !== this.width) this.pages.clear();
    this.vehicle = vehicle;
    this.columns = vehicle.columns;
    this.width = width;
    this.blockS = vehicle.block_s;
  }

  page(number, make) {
    let page = this.pages.get(number);
    if (!page && make) {
      page = {rows: new Float32Array(PAGE * this.width).fill(NaN), words: [], known: 0};
      this.pages.set(number, page);
      if (this.pages.size > PAGES_KEPT) this.pages.delete(this.pages.keys().next().value);
    }
    return page;
  }

  // Take a binary message: length of its head, head, rows.
  take(buffer) {
    const length = new DataView(buffer).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    if (!this.vehicle || head.id !== this.vehicle.id || head.version !== this.vehicle.version) return null;
    const rows = new Float32Array(buffer, 4 + length);
    for (let k = 0; k < head.count; k++) {
      const block = head.first + k, page = this.page(Math.floor(block / PAGE), true);
      page.rows.set(rows.subarray(k * this.width, (k + 1) * this.width), (block % PAGE) * this.width);
      page.known = Math.max(page.known, (block % PAGE) + 1);
    }
    const last = head.first + head.count - 1;
    for (let number = Math.floor(head.first / PAGE); number * PAGE <= last; number++) {
      const page = this.page(number, true), begin = number * PAGE;
      const fresh = head.words.filter(([block]) => block < begin + PAGE);
      // The words, and what is told beside them, that held before the page are kept at its beginning.
      page.words = page.words.filter(([block]) => block < head.first || block > last);
      for (const one of fresh) {
        if (one[0] >= begin) page.words.push(one);
        else page.words = [one, ...page.words.filter(([other]) => other >= begin)];
      }
      page.words.sort((one, other) => one[0] - other[0]);
    }
    return head;
  }

  // Ranges of blocks that are needed and not here, each asked for once in a while.
  missing(first, last, newest) {
    const wanted = [], now = performance.now();
    for (let number = Math.floor(Math.max(0, first) / PAGE); number * PAGE <= Math.min(last, newest); number++) {
      const page = this.pages.get(number), there = Math.min(PAGE, newest + 1 - number * PAGE);
      if (page && page.known >= there) continue;
      if (now - (this.asked.get(number) ?? -1e9) < 400) continue;
      this.asked.set(number, now);
      wanted.push([number * PAGE, number * PAGE + PAGE - 1]);
    }
    return wanted;
  }

  // Look up the places of a range once, for all figures that draw it.
  prepare(first, last) {
    this.first = Infinity;
    const places = [];
    for (let block = Math.max(0, first); block <= last; block++) places.push(this.at(block));
    this.places = places;
    this.first = Math.max(0, first);
  }

  // Place of a block in the rows of its page: [rows, offset], or null.
  at(block) {
    if (block >= this.first && block < this.first + this.places.length) return this.places[block - this.first];
    const page = block < 0 ? null : this.pages.get(Math.floor(block / PAGE));
    return page ? [page.rows, (block % PAGE) * this.width] : null;
  }

  value(block, name, k = 0) {
    const place = this.at(block), column = this.columns[name];
    return place && column ? place[0][place[1] + column[0] + k] : NaN;
  }

  // The last value of a quantity at most `seconds` before a block.
  recent(block, name, k = 0, seconds = 1) {
    const least = Math.max(0, block - Math.ceil(seconds / this.blockS));
    for (let at = block; at >= least; at--) {
      const value = this.value(at, name, k);
      if (!Number.isNaN(value)) return value;
    }
    return NaN;
  }

  words(block) {
    for (const number of [Math.floor(block / PAGE), Math.floor(block / PAGE) - 1]) {
      const page = this.pages.get(number);
      for (let k = (page?.words.length ?? 0) - 1; k >= 0; k--) if (page.words[k][0] <= block) return page.words[k].slice(1);
    }
    return [[], {}];
  }

  // Share of the samples inside the interval: of each axis, over the seconds before a block. As `BlockStore.inside`:
  // blocks that are not judged do not count, and of less than 2 s nothing is said.
  coverage(block, model, seconds) {
    const misses = new Array(6).fill(0), first = Math.max(0, block - Math.round(seconds / this.blockS) + 1);
    let count = 0, blocks = 0;
    const [countAt] = this.columns[`${model}.count`] ?? [], [missesAt] = this.columns[`${model}.misses`] ?? [];
    if (countAt === undefined) return {count, inside: misses.map(() => NaN)};
    for (let at = first; at <= block; at++) {
      const place = this.at(at);
      if (!place || Number.isNaN(place[0][place[1] + countAt]) || place[0][place[1] + this.columns.judged[0]] !== 1) continue;
      blocks++;
      count += place[0][place[1] + countAt];
      for (let k = 0; k < 6; k++) misses[k] += place[0][place[1] + missesAt + k];
    }
    if (blocks * this.blockS < LEAST_COVERED_S - 1e-6) count = 0;
    return {count, inside: misses.map((missed) => count ? 1 - missed / count : NaN)};
  }
}
