// One calibration: its numbers with deviations, what they stand on, and its ways into other programs.

import { API, api, problemNote } from "../lib/api.js";
import { $, h, pageData } from "../lib/dom.js";
import { number, seconds, show, uncertain, when } from "../lib/format.js";
import { SENSORS } from "../lib/triads.js";
import { bodeChart, correlationChart, driftChart, linesChart, spectrumChart } from "./calibration-plots.js";
import { copyCommand, notesList, section } from "./run-imu-parts.js";

const { calibration } = pageData();
const { gyro, accel, sd } = calibration.calibration;
const models = { gyro, accel };
const live = [];

const say = (error) => $("#said").replaceChildren(problemNote(error));

/* name, robot, delete */

function tools() {
  const name = h("input", { value: calibration.name, maxlength: "200", "aria-label": "Name" });
  const robot = h("input", { value: calibration.robot ?? "", maxlength: "200", placeholder: "robot", "aria-label": "Robot" });
  const write = async () => {
    try {
      const made = await api(`calibrations/${calibration.id}`, { method: "PATCH", json: { name: name.value.trim() || calibration.name, robot: robot.value.trim() } });
      Object.assign(calibration, { name: made.name, robot: made.robot });
      $("#calibration-name").textContent = made.name;
      document.title = `${made.name} · Driftscope`;
      $("#said").replaceChildren();
    } catch (error) {
      say(error);
    }
  };
  for (const input of [name, robot]) input.addEventListener("change", write);
  const remove = h("button", { type: "button", class: "button", id: "delete-calibration" }, "Delete");
  remove.addEventListener("click", () => {
    const yes = h("button", { type: "button", class: "button danger" }, "Delete for good");
    yes.addEventListener("click", () => api(`calibrations/${calibration.id}`, { method: "DELETE" }).then(() => location.assign("/calibrations"), say));
    const no = h("button", { type: "button", class: "button", onclick: () => $("#said").replaceChildren() }, "Keep");
    $("#said").replaceChildren(h("div", { class: "bar row form-row" }, h("span", { class: "spread" }, `“${calibration.name}” cannot be brought back. Runs that it corrected stay.`), yes, no));
    yes.focus();
  });
  $("#tools").append(name, robot, h("span", { class: "spread" }), h("a", { class: "button quiet", href: `/calibrations/${calibration.id}.json` }, "JSON"), remove);
}

/* numbers */

const both = (v, s, factor = 1) => (v === null ? h("span", { class: "dim" }, "not known") : uncertain(v * factor, s === null ? NaN : s * factor));

function numbers(sensor) {
  const { label, letter, unit, factor, fine, fineFactor } = SENSORS[sensor];
  const [model, own] = [models[sensor], sd[sensor]];
  const cell = (name, k, f = 1) => h("td", { class: "num" }, both(model[name][k], own[name][k], f));
  const rows = ["x", "y", "z"].map((k, i) => h("tr", { "data-axis": letter + k }, h("th", { scope: "row" }, letter + k), cell("static_bias", i, factor), cell("drift_amplitude", i, fineFactor), cell("drift_tau", i), cell("noise_sd", i, factor)));
  const heads = [["", ""], ["cal_static", `Static bias, ${unit}`], ["cal_drift", `Drift, ${fine}`], ["cal_tau", "Its time, s"], ["cal_noise", `Noise of a reading, ${unit}`]];
  const matrix = model.matrix.map((row, i) => h("tr", {}, h("th", { scope: "row" }, letter + "xyz"[i]), row.map((v, j) => h("td", {}, both(v, own.matrix[i][j])))));
  return h(
    "div",
    { class: "card" },
    h("h2", {}, label),
    h("div", { class: "scroll-x" }, h("table", { class: "table", id: `numbers-${sensor}` }, h("thead", {}, h("tr", {}, heads.map(([term, text]) => h("th", { class: text ? "num" : "", "data-term": term || undefined }, text)))), h("tbody", {}, rows))),
    h("div", { class: "scroll-x" }, h("table", { class: "table calibration-matrix" }, h("thead", {}, h("tr", {}, h("th", { "data-term": "cal_matrix" }, "Matrix"), ["x", "y", "z"].map((k) => h("th", { class: "num" }, `true ${k}`)))), h("tbody", {}, matrix))),
  );
}

/* exports */

function exportsCard() {
  const rate = h("input", { type: "number", min: "1", max: "100000", step: "any", value: String(Number(calibration.bode.rate_hz.toPrecision(5))) });
  const tracker = h("select", {}, ["best", "C"].map((m) => h("option", { value: m }, m)));
  const noise = h("select", {}, h("option", { value: "" }, "this calibration"), calibration.runs.map((r) => h("option", { value: r.id }, `Allan fit of ${r.name}`)));
  const files = [
    ["calibration.json", "JSON", "calibration/1, what `driftscope correct` and `firmware` take", () => ({})],
    ["kalibr-imu.yaml", "Kalibr YAML", "noise density and random walk, two-sided, with units", () => ({ rate: rate.value, run: noise.value })],
    ["imu-noise.sdf", "SDF noise", "a Gazebo IMU with a noise block per axis", () => ({ rate: rate.value, run: noise.value })],
    ["firmware.zip", "Firmware, C99", "Algorithm 1 and a bias tracker for a microcontroller", () => ({ rate: rate.value, run: noise.value, bias: tracker.value })],
  ];
  const get = async (file, params) => {
    const query = new URLSearchParams(Object.entries(params).filter(([, v]) => v));
    try {
      const answer = await fetch(`${API}/calibrations/${calibration.id}/files/${file}?${query}`);
      if (!answer.ok) throw await answer.json();
      const named = /filename="([^"]+)"/.exec(answer.headers.get("content-disposition") ?? "")?.[1] ?? file;
      const link = h("a", { href: URL.createObjectURL(await answer.blob()), download: named });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
    } catch (error) {
      say(error);
    }
  };
  const buttons = files.map(([file, label, what, params]) => h("button", { type: "button", class: "button", "data-file": file, "data-hint": what, onclick: () => get(file, params()) }, label));
  return h("div", { class: "exports" }, h("label", { class: "field", "data-term": "cal_rate" }, "IMU rate, Hz", rate), h("label", { class: "field" }, "Noise from", noise), h("label", { class: "field" }, "Firmware's bias tracker", tracker), buttons);
}

/* what it stands on */

function standsOn() {
  const { report } = calibration;
  const facts = [
    ["Made", `${when(calibration.created_at).si}${calibration.runtime_s ? `, in ${seconds(calibration.runtime_s).text}` : ""}`],
    ["From", calibration.runs.length ? calibration.runs.map((r, i) => [i ? ", " : "", h("a", { href: `/runs/${r.id}?tab=imu` }, r.name)]) : "an uploaded file"],
    ["Code", h("code", {}, calibration.code_version)],
    calibration.run_sha256.length && ["Runs' SHA-256", h("span", { class: "hash" }, calibration.run_sha256.join(" "))],
    report.used && ["Segments used", `${report.used}${report.left_out.length ? `, ${report.left_out.length} left out` : ""}`],
  ].filter(Boolean);
  return [h("dl", { class: "facts" }, facts.map(([k, v]) => [h("dt", {}, k), h("dd", {}, v)])), notesList([...report.left_out ?? [], ...calibration.notes])];
}

/* put together */

function plots(host, list, layout = "pair") {
  const grid = h("div", { class: `imu-charts ${layout}` });
  host.append(grid);
  for (const make of list) {
    const cell = h("div", { class: "imu-plot" });
    grid.append(cell);
    live.push(make(cell));
  }
}

function axisPlots(host) {
  const axes = Object.keys(calibration.report.axes);
  let axis = axes.includes("gz") ? "gz" : axes[0];
  const bar = h("div", { class: "segmented", role: "group", "aria-label": "Axis" });
  const body = h("div", { class: "imu-charts pair" });
  let shown = [];
  const paint = () => {
    bar.replaceChildren(...axes.map((a) => h("button", { type: "button", "aria-pressed": String(a === axis), "data-axis": a, onclick: () => ((axis = a), paint()) }, a)));
    shown.forEach((c) => c.destroy());
    const makers = [(cell) => driftChart(cell, calibration, axis), ...(calibration.report.axes[axis].paper.length ? [(cell) => correlationChart(cell, calibration, axis)] : [])];
    body.replaceChildren();
    shown = makers.map((make) => {
      const cell = h("div", { class: "imu-plot" });
      body.append(cell);
      return make(cell);
    });
  };
  host.append(bar, paperTable(), body);
  paint();
}

// The paper's way beside the joint fit: what each reads, and what it should read if the fit is right.
function paperTable() {
  const rows = Object.entries(calibration.report.axes).flatMap(([axis, a]) =>
    a.paper.map((p) => h("tr", {}, h("th", { scope: "row" }, axis), h("td", {}, calibration.runs[p.run]?.name ?? `run ${p.run + 1}`), h("td", { class: "num" }, p.tau === null ? "not reached" : both(p.tau, p.tau_sd)), h("td", { class: "num" }, number(p.expected, 4)), h("td", { class: "num" }, both(a.fit.tau, a.fit.tau_sd)))),
  );
  if (!rows.length) return "";
  const heads = [["Axis"], ["Rest"], ["Tc by the paper's rule, s", "cal_acf"], ["that rule on the fit, s", "cal_expected"], ["Tc by the joint fit, s", "cal_tau"]];
  return h("div", { class: "metrics-scroll" }, h("table", { class: "table metrics" }, h("thead", {}, h("tr", {}, heads.map(([text, term], i) => h("th", { class: i > 1 ? "num" : "", "data-term": term }, text)))), h("tbody", {}, rows)));
}

function build() {
  const root = $("#content");
  const add = (id, title, about, ...tools) => {
    const made = section(id, title, about, ...tools);
    root.append(made.root);
    return made.body;
  };
  add("numbers", "Numbers", "reading = matrix · true + static bias + drift (1 − exp(−t / time)) + noise, t from switching on").append(h("div", { class: "calibration-numbers" }, numbers("gyro"), numbers("accel")));
  add("exports", "Take it elsewhere", "", copyCommand(() => (calibration.runs.length ? `driftscope calibrate ${calibration.runs.map((r) => r.id).join(" ")} --json calibration.json` : `driftscope correct RUN --calibration calibration.json --out corrected`))).append(exportsCard());
  const { report } = calibration;
  const lines = ["gyro", "accel"].filter((s) => report.lines?.some((l) => l.axis[0] === SENSORS[s].letter));
  if (lines.length) plots(add("lines", "Characteristic lines", "each declared segment: what was true, what was read, what is left of the error"), lines.flatMap((s) => [(cell) => linesChart(cell, calibration, s, false), (cell) => linesChart(cell, calibration, s, true)]));
  if (report.axes && Object.keys(report.axes).length) axisPlots(add("drift", "Drift", "the bias of every rest against the time since switching on, and the fitted curve"));
  const drifting = ["gyro", "accel"].filter((s) => Object.keys(calibration.spectrum).some((a) => a[0] === SENSORS[s].letter));
  if (drifting.length) plots(add("spectrum", "Spectrum of the drift", "as the Gauss-Markov process that stands for it"), drifting.map((s) => (cell) => spectrumChart(cell, calibration, s)));
  plots(add("bode", "Moving average", `delays by ${seconds(calibration.bode.delay).text}; cut at −40 dB`), [(cell) => bodeChart(cell, calibration, "gain"), (cell) => bodeChart(cell, calibration, "phase")]);
  add("stands", "What it stands on", "").append(...standsOn());
}

tools();
build();
document.documentElement.dataset.ready = "calibration";
