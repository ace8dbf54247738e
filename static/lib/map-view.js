// The map's view: metres on the floor to pixels of the canvas, equal on both axes, y up.

export function createView() {
  const view = {
    width: 1,
    height: 1,
    scale: 50, // px per m
    x: 0, // the map point in the middle
    y: 0,
    toX: (x) => view.width / 2 + (x - view.x) * view.scale,
    toY: (y) => view.height / 2 - (y - view.y) * view.scale,
    fromX: (px) => view.x + (px - view.width / 2) / view.scale,
    fromY: (py) => view.y - (py - view.height / 2) / view.scale,

    pan(dx, dy) {
      view.x -= dx / view.scale;
      view.y += dy / view.scale;
    },

    // factor < 1 zooms in; the point under (px, py) stays.
    zoom(factor, px = view.width / 2, py = view.height / 2) {
      const [x, y] = [view.fromX(px), view.fromY(py)];
      view.scale = Math.min(Math.max(view.scale / factor, 1e-3), 1e6);
      view.x = x - (px - view.width / 2) / view.scale;
      view.y = y + (py - view.height / 2) / view.scale;
    },

    // Whether a box is wholly seen, a little clear of the edge.
    holds({ x0, x1, y0, y1 }, margin = 14) {
      return view.toX(x0) >= margin && view.toX(x1) <= view.width - margin && view.toY(y1) >= margin && view.toY(y0) <= view.height - margin;
    },

    // Wider above than below: the buttons lie there.
    fit({ x0, x1, y0, y1 }, margin = 36, top = margin + 18) {
      const room = (span, size, margins) => (size - margins) / Math.max(span, 1e-3);
      view.scale = Math.max(Math.min(room(x1 - x0, view.width, 2 * margin), room(y1 - y0, view.height, margin + top), 2000), 1e-3);
      view.x = (x0 + x1) / 2;
      view.y = (y0 + y1) / 2 + (top - margin) / 2 / view.scale;
    },
  };
  return view;
}

// 1, 2 or 5 times a power of ten, the nearest above `least`.
export function roundStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((m) => m * power).find((s) => s >= least * 0.999);
}

// What is noisy lies at the bottom, then solid lines; dashes on top of them still show what lies below.
export function inDrawOrder(lines) {
  const rank = (line) => ((line.method ?? line.key) === "beacon" ? 0 : line.dash.length ? 2 : 1);
  return [...lines].sort((a, b) => rank(a) - rank(b));
}

export function bounds(paths, points) {
  const box = { x0: Infinity, x1: -Infinity, y0: Infinity, y1: -Infinity };
  const take = (x, y) => {
    if (x === null || y === null) return;
    box.x0 = Math.min(box.x0, x);
    box.x1 = Math.max(box.x1, x);
    box.y0 = Math.min(box.y0, y);
    box.y1 = Math.max(box.y1, y);
  };
  for (const path of paths) for (let i = 0; i < path.x.length; i++) take(path.x[i], path.y[i]);
  for (const { x, y } of points) take(x, y);
  return box.x0 <= box.x1 ? box : { x0: -1, x1: 1, y0: -1, y1: 1 };
}

const ROOM = 4; // m: a robot that has just started still stands on a floor

// The box with a quarter of its size around it, for what is going to grow.
export function roomier({ x0, x1, y0, y1 }) {
  const more = (lo, hi) => Math.max(0.25 * (hi - lo), (ROOM - (hi - lo)) / 2);
  const [dx, dy] = [more(x0, x1), more(y0, y1)];
  return { x0: x0 - dx, x1: x1 + dx, y0: y0 - dy, y1: y1 + dy };
}

// Pose of a path at a time, linear between its points; null outside. A path that grows holds its last one.
export function poseAt(path, at) {
  const { t } = path;
  const time = path.hold ? Math.min(at, t[t.length - 1]) : at;
  if (!t.length || time < t[0] || time > t[t.length - 1]) return null;
  let lo = 0;
  let hi = t.length - 1;
  while (hi - lo > 1) {
    const mid = (lo + hi) >> 1;
    if (t[mid] <= time) lo = mid;
    else hi = mid;
  }
  const share = t[hi] > t[lo] ? (time - t[lo]) / (t[hi] - t[lo]) : 0;
  const mix = (column) => {
    const [a, b] = [path[column]?.[lo] ?? null, path[column]?.[hi] ?? null];
    return a === null || b === null ? a : a + share * (b - a);
  };
  const pose = { t: time, x: mix("x"), y: mix("y"), theta: mix("theta"), sd_x: mix("sd_x"), sd_y: mix("sd_y"), sd_theta: mix("sd_theta"), cov_xy: mix("cov_xy") };
  return pose.x === null || pose.y === null ? null : pose;
}

// Half axes and direction of the one-sigma ellipse; null where the method states no uncertainty.
export function ellipse({ sd_x, sd_y, cov_xy }) {
  if (sd_x === null || sd_y === null) return null;
  const [a, b, c] = [sd_x ** 2, sd_y ** 2, cov_xy ?? 0];
  const mean = (a + b) / 2;
  const spread = Math.hypot((a - b) / 2, c);
  return { major: Math.sqrt(mean + spread), minor: Math.sqrt(Math.max(mean - spread, 0)), angle: Math.atan2(2 * c, a - b) / 2 };
}

// The point of the paths nearest to a pixel: {path, index, distance in px}, or null.
export function nearest(view, paths, px, py, reach = 24) {
  let best = null;
  let least = reach * reach;
  for (const path of paths) {
    for (let i = 0; i < path.x.length; i++) {
      if (path.x[i] === null || path.y[i] === null) continue;
      const d = (view.toX(path.x[i]) - px) ** 2 + (view.toY(path.y[i]) - py) ** 2;
      if (d < least) [least, best] = [d, { path, index: i }];
    }
  }
  return best && { ...best, distance: Math.sqrt(least) };
}
