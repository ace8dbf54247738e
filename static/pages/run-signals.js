// Signals: every stream of the run on one time axis, one plot per kind of reading; only plots in sight are drawn.

import { api, query } from "../lib/api.js";
import { createChart } from "../lib/chart.js";
import { h } from "../lib/dom.js";
import { count, hertz } from "../lib/format.js";

const DEG = 180 / Math.PI;
const STYLES = [
  { color: "--c1", dash: [] },
  { color: "--c2", dash: [7, 3] },
  { color: "--c3", dash: [2, 2] },
  { color: "--c4", dash: [9, 3, 2, 3] },
];
const HUMAN = { rad: ["°", DEG], "rad/s": ["°/s", DEG] };
const TURNS = ["turns", 1 / (2 * Math.PI)]; // wheels: what people count
const GROUPS = {
  "wheels rad": "wheel angles",
  "imu rad/s": "turn rate",
  "imu m/s²": "specific force",
  "beacon m": "position of the tag",
  "truth m": "reference position",
  "ranges m": "distance to each beacon",
};
const SPARSE = new Set(["beacon", "ranges"]); // readings that nothing connects: dots

// Columns of one unit share a plot: [{ id, unit, columns: [{ name, label, unit }] }].
export function plotsOf(stream) {
  const columns = stream.name === "ranges" ? stream.names.map((name) => ({ name, unit: "m", label: name })) : stream.columns.filter((c) => c.name !== "t");
  const groups = new Map();
  for (const c of columns) groups.set(c.unit, [...(groups.get(c.unit) ?? []), c]);
  return [...groups].map(([unit, list]) => ({ id: `${stream.name}-${list[0].name}`, unit, columns: list }));
}

export function mountSignals(host, context) {
  const { run, state } = context;
  const charts = [];
  const pending = new Map();
  let events = [];
  const box = h("div", { class: "signals" });
  host.append(box);

  const sight = new IntersectionObserver(
    (entries) => {
      for (const { isIntersecting, target } of entries) {
        if (!isIntersecting) continue;
        sight.unobserve(target);
        const chart = pending.get(target)();
        chart.setEvents(events);
        charts.push(chart);
      }
    },
    { root: host.closest("main"), rootMargin: "300px" },
  );

  run.streams.forEach((stream) => {
    const plots = plotsOf(stream);
    const section = h("section", { class: "signal-stream", "data-stream": stream.name }, heading(stream));
    plots.forEach((plot, k) => {
      const showTime = k === plots.length - 1; // one time axis per stream
      const cell = h("div", { class: showTime ? "signal timed" : "signal", "data-signal": plot.id });
      section.append(cell);
      pending.set(cell, () => signalChart(cell, stream, plot, context, showTime));
      cell.classList.toggle("enlarged", state.big === plot.id);
      sight.observe(cell);
    });
    box.append(section);
  });
  const off = state.subscribe((what) => {
    if (what === "big") for (const cell of pending.keys()) cell.classList.toggle("enlarged", state.big === cell.dataset.signal);
  });
  return {
    setEvents(list) {
      events = list;
      for (const chart of charts) chart.setEvents(list);
    },
    destroy() {
      off();
      sight.disconnect();
      for (const chart of charts) chart.destroy();
      box.remove();
    },
  };
}

function heading(stream) {
  const pauses = stream.gaps.length;
  const lost = stream.gaps.reduce((sum, [a, b]) => sum + (b - a), 0);
  return h(
    "header",
    { class: "signal-head" },
    h("h2", {}, stream.name),
    h("span", { class: "dim" }, `${stream.label} · ${count(stream.rows)} rows · ${hertz(stream.rate_hz).text}`),
    pauses > 0 && h("span", { class: "chip amber", "data-hint": "Stamps pause for over ten typical steps; hatched in the plots." }, `${pauses}${pauses >= 100 ? "+" : ""} ${pauses === 1 ? "gap" : "gaps"}, ${lost.toFixed(1)} s`),
  );
}

function signalChart(cell, stream, plot, { run, clock, state, fileName }, showTime) {
  const [unit, factor] = stream.name === "wheels" ? TURNS : (HUMAN[plot.unit] ?? [plot.unit, 1]);
  const dots = SPARSE.has(stream.name);
  const series = plot.columns.map((c, i) => ({
    key: c.name,
    label: c.name,
    help: c.label,
    csv: `${stream.name}.${c.name}`,
    width: 1.1,
    style: dots ? "dots" : "line",
    ...STYLES[i % STYLES.length],
  }));
  const names = plot.columns.map((c) => c.name);
  return createChart(cell, {
    id: plot.id,
    title: names.length > 1 || stream.name === "ranges" ? (GROUPS[`${stream.name} ${plot.unit}`] ?? names.join(", ")) : plot.columns[0].label,
    subject: `${run.name} · ${stream.name}`,
    compact: true,
    help: plot.columns.map((c) => `${c.name}: ${c.label} [${c.unit}]`).join("; "),
    unit,
    siUnit: plot.unit,
    siFactor: 1 / factor,
    fileName,
    clock,
    series,
    showTime,
    onEnlarge: () => state.set("big", state.big === plot.id ? null : plot.id),
    async load({ t0, t1, whole, points, signal }) {
      const window = whole ? {} : { t0, t1 };
      const got = await api(`runs/${run.id}/streams/${stream.name}?${query({ columns: names.join(","), points, ...window })}`, { signal });
      const made = got.series.map((s) => [s.column, { ...s, y: factor === 1 ? s.y : s.y.map((v) => (v === null ? null : v * factor)) }]);
      return { series: Object.fromEntries(made), gaps: got.gaps };
    },
  });
}
