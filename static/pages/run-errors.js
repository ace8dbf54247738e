// Small multiples: position error, heading error, gyro bias; one line per method, the claimed deviation as a band.

import { api, query } from "../lib/api.js";
import { createChart } from "../lib/chart.js";
import { lowerBound } from "../lib/chart-data.js";
import { h } from "../lib/dom.js";
import { inDrawOrder } from "../lib/map-view.js";
import { methodStyle } from "../lib/methods.js";

const DEG = 180 / Math.PI;

// `band`: the claimed deviation of this quantity, out of an estimate's columns; `around`: what the band lies about.
export const QUANTITIES = {
  "error-xy": { title: "Position error", term: "error_xy", column: "error_xy", unit: "m", si: "m", factor: 1, zero: true, band: ["sd_x", "sd_y"], absent: (run) => `No position error: ${withoutTruth(run, "x", "positions")}.` },
  "error-theta": { title: "Heading error", term: "error_theta", column: "error_theta", unit: "°", si: "rad", factor: DEG, band: ["sd_theta"], absent: (run) => `No heading error: ${withoutTruth(run, "theta", "heading")}.` },
  bias: { title: "Gyro bias", term: "gyro_bias", column: "bias", unit: "°/h", si: "rad/s", factor: DEG * 3600, band: ["bias_sd"], around: "bias", settle: true, absent: (run) => `No gyro bias: ${run.streams.some((s) => s.name === "imu") ? "no method that ran estimates one" : "this run has no gyro"}.` },
};

function withoutTruth(run, column, what) {
  const truth = run.streams.find((s) => s.name === "truth");
  if (!truth) return "this run has no truth to compare with";
  return truth.columns.some((c) => c.name === column) ? "no path gives one where there is truth" : `the truth has no ${what}`;
}

export function estimateChart(host, id, { run, clock, state, estimates, lead, fileName }, extra = {}) {
  const q = QUANTITIES[id];
  const having = estimates().filter((e) => e.columns.includes(q.column));
  const series = having.map(({ method }) => {
    const { label, color, dash, width } = methodStyle(method);
    return { key: method, label, color, dash, width, on: state.isVisible(method), csv: `${method} ${q.column}` };
  });
  return createChart(host, {
    id,
    title: q.title,
    term: q.term,
    unit: q.unit,
    siUnit: q.si,
    siFactor: 1 / q.factor,
    zero: q.zero,
    settle: q.settle,
    subject: run.name,
    fileName,
    clock,
    series: inDrawOrder(series),
    bandFor: (visible) => [lead(), "smoothed", "fused", ...visible].find((m) => visible.includes(m) && hasBand(having, m, q)),
    onToggle: (key) => state.toggle(key),
    load: (wish) => load(having, q, wish),
    ...extra,
  });
}

const hasBand = (having, method, q) => q.band.every((c) => having.find((e) => e.method === method)?.columns.includes(c));

async function load(having, q, { t0, t1, whole, points, signal }) {
  const answer = { series: {}, bands: {}, gaps: [] };
  const window = whole ? {} : { t0, t1 };
  const one = async (e) => {
    const banded = q.band.every((c) => e.columns.includes(c));
    const columns = [q.column, ...(banded ? q.band : [])].join(",");
    const got = await api(`estimates/${e.id}/series?${query({ columns, points, ...window })}`, { signal });
    const by = Object.fromEntries(got.series.map((s) => [s.column, s]));
    if (!by[q.column]) return;
    answer.series[e.method] = scaled(by[q.column], q.factor);
    if (banded) answer.bands[e.method] = band(by, q);
  };
  await Promise.all(having.map(one));
  return answer;
}

const scaled = (s, factor) => ({ t: s.t, y: s.y.map((v) => (v === null ? null : v * factor)), total: s.total, shown: s.shown });

// The deviation was thinned by itself: it is smooth, so it may be read off between its points.
function band(by, q) {
  const line = by[q.around ?? q.band[0]];
  const sd = line.t.map((t) => Math.hypot(...q.band.map((c) => between(by[c], t))) * q.factor);
  return { t: line.t, mid: q.around ? line.y.map((v) => (v === null ? null : v * q.factor)) : line.t.map(() => 0), sd };
}

function between({ t, y }, time) {
  const i = lowerBound(t, time);
  if (i === 0) return y[0] ?? 0;
  if (i >= t.length) return y[t.length - 1] ?? 0;
  const share = (time - t[i - 1]) / (t[i] - t[i - 1]);
  return (y[i - 1] ?? 0) * (1 - share) + (y[i] ?? 0) * share;
}

export function mountMultiples(host, context) {
  const { state } = context;
  const charts = [];
  const cells = new Map();
  const grid = h("div", { class: "multiples" });
  host.append(grid);
  const absent = h("p", { class: "dim multiples-absent" });
  for (const [id, q] of Object.entries(QUANTITIES)) {
    if (!context.estimates().some((e) => e.columns.includes(q.column))) {
      absent.append(`${q.absent(context.run)} `);
      continue;
    }
    const cell = h("div", { class: "multiple", "data-multiple": id });
    grid.append(cell);
    cells.set(id, cell);
    charts.push(estimateChart(cell, id, context, { onEnlarge: () => state.set("big", state.big === id ? null : id) }));
  }
  if (absent.textContent) host.append(absent);
  const size = () => {
    for (const [id, cell] of cells) cell.classList.toggle("enlarged", state.big === id);
  };
  size();
  const off = state.subscribe((what, method) => {
    if (what === "big") size();
    if (what === "methods") for (const chart of charts) chart.setVisible(method, state.isVisible(method));
  });
  return {
    setEvents: (events) => charts.forEach((chart) => chart.setEvents(events)),
    destroy() {
      off();
      for (const chart of charts) chart.destroy();
      grid.remove();
      absent.remove();
    },
  };
}
