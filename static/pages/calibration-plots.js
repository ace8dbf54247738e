// The plots of a calibration: characteristic lines and what is left of them (Fig. 8, 9), the drift and its fit (Fig. 7),
// its autocorrelation (eq. 4), its spectrum (eq. 5, Fig. 3), and the moving average's Bode plot (eq. 8, Fig. 5).

import { createChart } from "../lib/chart.js";
import { SENSORS, sensorOf, styleOf } from "../lib/triads.js";

const once = (series, extra = {}) => async () => ({ series, gaps: [], ...extra });
const reading = (t, y) => ({ t, y, total: t.length, shown: t.length });
const around = (values, share = 0.05) => {
  const known = values.filter((v) => v !== null);
  const [lo, hi] = [Math.min(...known), Math.max(...known)];
  const room = (hi - lo || Math.abs(hi) || 1) * share;
  return [lo - room, hi + room];
};

// Points by their place on the axis, each a hair apart: several may stand at one place.
function sorted(x, y) {
  const order = x.map((_, i) => i).sort((a, b) => x[a] - x[b]);
  return { t: order.map((i, k) => x[i] + k * 1e-9), y: order.map((i) => y[i]) };
}

export function linesChart(host, calibration, sensor, left) {
  const { label, letter, si, unit, factor, fine, fineFactor } = SENSORS[sensor];
  const lines = calibration.report.lines.filter((l) => l.axis[0] === letter);
  const series = [];
  const data = {};
  for (const line of lines) {
    const style = styleOf(line.axis);
    const real = line.real.map((v) => v * factor);
    const values = left ? line.corrected.map((v, i) => (v - line.real[i]) * fineFactor) : line.measured.map((v) => v * factor);
    const points = sorted(real, values);
    series.push({ key: line.axis, label: line.axis, color: style.color, style: "marks", mark: style.mark, csv: `${line.axis} ${left ? "left" : "measured"}` });
    data[line.axis] = { ...points, total: real.length, shown: real.length };
    if (left) continue;
    series.push({ key: `${line.axis}-fit`, label: `${line.axis} fit`, color: style.color, dash: style.dash, width: 1.25, csv: `${line.axis} fit` });
    data[`${line.axis}-fit`] = reading(line.line_real.map((v) => v * factor), line.line_measured.map((v) => v * factor));
  }
  return createChart(host, {
    id: `lines-${sensor}${left ? "-left" : ""}`,
    title: left ? `${label}: left after correction` : `${label}: characteristic lines`,
    term: left ? "cal_left" : "cal_lines",
    unit: left ? fine : unit,
    siUnit: si,
    siFactor: 1 / (left ? fineFactor : factor),
    subject: calibration.name,
    fileName: "calibration",
    domain: around(lines.flatMap((l) => l.real.map((v) => v * factor))),
    xLabel: "true value",
    xUnit: unit,
    series,
    load: once(data),
  });
}

export function driftChart(host, calibration, axis) {
  const { si, fine, fineFactor } = sensorOf(axis);
  const { t, run, bias, curve, blocks } = calibration.report.axes[axis];
  const runs = [...new Set(run)];
  const series = [];
  const data = {};
  const marks = ["dot", "cross", "triangle"];
  runs.forEach((r, k) => {
    const rows = t.map((_, i) => i).filter((i) => run[i] === r);
    const key = `run${r}`;
    const points = sorted(rows.map((i) => t[i]), rows.map((i) => bias[i] * fineFactor));
    series.push({ key, label: calibration.runs[r]?.name ?? `run ${r + 1}`, color: ["--c2", "--c3", "--c4", "--c1"][k % 4], style: "marks", mark: marks[k % 3], csv: `bias of run ${r + 1}` });
    data[key] = { ...points, total: k ? 0 : blocks, shown: k ? 0 : t.length };
    series.push({ key: `${key}-fit`, label: k ? `fit ${k + 1}` : "fit", color: "--method-encoders-gyro", width: 2, dash: k ? [7, 3] : [], csv: `fit of run ${r + 1}` });
    data[`${key}-fit`] = { ...sorted(rows.map((i) => t[i]), rows.map((i) => curve[i] * fineFactor)), total: 0, shown: 0 };
  });
  return createChart(host, {
    id: `drift-${axis}`,
    title: `Bias of ${axis} from switching on`,
    term: "cal_drift",
    unit: fine,
    siUnit: si,
    siFactor: 1 / fineFactor,
    subject: calibration.name,
    fileName: "calibration",
    domain: around(t, 0.02),
    xLabel: "time since switching on",
    xUnit: "s",
    series,
    load: once(data),
  });
}

export function correlationChart(host, calibration, axis) {
  const records = calibration.report.axes[axis].paper;
  const far = Math.max(...records.flatMap((r) => r.lag));
  const series = records.map((r, k) => ({ key: `r${k}`, label: `${calibration.runs[r.run]?.name ?? "run"}: Tc ${r.tau === null ? "not reached" : `${Math.round(r.tau)} s`}`, color: ["--c2", "--c3", "--c4"][k % 3], dash: [[], [7, 3], [2, 2]][k % 3], width: 1.5 }));
  const data = Object.fromEntries(records.map((r, k) => [`r${k}`, reading(r.lag, r.correlation)]));
  series.push({ key: "e", label: "1/e", color: "--ink-3", dash: [4, 4], width: 1 });
  data.e = { ...reading([0, far], [Math.exp(-1), Math.exp(-1)]), total: 0, shown: 0 };
  return createChart(host, { id: `acf-${axis}`, title: `Autocorrelation of the drift of ${axis}`, term: "cal_acf", unit: "", subject: calibration.name, fileName: "calibration", domain: [0, far], xLabel: "lag", xUnit: "s", series, load: once(data) });
}

export function spectrumChart(host, calibration, sensor) {
  const { label, letter, si } = SENSORS[sensor];
  const axes = Object.keys(calibration.spectrum).filter((a) => a[0] === letter);
  const all = axes.flatMap((a) => calibration.spectrum[a].f);
  return createChart(host, {
    id: `spectrum-${sensor}`,
    title: `${label}: spectrum of the drift`,
    term: "cal_spectrum",
    unit: `(${si})²/Hz`,
    siUnit: `(${si})²/Hz`,
    subject: calibration.name,
    fileName: "calibration",
    log: { x: true, y: true },
    domain: [Math.min(...all), Math.max(...all)],
    xLabel: "frequency",
    xUnit: "Hz",
    series: axes.map((a) => ({ key: a, label: a, color: styleOf(a).color, dash: styleOf(a).dash, width: 1.75 })),
    load: once(Object.fromEntries(axes.map((a) => [a, reading(calibration.spectrum[a].f, calibration.spectrum[a].density)]))),
  });
}

export function bodeChart(host, calibration, what) {
  const { f, gain, phase, window, rate_hz: rate } = calibration.bode;
  const y = what === "gain" ? gain.map((g) => Math.max(20 * Math.log10(Math.max(g, 1e-4)), -40)) : phase.map((p) => (p * 180) / Math.PI);
  return createChart(host, {
    id: `bode-${what}`,
    title: what === "gain" ? `Moving average of ${window} at ${Number(rate.toPrecision(4))} Hz: gain` : "Its phase",
    term: "cal_bode",
    unit: what === "gain" ? "dB" : "°",
    siUnit: what === "gain" ? "dB" : "rad",
    siFactor: what === "gain" ? 1 : Math.PI / 180,
    subject: calibration.name,
    fileName: "calibration",
    domain: [0, f[f.length - 1]],
    xLabel: "frequency",
    xUnit: "Hz",
    series: [{ key: what, label: what, color: "--c2", width: 1.5, dash: [] }],
    load: once({ [what]: reading(f, y) }),
  });
}
