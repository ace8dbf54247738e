// Every column of the run: readings at the left, what is left of them at the right; only plots in sight are asked for.

import { createChart } from "../lib/chart.js";
import { debounce, h } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { humanOf } from "./sandbox-scale.js";

const SPARSE = ["beacon", "ranges"];

export function createStreams(host, { clock, source, lines, onSight }) {
  const pairs = new Map();
  const seen = new Set();
  const announce = debounce(30, onSight);
  const sight = new IntersectionObserver(
    (entries) => {
      let fresh = false;
      for (const { isIntersecting, target } of entries) {
        const name = target.dataset.column;
        if (isIntersecting && !seen.has(name)) fresh = true;
        if (isIntersecting) seen.add(name);
        else seen.delete(name);
      }
      if (fresh) announce();
    },
    { root: host.closest("main"), rootMargin: "60px" },
  );
  for (const name of source.channels) {
    const root = h("div", { class: "stream-pair", "data-column": name }, h("div", { class: "card" }), h("div", { class: "card" }));
    host.append(root);
    pairs.set(name, { root, charts: null, column: null });
    sight.observe(root);
  }

  return {
    visible: () => source.channels.filter((name) => seen.has(name)),
    show({ streams }) {
      for (const column of streams) {
        const pair = pairs.get(column.column);
        pair.answers = answersOf(column);
        pair.charts ??= made(pair, column);
        pair.charts.forEach((chart, k) => chart.plot && chart.give(pair.answers[k]));
      }
    },
    showGap(gap) {
      for (const [name, pair] of pairs) tellGap(pair, name, gap?.streams[name]);
    },
  };

  function tellGap(pair, name, figures) {
    const title = pair.charts && pair.root.children[1].querySelector(".chart-unit");
    if (title) title.textContent = figures ? `${pair.unit}, ${number(figures.before)} → ${number(figures.now)} × noise` : pair.unit;
  }

  function made(pair, { column, unit, label }) {
    const human = humanOf(unit);
    const style = SPARSE.some((s) => column.startsWith(s)) ? "dots" : "line";
    const recorded = source.recorded;
    const line = (key, of, text = lines[key].label) => ({ key: of, label: text, color: lines[key].color, dash: style === "dots" ? [] : lines[key].dash, width: 1.5, style });
    const readings = ["real", "nominal", "patched", "recorded"].filter((key) => pair.answers[0].series[key]).map((key) => line(key, key));
    const rests = recorded ? [line("nominal", "residual_nominal"), line("patched", "residual_patched")] : [line("patched", "difference", "patched − nominal")];
    const load = (k) => async () => pair.answers[k]; // a range that moves is asked for by the page, for all charts at once
    const id = column.replace(".", "-");
    const spec = { unit: human.unit, clock };
    pair.unit = human.unit;
    return [
      createChart(pair.root.children[0], { ...spec, id, title: column, help: label, series: readings, load: load(0), fileName: `sandbox-${id}` }),
      createChart(pair.root.children[1], { ...spec, id: `${id}-rest`, title: recorded ? "residual" : "difference", term: "sandbox_residual", series: rests, load: load(1), fileName: `sandbox-${id}-residual` }),
    ];
  }
}

/** A column's answers for its two charts: readings, and what is left of them; angles in degrees. */
function answersOf(column) {
  const { factor } = humanOf(column.unit);
  const { t, total, shown } = column;
  const scaled = (values) => (factor === 1 ? values : values.map((v) => (v === null ? null : v * factor)));
  const of = (keys) => Object.fromEntries(keys.filter((key) => column[key]).map((key) => [key, { t, y: scaled(column[key]), total, shown }]));
  const rests = column.real ? of(["residual_nominal", "residual_patched"]) : { difference: { t, y: scaled(difference(column)), total, shown } };
  return [of(["real", "nominal", "patched", "recorded"]), rests].map((series) => ({ series, bands: {}, gaps: [] }));
}

const difference = ({ patched, nominal }) => patched.map((v, i) => (v === null || nominal[i] === null ? null : v - nominal[i]));
