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
  for (const band of bands) for (const sigmas of [2, 1]) sigmaBand(u, band, sigmas, range);
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
  const x0 = u.valToPos(event.t0, "x", true);
  const x1 = Math.max(u.valToPos(event.t1, "x", true), x0 + 2 * devicePixelRatio);
  ctx.fillStyle = withAlpha(ink, 0.14);
  if (!crowded) ctx.fillRect(x0, bbox.top, x1 - x0, bbox.height);
  ctx.fillStyle = ink;
  ctx.fillRect(x0, bbox.top, x1 - x0, 3 * devicePixelRatio);
}
