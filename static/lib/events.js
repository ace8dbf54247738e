// What can befall a robot: a name, a mark and a colour per kind, the same on strip, map, plots, 3D and lists.

import { h, s } from "./dom.js";
import { seconds } from "./format.js";
import { colour } from "./palette.js";

// Marks fill a box of 12 about the origin, even-odd. The shape tells the kind; the colour only its family:
// red the robot itself, amber the beacon or the floor, indigo a place that changed, grey the wheels.
const RING = "M6 0A6 6 0 1 1-6 0A6 6 0 1 1 6 0ZM3.2 0A3.2 3.2 0 1 0-3.2 0A3.2 3.2 0 1 0 3.2 0Z";

export const KINDS = {
  slip: ["slip", "--event-robot", "M0-6.5L6 0L0 6.5L-6 0Z", "Wheels turn more or less than the body does."],
  collision: ["collision", "--event-robot", "M0-7L1.9-1.9L7 0L1.9 1.9L0 7L-1.9 1.9L-7 0L-1.9-1.9Z", "Speed lost or gained faster than motors can."],
  bounce: ["bounce", "--event-beacon", "M0-6L6 5H-6Z", "A blow upwards: a joint, a sill, a stone."],
  pushed: ["push", "--event-place", "M-6-5L0-5L6 0L0 5L-6 5L-1 0Z", "Wheels and command rest, yet the robot moves."],
  stuck: ["blocked", "--event-wheel", "M-5-5H5V5H-5Z", "Asked to turn and not turning, or wheels that turn on the spot."],
  dead_encoder: ["dead encoder", "--event-wheel", "M-6-3L-3-6L0-3L3-6L6-3L3 0L6 3L3 6L0 3L-3 6L-6 3L-3 0Z", "A wheel's reading stands while everything else goes on."],
  beacon_loss: ["beacon loss", "--event-beacon", RING, "No fix that could be used for longer than the beacon's rhythm explains."],
  beacon_lying: ["false fixes", "--event-beacon", "M-6-5L6 5V-5L-6 5Z", "Fixes that agree with nothing else, several in a row."],
  kidnap: ["kidnapping", "--event-place", "M0-6.5L6.5-1H3V6H-3V-1H-6.5Z", "The robot was elsewhere while no wheel turned."],
  replacement: ["position replaced", "--event-place", "M-2-6H2V-2H6V2H2V6H-2V2H-6V-2H-2Z", "The published system took its position from the beacon."],
};

const OTHER = (kind) => [kind.replaceAll("_", " "), "--event-wheel", "M4 0A4 4 0 1 1-4 0A4 4 0 1 1 4 0Z", "Something happened."];

export const DECISIONS = { confirmed: "confirmed", dismissed: "dismissed" };

export function eventKind(kind) {
  const [label, color, path, about] = KINDS[kind] ?? OTHER(kind);
  return { label, color, path, about };
}

/** A remark with numbers as people write them: a true minus, and no sign before nothing. */
export function legible(text) {
  return text?.replace(/(^|[\s(])[+-](\d+(?:\.\d+)?)/g, (all, before, digits) => `${before}${Number(digits) === 0 ? "" : all.includes("-") ? "−" : "+"}${digits}`);
}

/** An event as it is drawn: label, color, path; `faint` where it was dismissed. */
export function dressedEvent(event) {
  return { ...event, ...eventKind(event.kind), evidence: legible(event.evidence), faint: event.decision === "dismissed" };
}

/** The mark as a small picture, for legends and lists. */
export function eventSwatch(kind, faint = false) {
  const { color, path } = eventKind(kind);
  const mark = s("path", { d: path, "fill-rule": "evenodd" });
  mark.style.fill = `var(${color})`;
  return s("svg", { class: faint ? "event-swatch faint" : "event-swatch", viewBox: "-8 -8 16 16", "aria-hidden": "true" }, mark);
}

const shapes = new Map();

/** The mark on a canvas, `size` px from its middle to its edge, with a rim that parts it from what lies below. */
export function drawEventMark(ctx, event, x, y, size) {
  if (!shapes.has(event.path)) shapes.set(event.path, new Path2D(event.path));
  ctx.save();
  ctx.translate(x, y);
  ctx.scale(size / 6, size / 6);
  ctx.globalAlpha *= event.faint ? 0.3 : 1;
  ctx.lineJoin = "round";
  ctx.lineWidth = 3;
  ctx.strokeStyle = colour("--surface");
  ctx.stroke(shapes.get(event.path));
  ctx.fillStyle = colour(event.color);
  ctx.fill(shapes.get(event.path), "evenodd");
  ctx.restore();
}

/** What is told of an event under the pointer. */
export function eventTip(event) {
  const lasted = event.t1 - event.t0;
  return [
    h("b", {}, eventSwatch(event.kind, event.faint), ` ${event.label}${event.decision ? `, ${event.decision}` : ""}`),
    h("span", {}, `${event.t0.toFixed(2)} s, for ${seconds(lasted).text}`),
    event.evidence && h("span", { class: "wrap" }, event.evidence),
    event.replaced && h("span", { class: "wrap dim" }, `Instead: ${event.replaced}`),
  ].filter(Boolean);
}

/** The kinds that are there, each with its mark, its number, and what it is on hover. */
export function eventLegend(events) {
  const counts = new Map();
  for (const e of events) counts.set(e.kind, (counts.get(e.kind) ?? 0) + 1);
  const order = Object.keys(KINDS);
  const kinds = [...counts.keys()].sort((a, b) => order.indexOf(a) - order.indexOf(b));
  return kinds.map((kind) => {
    const { label, about } = eventKind(kind);
    return h("li", { "data-kind": kind, tabindex: "0", "data-hint": about }, eventSwatch(kind), `${label} ${counts.get(kind)}`);
  });
}
