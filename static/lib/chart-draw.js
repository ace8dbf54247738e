// What lies under the lines of a plot: gaps, events, sigma bands. Drawn on uPlot's own canvas, in its pixels.

import { lowerBound } from "./chart-data.js";
import { colour, withAlpha } from "./palette.js";

const CROWD = 40;

export function drawUnder(u, { gaps, events, bands, range }) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  for (const [a, b] of gaps) if (b >= range[0] && a <= range[1]) hatch(u, a, b, colour("--amber"));
  const seen = events.filter((e) => e.t1 >= range[0] && e.t0 <= range[1]);
  for (const event of seen) eventBand(u, event, seen.length > CROWD);
  for (const band of bands) {
    if (band.lo) intervalBand(u, band, range);
    else for (const sigmas of [2, 1]) sigmaBand(u, band, sigmas, range);
  }
  ctx.restore();
}

function sigmaBand(u, { t, mid, sd, color }, sigmas, range) {
  const { ctx } = u;
  const first = Math.max(lowerBound(t, range[0]) - 1, 0);
  const last = Math.min(lowerBound(t, range[1]) + 1, t.length);
  ctx.fillStyle = withAlpha(colour(color), sigmas === 1 ? 0.2 : 0.1);
  let run = [];
  const flush = () => {
    if (run.length > 1) fillBetween(u, t, mid, sd, sigmas, run);
    run = [];
  };
  for (let i = first; i < last; i++) {
    if (mid[i] === null || sd[i] === null || mid[i] === undefined || sd[i] === undefined) flush();
    else run.push(i);
  }
  flush();
}

function fillBetween(u, t, mid, sd, sigmas, run) {
  const { ctx } = u;
  ctx.beginPath();
  for (const i of run) ctx.lineTo(u.valToPos(t[i], "x", true), clampY(u, mid[i] + sigmas * sd[i]));
  for (let k = run.length - 1; k >= 0; k--) {
    const i = run[k];
    ctx.lineTo(u.valToPos(t[i], "x", true), clampY(u, mid[i] - sigmas * sd[i]));
  }
  ctx.fill();
}

// One band between two curves, as a chi-square interval is: not the same up as down.
function intervalBand(u, { t, lo, hi, color }, range) {
  const { ctx } = u;
  const first = Math.max(lowerBound(t, range[0]) - 1, 0);
  const last = Math.min(lowerBound(t, range[1]) + 1, t.length);
  ctx.fillStyle = withAlpha(colour(color), 0.2);
  ctx.beginPath();
  for (let i = first; i < last; i++) if (hi[i] > 0) ctx.lineTo(u.valToPos(t[i], "x", true), clampY(u, hi[i]));
  for (let i = last - 1; i >= first; i--) if (lo[i] > 0) ctx.lineTo(u.valToPos(t[i], "x", true), clampY(u, lo[i]));
  ctx.fill();
}

// Marks of one series, by their shape as well as their colour; what lies off the scale is shown at its edge.
export function drawMarks(u, { t, y }, { mark, color }, range) {
  const { ctx, bbox } = u;
  const first = lowerBound(t, range[0]);
  const last = Math.min(lowerBound(t, range[1]) + 1, t.length);
  const r = 3 * devicePixelRatio;
  const [top, bottom] = [bbox.top + r, bbox.top + bbox.height - r];
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  ctx.strokeStyle = ctx.fillStyle = colour(color);
  ctx.lineWidth = 1.2 * devicePixelRatio;
  ctx.globalAlpha = Math.min(1, Math.max(0.3, bbox.width / (2 * r * Math.max(last - first, 1)))); // a crowd is drawn lighter
  ctx.beginPath();
  for (let i = first; i < last; i++) {
    if (y[i] === null || y[i] === undefined) continue;
    const at = u.valToPos(y[i], "y", true);
    SHAPES[mark](ctx, u.valToPos(t[i], "x", true), Math.min(Math.max(at, top), bottom), r);
  }
  if (mark === "dot") ctx.fill();
  else ctx.stroke();
  ctx.restore();
}

const SHAPES = {
  dot(ctx, x, y, r) {
    ctx.moveTo(x + 0.7 * r, y);
    ctx.arc(x, y, 0.7 * r, 0, 2 * Math.PI);
  },
  cross(ctx, x, y, r) {
    ctx.moveTo(x - r, y - r);
    ctx.lineTo(x + r, y + r);
    ctx.moveTo(x - r, y + r);
    ctx.lineTo(x + r, y - r);
  },
  triangle(ctx, x, y, r) {
    ctx.moveTo(x, y - 1.2 * r);
    ctx.lineTo(x + 1.1 * r, y + 0.8 * r);
    ctx.lineTo(x - 1.1 * r, y + 0.8 * r);
    ctx.closePath();
  },
};

// The same shapes as the path of an SVG, about the origin.
export const MARK_PATHS = {
  dot: "M2.1 0a2.1 2.1 0 1 1-4.2 0a2.1 2.1 0 1 1 4.2 0",
  cross: "M-3-3L3 3M-3 3L3-3",
  triangle: "M0-3.6L3.3 2.4L-3.3 2.4Z",
};

// Far-away corners make some canvases slow; anything well outside the plot may as well be just outside.
function clampY(u, value) {
  const y = u.valToPos(value, "y", true);
  return Math.min(Math.max(y, u.bbox.top - u.bbox.height), u.bbox.top + 2 * u.bbox.height);
}

function hatch(u, a, b, ink) {
  const { ctx, bbox } = u;
  const x0 = Math.max(u.valToPos(a, "x", true), bbox.left);
  const x1 = Math.max(Math.min(u.valToPos(b, "x", true), bbox.left + bbox.width), x0 + 1);
  ctx.save();
  ctx.beginPath();
  ctx.rect(x0, bbox.top, x1 - x0, bbox.height);
  ctx.clip();
  ctx.fillStyle = withAlpha(ink, 0.1);
  ctx.fillRect(x0, bbox.top, x1 - x0, bbox.height);
  ctx.strokeStyle = withAlpha(ink, 0.45);
  ctx.lineWidth = devicePixelRatio;
  ctx.beginPath();
  const step = 7 * devicePixelRatio;
  for (let x = x0 - bbox.height; x < x1; x += step) {
    ctx.moveTo(x, bbox.top + bbox.height);
    ctx.lineTo(x + bbox.height, bbox.top);
  }
  ctx.stroke();
  ctx.restore();
}

// Among many events a band each would hide the plot: marks along its top then.
function eventBand(u, event, crowded) {
  const { ctx, bbox } = u;
  const ink = colour(event.color ?? "--amber");
  if (event.faint) ctx.globalAlpha = 0.25;
  const x0 = u.valToPos(event.t0, "x", true);
  const x1 = Math.max(u.valToPos(event.t1, "x", true), x0 + 2 * devicePixelRatio);
  ctx.fillStyle = withAlpha(ink, 0.14);
  if (!crowded) ctx.fillRect(x0, bbox.top, x1 - x0, bbox.height);
  ctx.fillStyle = ink;
  ctx.fillRect(x0, bbox.top, x1 - x0, 3 * devicePixelRatio);
  ctx.globalAlpha = 1;
}
