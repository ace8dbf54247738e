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
    show({ streams, gap }) {
      for (const column of streams) {
        const pair = pairs.get(column.column);
        pair.column = column;
        if (!pair.charts) pair.charts = made(pair, column);
        else for (const chart of pair.charts) chart.refresh();
        tellGap(pair, gap?.streams[column.column]);
      }
    },
  };

  function tellGap(pair, figures) {
    const title = pair.root.children[1].querySelector(".chart-unit");
    if (figures && title) title.textContent = `${humanOf(pair.column.unit).unit}, ${number(figures.before)} → ${number(figures.now)} × noise`;
  }

  function made(pair, { column, unit, label }) {
    const human = humanOf(unit);
    const style = SPARSE.some((s) => column.startsWith(s)) ? "dots" : "line";
    const recorded = source.recorded;
    const line = (key, of, text = lines[key].label) => ({ key: of, label: text, color: lines[key].color, dash: style === "dots" ? [] : lines[key].dash, width: 1.5, style });
    const readings = (recorded ? ["real", "nominal", "patched"] : ["nominal", "patched"]).map((key) => line(key, key));
    const rests = recorded ? [line("nominal", "residual_nominal"), line("patched", "residual_patched")] : [line("patched", "difference", "patched − nominal")];
    const load = (keys) => async () => ({ series: Object.fromEntries(keys.map((key) => [key, series(pair.column, key, human.factor)])), bands: {}, gaps: [] });
    const id = column.replace(".", "-");
    const spec = { unit: human.unit, clock };
    return [
      createChart(pair.root.children[0], { ...spec, id, title: column, help: label, series: readings, load: load(readings.map((r) => r.key)), fileName: `sandbox-${id}` }),
      createChart(pair.root.children[1], { ...spec, id: `${id}-rest`, title: recorded ? "residual" : "difference", term: "sandbox_residual", series: rests, load: load(rests.map((r) => r.key)), fileName: `sandbox-${id}-residual` }),
    ];
  }
}

function series(column, key, factor) {
  const values = key === "difference" ? column.patched.map((v, i) => (v === null || column.nominal[i] === null ? null : v - column.nominal[i])) : column[key];
  return { t: column.t, y: values.map((v) => (v === null ? null : v * factor)), total: column.total, shown: column.shown };
}
