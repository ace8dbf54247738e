// A plot that scrolls: the newest seconds of a few signals, drawn by uPlot from rings. Whoever owns it says when.
//
//   const plot = createScroll(host, { id: "gyro", title: "Gyro", unit: "°/s", term: "live_gyro", scale: 57.3, seconds: 20,
//                                     series: [{ key: "gz", label: "gz", color: "--c1", dash: [], band: true, widest: 0.1 }] });
//   plot.push("gz", t, y, sd); plot.draw(now);      draw at most once per animation frame; nothing new, nothing drawn

import uPlot from "../vendor/uPlot.esm.js";
import { axes, reading } from "./chart-axes.js";
import { seriesSwatch } from "./chart-frame.js";
import { h } from "./dom.js";
import { colour, onThemeChange, withAlpha } from "./palette.js";
import { createRing } from "./ring.js";

const VALUE_AXIS = 50;

export function createScroll(host, { id, title, unit, term, series, scale = 1, seconds = 20, capacity = 4000, least = 0, zero = false }) {
  const rings = new Map(series.map((s) => [s.key, createRing(["y", "sd"], capacity)]));
  const values = new Map(series.map((s) => [s.key, h("output", { class: "legend-value" }, "–")]));
  const legend = series.map((s) => h("span", { class: "legend-item", "data-hint": s.help, tabindex: s.help ? "0" : undefined }, seriesSwatch({ dash: [], ...s }), h("span", {}, s.label), values.get(s.key)));
  const head = h("figcaption", { class: "chart-head" }, h("span", { class: "chart-title", "data-term": term, tabindex: term ? "0" : undefined }, title), h("span", { class: "chart-unit" }, unit), h("div", { class: "chart-legend" }, legend));
  const body = h("div", { class: "chart-plot", role: "img", "aria-label": `${title}, ${unit}, the newest ${seconds} s` });
  const root = h("figure", { class: "chart compact scroll", "data-scroll": id }, head, body);
  host.append(root);
  let now = 0;
  let plot = null;
  let dirty = true;

  const seen = (key) => rings.get(key).since(now - seconds);

  function options() {
    const font = `11px ${getComputedStyle(root).fontFamily}`;
    return {
      width: body.clientWidth,
      height: body.clientHeight,
      padding: [6, 8, 0, 0],
      cursor: { show: false },
      legend: { show: false },
      scales: { x: { time: false, range: () => [now - seconds, now] }, y: { range: valueRange } },
      axes: axes({ clock: null, log: {}, ink: () => colour("--ink-2"), grid: () => colour("--line"), font, showTime: true, valueWidth: VALUE_AXIS, label: "time, s" }),
      series: [{}, ...series.map(line)],
      hooks: { drawAxes: [drawBands] },
    };
  }

  function line(s) {
    const paths = s.style === "steps" ? uPlot.paths.stepped({ align: 1 }) : undefined;
    return { stroke: () => colour(s.color), width: s.width ?? 1.4, dash: s.dash?.length ? s.dash : undefined, paths, points: { show: false } };
  }

  // As wide as what is seen, and never narrower than `least`: noise at rest stays noise.
  function valueRange() {
    let [lo, hi] = zero ? [0, 0] : [Infinity, -Infinity];
    for (const s of series) {
      const { y, sd } = seen(s.key);
      for (let i = 0; i < y.length; i++) {
        const wide = s.band && sd[i] > 0 ? Math.min(2 * sd[i], s.widest ?? Infinity) : 0;
        if (y[i] - wide < lo) lo = y[i] - wide;
        if (y[i] + wide > hi) hi = y[i] + wide;
      }
    }
    if (!(lo <= hi)) return [-1, 1];
    const half = Math.max((hi - lo) / 2, least / 2, 1e-9) * 1.1;
    return [((lo + hi) / 2 - half) * scale, ((lo + hi) / 2 + half) * scale];
  }

  function drawBands(u) {
    for (const s of series.filter((one) => one.band)) {
      const rows = seen(s.key);
      for (const [sigmas, alpha] of [[2, 0.12], [1, 0.2]]) fillBand(u, rows, s, sigmas, alpha);
    }
  }

  function fillBand(u, { t, y, sd }, s, sigmas, alpha) {
    const { ctx, bbox } = u;
    const put = (i, side) => sd[i] > 0 && ctx.lineTo(u.valToPos(t[i], "x", true), u.valToPos((y[i] + side * sigmas * sd[i]) * scale, "y", true));
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.beginPath();
    for (let i = 0; i < t.length; i++) put(i, 1);
    for (let i = t.length - 1; i >= 0; i--) put(i, -1);
    ctx.closePath();
    ctx.fillStyle = withAlpha(colour(s.color), alpha);
    ctx.fill();
    ctx.restore();
  }

  function draw(time) {
    if (!dirty || !body.clientWidth) return;
    dirty = false;
    now = time;
    const tables = series.map((s) => {
      const { t, y } = seen(s.key);
      return [t, scale === 1 ? y : y.map((v) => v * scale)];
    });
    const data = tables.length === 1 ? tables[0] : uPlot.join(tables, tables.map(() => [0, 1]));
    if (plot) plot.setData(data);
    else plot = new uPlot(options(), data, body);
  }

  // Figures are for reading: at the rate of the drawing they would flicker.
  function tell() {
    const { min, max } = plot?.scales.y ?? {};
    for (const s of series) values.get(s.key).textContent = reading(rings.get(s.key).latest("y") * scale, [min, max]);
  }

  const sizes = new ResizeObserver(() => {
    if (!body.clientWidth) return;
    plot?.setSize({ width: body.clientWidth, height: body.clientHeight });
    dirty = true;
  });
  sizes.observe(body);
  onThemeChange(() => plot?.redraw(false));

  return {
    element: root,
    push(key, t, y, sd) {
      rings.get(key).push(t, { y, sd });
      dirty = true;
    },
    draw,
    tell,
    clear() {
      for (const ring of rings.values()) ring.clear();
      dirty = true;
    },
  };
}
