// Ticks and numbers of the axes. Times read as seconds in short runs and as h:min:s in long ones.

const DECADES = [];
for (let e = -12; e <= 12; e++) for (const m of [1, 2, 5]) DECADES.push(Number(`${m}e${e}`));
const TIMES = [...DECADES.filter((d) => d <= 10), 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400];

export const valueIncrements = DECADES;
export const timeIncrements = TIMES;

const formats = new Map();

// Intl formats are slow to make and quick to use.
function fixed(value, digits) {
  if (!formats.has(digits)) formats.set(digits, new Intl.NumberFormat("en", { minimumFractionDigits: digits, maximumFractionDigits: digits }));
  return formats.get(digits).format(value);
}

export function decimals(step) {
  return step >= 1 || !(step > 0) ? 0 : Math.min(9, Math.ceil(-Math.log10(step) - 1e-9));
}

export function tick(value, step) {
  if (Math.abs(value) < step * 1e-6) return "0";
  if (Math.abs(value) >= 1e6 || step < 1e-6) return value.toExponential(1).replace("-", "−").replace("e+", "e");
  return fixed(value, decimals(step)).replace("-", "−");
}

const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };

// 3.1 × 10⁻⁵: a number whose size is far from 1.
function power(value, digits) {
  const [head, exponent] = value.toExponential(digits).split("e");
  return `${head.replace("-", "−")} × 10${[...String(Number(exponent))].map((c) => RAISED[c]).join("")}`;
}

// 4 significant digits, by itself.
export function number(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e7 || size < 1e-4) return power(value, 2);
  return fixed(value, Math.max(0, 3 - Math.floor(Math.log10(size)))).replace("-", "−");
}

// A reading beside its axis: as fine as a ten-thousandth of what the axis shows, so that what is next to nothing there
// is told as 0, and digits do not dance while the time runs. On a logarithmic axis three significant digits.
export function reading(value, range, log = false) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const step = (range[1] - range[0]) * 1e-4;
  if (log || !(step > 0) || step < 1e-7) return number(value);
  if (Math.abs(value) < step / 2) return "0";
  return fixed(value, decimals(10 ** Math.floor(Math.log10(step)))).replace("-", "−");
}

export function timeText(t, step = 0.01, span = Infinity) {
  const digits = Math.min(3, decimals(step));
  if (span < 180) return tick(t, step);
  const rounded = Number(t.toFixed(digits));
  const s = rounded % 60;
  const m = Math.floor(rounded / 60) % 60;
  const h = Math.floor(rounded / 3600);
  const seconds = s.toFixed(digits).padStart(digits ? digits + 3 : 2, "0");
  return span < 3600 ? `${m}:${seconds}` : `${h}:${String(m).padStart(2, "0")}:${seconds}`;
}

export function timeUnit(span) {
  return span < 180 ? "s" : span < 3600 ? "min:s" : "h:min:s";
}

// Ticks of a logarithmic axis: round numbers, fewer of them the more decades there are.
export function logTicks(lo, hi) {
  const decades = Math.log10(hi / lo);
  const steps = decades < 1.2 ? [1, 2, 3, 4, 5, 6, 8] : decades < 3.2 ? [1, 2, 5] : [1];
  const found = [];
  for (let e = Math.floor(Math.log10(lo)); e <= Math.ceil(Math.log10(hi)); e++) for (const m of steps) found.push(Number(`${m}e${e}`));
  return found.filter((v) => v >= lo && v <= hi);
}

// 0.01, 20, 5e6: a round number as short as it can be.
export function roundText(value) {
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-4 || size >= 1e6) ? value.toExponential(0).replace("-", "−").replace("e+", "e") : value.toLocaleString("en-US", { maximumFractionDigits: 4 });
}

export function count(n) {
  if (n >= 1e6) return `${(n / 1e6).toFixed(1)} M`;
  return n.toLocaleString("en-US");
}

// uPlot axis options shared by plots. `ink`, `grid` are functions that give colours; `font` a canvas font.
export function axes({ clock, log, ink, grid, font, showTime, valueWidth, label }) {
  const base = { stroke: ink, font, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1, size: 4 }, gap: 3 };
  const timeSpan = clock ? clock.full[1] : 0;
  const x = { ...base, size: showTime ? 26 : 0, space: 64 };
  if (!showTime) Object.assign(x, { ticks: { show: false }, values: (u, splits) => splits.map(() => "") });
  else if (clock) x.values = (u, splits, i, space, step) => splits.map((t) => timeText(t, step, timeSpan));
  if (clock) x.incrs = TIMES;
  if (label && showTime) Object.assign(x, { label, labelFont: font, labelSize: 15, labelGap: 0 });
  const y = { ...base, size: valueWidth, space: (u, i, lo, hi, height) => Math.max(18, height / 9) };
  const plain = (u, splits, i, space, step) => splits.map((v) => (v === null ? "" : tick(v, step)));
  const round = { values: (u, splits) => splits.map(roundText), splits: (u, axis, lo, hi) => logTicks(lo, hi), filter: (u, splits) => splits };
  if (log.y) Object.assign(y, round);
  else Object.assign(y, { values: plain, incrs: DECADES });
  if (log.x && showTime) Object.assign(x, round);
  else if (!clock && showTime) x.values = plain;
  return [x, y];
}
