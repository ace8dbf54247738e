// One run of the report: its path by the gap, timeline, and the overlay with its slider, on one time cursor.

import { $, h } from "../lib/dom.js";
import { createChart } from "../lib/chart.js";
import { createMap } from "../lib/map.js";
import { seriesSwatch } from "../lib/chart-frame.js";
import { length } from "../lib/format.js";
import { createTimeCursor } from "../lib/timecursor.js";
import { mountGapScene } from "./diagnosis-scene.js";
import { level, levelColour } from "./gap-levels.js";
import { streamName } from "./gap-words.js";

const NAMES = ["under 1.1", "1.1 to 1.5", "1.5 to 2.5", "2.5 to 4", "4 to 8", "8 to 16", "over 16"];
const REAL = { label: "real", color: "--method-truth", dash: [], width: 1.75 };
const NOMINAL = { label: "simulated", color: "--ink-3", dash: [6, 4], width: 1.5 };
const PATCHED = { label: "patched", color: "--patched", dash: [], width: 2 };

export function mountRun(run, { params, some, changed, fileName }) {
  const clock = createTimeCursor(spanOf(run));
  const given = (name) => (params.has(name) ? Number(params.get(name)) : null);
  if (given("t0") !== null) clock.setRange(given("t0"), given("t1") ?? clock.full[1]);
  if (given("t") !== null) clock.setTime(given("t"));
  const offs = [];
  const map = run.path && gapMap(run, clock, fileName);
  const chart = run.timeline?.t.length > 1 && timeline(run, clock, fileName);
  const overlay = run.free_run?.paths.length && overlayMap(run, clock, fileName, given("share"), some, moved);
  const alone = params.get("view");
  const scene = run.stored && alone !== "map" && (run.path || run.free_run) ? mountGapScene($("#scene"), run.id, clock) : null;
  $("#scene").hidden = !scene;
  $("#map-gap").hidden = !map || (alone === "scene" && Boolean(scene));
  $("#map-scale").hidden = !map;
  $("#views").hidden = !map && !scene;
  $("#strip").hidden = !map && !chart;
  $("#timeline").hidden = !chart;
  $("#overlay").hidden = !overlay;
  if (scene) scene.show(run.path && finest(run), overlay?.nominal ?? null, overlay?.mixed() ?? null);
  offs.push(strip(clock), clock.subscribe((what) => ["time", "range"].includes(what) && changed()));

  function moved() {
    scene?.show(null, null, overlay.mixed());
    changed();
  }

  return {
    clock,
    look(t0, t1) {
      const room = 0.25 * (t1 - t0);
      clock.setRange(t0 - room, t1 + room);
      clock.setTime(t0);
    },
    address: () => ({
      ...(alone ? { view: alone } : {}),
      ...(clock.isFullRange ? {} : { t0: clock.range[0].toFixed(2), t1: clock.range[1].toFixed(2) }),
      ...(clock.time > clock.full[0] ? { t: clock.time.toFixed(2) } : {}),
      ...(overlay && overlay.share() < 1 ? { share: overlay.share().toFixed(2) } : {}),
    }),
    destroy() {
      clock.pause();
      offs.forEach((off) => off());
      for (const part of [map, chart, overlay, scene]) (part?.destroy ?? part?.dispose)?.();
      for (const name of ["t0", "t1", "t"]) params.delete(name);
    },
  };
}

function spanOf(run) {
  const stamps = [run.path?.t, run.free_run?.t, run.timeline?.t].filter((t) => t?.length);
  return { t0: Math.min(...stamps.map((t) => t[0])), t1: Math.max(...stamps.map((t) => t.at(-1))) };
}

/* the path in pieces, each in the colour of its gap */

function gapMap(run, clock, fileName) {
  const { t, x, y, theta, gap } = finest(run);
  const levels = gap.map(level);
  const map = createMap($("#map-gap"), { clock, subject: run.name, fileName: `${fileName}-gap` });
  const pieces = NAMES.map((label, k) => {
    const on = (i) => levels[i] === k || levels[i - 1] === k; // a piece reaches to where the next begins
    const only = (column) => column.map((v, i) => (on(i) ? v : null));
    return { method: `gap-${k}`, label: `gap ${label} × the floor`, color: levelColour(k), dash: [], width: 4, ends: false, t, x: only(x), y: only(y), theta };
  }).filter((piece) => piece.x.some((v) => v !== null));
  const robot = { method: "real", label: "real", ...REAL, width: 0.75, t, x, y, theta };
  map.setPaths([robot, ...pieces.map((p) => ({ ...p, robot: false }))], []);
  map.setLead("real");
  return map;
}

// Where the whole drive is known at more points than the path by the gap, on those.
export function finest({ path, free_run: free }) {
  if (!free || free.t.length <= path.t.length) return path;
  let k = 0;
  const gap = free.t.map((t) => {
    while (k < path.t.length - 1 && path.t[k] < t) k += 1;
    return path.gap[k];
  });
  return { t: free.t, ...free.real, gap };
}

/* the gap over time */

function timeline(run, clock, fileName) {
  const { t, before, after } = run.timeline;
  const streams = Object.keys(before);
  const rms = (by) => t.map((_, k) => {
    const known = streams.map((s) => by[s]?.[k]).filter((v) => v !== null && v !== undefined);
    return known.length ? Math.sqrt(known.reduce((sum, v) => sum + v * v, 0) / known.length) : null;
  });
  const reading = (y) => ({ t, y, total: t.length, shown: t.length });
  const single = streams.map((s, i) => ({ key: s, label: streamName(s), csv: s, color: ["--c1", "--c3", "--c4", "--method-fixes"][i % 4], dash: [[], [4, 3], [1, 3]][Math.floor(i / 4) % 3], on: false, width: 1 }));
  return createChart($("#timeline"), {
    id: "gap-timeline",
    title: "Gap over time",
    unit: "× noise",
    term: "gap_timeline",
    subject: run.name,
    fileName,
    clock,
    zero: true,
    series: [{ key: "before", label: "simulated", color: "--ink-3", dash: [6, 4] }, { key: "after", label: "patched", color: "--patched", width: 2 }, ...single],
    load: async () => ({ series: { before: reading(rms(before)), after: reading(rms(after)), ...Object.fromEntries(streams.map((s) => [s, reading(before[s])])) }, gaps: [] }),
  });
}

/* real, simulated, and with a share of the effects added */

function overlayMap(run, clock, fileName, first, some, moved) {
  const { t, real, shares, paths } = run.free_run;
  const map = createMap($("#map-overlay"), { clock, subject: run.name, fileName: `${fileName}-overlay` });
  const slider = $("#share");
  if (first !== null) slider.value = String(Math.round(100 * first));

  function mixed() {
    const share = Number(slider.value) / 100;
    const hi = Math.max(1, shares.findIndex((s) => s >= share));
    const part = (share - shares[hi - 1]) / (shares[hi] - shares[hi - 1] || 1);
    const mix = (c) => paths[hi][c].map((v, i) => (v === null || paths[hi - 1][c][i] === null ? null : paths[hi - 1][c][i] + part * (v - paths[hi - 1][c][i])));
    return { t, x: mix("x"), y: mix("y"), theta: mix("theta") };
  }

  const paint = () => {
    $("#share-now").textContent = `${slider.value} %`;
    const shown = mixed();
    $("#overlay-told").textContent = apart(real, paths[0], some && Number(slider.value) ? shown : null, Number(slider.value));
    const patched = { method: "patched", ...PATCHED, label: `with ${slider.value} % of the effects`, ...shown };
    map.setPaths([{ method: "real", ...REAL, t, ...real }, { method: "simulated", ...NOMINAL, t, ...paths[0] }, ...(some ? [patched] : [])], []);
  };
  const named = [REAL, { ...NOMINAL, label: "simulated, as it is" }, ...(some ? [{ ...PATCHED, label: "simulated, with the effects" }] : [])];
  $("#overlay-legend").replaceChildren(...named.map((one) => h("span", {}, seriesSwatch(one), one.label)));
  const onInput = () => (paint(), moved());
  slider.addEventListener("input", onInput);
  map.setLead("real");
  paint();
  return {
    nominal: { t, ...paths[0] },
    mixed,
    share: () => Number(slider.value) / 100,
    destroy() {
      slider.removeEventListener("input", onInput);
      map.destroy();
    },
  };
}

// How far the paths are from the real one: at the end, and on the whole.
function apart(real, simulated, patched, share) {
  const away = ({ x, y }) => {
    const known = real.x.map((v, i) => (v === null || x[i] === null ? null : Math.hypot(x[i] - v, y[i] - real.y[i]))).filter((v) => v !== null);
    return known.length ? `${length(known.at(-1)).text} at the end (rms ${length(Math.sqrt(known.reduce((sum, v) => sum + v * v, 0) / known.length)).text})` : "unknown";
  };
  return `Driven in one go from the start, the simulator is ${away(simulated)} from the real path${patched ? `; with ${share} % of the effects ${away(patched)}` : ""}.`;
}

function strip(clock) {
  const [slider, now, play] = [$("#time"), $("#now"), $("#play")];
  const [a, b] = clock.full;
  const paint = () => {
    slider.value = String((1000 * (clock.time - a)) / (b - a));
    now.textContent = `${clock.time.toFixed(1)} s`;
    play.textContent = clock.playing ? "Pause" : "Play";
  };
  const onInput = () => clock.setTime(a + (Number(slider.value) / 1000) * (b - a));
  const onPlay = () => clock.toggle();
  slider.addEventListener("input", onInput);
  play.addEventListener("click", onPlay);
  const off = clock.subscribe(paint);
  paint();
  return () => {
    off();
    slider.removeEventListener("input", onInput);
    play.removeEventListener("click", onPlay);
  };
}
