// The map as a drawing: same view, same colours and dashes, text as text.

import { escape } from "./chart-export.js";
import { colour } from "./palette.js";
import { SIGMAS_95 } from "./map-draw.js";
import { ellipse, roundStep } from "./map-view.js";

// `events`: as placed on the screen; `claim`: the path whose `poses` get ellipses, or null.
export function mapSvg({ paths, beacons, view, range, subject, events, claim, poses }) {
  const { width, height } = view;
  const ink = colour("--ink-2");
  const parts = [`<rect width="${width}" height="${height}" fill="${colour("--surface")}"/>`, ...grid(view)];
  if (claim) parts.push(...poses.map((pose) => claimed(pose, claim, view)));
  for (const path of paths) parts.push(path.dots ? dots(path, view, range) : line(path, view, range));
  for (const { name, x, y } of beacons) {
    const [px, py] = [view.toX(x), view.toY(y)];
    parts.push(`<path d="M${px} ${py - 6}l6 11h-12z" fill="none" stroke="${ink}"/><text x="${px + 9}" y="${py + 4}" fill="${ink}">${escape(name)}</text>`);
  }
  parts.push(...events.map((placed) => mark(placed, ink)), ...legend(paths), scaleBar(view, ink));
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" font-family="sans-serif" font-size="11"><title>${escape(subject || "Path")}</title>${parts.join("\n")}</svg>`;
}

function claimed(pose, path, view) {
  const e = ellipse(pose);
  if (!e) return "";
  const [rx, ry] = [e.major, e.minor].map((axis) => Math.max(SIGMAS_95 * axis * view.scale, 0.5).toFixed(2));
  const ink = colour(path.color);
  const turn = ((-e.angle * 180) / Math.PI).toFixed(2);
  return `<ellipse rx="${rx}" ry="${ry}" transform="translate(${view.toX(pose.x).toFixed(1)} ${view.toY(pose.y).toFixed(1)}) rotate(${turn})" fill="${ink}" fill-opacity="0.08" stroke="${ink}" stroke-opacity="0.7"/>`;
}

function mark({ event, x, y, size, label }, ink) {
  const title = `${event.label} at ${event.t0.toFixed(2)} s. ${event.evidence}`;
  const shape = `<path transform="translate(${x.toFixed(1)} ${y.toFixed(1)}) scale(${size / 6})" d="${event.path}" fill="${colour(event.color)}" fill-rule="evenodd"${event.faint ? ' opacity="0.3"' : ""}><title>${escape(title)}</title></path>`;
  return label ? `${shape}<text x="${(x + 10).toFixed(1)}" y="${(y + 4).toFixed(1)}" fill="${ink}">${escape(label)}</text>` : shape;
}

function grid(view) {
  const step = roundStep(70 / view.scale);
  const lines = [];
  const stroke = `stroke="${colour("--line")}"`;
  for (let k = Math.ceil(view.fromX(0) / step); k * step <= view.fromX(view.width); k++) lines.push(`<path d="M${view.toX(k * step).toFixed(1)} 0V${view.height}" ${stroke}/>`);
  for (let k = Math.ceil(view.fromY(view.height) / step); k * step <= view.fromY(0); k++) lines.push(`<path d="M0 ${view.toY(k * step).toFixed(1)}H${view.width}" ${stroke}/>`);
  return lines;
}

function line({ t, x, y, color, dash, width }, view, range) {
  let d = "";
  let pen = "M";
  for (let i = 0; i < t.length; i++) {
    if (t[i] < range[0] || t[i] > range[1] || x[i] === null || y[i] === null) {
      pen = "M";
      continue;
    }
    d += `${pen}${view.toX(x[i]).toFixed(1)} ${view.toY(y[i]).toFixed(1)}`;
    pen = "L";
  }
  const dashes = dash.length ? ` stroke-dasharray="${dash.join(" ")}"` : "";
  return `<path d="${d}" fill="none" stroke="${colour(color)}" stroke-width="${width}" stroke-linejoin="round"${dashes}/>`;
}

function dots({ t, x, y, color }, view, range) {
  const marks = [];
  for (let i = 0; i < t.length; i++) {
    if (t[i] < range[0] || t[i] > range[1] || x[i] === null || y[i] === null) continue;
    marks.push(`<circle cx="${view.toX(x[i]).toFixed(1)}" cy="${view.toY(y[i]).toFixed(1)}" r="1.3"/>`);
  }
  return `<g fill="${colour(color)}">${marks.join("")}</g>`;
}

function legend(paths) {
  let x = 12;
  return paths.map(({ label, color, dash }) => {
    const item = `<path d="M${x} 14h22" stroke="${colour(color)}" stroke-width="2" stroke-dasharray="${dash.join(" ") || "none"}"/><text x="${x + 28}" y="18" fill="${colour("--ink")}">${escape(label)}</text>`;
    x += 46 + 6.4 * label.length;
    return item;
  });
}

function scaleBar(view, ink) {
  const step = roundStep(70 / view.scale);
  const [x, y] = [view.width - 14, view.height - 10];
  const w = step * view.scale;
  return `<path d="M${x - w} ${y - 4}v4h${w}v-4" fill="none" stroke="${ink}"/><text x="${x - w / 2}" y="${y - 5}" text-anchor="middle" fill="${ink}">${step} m</text>`;
}
