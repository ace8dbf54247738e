// What a stretch of readings looks like: Tab. 2, histogram with the Gaussian (Fig. 3), normal probability plot (Fig. 4).
// The stretch is what the page's plots are zoomed to; with all in view, the longest rest.

import { api, problemNote, query } from "../lib/api.js";
import { axisUnits } from "../lib/bias-methods.js";
import { createChart } from "../lib/chart.js";
import { debounce, h } from "../lib/dom.js";
import { count, number } from "../lib/format.js";
import { notesList } from "./run-imu-parts.js";

const ROWS = [
  ["minimum", "Minimum"],
  ["quartile_1", "First quartile"],
  ["median", "Median"],
  ["quartile_3", "Third quartile"],
  ["maximum", "Maximum"],
  ["mean", "Mean"],
  ["sd", "Standard deviation"],
  ["skewness", "Skewness"],
  ["kurtosis", "Kurtosis"],
];

export function mountStatistics(host, context, axis) {
  const { run, clock, imu } = context;
  let charts = [];
  let request = null;
  const said = h("p", { class: "dim", id: "imu-stretch" });
  const body = h("div", {});
  host.replaceChildren(said, body);

  // Which stretch, and why that one.
  function stretch() {
    if (!clock.isFullRange) return { t0: clock.range[0], t1: clock.range[1], why: "the range that you look at" };
    if (imu.rest) return { t0: imu.rest[0], t1: imu.rest[1], why: "the longest rest; drag a range in any plot over time to choose another" };
    return { why: "the whole run, since it holds no rest; drag a range in any plot over time to choose another" };
  }

  async function load() {
    request?.abort();
    request = new AbortController();
    const { t0, t1, why } = stretch();
    const clear = () => charts.splice(0).forEach((c) => c.destroy());
    try {
      const got = await api(`runs/${run.id}/imu/statistics?${query({ axis, t0, t1 })}`, { signal: request.signal });
      clear();
      const where = t0 === undefined ? "" : `${number(Math.max(t0, run.t0), 5)} to ${number(Math.min(t1, run.t1), 5)} s, `;
      said.textContent = `${count(got.description.count)} readings of ${where}${why}.`;
      charts = draw(body, got, context, axis);
    } catch (error) {
      if (error.name === "AbortError") return;
      clear();
      said.textContent = "";
      body.replaceChildren(problemNote(error));
    }
  }

  const later = debounce(250, load);
  const off = clock.subscribe((what) => what === "range" && later());
  load();
  return {
    destroy() {
      off();
      request?.abort();
      charts.forEach((c) => c.destroy());
    },
  };
}

function draw(body, got, context, axis) {
  const units = axisUnits(axis);
  const plots = h("div", { class: "imu-pair" });
  body.replaceChildren(h("div", { class: "imu-beside narrow-side" }, plots, h("div", { class: "imu-side" }, table(got, units), notesList(got.notes))));
  if (!got.histogram) return [];
  const cells = [0, 1].map(() => h("div", { class: "imu-plot" }));
  plots.append(...cells);
  return [histogram(cells[0], got, context, axis, units), probability(cells[1], got, context, axis, units)];
}

function histogram(cell, { histogram: { edges, counts, gaussian } }, { run, fileName }, axis, { unit, factor }) {
  const x = edges.map((v) => v * factor);
  const middle = x.slice(1).map((v, i) => (v + x[i]) / 2);
  const total = counts.length;
  const room = (x[x.length - 1] - x[0]) * 0.04;
  return createChart(cell, {
    id: "imu-histogram",
    title: `Histogram of ${axis}`,
    term: "imu_histogram",
    unit: "readings",
    siUnit: "readings",
    subject: run.name,
    fileName,
    domain: [x[0] - room, x[x.length - 1] + room],
    xLabel: "reading",
    xUnit: unit,
    zero: true,
    series: [
      { key: "counts", label: "readings", color: "--c2", style: "steps", fill: true, width: 1.25, dash: [], csv: "count" },
      { key: "gaussian", label: "Gaussian of this mean and sd", color: "--method-encoders-gyro", width: 2, dash: [7, 3], csv: "gaussian" },
    ],
    load: async () => ({
      series: {
        counts: { t: [x[0] - 1e-9 * room, ...x], y: [0, ...counts, 0], total, shown: total },
        gaussian: { t: middle, y: gaussian, total, shown: total },
      },
    }),
  });
}

function probability(cell, { probability: p }, { run, fileName }, axis, { unit, si, factor }) {
  const ends = [p.quantiles[0], p.quantiles[p.quantiles.length - 1]];
  return createChart(cell, {
    id: "imu-probability",
    title: `Normal probability plot of ${axis}`,
    term: "imu_probability",
    unit,
    siUnit: si,
    siFactor: 1 / factor,
    subject: run.name,
    fileName,
    domain: [ends[0] - 0.2, ends[1] + 0.2],
    xLabel: "quantile of a Gaussian",
    xUnit: "σ",
    series: [
      { key: "line", label: `Gaussian, r = ${p.correlation.toFixed(4)}`, color: "--method-encoders-gyro", width: 1.5, dash: [7, 3] },
      { key: "readings", label: "readings in order", color: "--c2", style: "dots" },
    ],
    load: async () => ({
      series: {
        line: { t: ends, y: ends.map((q) => (p.intercept + p.slope * q) * factor), total: 0, shown: 0 },
        readings: { t: p.quantiles, y: p.ordered.map((v) => v * factor), total: p.total, shown: p.shown },
      },
    }),
  });
}

function table({ description }, { unit, si, factor }) {
  const rows = ROWS.map(([name, label]) => {
    const plain = name === "skewness" || name === "kurtosis";
    const v = description[name];
    const value = v === null ? "–" : number(plain ? v : v * factor, 4);
    return h("tr", { "data-statistic": name }, h("th", { scope: "row", "data-term": `imu_${name}` }, label), h("td", { class: "num", "data-si": plain || v === null ? undefined : `${number(v, 5)} ${si}`, "data-hint": plain ? undefined : "" }, value, !plain && h("span", { class: "unit" }, unit)));
  });
  const left = description.left_out ? h("p", { class: "dim imu-facts" }, `${count(description.left_out)} readings are not numbers and left out.`) : "";
  return [h("div", { class: "metrics-scroll" }, h("table", { class: "table metrics", id: "imu-statistics" }, h("tbody", {}, rows))), left];
}
