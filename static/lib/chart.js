// The one adapter around uPlot. A chart draws readings over time (or over anything), linked to its page by a
// time cursor: zooming one zooms all, and each asks the server again for as many points as it has room for.
//
//   const chart = createChart(host, {
//     id: "error-xy", title: "Position error", unit: "m", term: "error_xy" (terms.js), help: "own words",
//     series: [{ key: "fused", label: "fused", color: "--method-fused", dash: [], on: true, style: "line" | "dots" | "steps" | "bars" | "marks" }],
//                                             // marks: mark: "dot" | "cross" | "triangle"; scale: false: doesn't widen the value axis
//     clock,                                    // timecursor.js; absent: the chart keeps its own range over `domain`
//     load: async ({ t0, t1, points, signal }) => ({ series: { fused: { t, y, total, shown } },
//                                                    bands: { fused: { t, mid, sd } or { t, lo, hi, fit (widens the value axis) } }, gaps: [[t0, t1]] }),
//     bandFor: (keys) => key,                   // absent: the bands of all visible series
//     log: { x: false, y: false }, settle: false (scale to where the curve settles), domain: [x0, x1], xLabel: "τ", xUnit: "s", showTime: true, zero: false,
//     onToggle: (key, on) => {}, onEnlarge: () => {}, fileName: "run-error",
//   });
//   chart.setVisible(key, on); chart.setEvents([{ t0, t1, kind, color }]); chart.refresh(); chart.destroy();
//
// Mouse: wheel zooms, drag zooms to the selection, shift-drag pans, double-click shows all, click sets the time.
// Touch: drag pans, two fingers zoom. Keyboard, when focused: arrows move the time, + - zoom, Home shows all.

import uPlot from "../vendor/uPlot.esm.js";
import { axes, count, number, reading as legible, tick, timeText, timeUnit } from "./chart-axes.js";
import { bandExtent, breakAtGaps, extent, merge, settledExtent, valueAt } from "./chart-data.js";
import { drawMarks, drawUnder } from "./chart-draw.js";
import { buildFrame, legendItem, summaryTable } from "./chart-frame.js";
import { exportCsv, exportPng, exportSvg, copyLink } from "./chart-export.js";
import { gestures } from "./gestures.js";
import { colour, onThemeChange, withAlpha } from "./palette.js";
import { createTimeCursor } from "./timecursor.js";

const REFETCH_DELAY = 90; // ms of rest before the server is asked again
const DESCRIBE_DELAY = 60; // ms until what is drawn is told in words
const VALUE_AXIS = 58; // px, equal on all plots so that their time axes line up

export function createChart(host, spec) {
  const clock = spec.clock ?? createTimeCursor({ t0: spec.domain[0], t1: spec.domain[1] });
  const log = { x: false, y: false, ...spec.log };
  const visible = new Map(spec.series.map((s) => [s.key, s.on !== false]));
  const frame = buildFrame(host, spec, { toggle, tool });
  const cleanups = [];
  let coarse = null; // the answer for the whole range
  let fine = null; // the answer for `fineRange`
  let fineRange = null;
  let current = { readings: new Map(), bands: [], gaps: [] };
  let events = [];
  let plot = null;
  let request = null;
  let timer = 0;
  let describing = 0;
  let pending = 0; // the animation frame asked for
  let rangeMoved = false;
  let offScale = false; // a settled view leaves extremes out, and says so

  const chart = {
    spec,
    clock,
    frame,
    element: frame.root,
    get plot() {
      return plot;
    },
    get visibleSeries() {
      return spec.series.filter((s) => visible.get(s.key) && current.readings.has(s.key));
    },
    reading: (key) => current.readings.get(key),
    // Bands lie on each other: only one is shown where the spec says which.
    get bands() {
      const shown = current.bands.filter((b) => visible.get(b.key));
      const one = spec.bandFor?.(shown.map((b) => b.key));
      return spec.bandFor ? shown.filter((b) => b.key === one) : shown;
    },
    get gaps() {
      return current.gaps;
    },
    get events() {
      return events;
    },
    get sampling() {
      return frame.sampling.textContent;
    },
    setVisible(key, on) {
      if (!visible.has(key) || visible.get(key) === on) return;
      visible.set(key, on);
      showToggles();
      plot?.setSeries(spec.series.findIndex((s) => s.key === key) + 1, { show: on });
      if (on && !current.readings.has(key)) chart.refresh();
      else describe();
      drawCursors();
    },
    setEvents(list) {
      events = list;
      plot?.redraw(false);
    },
    refresh() {
      coarse = fine = fineRange = null;
      fetchNow();
    },
    // An answer that is at hand: drawn at once, on the range that it was made for.
    give(answer, range = clock.range) {
      request?.abort();
      coarse = fine = answer;
      fineRange = range;
      frame.say("");
      combine();
      frame.root.dataset.state = "ready";
      frame.root.dataset.range = `${range[0]},${range[1]}`;
    },
    export: (kind) => tool(kind),
    destroy() {
      request?.abort();
      clearTimeout(timer);
      clearTimeout(describing);
      cancelAnimationFrame(pending);
      for (const off of cleanups) off();
      plot?.destroy();
      frame.root.remove();
    },
  };

  // ---- readings

  function fetchLater() {
    clearTimeout(timer);
    timer = setTimeout(fetchNow, REFETCH_DELAY);
  }

  async function fetchNow() {
    request?.abort();
    const mine = (request = new AbortController());
    const whole = clock.isFullRange;
    const [t0, t1] = clock.range;
    const points = Math.min(Math.max(Math.round(frame.plot.clientWidth * 2), 1000), 4000);
    frame.root.dataset.state = "loading";
    try {
      const answer = await spec.load({ t0, t1, points, whole, signal: mine.signal, visible: (key) => visible.get(key) });
      if (mine.signal.aborted) return;
      if (whole) coarse = answer;
      [fine, fineRange] = [answer, [t0, t1]];
      frame.say("");
      combine();
      frame.root.dataset.state = "ready";
      frame.root.dataset.range = `${t0},${t1}`;
    } catch (error) {
      if (mine.signal.aborted || error.name === "AbortError") return;
      frame.root.dataset.state = "failed";
      frame.say(error.message, () => fetchNow());
    }
  }

  function combine() {
    const gaps = coarse?.gaps ?? fine.gaps ?? [];
    const readings = new Map();
    for (const s of spec.series) {
      const answer = fine.series[s.key];
      if (!answer) continue;
      const all = whole() ? answer : merge(coarse?.series[s.key], answer, fineRange);
      readings.set(s.key, { ...breakAtGaps(all, gaps), total: answer.total, shown: answer.shown });
    }
    const bands = Object.entries(fine.bands ?? {}).map(([key, band]) => ({
      key,
      color: spec.series.find((s) => s.key === key)?.color ?? "--ink",
      ...band,
    }));
    current = { readings, bands, gaps: fine.gaps ?? gaps };
    show();
  }

  function whole() {
    return fine === coarse;
  }

  // ---- drawing

  // The plot itself is made once and then only given data: a drag under way must survive an answer that arrives.
  function show() {
    if (!frame.plot.clientWidth) return;
    const empty = { t: [], y: [] };
    const readings = spec.series.map((s) => current.readings.get(s.key) ?? empty);
    const together = readings.every(({ t }) => t === readings[0].t); // one set of stamps: nothing to join
    const data = together ? [readings[0].t, ...readings.map(({ y }) => y)] : uPlot.join(readings.map(({ t, y }) => [t, y]), readings.map(() => [0, 1]));
    if (plot) {
      plot.setData(data);
    } else {
      plot = new uPlot(options(), data, frame.plot);
      attach(plot.over);
    }
    frame.root.dataset.points = String(chart.visibleSeries.reduce((n, s) => n + current.readings.get(s.key).shown, 0));
    drawCursors();
    clearTimeout(describing);
    describing = setTimeout(describe, DESCRIBE_DELAY); // after uPlot has settled its scales, and not with every move
  }

  function options() {
    const font = `11px ${getComputedStyle(frame.root).fontFamily}`;
    const showTime = spec.showTime !== false;
    const across = spec.clock ? ["time", timeUnit(clock.full[1])] : [spec.xLabel, spec.xUnit].filter(Boolean);
    const look = { clock: spec.clock, log, showTime, font, valueWidth: VALUE_AXIS, label: across.join(", ") };
    return {
      width: frame.plot.clientWidth,
      height: frame.plot.clientHeight,
      padding: [8, clock.full[1] > 3600 ? 24 : 15, showTime ? 0 : 7, 0],
      cursor: { show: false },
      legend: { show: false },
      scales: {
        x: { time: false, distr: log.x ? 3 : 1, range: () => clock.range },
        y: { distr: log.y ? 3 : 1, range: valueRange },
      },
      axes: axes({ ...look, ink: () => colour("--ink-2"), grid: () => colour("--line") }),
      series: [{}, ...spec.series.map(line)],
      hooks: {
        setScale: [(u, key) => key === "y" && u === plot && drawCursors()], // readings are as fine as their axis
        drawAxes: [(u) => drawUnder(u, { gaps: current.gaps, events, bands: chart.bands, range: clock.range })],
        draw: [(u) => chart.visibleSeries.filter((s) => s.style === "marks").reverse().forEach((s) => drawMarks(u, current.readings.get(s.key), s, clock.range))],
      },
    };
  }

  function line(s) {
    const ink = () => colour(s.color);
    const dots = s.style === "dots";
    if (s.style === "marks") return { show: visible.get(s.key), paths: () => null, points: { show: false } };
    return {
      show: visible.get(s.key),
      stroke: ink,
      width: s.width ?? 1.5,
      dash: s.dash?.length ? s.dash : undefined,
      paths: dots ? () => null : s.style === "bars" ? uPlot.paths.bars({ size: [0.55, 40] }) : s.style === "steps" ? uPlot.paths.stepped({ align: 1 }) : undefined,
      fill: s.fill || s.style === "bars" ? () => withAlpha(ink(), 0.18) : undefined,
      points: dots ? { show: true, size: 3.5, fill: ink, stroke: ink } : s.style === "steps" || s.style === "bars" ? { show: false } : { size: 4, fill: ink, stroke: ink },
    };
  }

  function valueRange() {
    let all = null;
    const widen = (e) => {
      if (e) all = all ? [Math.min(all[0], e[0]), Math.max(all[1], e[1])] : e;
    };
    const scaling = chart.visibleSeries.filter((s) => s.scale !== false);
    for (const s of scaling) widen(extent(current.readings.get(s.key), clock.range));
    const settled = spec.settle ? settledExtent(scaling.map((s) => current.readings.get(s.key)), clock.range) : null;
    offScale = Boolean(settled && all && (all[0] < settled[0] || all[1] > settled[1]));
    if (offScale) all = [Math.max(all[0], settled[0]), Math.min(all[1], settled[1])];
    const lines = all;
    for (const band of chart.bands.filter((b) => b.sd)) widen(bandExtent(band, clock.range, lines, spec.settle ? 0.3 : 2));
    for (const band of chart.bands.filter((b) => b.fit)) [band.lo, band.hi].forEach((y) => widen([Math.min(...y), Math.max(...y)]));
    if (all && spec.zero && (!lines || lines[0] >= 0)) all = [Math.max(all[0], 0), all[1]];
    if (!all) return log.y ? [0.1, 10] : [-1, 1];
    if (log.y) return [all[0] / 1.3, all[1] * 1.3];
    if (spec.zero) widen([0, 0]);
    const room = all[1] > all[0] ? 0.07 * (all[1] - all[0]) : Math.max(Math.abs(all[0]) * 0.1, 1e-6);
    return [spec.zero && all[0] === 0 ? 0 : all[0] - room, all[1] + room];
  }

  // ---- the cursor and what it reads

  function drawCursors() {
    if (!plot) return;
    const place = (element, t) => {
      const inside = t !== null && t >= clock.range[0] && t <= clock.range[1];
      element.hidden = !inside;
      if (inside) element.style.transform = `translateX(${plot.valToPos(t, "x")}px)`;
    };
    if (spec.clock) place(frame.timeLine, clock.time);
    place(frame.hoverLine, clock.hover);
    const t = clock.hover ?? (spec.clock ? clock.time : null);
    frame.root.dataset.time = t === null ? "" : String(t);
    for (const s of spec.series) {
      const reading = current.readings.get(s.key);
      const value = t === null || !reading ? null : valueAt(reading, t);
      frame.legend.get(s.key).value.textContent = value === null ? "–" : legible(value, [plot.scales.y.min, plot.scales.y.max], log.y);
    }
    const span = clock.full[1];
    const when = spec.clock ? `${timeText(t, 0.01, span)} ${timeUnit(span)}` : t === null ? "" : `${number(t)} ${spec.xUnit ?? ""}`;
    if (frame.when) frame.when.textContent = when;
  }

  function showToggles() {
    for (const s of spec.series) {
      const on = visible.get(s.key);
      const item = frame.legend.get(s.key);
      item.root.setAttribute("aria-pressed", String(on));
    }
  }

  // "4,000 of 16.6 M points": said of what is visible.
  function describe() {
    let total = 0;
    let shown = 0;
    for (const s of chart.visibleSeries) {
      total += current.readings.get(s.key).total;
      shown += current.readings.get(s.key).shown;
    }
    frame.sampling.textContent = total ? (shown < total ? `${count(shown)} of ${count(total)} points` : `all ${count(total)} points`) : "no readings here";
    if (offScale) frame.sampling.prepend("peaks cut · ");
    const [a, b] = clock.range;
    const names = chart.visibleSeries.map((s) => s.label).join(", ") || "nothing shown";
    frame.plot.setAttribute(
      "aria-label",
      `${spec.title}, ${spec.unit || "no unit"}: ${names}; ${tick(a, 0.01)} to ${tick(b, 0.01)} ${spec.xUnit ?? "s"}; ${frame.sampling.textContent}`,
    );
    if (!frame.table.hidden) summaryTable(frame.table, chart);
  }

  function toggle(key) {
    const on = !visible.get(key);
    if (spec.onToggle) spec.onToggle(key, on);
    else chart.setVisible(key, on);
  }

  function tool(kind) {
    if (kind === "png") return exportPng(chart);
    if (kind === "svg") return exportSvg(chart);
    if (kind === "csv") return exportCsv(chart);
    if (kind === "link") return copyLink();
    if (kind === "enlarge") return spec.onEnlarge?.();
    frame.table.hidden = !frame.table.hidden;
    return summaryTable(frame.table, chart);
  }

  // ---- what the user does

  function attach(over) {
    over.append(frame.timeLine, frame.hoverLine, frame.selection);
    const width = () => over.clientWidth;
    // From the clock, not from the plot: several moves may come before the plot is drawn again.
    const time = (x) => {
      const [lo, hi] = clock.range;
      const share = x / width();
      return log.x ? lo * (hi / lo) ** share : lo + (hi - lo) * share;
    };
    gestures(over, {
      hover: (x) => clock.setHover(time(x)),
      leave: () => clock.setHover(null),
      click: (x) => clock.setTime(time(x)),
      reset: () => clock.resetRange(),
      pan: (dx) => clock.setRange(time(-dx), time(width() - dx)),
      zoom: (factor, x) => clock.setRange(time(x - x * factor), time(x + (width() - x) * factor)),
      select(x0, x1, done) {
        const [a, b] = [Math.max(Math.min(x0, x1), 0), Math.min(Math.max(x0, x1), width())];
        frame.selection.hidden = done !== false;
        frame.selection.style.transform = `translateX(${a}px)`;
        frame.selection.style.width = `${b - a}px`;
        if (done && b - a > 3) clock.setRange(time(a), time(b));
      },
    });
  }

  function onKey(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const act = {
      ArrowLeft: () => clock.step(event.shiftKey ? -25 : -1),
      ArrowRight: () => clock.step(event.shiftKey ? 25 : 1),
      "+": () => clock.zoom(0.5, clock.time),
      "=": () => clock.zoom(0.5, clock.time),
      "-": () => clock.zoom(2, clock.time),
      Home: () => clock.resetRange(),
    }[event.key];
    if (!act) return;
    event.preventDefault();
    event.stopPropagation();
    act();
  }

  function onClock(what) {
    if (what === "range") {
      rangeMoved = true;
      fetchLater();
    } else if (what !== "time" && what !== "hover") return;
    if (!pending) pending = requestAnimationFrame(follow);
  }

  function follow() {
    pending = 0;
    if (rangeMoved) plot?.setScale("x", { min: clock.range[0], max: clock.range[1] });
    rangeMoved = false;
    drawCursors();
  }

  let width = 0;
  const sizes = new ResizeObserver(() => {
    const grown = frame.plot.clientWidth > width * 1.2;
    if (!frame.plot.clientWidth) return;
    if (!plot && fine) show();
    plot?.setSize({ width: frame.plot.clientWidth, height: frame.plot.clientHeight });
    drawCursors();
    if (grown) {
      width = frame.plot.clientWidth;
      fetchLater();
    }
  });

  width = frame.plot.clientWidth;
  frame.plot.addEventListener("keydown", onKey);
  sizes.observe(frame.plot);
  cleanups.push(clock.subscribe(onClock), onThemeChange(() => plot?.redraw(false)), () => sizes.disconnect());
  for (const s of spec.series) legendItem(frame, s, toggle);
  showToggles();
  fetchNow();
  return chart;
}
