// Every view out: PNG and SVG with title and legend, CSV of the visible range, and the link to the exact view.

import { number, roundText, tick, timeText, timeUnit } from "./chart-axes.js";
import { lowerBound, rows } from "./chart-data.js";
import { MARK_PATHS } from "./chart-draw.js";
import { save } from "./dom.js";
import { colour, withAlpha } from "./palette.js";

const HEAD = 44; // px above the plot: title and legend

// Resolves to whether the link is on the clipboard (it may be refused: then the address bar has it).
export async function copyText(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return false;
  }
}

export function copyLink() {
  return copyText(location.href);
}

export function fileName(chart, suffix) {
  const [a, b] = chart.clock.range.map((t) => Number(t.toPrecision(6)));
  const span = chart.spec.clock ? `-${a}s-${b}s` : "";
  const base = `${chart.spec.fileName ?? "driftscope"}-${chart.spec.id}${span}`;
  return `${base.replace(/[^\w.+-]+/g, "_")}.${suffix}`;
}

export async function exportPng(chart) {
  const source = chart.plot.ctx.canvas;
  const scale = devicePixelRatio;
  const canvas = document.createElement("canvas");
  canvas.width = source.width;
  canvas.height = source.height + HEAD * scale;
  const ctx = canvas.getContext("2d");
  ctx.fillStyle = colour("--surface");
  ctx.fillRect(0, 0, canvas.width, canvas.height);
  ctx.drawImage(source, 0, HEAD * scale);
  ctx.scale(scale, scale);
  drawHead(ctx, chart);
  const blob = await new Promise((done) => canvas.toBlob(done, "image/png"));
  save(blob, fileName(chart, "png"));
}

function drawHead(ctx, chart) {
  const family = getComputedStyle(chart.element).fontFamily;
  ctx.textBaseline = "middle";
  ctx.fillStyle = colour("--ink");
  ctx.font = `600 13px ${family}`;
  ctx.fillText(heading(chart), 12, 15);
  ctx.font = `11px ${family}`;
  let x = 12;
  for (const s of chart.visibleSeries) {
    ctx.strokeStyle = colour(s.color);
    ctx.lineWidth = 2;
    ctx.setLineDash(s.dash ?? []);
    if (s.style === "marks") {
      ctx.translate(x + 12, 34);
      ctx.stroke(new Path2D(MARK_PATHS[s.mark]));
      ctx.translate(-x - 12, -34);
    } else ctx.stroke(new Path2D(`M${x} 34h24`));
    ctx.fillStyle = colour("--ink-2");
    ctx.fillText(s.label, x + 30, 34);
    x += 44 + ctx.measureText(s.label).width;
  }
}

function heading({ spec, clock, sampling }) {
  const unit = spec.unit ? `, ${spec.unit}` : "";
  const subject = spec.subject ? ` · ${spec.subject}` : "";
  const across = spec.clock ? `time, ${timeUnit(clock.full[1])}` : `${spec.xLabel ?? "x"}, ${spec.xUnit ?? ""}`;
  return `${spec.title}${unit}${subject} · against ${across} · ${sampling}`;
}

export function exportCsv(chart) {
  const series = chart.visibleSeries;
  const toSi = (s) => s.siFactor ?? chart.spec.siFactor ?? 1;
  const unit = (s) => s.siUnit ?? chart.spec.siUnit ?? s.unit ?? chart.spec.unit ?? "";
  const readings = series.map((s) => {
    const { t, y } = chart.reading(s.key);
    return { t, y: y.map((v) => (v === null ? null : v * toSi(s))) };
  });
  const first = chart.spec.clock ? "t [s]" : `${chart.spec.xLabel ?? "x"} [${chart.spec.xUnit ?? ""}]`;
  const head = [first, ...series.map((s) => `${s.csv ?? s.label} [${unit(s)}]`)];
  const table = [head.map(quote), ...rows(readings, chart.clock.range)];
  save(new Blob([table.map((r) => r.join(",")).join("\r\n"), "\r\n"], { type: "text/csv" }), fileName(chart, "csv"));
}

export function quote(text) {
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

// ---- SVG: the same lines, bands and ticks as text; no raster.

export function exportSvg(chart) {
  const { plot, spec, clock } = chart;
  const scale = devicePixelRatio;
  const box = { x: plot.bbox.left / scale, y: plot.bbox.top / scale + HEAD, w: plot.bbox.width / scale, h: plot.bbox.height / scale };
  const [width, height] = [plot.width, plot.height + HEAD];
  const px = (v) => (box.x + plot.valToPos(v, "x")).toFixed(2);
  const py = (v) => (box.y + plot.valToPos(v, "y")).toFixed(2);
  const parts = [
    `<rect width="${width}" height="${height}" fill="${colour("--surface")}"/>`,
    text(12, 19, heading(chart), `font-size="13" font-weight="600" fill="${colour("--ink")}"`),
    ...ticks(chart, box, px, py),
    `<clipPath id="p"><rect x="${box.x}" y="${box.y}" width="${box.w}" height="${box.h}"/></clipPath><g clip-path="url(#p)">`,
    ...chart.bands.flatMap((band) => [2, 1].map((n) => bandPath(band, n, clock.range, px, py))),
    ...chart.visibleSeries.map((s) => linePath(chart.reading(s.key), s, clock.range, px, py, box)),
    "</g>",
    ...legend(chart),
  ];
  const svg = `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}" viewBox="0 0 ${width} ${height}" font-family="sans-serif" font-size="11"><title>${escape(spec.title)}</title>${parts.join("\n")}</svg>`;
  save(new Blob([svg], { type: "image/svg+xml" }), fileName(chart, "svg"));
}

function ticks({ plot, clock, spec }, box, px, py) {
  const [xs, ys] = plot.axes.map((axis) => axis._splits ?? []);
  const grid = `stroke="${colour("--line")}"`;
  const ink = `fill="${colour("--ink-2")}"`;
  const step = xs.length > 1 ? xs[1] - xs[0] : 1;
  const stepY = ys.length > 1 ? ys[1] - ys[0] : 1;
  const label = (v) => (spec.clock ? timeText(v, step, clock.full[1]) : spec.log?.x ? roundText(v) : number(v));
  const value = (v) => (spec.log?.y ? roundText(v) : tick(v, stepY));
  return [
    ...xs.map((v) => `<path d="M${px(v)} ${box.y}v${box.h}" ${grid}/>` + text(px(v), box.y + box.h + 15, label(v), `text-anchor="middle" ${ink}`)),
    ...ys.map((v) => `<path d="M${box.x} ${py(v)}h${box.w}" ${grid}/>` + text(box.x - 6, Number(py(v)) + 4, value(v), `text-anchor="end" ${ink}`)),
  ];
}

function linePath({ t, y }, series, range, px, py, box) {
  const first = Math.max(lowerBound(t, range[0]) - 1, 0);
  const last = Math.min(lowerBound(t, range[1]) + 1, t.length);
  const ink = colour(series.color);
  if (series.style === "dots") {
    const dots = [];
    for (let i = first; i < last; i++) if (y[i] !== null) dots.push(`<circle cx="${px(t[i])}" cy="${py(y[i])}" r="1.7" fill="${ink}"/>`);
    return dots.join("");
  }
  if (series.style === "marks") {
    const edge = (v) => Math.min(Math.max(Number(py(v)), box.y + 3), box.y + box.h - 3);
    const paint = series.mark === "dot" ? `fill="${ink}"` : `fill="none" stroke="${ink}" stroke-width="1.2"`;
    return t.map((x, i) => (x < range[0] || x > range[1] || y[i] === null ? "" : `<path transform="translate(${px(x)} ${edge(y[i])})" d="${MARK_PATHS[series.mark]}" ${paint}/>`)).join("");
  }
  if (series.style === "bars") return t.map((x, i) => (y[i] === null ? "" : `<path d="M${px(x)} ${py(0)}V${py(y[i])}" stroke="${ink}" stroke-width="5"/>`)).join("");
  let d = "";
  let pen = "M";
  for (let i = first; i < last; i++) {
    if (y[i] === null || y[i] === undefined) {
      pen = "M";
      continue;
    }
    if (series.style === "steps" && pen === "L") d += `H${px(t[i])}`;
    d += `${pen}${px(t[i])} ${py(y[i])}`;
    pen = "L";
  }
  const dash = series.dash?.length ? ` stroke-dasharray="${series.dash.join(" ")}"` : "";
  return `<path d="${d}" fill="none" stroke="${ink}" stroke-width="${series.width ?? 1.5}"${dash}/>`;
}

function bandPath({ t, mid, sd, lo, hi, color }, sigmas, range, px, py) {
  const up = [];
  const down = [];
  if (lo) {
    t.forEach((x, i) => lo[i] > 0 && up.push(`${px(x)} ${py(hi[i])}`) && down.unshift(`${px(x)} ${py(lo[i])}`));
    return sigmas === 1 && up.length ? `<path d="M${[...up, ...down].join("L")}Z" fill="${withAlpha(colour(color), 0.2)}"/>` : "";
  }
  for (let i = Math.max(lowerBound(t, range[0]) - 1, 0); i < Math.min(lowerBound(t, range[1]) + 1, t.length); i++) {
    if (mid[i] === null || sd[i] === null) continue;
    up.push(`${px(t[i])} ${py(mid[i] + sigmas * sd[i])}`);
    down.unshift(`${px(t[i])} ${py(mid[i] - sigmas * sd[i])}`);
  }
  return up.length ? `<path d="M${[...up, ...down].join("L")}Z" fill="${withAlpha(colour(color), sigmas === 1 ? 0.2 : 0.1)}"/>` : "";
}

function legend(chart) {
  let x = 12;
  return chart.visibleSeries.map((s) => {
    const dash = s.dash?.length ? ` stroke-dasharray="${s.dash.join(" ")}"` : "";
    const line = s.style === "marks" ? `<path transform="translate(${x + 12} 34)" d="${MARK_PATHS[s.mark]}" fill="none" stroke="${colour(s.color)}"/>` : `<path d="M${x} 34h24" stroke="${colour(s.color)}" stroke-width="2"${dash}/>`;
    const item = line + text(x + 30, 38, s.label, `fill="${colour("--ink-2")}"`);
    x += 50 + 6.2 * s.label.length;
    return item;
  });
}

function text(x, y, content, attributes) {
  return `<text x="${x}" y="${y}" ${attributes}>${escape(content)}</text>`;
}

export function escape(content) {
  return String(content).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);
}
