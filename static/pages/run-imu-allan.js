// Fig. 2: Allan deviation on logarithmic axes with its band, the fitted model and the lines it is made of; the figures
// in SI and as data sheets write them, with the conversion.

import { api, query } from "../lib/api.js";
import { axisUnits } from "../lib/bias-methods.js";
import { createChart } from "../lib/chart.js";
import { h } from "../lib/dom.js";
import { count, number, percent, seconds, uncertain } from "../lib/format.js";
import { notesList, refusal } from "./run-imu-parts.js";

const FLOOR = Math.sqrt((2 * Math.log(2)) / Math.PI);
const LINES = {
  N: { label: "N: white", dash: [2, 3], of: (v, tau) => v / Math.sqrt(tau) },
  B: { label: "B: instability", dash: [7, 3], of: (v) => FLOOR * v },
  K: { label: "K: random walk", dash: [9, 3, 2, 3], of: (v, tau) => v * Math.sqrt(tau / 3) },
};

export async function mountAllan(host, context, axis) {
  const { run, imu } = context;
  if (imu.refusals[`allan.${axis}`]) {
    host.replaceChildren(refusal(`No Allan deviation of ${axis}`, imu.refusals[`allan.${axis}`], "A longer record at rest gives one; ten times the longest averaging time that you care about."));
    return { destroy() {} };
  }
  const path = (kind) => `runs/${run.id}/imu/allan?${query({ axis, kind })}`;
  const [allan, hadamard] = await Promise.all([api(path("allan")), api(path("hadamard"))]);
  const whole = allan.readings === "rest" ? await api(path("whole")) : null;
  const cell = h("div", { class: "imu-plot tall" });
  host.replaceChildren(h("div", { class: "imu-beside" }, cell, table(allan)));
  const chart = plot(cell, context, axis, { allan, hadamard, whole });
  return { destroy: () => chart.destroy() };
}

function plot(cell, { run, fileName }, axis, { allan, hadamard, whole }) {
  const { si, fine, fineFactor } = axisUnits(axis);
  const { curve } = allan;
  const tau = curve.tau;
  const value = Object.fromEntries(allan.noise.map((term) => [term.name, term.value]));
  const reading = (t, y) => ({ t, y: y.map((v) => (v === null ? null : v * fineFactor)), total: t.length, shown: t.length });
  const series = [{ key: "allan", label: whole ? "Allan, at rest" : "Allan", color: "--c1", width: 2, dash: [], csv: "adev" }];
  const readings = { allan: reading(tau, curve.deviation) };
  const add = (key, label, t, y, style) => {
    series.push({ key, label, ...style });
    readings[key] = reading(t, y);
  };
  if (curve.model.some((v) => v !== null)) add("model", "fit", tau, curve.model, { color: "--method-fused", width: 1.5, dash: [12, 3] });
  for (const [name, line] of Object.entries(LINES)) {
    if (value[name] === null) continue;
    const y = tau.map((t) => line.of(value[name], t));
    const least = Math.min(...curve.lo.filter((v) => v > 0)) / 2;
    add(name, line.label, tau, y.map((v) => (v < least ? null : v)), { color: { N: "--method-encoders", B: "--method-smoothed", K: "--method-published" }[name], width: 1.25, dash: line.dash, scale: false });
  }
  add("hadamard", "Hadamard", hadamard.curve.tau, hadamard.curve.deviation, { color: "--method-beacon", width: 1.5, dash: [5, 2, 1, 2], on: false });
  if (whole) add("whole", "all readings, motion too", whole.curve.tau, whole.curve.deviation, { color: "--ink-3", width: 1.25, dash: [4, 4], on: false });
  const band = { t: tau, lo: curve.lo.map((v) => v * fineFactor), hi: curve.hi.map((v) => v * fineFactor) };
  const ends = [Math.min(...tau, ...hadamard.curve.tau), Math.max(...tau, ...(whole?.curve.tau ?? []))];
  return createChart(cell, {
    id: "imu-allan",
    title: `Allan deviation of ${axis}`,
    term: "imu_allan",
    unit: fine,
    siUnit: si,
    siFactor: 1 / fineFactor,
    subject: run.name,
    fileName,
    log: { x: true, y: true },
    domain: [ends[0] * 0.85, ends[1] * 1.18],
    xLabel: "averaging time τ",
    xUnit: "s",
    series,
    load: async () => ({ series: readings, bands: { allan: band }, gaps: [] }),
  });
}

function table({ noise, fit, notes, readings, rest_share: share }) {
  const always = new Set(["N", "B", "K"]);
  const shown = noise.filter((term) => always.has(term.name) || term.value !== null);
  const rows = shown.map((term) => {
    const known = term.value !== null;
    const si = known ? [uncertain(term.value, term.sd), h("span", { class: "unit" }, term.unit)] : h("span", { class: "dim" }, "not identifiable from this record");
    const forms = known
      ? term.forms.filter((f) => f.conversion).map((f) => h("div", { class: "imu-form" }, h("div", {}, uncertain(f.value, f.sd), h("span", { class: "unit" }, f.unit)), h("div", { class: "dim imu-conversion" }, f.conversion)))
      : "";
    return h("tr", { "data-term-row": term.name }, h("th", { scope: "row", "data-term": `imu_${term.name}` }, h("b", {}, SYMBOLS[term.name]), h("div", { class: "dim" }, term.label)), h("td", {}, si), h("td", {}, forms));
  });
  const facts = [
    readings === "rest" ? `Of the readings at rest, ${percent(share).text} of all.` : "Of all readings.",
    `Step ${seconds(fit.tau0).text}, ${seconds(fit.duration).text} long.`,
    fit.chi2 !== null && fit.chi2 !== undefined ? `χ² ${number(fit.chi2, 3)} over ${count(fit.dof)} degrees of freedom.` : "",
    "The band is one sigma of the estimate.",
    noise.some((term) => term.name === "markov_sd" && term.value === null) ? "No Gauss-Markov process shows." : "",
  ];
  return h(
    "div",
    { class: "imu-side" },
    h("div", { class: "metrics-scroll" }, h("table", { class: "table metrics imu-noise" }, h("thead", {}, h("tr", {}, h("th", {}, "Noise"), h("th", {}, "SI, two-sided"), h("th", {}, "Data sheet"))), h("tbody", {}, rows))),
    h("p", { class: "dim imu-facts" }, facts.filter(Boolean).join(" ")),
    notesList(notes.filter((n) => !n.includes("not identifiable"))),
  );
}

const SYMBOLS = { N: "N", B: "B", K: "K", Q: "Q", markov_sd: "σ", markov_tau: "T" };
