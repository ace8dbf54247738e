// Consistency: does a method know its own errors? NIS per sensor and NEES with chi-square bands, whiteness, what R should be.

import { api, problemNote, query } from "../lib/api.js";
import { copyText } from "../lib/chart-export.js";
import { createChart } from "../lib/chart.js";
import { h, save } from "../lib/dom.js";
import { count, number, percent, show } from "../lib/format.js";
import { methodStyle, sortMethods } from "../lib/methods.js";
import { methodSwatch } from "./run-methods.js";

export function mountConsistency(host, context) {
  const { state, estimates, data } = context;
  const judged = estimates().filter((e) => e.sensors.length || e.columns.includes("nees"));
  const box = h("div", { id: "consistency" });
  host.append(box);
  let charts = [];
  let events = [];
  let alive = true;

  const methods = sortMethods(judged.map((e) => e.method));
  const chosen = () => (methods.includes(state.by) ? state.by : [data.lead, "fused", ...methods].find((m) => methods.includes(m)));

  async function paint() {
    for (const chart of charts) chart.destroy();
    charts = [];
    if (!judged.length) {
      box.replaceChildren(h("div", { class: "calm" }, h("h2", {}, "Nothing to judge"), h("p", {}, estimates().length ? "No path of this run predicts readings or states an uncertainty; those made by an older version are judged once “Estimate again” has run." : "No path has been estimated yet.")));
      return;
    }
    const estimate = judged.find((e) => e.method === chosen());
    const fetched = fetcher(estimate.id);
    try {
      const whole = await fetched({});
      if (alive && estimate.method === chosen()) draw(estimate, whole, fetched);
    } catch (error) {
      if (alive) box.replaceChildren(problemNote(error));
    }
  }

  function draw(estimate, whole, fetched) {
    const chips = methods.map((m) => h("button", { type: "button", class: "method", "data-method": m, "aria-pressed": String(m === estimate.method), onclick: () => state.set("by", m) }, methodSwatch(m), methodStyle(m).label));
    box.replaceChildren(h("div", { class: "methods choice", role: "group", "aria-label": "Method judged" }, chips), h("p", { class: "cons-verdict", id: "cons-verdict" }, whole.sentence), figures(whole, context));
    for (const sensor of whole.sensors) sensorSection(sensor, estimate, fetched);
    if (whole.nees) neesSection(whole.nees, estimate, fetched);
    for (const chart of charts) if (chart.spec.clock) chart.setEvents(events);
    box.dataset.method = estimate.method;
  }

  function plot(row, spec, big) {
    const cell = h("div", { class: "cons-plot", "data-cons": spec.id });
    row.append(cell);
    cell.classList.toggle("enlarged", state.big === spec.id);
    const enlarge = big && { onEnlarge: () => state.set("big", state.big === spec.id ? null : spec.id) };
    charts.push(createChart(cell, { subject: context.run.name, fileName: `${context.fileName}-${chosen()}`, ...enlarge, ...spec }));
  }

  function sensorSection(sensor, { method }, fetched) {
    const { color } = methodStyle(method);
    const row = h("div", { class: sensor.whiteness ? "cons-row" : "cons-row alone" });
    const heading = h("span", { class: "dim" }, `${count(sensor.readings)} readings, ${count(sensor.rejected)} refused${sensor.at_rest ? `, ${count(sensor.at_rest)} more at rest are left out` : ""}, ${sensor.dof} ${sensor.dof === 1 ? "degree" : "degrees"} of freedom`);
    box.append(h("section", { class: "cons-sensor", "data-sensor": sensor.sensor }, h("div", { class: "block-head" }, h("h2", {}, capital(sensor.label)), heading), row));
    const id = `nis-${sensor.sensor.replace(".", "-")}`;
    plot(row, {
      id,
      title: "Running mean NIS",
      term: "nis_running",
      unit: "",
      log: { y: true },
      clock: context.clock,
      series: [
        { key: "nis", label: "mean of accepted", color, csv: `${method} mean NIS ${sensor.sensor}` },
        { key: "expected", label: "expected", color: "--ink-3", dash: [4, 3], width: 1 },
        { key: "refused", label: "refused", color: "--red", style: "marks", mark: "cross", scale: false },
      ],
      load: async (wish) => running((await fetched(wish)).sensors.find((s) => s.sensor === sensor.sensor), context.clock.full),
    }, true);
    if (sensor.whiteness) plot(row, whitenessSpec(id, sensor, color));
  }

  function neesSection(nees, { method }, fetched) {
    const row = h("div", { class: "cons-row alone" });
    const heading = h("span", { class: "dim" }, `against truth, ${nees.dof} degrees of freedom`);
    box.append(h("section", { class: "cons-sensor", "data-sensor": "nees" }, h("div", { class: "block-head" }, h("h2", {}, "Claimed uncertainty"), heading), row));
    plot(row, {
      id: "nees",
      title: "NEES",
      term: "nees",
      unit: "",
      log: { y: true },
      clock: context.clock,
      series: [
        { key: "nees", label: "NEES", color: methodStyle(method).color, width: 1.1, csv: `${method} NEES` },
        { key: "expected", label: "expected", color: "--ink-3", dash: [4, 3], width: 1 },
      ],
      load: async (wish) => neesCurve((await fetched(wish)).nees, context.clock.full),
    }, true);
  }

  const off = state.subscribe((what) => {
    if (what === "by") paint();
    if (what === "big") for (const cell of box.querySelectorAll("[data-cons]")) cell.classList.toggle("enlarged", state.big === cell.dataset.cons);
  });
  paint();
  return {
    setEvents(list) {
      events = list;
      for (const chart of charts) if (chart.spec.clock) chart.setEvents(list);
    },
    destroy() {
      alive = false;
      off();
      for (const chart of charts) chart.destroy();
      box.remove();
    },
  };
}

// One answer for all plots that ask for the same range.
function fetcher(id) {
  const cache = new Map();
  return ({ t0, t1, whole = true }) => {
    const key = query(whole ? {} : { t0, t1 });
    if (!cache.has(key)) {
      if (cache.size > 8) cache.delete([...cache.keys()][1]);
      const asked = api(`estimates/${id}/consistency?${key}`);
      asked.catch(() => cache.delete(key));
      cache.set(key, asked);
    }
    return cache.get(key);
  };
}

const positive = (values) => values.map((v) => (v > 0 ? v : null));
const flat = ([a, b], value) => ({ t: [a, b], y: [value, value], total: 0, shown: 0 });
const bandOf = (span, [lo, hi]) => ({ t: span, lo: [lo, lo], hi: [hi, hi], fit: true });

function running({ running: r, dof }, span) {
  const top = Math.max(r.band[1], ...r.mean.map((v) => v ?? 0));
  return {
    series: {
      nis: { ...broken(r.t, positive(r.mean)), total: r.readings - r.rejected, shown: r.t.length },
      expected: flat(span, dof),
      refused: { t: r.rejected_t, y: r.rejected_t.map(() => top), total: r.rejected, shown: r.rejected_t.length },
    },
    bands: { expected: bandOf(span, r.band) },
    gaps: [],
  };
}

// No line over a stretch without readings, as where the wheels stood.
function broken(t, y) {
  const steps = t.slice(1).map((v, i) => v - t[i]).sort((a, b) => a - b);
  const longest = 5 * (steps[steps.length >> 1] ?? 0);
  const out = { t: [], y: [] };
  t.forEach((v, i) => {
    if (i && v - t[i - 1] > longest) [out.t, out.y].forEach((column, k) => column.push(k ? null : (v + t[i - 1]) / 2));
    out.t.push(v);
    out.y.push(y[i]);
  });
  return out;
}

function neesCurve(nees, span) {
  return { series: { nees: { t: nees.t, y: positive(nees.y), total: nees.total, shown: nees.shown }, expected: flat(span, nees.dof) }, bands: { expected: bandOf(span, nees.band) }, gaps: [] };
}

function whitenessSpec(id, { whiteness: w, sensor }, color) {
  const lags = w.autocorrelation.map((_, i) => i + 1);
  const ends = [0.4, lags.length + 0.6];
  return {
    id: `${id}-white`,
    title: "Whiteness",
    term: "whiteness",
    unit: "",
    zero: true,
    domain: ends,
    xLabel: "lag",
    xUnit: "",
    series: [{ key: "r", label: "autocorrelation", color, style: "bars", csv: `autocorrelation ${sensor}` }],
    load: async () => ({ series: { r: { t: lags, y: w.autocorrelation, total: lags.length, shown: lags.length } }, bands: { r: { t: ends, mid: [0, 0], sd: [w.limit / 2, w.limit / 2] } }, gaps: [] }),
  };
}

// [key, heading, value of a sensor, how it is told]
const COLUMNS = [
  ["nis_readings", "Readings", (s) => s.readings, count],
  ["nis_refused", "Refused", (s) => s.rejected / Math.max(s.readings, 1), (v) => show(percent(v))],
  ["nis_mean", "Mean NIS", (s) => s.mean, number],
  ["nis_band", "95 % band", (s) => s.band, (b) => `${number(b[0])} to ${number(b[1])}`],
  ["whiteness", "White, p", (s) => s.whiteness?.p_value, (p) => (p < 0.001 ? "< 0.001" : number(p, 2))],
  ["nis_effective", "Independent", (s) => s.whiteness?.effective, (v) => count(v)],
  ["advice", "R should be", (s) => s.advice, (a) => (a.fits ? "as it is" : !a.single ? `no one value: × ${number(a.factor, 2)} to ${number(a.wide, 2)}` : `× ${number(a.factor, 2)} (${number(a.low, 2)} to ${number(a.high, 2)})`)],
];

function figures({ sensors, nees }, { fileName }) {
  if (!sensors.length) return neesLine(nees);
  const cell = (s) => ([key, , of, tell]) => {
    const v = of(s) ?? null;
    const outside = (key === "nis_mean" && v !== null && (v < s.band[0] || v > s.band[1])) || (key === "advice" && v && !v.fits);
    return h("td", { class: outside ? "num off" : "num" }, v === null ? "–" : tell(v));
  };
  const rows = sensors.map((s) => h("tr", { "data-sensor-row": s.sensor }, h("th", { scope: "row" }, capital(s.label)), COLUMNS.map(cell(s))));
  const csv = () => [["sensor", "dof", "readings", "refused", "mean_nis", "band_low", "band_high", "p_white", "effective_readings", "r_factor", "r_low", "r_high", "r_wide", "at_rest"], ...sensors.map((s) => [s.sensor, s.dof, s.readings, s.rejected, s.mean, ...(s.band ?? ["", ""]), s.whiteness?.p_value, s.whiteness?.effective, s.advice?.factor, s.advice?.low, s.advice?.high, s.advice?.wide, s.at_rest])].map((r) => r.map((v) => v ?? "").join(",")).join("\r\n") + "\r\n";
  const copy = h("button", { type: "button", class: "button quiet", "data-hint": "The table" }, "Copy CSV");
  copy.addEventListener("click", async () => (copy.textContent = (await copyText(csv())) ? "Copied" : "Use the file"));
  const file = h("button", { type: "button", class: "button quiet", "data-hint": "The table as a file", onclick: () => save(new Blob([csv()], { type: "text/csv" }), `${fileName}-consistency.csv`) }, "CSV file");
  const heads = COLUMNS.map(([key, label]) => h("th", { class: "num", scope: "col", "data-term": key }, label));
  return h(
    "section",
    { class: "block", "aria-label": "Figures" },
    h("div", { class: "block-head" }, h("h2", {}, "Sensors by figures"), copy, file),
    h("div", { class: "metrics-scroll" }, h("table", { class: "table metrics cons-table", id: "cons-figures" }, h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Sensor"), heads)), h("tbody", {}, rows))),
    nees ? neesLine(nees) : h("p", { class: "dim" }, "No NEES: there is no truth to hold the claimed uncertainty against."),
  );
}

function neesLine(nees) {
  return h("p", {}, h("span", { "data-term": "nees" }, "NEES"), ` ${number(nees.mean)} on average (${nees.dof} expected); `, h("span", { "data-term": "nees_inside" }, `${number(100 * nees.inside)} % of stamps inside the claimed 95 %`), ".");
}

const capital = (text) => text[0].toUpperCase() + text.slice(1);
