// What the gyro did over time: its signal in segments, the bias that each method takes for true, the heading that
// comes of it and how wrong that is. All on the page's one time axis.

import { api, query } from "../lib/api.js";
import { BIAS_METHODS, TRUTH, VERDICTS, axisUnits, biasStyle } from "../lib/bias-methods.js";
import { number } from "../lib/chart-axes.js";
import { createChart } from "../lib/chart.js";

const DEG = 180 / Math.PI;
const HOURLY = DEG * 3600;

const scaled = (s, factor, shift = 0) => ({ t: shift ? s.t.map((t) => t + shift) : s.t, y: s.y.map((v) => (v === null ? null : v * factor)), total: s.total, shown: s.shown });
const byColumn = (answer) => Object.fromEntries(answer.series.map((s) => [s.column, s]));
const windowOf = ({ t0, t1, whole, points }) => ({ points, ...(whole ? {} : { t0, t1 }) });

const common = ({ run, clock, state, fileName }, id) => ({ id, clock, fileName, subject: run.name, onEnlarge: () => state.set("big", state.big === id ? null : id) });

export function signalChart(host, context, axis) {
  const { run, imu } = context;
  const { si, unit, factor, label } = axisUnits(axis);
  const length = context.lengthOf();
  const parted = !imu.refusals[`segments.${axis}`] && imu.analysed;
  const series = [{ key: "signal", label: axis, help: `${label}, as recorded`, color: "--ink-3", width: 0.8, dash: [], csv: `imu.${axis}` }];
  if (parted) {
    series.push({ key: "mean", label: `mean of ${length} s`, color: "--c2", width: 2, style: "steps", dash: [], csv: "segment mean" });
    for (const [key, name] of [["quartile_1", "first quartile"], ["quartile_3", "third quartile"]]) series.push({ key, label: name, color: "--c3", width: 1, style: "steps", dash: [3, 2], csv: `segment ${name}` });
  }
  return createChart(host, {
    ...common(context, "imu-signal"),
    title: `Signal ${axis} and its segments`,
    term: "imu_segment",
    unit,
    siUnit: si,
    siFactor: 1 / factor,
    series,
    async load(wish) {
      const window = windowOf(wish);
      const [raw, cut] = await Promise.all([
        api(`runs/${run.id}/streams/imu?${query({ columns: axis, ...window })}`, { signal: wish.signal }),
        parted ? api(`runs/${run.id}/imu/segments?${query({ axis, columns: "mean,quartile_1,quartile_3", ...window })}`, { signal: wish.signal }) : { series: [] },
      ]);
      const made = { signal: scaled(raw.series[0], factor) };
      for (const s of cut.series) made[s.column] = scaled(s, factor, -length / 2);
      return { series: made, gaps: raw.gaps };
    },
  });
}

const lines = ({ imu, state }, needed) =>
  imu.methods
    .filter((m) => m.columns.includes(needed))
    .map((m) => {
      const { label, color, dash, width } = biasStyle(m.method);
      return { key: m.method, label, help: `${m.label}; ${m.causal ? "looks back only" : "with hindsight"}`, color, dash, width, on: state.biasVisible(m.method), csv: `${m.method} ${needed}` };
    });

const series = (context, method, columns, wish) => api(`runs/${context.run.id}/imu/bias/${method}/series?${query({ columns: columns.join(","), ...windowOf(wish) })}`, { signal: wish.signal }).then(byColumn);

/** Fig. 8: every method's bias; of the one in focus also its band and what it made of each segment. */
export function biasChart(host, context) {
  const { imu, state } = context;
  const focus = state.focus();
  const marks = Object.entries(VERDICTS).map(([key, v]) => ({ key, label: v.label, help: v.help, style: "marks", mark: v.mark, color: v.color ?? biasStyle(focus).color, scale: key !== "rejected_by_range", csv: `${focus} ${key}` }));
  return createChart(host, {
    ...common(context, "imu-bias"),
    title: "Gyro bias",
    term: "imu_bias",
    unit: "°/h",
    siUnit: "rad/s",
    siFactor: 1 / HOURLY,
    settle: true,
    series: [...marks, ...lines(context, "bias")],
    bandFor: (visible) => visible.find((m) => m === focus),
    onToggle: (key) => key in BIAS_METHODS && state.toggleBias(key),
    async load(wish) {
      const made = { series: {}, bands: {}, gaps: context.gaps };
      const one = async (m) => {
        const own = m.method === focus ? ["sd", ...Object.keys(VERDICTS)] : [];
        const got = await series(context, m.method, ["bias", ...own], wish);
        if (got.bias) made.series[m.method] = scaled(got.bias, HOURLY);
        for (const key of Object.keys(VERDICTS)) if (got[key]) made.series[key] = scaled(got[key], HOURLY);
        if (got.sd) made.bands[m.method] = bandAround(got.bias, got.sd, HOURLY);
      };
      await Promise.all(imu.methods.filter((m) => m.columns.includes("bias")).map(one));
      return made;
    },
  });
}

/** Fig. 6: the headings, and the truth where there is one. */
export function headingChart(host, context) {
  const { imu, state } = context;
  const judged = imu.methods.find((m) => m.columns.includes("reference"));
  const truth = judged ? [{ key: "truth", ...TRUTH, csv: "reference theta" }] : [];
  return createChart(host, {
    ...common(context, "imu-heading"),
    title: "Heading",
    term: "imu_heading",
    unit: "°",
    siUnit: "rad",
    siFactor: 1 / DEG,
    series: [...truth, ...lines(context, "theta")],
    onToggle: (key) => key in BIAS_METHODS && state.toggleBias(key),
    async load(wish) {
      const made = { series: {}, gaps: context.gaps };
      const one = async (m) => {
        const got = await series(context, m.method, m === judged ? ["theta", "reference"] : ["theta"], wish);
        if (got.theta) made.series[m.method] = scaled(got.theta, DEG);
        if (got.reference) made.series.truth = scaled(got.reference, DEG);
      };
      await Promise.all(imu.methods.filter((m) => m.columns.includes("theta")).map(one));
      return made;
    },
  });
}

const FAR = 8; // times the next largest error: such a method would press all others flat

// Methods whose error would hide the others': they are drawn, but do not widen the axis, and their label says how far they go.
function offScale(methods) {
  const known = methods.filter((m) => m.summary?.max_rad > 0).sort((a, b) => a.summary.max_rad - b.summary.max_rad);
  const first = known.findIndex((m, k) => k > 0 && m.summary.max_rad > FAR * known[k - 1].summary.max_rad && m.summary.max_rad * DEG > 10);
  return new Map(first < 0 ? [] : known.slice(first).map((m) => [m.method, m.summary.max_rad * DEG]));
}

/** Fig. 7: heading error of each method, with what the one in focus claims. */
export function errorChart(host, context) {
  const { imu, state } = context;
  const focus = state.focus();
  const far = offScale(imu.methods);
  const drawn = lines(context, "error").map((s) => (far.has(s.key) ? { ...s, scale: false, label: `${s.label} (off scale, to ${number(far.get(s.key))}°)` } : s));
  return createChart(host, {
    ...common(context, "imu-error"),
    title: "Heading error",
    term: "imu_heading_error",
    unit: "°",
    siUnit: "rad",
    siFactor: 1 / DEG,
    series: drawn,
    bandFor: (visible) => visible.find((m) => m === focus) ?? visible[0],
    onToggle: (key) => state.toggleBias(key),
    async load(wish) {
      const made = { series: {}, bands: {}, gaps: context.gaps };
      const one = async (m) => {
        const claimed = m.columns.includes("theta_sd");
        const got = await series(context, m.method, claimed ? ["error", "theta_sd"] : ["error"], wish);
        if (got.error) made.series[m.method] = scaled(got.error, DEG);
        if (got.theta_sd) made.bands[m.method] = { t: got.theta_sd.t, mid: got.theta_sd.t.map(() => 0), sd: got.theta_sd.y.map((v) => (v === null ? null : v * DEG)) };
      };
      await Promise.all(imu.methods.filter((m) => m.columns.includes("error")).map(one));
      return made;
    },
  });
}

// The deviation was thinned by itself: it is held from one of its points to the next.
function bandAround(line, sd, factor) {
  let k = 0;
  const held = line.t.map((t) => {
    while (k + 1 < sd.t.length && sd.t[k + 1] <= t) k += 1;
    return sd.y[k] === null || sd.y[k] === undefined ? null : sd.y[k] * factor;
  });
  return { t: line.t, mid: line.y.map((v) => (v === null ? null : v * factor)), sd: held };
}
