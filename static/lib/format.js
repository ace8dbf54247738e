// The human edge: SI and radians come in, what people read goes out. Each function gives {text, value, unit, si}:
// the whole text, its number and unit apart, and the SI value for the hover.

import { h } from "./dom.js";

const MINUS = "−";
const NONE = "–";
const DEG = 180 / Math.PI;

const finite = (x) => typeof x === "number" && Number.isFinite(x);

/** A number with `digits` significant digits, thousands apart, a true minus, no exponent within reason. */
export function number(x, digits = 3) {
  if (!finite(x)) return NONE;
  const a = Math.abs(x);
  let out;
  if (a !== 0 && (a < 1e-4 || a >= 1e9)) {
    const [head, power] = a.toExponential(digits - 1).split("e");
    out = `${head} × 10${[...String(Number(power))].map((c) => RAISED[c]).join("")}`;
  }
  else {
    const decimals = a === 0 ? 0 : Math.min(8, Math.max(0, digits - 1 - Math.floor(Math.log10(a))));
    out = a.toLocaleString("en", { minimumFractionDigits: decimals, maximumFractionDigits: decimals });
  }
  return x < 0 && /[1-9]/.test(out) ? MINUS + out : out;
}

const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };

/** A value with its deviation, both to the deviation's second digit: 0.4630 ± 0.0033, (1.346 ± 0.010) × 10⁻⁴. */
export function uncertain(x, sd) {
  if (!finite(x)) return NONE;
  if (!finite(sd) || sd <= 0) return number(x, 4);
  const power = x === 0 ? 0 : Math.floor(Math.log10(Math.abs(x)));
  const far = power < -2 || power > 5;
  const scale = far ? 10 ** -power : 1;
  const decimals = Math.min(8, Math.max(0, 1 - Math.floor(Math.log10(sd * scale))));
  const text = [x, sd].map((v) => (v * scale).toLocaleString("en", { minimumFractionDigits: decimals, maximumFractionDigits: decimals }).replace("-", MINUS));
  const raised = [...String(power)].map((c) => RAISED[c]).join("");
  return far ? `(${text[0]} ± ${text[1]}) × 10${raised}` : `${text[0]} ± ${text[1]}`;
}

function made(x, scale, unit, siUnit, digits = 3) {
  if (!finite(x)) return { text: NONE, value: NONE, unit: "", si: "" };
  const value = number(x * scale, digits);
  const gap = unit && unit !== "°" ? " " : "";
  return { text: value + gap + unit, value, unit, si: siUnit && `${number(x, 5)} ${siUnit}` };
}

/** Metres; centimetres below 0.1 m, millimetres below 1 mm, and nothing below a micrometre. */
export function length(m) {
  const size = finite(m) ? Math.abs(m) : Infinity;
  if (size < 1e-6) return { ...made(0, 100, "cm", "m"), si: `${number(m, 5)} m` };
  return size < 0.001 ? made(m, 1000, "mm", "m", 2) : size < 0.1 ? made(m, 100, "cm", "m", 2) : made(m, 1, "m", "m");
}
export const angle = (rad) => made(rad, DEG, "°", "rad");
export const turnRate = (rad_s) => made(rad_s, DEG, "°/s", "rad/s");
/** Gyro bias and its drift. */
export const bias = (rad_s) => made(rad_s, DEG * 3600, "°/h", "rad/s");
export const walk = (rad_sqrt_s) => made(rad_sqrt_s, DEG * 60, "°/√h", "rad/√s");
export const percent = (share) => made(share, 100, "%", "");
export const seconds = (x) => (finite(x) && x !== 0 && Math.abs(x) < 0.1 ? made(x, 1000, "ms", "s") : made(x, 1, "s", "s"));
export const hertz = (x) => made(x, 1, "Hz", "Hz", finite(x) && x >= 100 ? 4 : 3);

/** How long a run is: 42 s, 12 min 05 s, 3 h 20 min. */
export function duration(x) {
  if (!finite(x)) return { text: NONE, value: NONE, unit: "", si: "" };
  const t = Math.round(x);
  const pad = (n) => String(n).padStart(2, "0");
  let text;
  if (x < 60) text = `${number(x, x < 10 ? 2 : 3)} s`;
  else if (t < 3600) text = `${Math.floor(t / 60)} min ${pad(t % 60)} s`;
  else text = `${Math.floor(t / 3600)} h ${pad(Math.floor((t % 3600) / 60))} min`;
  return { text, value: text, unit: "", si: `${number(x, 7)} s` };
}

/** A clock on a time axis: 0:07, 12:05, 3:20:00. */
export function clock(x) {
  const t = Math.floor(Math.abs(x));
  const pad = (n) => String(n).padStart(2, "0");
  const head = t >= 3600 ? `${Math.floor(t / 3600)}:${pad(Math.floor((t % 3600) / 60))}` : `${Math.floor(t / 60)}`;
  return `${x < 0 ? MINUS : ""}${head}:${pad(t % 60)}`;
}

/** 4,000 or 16.6 M. */
export function count(n) {
  if (!finite(n)) return NONE;
  if (n < 1e6) return Math.round(n).toLocaleString("en");
  return n < 1e9 ? `${number(n / 1e6)} M` : `${number(n / 1e9)} G`;
}

export function bytes(n) {
  if (!finite(n)) return { text: NONE, value: NONE, unit: "", si: "" };
  const units = ["B", "kB", "MB", "GB", "TB"];
  const k = n < 1000 ? 0 : Math.min(4, Math.floor(Math.log10(n) / 3));
  return { text: `${number(n / 1000 ** k)} ${units[k]}`, value: number(n / 1000 ** k), unit: units[k], si: `${Math.round(n).toLocaleString("en")} bytes` };
}

/** When something happened: today's time, else the date. `si` is the whole stamp. */
export function when(iso) {
  if (!iso) return { text: NONE, value: NONE, unit: "", si: "" };
  const date = new Date(iso);
  const today = new Date().toDateString() === date.toDateString();
  const sameYear = new Date().getFullYear() === date.getFullYear();
  const text = today
    ? date.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" })
    : date.toLocaleDateString("en-GB", { day: "numeric", month: "short", ...(sameYear ? {} : { year: "numeric" }) });
  return { text, value: text, unit: "", si: date.toLocaleString("en-GB", { dateStyle: "full", timeStyle: "medium" }) };
}

const BY_UNIT = { m: length, rad: angle, "rad/s": turnRate, "rad/√s": walk, s: seconds, Hz: hertz, "%": percent };

/** A value of the API with its SI unit, at the edge. A gyro's bias is told per hour: `name` says that it is one. */
export function quantity(value, unit, name = "") {
  if (name.startsWith("bias")) return bias(value);
  if (unit === "" && Number.isInteger(value)) return { text: count(value), value: count(value), unit: "", si: "" };
  return BY_UNIT[unit]?.(value) ?? made(value, 1, unit ?? "", unit ?? "");
}

/** A formatted quantity as an element: the unit quieter than the number, SI and the term's explanation on hover. */
export function show(q, term) {
  if (q.value === NONE) return h("span", { class: "dim" }, NONE);
  const gap = q.unit && q.unit !== "°";
  return h(
    "span",
    { class: "q", "data-term": term, "data-si": q.si || undefined, "data-hint": !term && q.si ? "" : undefined },
    q.value,
    q.unit && h("span", { class: gap ? "unit" : "unit tight" }, q.unit),
  );
}
