// One colour and one dash per method, everywhere. Colours live in tokens.css; the order is that of keys 1 to 6, 0 the truth.

import { s } from "./dom.js";

export const METHODS = {
  truth: { label: "truth", color: "--method-truth", dash: [], width: 1.5 },
  encoders: { label: "encoders", color: "--method-encoders", dash: [7, 3], width: 1.5 },
  beacon: { label: "beacon", color: "--method-beacon", dash: [2, 3], width: 1.75 },
  "encoders+gyro": { label: "encoders + gyro", color: "--method-encoders-gyro", dash: [9, 3, 2, 3], width: 1.5 },
  published: { label: "published", color: "--method-published", dash: [5, 2, 1, 2, 1, 2], width: 1.5 },
  fused: { label: "fused", color: "--method-fused", dash: [], width: 2 },
  smoothed: { label: "smoothed", color: "--method-smoothed", dash: [12, 3], width: 1.75 },
  fixes: { label: "beacon fixes", color: "--method-fixes", dash: [], width: 1 },
};

/** The same key everywhere, whatever a run lacks. */
export const METHOD_KEYS = { truth: "0", encoders: "1", beacon: "2", "encoders+gyro": "3", published: "4", fused: "5", smoothed: "6", fixes: "7" };

const FALLBACK = { color: "--ink-3", dash: [4, 4], width: 1.5 };

export const methodStyle = (name) => METHODS[name] ?? { ...FALLBACK, label: name };

/** The method's colour as the theme has it now, for canvas. */
export function methodColor(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(methodStyle(name).color).trim();
}

/** Its line as a small picture, for legends. */
export function swatch(name) {
  const { color, dash } = methodStyle(name);
  const line = s("path", { d: "M0 4H18", "stroke-dasharray": dash.join(" ") || undefined });
  line.style.stroke = `var(${color})`;
  return s("svg", { class: "swatch", viewBox: "0 0 18 8", "aria-hidden": "true" }, line);
}

/** Known methods first, in the order of the keys. */
export function sortMethods(names) {
  const order = Object.keys(METHODS);
  const rank = (n) => (order.includes(n) ? order.indexOf(n) : order.length);
  return [...names].sort((a, b) => rank(a) - rank(b) || a.localeCompare(b));
}
