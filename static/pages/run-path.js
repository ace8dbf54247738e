// Map beside 3D, and what both show: the paths, thinned for the whole run and drawn again finely for the visible range.

import { api, query } from "../lib/api.js";
import { $, debounce, h } from "../lib/dom.js";
import { keys } from "../lib/keys.js";
import { createMap } from "../lib/map.js";
import { lowerBound } from "../lib/chart-data.js";
import { methodStyle } from "../lib/methods.js";
import { mountScene } from "../lib/scene.js";

const POINTS = 4000;
const COLUMNS = ["t", "x", "y", "theta", "sd_x", "sd_y", "sd_theta", "cov_xy"];

export function mountPaths({ run, clock, state, fileName, lead }) {
  const split = $("#split");
  const bar = $("#split-bar");
  const stage = $("#split-scene");
  const map = createMap($("#split-map"), { clock, subject: run.name, fileName });
  let scene = null;
  let coarse = null;
  let request = null;

  for (const m of state.methods) map.setVisible(m.name, state.isVisible(m.name));
  map.setLead(lead());
  if (state.map) map.setView(state.map);
  map.onView = (view) => (state.map = view) || state.writeNow();

  async function load() {
    request?.abort();
    request = new AbortController();
    const [t0, t1] = clock.isFullRange ? [] : clock.range;
    try {
      if (!coarse) coarse = await api(`runs/${run.id}/path?${query({ points: POINTS })}`, { signal: request.signal });
      const fine = t0 === undefined ? coarse : await api(`runs/${run.id}/path?${query({ points: POINTS, t0, t1 })}`, { signal: request.signal });
      show(fine, t0, t1);
    } catch (error) {
      if (error.name === "AbortError") return;
      map.say(error.message);
    }
  }

  function show(fine, t0, t1) {
    const paths = coarse.paths.map((whole) => {
      const part = fine === coarse ? null : fine.paths.find((p) => p.method === whole.method);
      return dressed(part ? spliced(whole, part, t0, t1) : whole);
    });
    map.setPaths(paths, coarse.beacons);
    map.say(paths.length ? "" : "No path yet.");
  }

  function dressed(path) {
    const style = methodStyle(path.method);
    return { ...path, label: style.label, color: style.color, dash: style.dash, width: style.width, dots: path.method === "fixes" };
  }

  // ---- 3D: after the first paint, and only where it is in sight

  function openScene() {
    if (scene || state.view === "map" || state.tab !== "path") return;
    scene = mountScene(stage, run.id, clock, { methods: shown() });
  }

  // Of a run that goes on, 3D has the paths so far, which are not stored yet.
  const shown = () => run.is_live ? null : state.methods.filter((m) => m.has && state.isVisible(m.name)).map((m) => m.name);

  // ---- layout

  function layout() {
    split.dataset.view = state.view;
    split.style.setProperty("--share", `${state.split}%`);
    bar.setAttribute("aria-valuenow", String(Math.round(state.split)));
    openScene();
  }

  bar.addEventListener("pointerdown", (event) => {
    bar.setPointerCapture(event.pointerId);
    split.classList.add("dragging");
  });
  bar.addEventListener("pointermove", (event) => {
    if (!split.classList.contains("dragging")) return;
    const box = split.getBoundingClientRect();
    state.set("split", Math.min(Math.max(((event.clientX - box.left) / box.width) * 100, 10), 90));
  });
  for (const end of ["pointerup", "pointercancel"]) bar.addEventListener(end, () => split.classList.remove("dragging"));
  bar.addEventListener("dblclick", () => state.set("split", 50));
  bar.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -4, ArrowRight: 4 }[event.key];
    if (!step) return;
    event.preventDefault();
    state.set("split", Math.min(Math.max(state.split + step, 10), 90));
  });
  keys("Run", {
    m: ["map alone, and back", () => state.set("view", state.view === "map" ? "both" : "map")],
    v: ["3D alone, and back", () => state.set("view", state.view === "scene" ? "both" : "scene")],
  });

  const loadLater = debounce(160, load);
  clock.subscribe((what) => what === "range" && loadLater());
  state.subscribe((what, method) => {
    if (what === "view" || what === "split" || what === "tab") layout();
    if (what !== "methods") return;
    map.setVisible(method, state.isVisible(method));
    scene?.setMethods(shown());
  });
  requestAnimationFrame(layout);
  load();
  return {
    map,
    setEvents: (method, events) => map.setEvents(method, events),
    reload() {
      coarse = null;
      map.setLead(lead());
      load();
      scene?.reload();
    },
  };
}

// The whole path with its visible part replaced by what the server thinned for that part alone.
function spliced(whole, part, t0, t1) {
  const [a, b] = [lowerBound(whole.t, t0), lowerBound(whole.t, t1)];
  const out = { ...whole, total: part.total, shown: part.shown };
  for (const c of COLUMNS) if (whole[c]) out[c] = [...whole[c].slice(0, a), ...(part[c] ?? []), ...whole[c].slice(b)];
  return out;
}

// Why there is nothing to see, and what would help: calm, one place.
export function calm(title, ...content) {
  return h("div", { class: "calm" }, h("h2", {}, title), ...content);
}
