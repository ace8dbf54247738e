// What the map draws, onto any 2D context: the canvas, or a picture to save. Units are CSS pixels.

import { drawEventMark } from "./events.js";
import { ellipse, poseAt, roundStep } from "./map-view.js";
import { colour, withAlpha } from "./palette.js";

// Half axes of the ellipse that holds 95 % of a normal density in the plane, in sigmas: sqrt(-2 ln 0.05).
export const SIGMAS_95 = 2.4477;

export function drawGround(ctx, view) {
  const step = roundStep(70 / view.scale);
  ctx.fillStyle = colour("--surface");
  ctx.fillRect(0, 0, view.width, view.height);
  ctx.lineWidth = 1;
  for (const [from, to, put] of [
    [view.fromX(0), view.fromX(view.width), (v) => [view.toX(v), 0, view.toX(v), view.height]],
    [view.fromY(view.height), view.fromY(0), (v) => [0, view.toY(v), view.width, view.toY(v)]],
  ]) {
    for (let k = Math.ceil(from / step); k * step <= to; k++) {
      ctx.strokeStyle = colour(k === 0 ? "--line-strong" : "--line");
      const [x0, y0, x1, y1] = put(k * step).map((p) => Math.round(p) + 0.5);
      ctx.beginPath();
      ctx.moveTo(x0, y0);
      ctx.lineTo(x1, y1);
      ctx.stroke();
    }
  }
  drawGridNumbers(ctx, view, step);
}

function drawGridNumbers(ctx, view, step) {
  const text = (v) => Number(v.toPrecision(6)).toString().replace("-", "−");
  const ink = colour("--ink-3");
  ctx.textAlign = "center";
  ctx.textBaseline = "alphabetic";
  for (let k = Math.ceil(view.fromX(40) / step); view.toX(k * step) < view.width - step * view.scale - 30; k++) halo(ctx, text(k * step), view.toX(k * step), view.height - 5, ink);
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  for (let k = Math.ceil(view.fromY(view.height - 30) / step); view.toY(k * step) > 30; k++) halo(ctx, text(k * step), 5, view.toY(k * step), ink);
}

// One grid step, as long as it is on the floor.
export function drawScaleBar(ctx, view) {
  const step = roundStep(70 / view.scale);
  const [x, y] = [view.width - 14, view.height - 10];
  const width = step * view.scale;
  ctx.strokeStyle = ctx.fillStyle = colour("--ink-2");
  ctx.lineWidth = 1.5;
  ctx.setLineDash([]);
  ctx.beginPath();
  ctx.moveTo(x - width, y - 4);
  ctx.lineTo(x - width, y);
  ctx.lineTo(x, y);
  ctx.lineTo(x, y - 4);
  ctx.stroke();
  ctx.textAlign = "center";
  ctx.textBaseline = "bottom";
  ctx.fillText(step >= 0.01 ? (step >= 1 ? `${step} m` : `${Math.round(step * 100)} cm`) : `${Number((step * 1000).toPrecision(3))} mm`, x - width / 2, y - 3);
}

// The visible range in full ink, the rest pale.
export function drawPath(ctx, view, path, range) {
  const ink = colour(path.color);
  if (path.dots) return drawDots(ctx, view, path, range, ink);
  ctx.lineJoin = "round";
  const inside = (t) => t >= range[0] && t <= range[1];
  strokeWhere(ctx, view, path, (t) => !inside(t), withAlpha(ink, 0.22), path.width);
  strokeWhere(ctx, view, path, inside, ink, path.width);
  return undefined;
}

function strokeWhere(ctx, view, path, wanted, ink, width) {
  const { t, x, y } = path;
  ctx.strokeStyle = ink;
  ctx.lineWidth = width;
  ctx.setLineDash(path.dash);
  ctx.beginPath();
  let pen = false;
  for (let i = 0; i < t.length; i++) {
    const broken = x[i] === null || y[i] === null;
    if (broken || !(wanted(t[i]) || (i + 1 < t.length && wanted(t[i + 1])))) {
      pen = false;
      continue;
    }
    if (pen) ctx.lineTo(view.toX(x[i]), view.toY(y[i]));
    else ctx.moveTo(view.toX(x[i]), view.toY(y[i]));
    pen = wanted(t[i + 1] ?? t[i]);
  }
  ctx.stroke();
  ctx.setLineDash([]);
}

// What has been added to a path since its first `from` poses were drawn.
export function drawTail(ctx, view, path, from) {
  if (path.t.length <= from) return;
  const start = Math.max(0, from - 1);
  const tail = { ...path, t: path.t.slice(start), x: path.x.slice(start), y: path.y.slice(start) };
  strokeWhere(ctx, view, tail, () => true, colour(path.color), path.width);
}

function drawDots(ctx, view, { t, x, y }, range, ink) {
  const strong = withAlpha(ink, 0.75);
  const pale = withAlpha(ink, 0.2);
  for (let i = 0; i < t.length; i++) {
    if (x[i] === null || y[i] === null) continue;
    ctx.fillStyle = t[i] >= range[0] && t[i] <= range[1] ? strong : pale;
    ctx.fillRect(view.toX(x[i]) - 1.25, view.toY(y[i]) - 1.25, 2.5, 2.5);
  }
}

// Start: an open ring. End: a filled square, in the method's colour.
export function drawEnds(ctx, view, path) {
  const ends = [path.x.findIndex((v) => v !== null), path.x.findLastIndex((v) => v !== null)];
  if (path.dots || path.ends === false || ends[0] < 0) return;
  ctx.strokeStyle = ctx.fillStyle = colour(path.color);
  ctx.lineWidth = 2;
  ctx.beginPath();
  ctx.arc(view.toX(path.x[ends[0]]), view.toY(path.y[ends[0]]), 5, 0, 7);
  ctx.stroke();
  if (path.hold) return; // the robot stands there
  ctx.fillRect(view.toX(path.x[ends[1]]) - 4, view.toY(path.y[ends[1]]) - 4, 8, 8);
  ctx.strokeStyle = colour("--surface");
  ctx.lineWidth = 1;
  ctx.strokeRect(view.toX(path.x[ends[1]]) - 4.5, view.toY(path.y[ends[1]]) - 4.5, 9, 9);
}

export function drawBeacons(ctx, view, beacons) {
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  for (const { name, x, y } of beacons) {
    const [px, py] = [view.toX(x), view.toY(y)];
    ctx.fillStyle = colour("--surface");
    ctx.strokeStyle = colour("--ink-2");
    ctx.lineWidth = 1.5;
    ctx.beginPath();
    ctx.moveTo(px, py - 6);
    ctx.lineTo(px + 6, py + 5);
    ctx.lineTo(px - 6, py + 5);
    ctx.closePath();
    ctx.fill();
    ctx.stroke();
    halo(ctx, name, px + 10, py, colour("--ink-2"));
  }
}

export function halo(ctx, text, x, y, ink) {
  ctx.lineWidth = 3;
  ctx.lineJoin = "round";
  ctx.strokeStyle = withAlpha(colour("--surface"), 0.85);
  ctx.strokeText(text, x, y);
  ctx.fillStyle = ink;
  ctx.fillText(text, x, y);
}

// Where events are on a path: [{ event, x, y, size, label }] in px. Where they crowd, one mark stands for all within its
// reach; what was dismissed gives way.
export function placeEvents(view, path, events) {
  const taken = new Set();
  const size = events.length > 40 ? 4 : 6;
  const placed = [];
  for (const event of [...events].sort((a, b) => a.faint - b.faint || a.t0 - b.t0)) {
    const pose = poseAt(path, event.t0);
    if (!pose) continue;
    const [x, y] = [view.toX(pose.x), view.toY(pose.y)];
    const place = `${Math.round(x / 20)},${Math.round(y / 20)}`;
    if (taken.has(place)) continue;
    taken.add(place);
    placed.push({ event, x, y, size, label: events.length <= 12 && !event.faint ? event.label : "" });
  }
  return withoutCrowding(placed);
}

// A label that would lie on another mark or label gives way; its mark tells it on hover.
function withoutCrowding(placed) {
  const boxes = placed.map(({ x, y, size, label }) => ({ left: x + 8, right: x + 12 + 6.6 * label.length, y, mark: [x - size, x + size] }));
  const shown = new Set();
  const hits = (a, b, i) => Math.abs(a.y - b.y) < 14 && ((a.left < b.mark[1] && b.mark[0] < a.right) || (shown.has(i) && a.left < b.right && b.left < a.right));
  return placed.map((one, i) => {
    if (!one.label || boxes.some((box, j) => j !== i && hits(boxes[i], box, j))) return { ...one, label: "" };
    shown.add(i);
    return one;
  });
}

// Events where the path was when they began, each kind with its own mark.
export function drawEvents(ctx, placed) {
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  for (const { event, x, y, size, label } of placed) {
    drawEventMark(ctx, event, x, y, size);
    if (label) halo(ctx, label, x + 10, y, colour("--ink-2"));
  }
}

export function drawEllipse(ctx, view, path, pose, sigmas, alpha) {
  const e = ellipse(pose);
  if (!e) return;
  const ink = colour(path.color);
  ctx.beginPath();
  ctx.ellipse(view.toX(pose.x), view.toY(pose.y), Math.max(sigmas * e.major * view.scale, 0.5), Math.max(sigmas * e.minor * view.scale, 0.5), -e.angle, 0, 7);
  ctx.fillStyle = withAlpha(ink, alpha);
  ctx.fill();
  ctx.strokeStyle = withAlpha(ink, 0.7);
  ctx.lineWidth = 1;
  ctx.stroke();
}

// Poses whose 95 % ellipses are drawn: about every 40 px of way.
export function ellipsesAlong(view, path, range) {
  const poses = [];
  let last = null;
  for (let i = 0; i < path.t.length; i++) {
    if (path.t[i] < range[0] || path.t[i] > range[1] || path.x[i] === null) continue;
    const at = [view.toX(path.x[i]), view.toY(path.y[i])];
    if (last && Math.hypot(at[0] - last[0], at[1] - last[1]) < 40) continue;
    last = at;
    poses.push(poseAt(path, path.t[i]));
  }
  return poses;
}

// The robot: a disc with its heading; on a heading unknown, the disc alone.
export function drawRobot(ctx, view, path, pose, ghost) {
  const [px, py] = [view.toX(pose.x), view.toY(pose.y)];
  const ink = colour(path.color);
  ctx.save();
  ctx.globalAlpha = ghost ? 0.45 : 1;
  ctx.translate(px, py);
  ctx.fillStyle = ink;
  ctx.strokeStyle = colour("--surface");
  ctx.lineWidth = 2;
  ctx.beginPath();
  if (pose.theta === null) {
    ctx.arc(0, 0, 6, 0, 7);
  } else {
    ctx.rotate(-pose.theta);
    ctx.moveTo(12, 0);
    ctx.lineTo(-7, 7);
    ctx.lineTo(-3.5, 0);
    ctx.lineTo(-7, -7);
    ctx.closePath();
  }
  ctx.stroke();
  ctx.fill();
  ctx.restore();
}
