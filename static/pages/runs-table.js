// The table of runs: only the rows in view exist; pages of the list are fetched as they are scrolled to.

import { h, icon, s } from "../lib/dom.js";
import { bias, count, duration, hertz, length, show, when } from "../lib/format.js";
import { swatch, methodStyle } from "../lib/methods.js";

const OVERSCAN = 8;
const SHORT = { commands: "cmd", wheels: "whl", imu: "imu", beacon: "bcn", ranges: "rng", truth: "tru" };

export const COLUMNS = [
  { key: "select", label: "", cell: selectCell },
  { key: "path", label: "Path", term: "path", cell: (run) => sparkline(run.sparkline) },
  { key: "name", label: "Name", term: "name", sort: "name", cell: nameCell },
  { key: "when", label: "When", term: "when", sort: "created_at", cell: (run) => show(when(run.created_at)) },
  { key: "length", label: "Length", term: "length", sort: "duration_s", num: true, cell: (run) => show(duration(run.duration_s)) },
  { key: "streams", label: "Streams", term: "streams", cell: (run) => streamChips(run.streams) },
  { key: "best", label: "Best error", term: "best_error", sort: "best_ate_m", num: true, cell: bestCell },
  { key: "bias", label: "Bias drift", term: "bias_drift", sort: "bias_drift_rad_s", num: true, cell: (run) => show(bias(run.bias_drift_rad_s)) },
  { key: "verdict", label: "Verdict", term: "verdict", sort: "verdict", cell: (run) => (run.verdict ? h("span", { class: "chip", "data-verdict": run.verdict }, { none: "no gap", partly_explained: "partly explained", unknown: "unknown cause" }[run.verdict] ?? run.verdict) : "") },
];

function selectCell(run, table) {
  const box = h("input", { type: "checkbox", "aria-label": `Select ${run.name}`, checked: table.selected.has(run.id) });
  box.addEventListener("change", () => table.select(run.id, box.checked));
  return h("label", {}, box);
}

/** A path of [x, y] points [m] as a small picture; its first point is marked. */
export function sparkline(points, width = 56, height = 32) {
  if (!points || points.length < 2) return h("span", { class: "dim" }, "");
  const xs = points.map((p) => p[0]);
  const ys = points.map((p) => p[1]);
  const [x0, y0] = [Math.min(...xs), Math.min(...ys)];
  const scale = Math.min((width - 6) / (Math.max(...xs) - x0 || 1e-9), (height - 6) / (Math.max(...ys) - y0 || 1e-9));
  const [dx, dy] = [(width - (Math.max(...xs) - x0) * scale) / 2, (height - (Math.max(...ys) - y0) * scale) / 2];
  const at = points.map(([x, y]) => [dx + (x - x0) * scale, height - dy - (y - y0) * scale].map((v) => v.toFixed(1)));
  return s(
    "svg",
    { class: "spark", viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" },
    s("path", { d: `M${at.join("L")}` }),
    s("circle", { cx: at[0][0], cy: at[0][1], r: 2 }),
  );
}

function nameCell(run, table) {
  const add = h("button", { class: "tag-add", type: "button", "aria-label": `Edit tags of ${run.name}`, onclick: () => table.editTags(run.id) }, icon("tag"));
  return [
    h("div", { class: "run-name" }, h("a", { class: "clip", href: `/runs/${run.id}` }, run.name), run.is_live && h("a", { class: "chip green live-chip", href: `/live/${encodeURIComponent(run.robot)}`, "data-hint": "A robot still streams it. Click: its monitor." }, "● live"), run.is_example && h("span", { class: "chip absent" }, "example"), warningMark(run)),
    table.editing === run.id ? tagEditor(run, table) : h("div", { class: "run-sub" }, run.robot && h("button", { class: "run-robot clip", type: "button", onclick: () => table.filter("robot", run.robot) }, run.robot), run.tags.map((t) => h("button", { class: "chip tag", type: "button", onclick: () => table.filter("tag", t) }, t)), add),
  ];
}

function warningMark(run) {
  if (!run.warnings?.length) return null;
  return h("span", { class: "warn-mark", "data-hint": run.warnings.join(" "), tabindex: "0" }, icon("warn"));
}

function tagEditor(run, table) {
  const input = h("input", { class: "tag-input", value: run.tags.join(", "), placeholder: "wet, night", "aria-label": `Tags of ${run.name}, commas between` });
  const done = () => table.saveTags(run.id, input.value.split(",").map((t) => t.trim()).filter(Boolean));
  input.addEventListener("keydown", (event) => {
    if (event.key === "Enter") done();
    else if (event.key === "Escape") table.editTags(null);
    else return;
    event.preventDefault();
    event.stopPropagation();
  });
  input.addEventListener("blur", () => table.editing === run.id && done());
  queueMicrotask(() => input.focus());
  return input;
}

/** One chip per stream of the format: dashed where absent, amber where the stamps pause. */
export function streamChips(streams) {
  const found = new Map(streams.map((x) => [x.name, x]));
  return h(
    "span",
    { class: "chips" },
    Object.entries(SHORT).map(([name, short]) => {
      const stream = found.get(name);
      if (!stream) return h("span", { class: "chip absent", "data-hint": `No ${name}.` }, short);
      const gaps = stream.gaps ? ` The stamps pause ${stream.gaps} ${stream.gaps === 1 ? "time" : "times"}.` : "";
      const rows = `${name}: ${count(stream.rows)} rows at ${hertz(stream.rate_hz).text}, ${(stream.columns ?? []).join(", ")}.`;
      return h("span", { class: stream.gaps ? "chip amber" : "chip", "data-hint": rows + gaps }, short);
    }),
  );
}

function bestCell(run) {
  if (!run.best) return h("span", { class: "dim" }, "–");
  const label = methodStyle(run.best.method).label;
  return [h("span", { class: "best-method", "data-hint": `By ${label}.` }, swatch(run.best.method)), show(length(run.best.ate_rmse_m), "best_error")];
}

export class RunTable {
  /** callbacks: more(index) fetches rows up to an index; open(id), selection(set), filter(key, value), saveTags(id, tags), sort(key) */
  constructor(scroll, table, callbacks) {
    Object.assign(this, { scroll, table, callbacks, items: [], total: 0, selected: new Set(), active: -1, editing: null, rows: new Map(), sortKey: "" });
    this.head = table.tHead;
    this.body = table.tBodies[0];
    this.before = h("tr", { class: "spacer", "aria-hidden": "true" });
    this.after = h("tr", { class: "spacer", "aria-hidden": "true" });
    this.frame = 0;
    scroll.addEventListener("scroll", () => this.later(), { passive: true });
    new ResizeObserver(() => this.later()).observe(scroll);
    this.body.addEventListener("click", (event) => this.click(event));
  }

  get rowHeight() {
    this.height ??= parseFloat(getComputedStyle(this.table).getPropertyValue("--row")) || 46;
    return this.height;
  }

  filter(key, value) {
    this.callbacks.filter(key, value);
  }

  saveTags(id, tags) {
    this.editing = null;
    this.callbacks.saveTags(id, tags);
  }

  editTags(id) {
    const before = this.editing;
    this.editing = id;
    for (const changed of [before, id]) this.redraw(changed);
    if (id === null) this.scroll.focus({ preventScroll: true });
  }

  /** New content. `keep` leaves the scroll position and the active row where they are. */
  set({ items, total, sort, keep = false, columns = COLUMNS }) {
    const activeId = this.items[this.active]?.id;
    const top = keep ? this.scroll.scrollTop : 0; // read before rows go: a shorter table would move it
    Object.assign(this, { items, total, sortKey: sort, columns });
    this.active = activeId ? items.findIndex((r) => r.id === activeId) : -1;
    this.clear();
    this.paintHead();
    this.paint(top);
    this.scroll.scrollTop = top;
  }

  /** More rows at the end; those that were shown as pending are drawn. */
  append(items) {
    const known = this.items.length;
    this.items.push(...items);
    for (const i of [...this.rows.keys()]) if (i >= known) this.renew(i);
    this.paint();
  }

  /** Draw a row again in its place. */
  renew(i) {
    const before = this.rows.get(i);
    if (!before) return;
    this.rows.set(i, this.row(i));
    before.replaceWith(this.rows.get(i));
  }

  replace(run) {
    const i = this.items.findIndex((r) => r.id === run.id);
    if (i >= 0) this.items[i] = { ...this.items[i], ...run };
    this.redraw(run.id);
  }

  clear() {
    for (const row of this.rows.values()) row.remove();
    this.rows.clear();
  }

  redraw(id) {
    this.renew(this.items.findIndex((r) => r.id === id));
  }

  later() {
    this.frame ||= requestAnimationFrame(() => {
      this.frame = 0;
      this.paint();
    });
  }

  paintHead() {
    const all = h("input", { type: "checkbox", "aria-label": "Select none" , checked: this.selected.size > 0, disabled: this.selected.size === 0 });
    all.addEventListener("change", () => this.selectNone());
    const cells = this.columns.map((c) => {
      if (c.key === "select") return h("th", { class: "col-select", scope: "col" }, h("label", {}, all));
      const down = this.sortKey === `-${c.sort}`;
      const sorted = c.sort && (down || this.sortKey === c.sort);
      const order = sorted ? (down ? "descending" : "ascending") : undefined;
      const label = c.sort
        ? h("button", { type: "button", "data-term": c.term, onclick: () => this.callbacks.sort(c.sort) }, c.label, h("span", { class: "arrow", "aria-hidden": "true" }, sorted ? (down ? "↓" : "↑") : ""))
        : h("span", { "data-term": c.term }, c.label);
      return h("th", { class: `col-${c.key}${c.num ? " num" : ""}`, scope: "col", "aria-sort": order }, label);
    });
    this.head.replaceChildren(h("tr", {}, cells));
  }

  paint(top = this.scroll.scrollTop) {
    const height = this.rowHeight;
    const first = Math.max(0, Math.floor(top / height) - OVERSCAN);
    const last = Math.min(this.total, Math.ceil((top + this.scroll.clientHeight) / height) + OVERSCAN);
    for (const [i, row] of this.rows) {
      if (i >= first && i < last) continue;
      if (row.contains(document.activeElement) && this.editing) continue;
      row.remove();
      this.rows.delete(i);
    }
    if (!this.before.isConnected) this.body.replaceChildren(this.before, this.after);
    let next = this.before.nextSibling;
    for (let i = first; i < last; i++) {
      if (!this.rows.has(i)) this.rows.set(i, this.row(i));
      const row = this.rows.get(i);
      if (row === next) next = next.nextSibling;
      else this.body.insertBefore(row, next);
    }
    this.before.style.height = `${first * height}px`;
    this.after.style.height = `${Math.max(0, this.total - last) * height}px`;
    this.table.setAttribute("aria-rowcount", String(this.total));
    if (last > this.items.length && this.items.length < this.total) this.callbacks.more(last);
  }

  row(i) {
    const run = this.items[i];
    if (!run) return h("tr", { class: "pending", "aria-rowindex": i + 1 }, h("td", { colspan: this.columns.length }, h("span", { class: "dim" }, "…")));
    const cells = this.columns.map((c) => h("td", { class: `col-${c.key}${c.num ? " num" : ""}` }, c.cell(run, this)));
    const state = `${i === this.active ? "active " : ""}${this.selected.has(run.id) ? "selected" : ""}`;
    return h("tr", { class: state, "data-run": run.id, "aria-rowindex": i + 1, "aria-selected": String(this.selected.has(run.id)) }, cells);
  }

  click(event) {
    const row = event.target.closest("tr[data-run]");
    if (!row || event.target.closest("a, button, input, label")) return;
    if (getSelection()?.toString()) return; // copying text is not opening
    if (event.ctrlKey || event.metaKey) this.select(row.dataset.run, !this.selected.has(row.dataset.run));
    else this.callbacks.open(row.dataset.run);
  }

  select(id, yes) {
    if (yes) this.selected.add(id);
    else this.selected.delete(id);
    this.redraw(id);
    this.paintHead();
    this.callbacks.selection(this.selected);
  }

  selectNone() {
    this.selected.clear();
    for (const i of [...this.rows.keys()]) this.renew(i);
    this.paintHead();
    this.callbacks.selection(this.selected);
  }

  /** Move the active row by `step`, into view. */
  move(step) {
    const to = Math.max(0, Math.min(this.total - 1, this.active + step));
    if (this.total === 0) return;
    const from = this.active;
    this.active = to;
    for (const i of [from, to]) this.renew(i);
    const height = this.rowHeight;
    const top = to * height;
    const view = this.scroll.clientHeight - this.head.offsetHeight;
    if (top < this.scroll.scrollTop) this.scroll.scrollTop = top;
    else if (top + height > this.scroll.scrollTop + view) this.scroll.scrollTop = top + height - view;
    this.paint();
  }

  get activeRun() {
    return this.items[this.active] ?? null;
  }
}
