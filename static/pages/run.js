// The run page: one clock and one state; header, methods, map and 3D, strip and tabs hang on them.

import { api, query, request } from "../lib/api.js";
import { $, $$, h, pageData } from "../lib/dom.js";
import { keys } from "../lib/keys.js";
import { createTimeCursor } from "../lib/timecursor.js";
import { mountConsistency } from "./run-consistency.js";
import { mountMultiples } from "./run-errors.js";
import { eventMethod, eventsOf, mountEvents } from "./run-events.js";
import { mountFiles } from "./run-files.js";
import { mountGap } from "./run-gap.js";
import { mountHeader } from "./run-header.js";
import { mountImu } from "./run-imu.js";
import { mountJobs } from "./run-job.js";
import { methodsOf, mountMethods } from "./run-methods.js";
import { methodNotes, metricsTable } from "./run-metrics.js";
import { mountNotes } from "./run-notes.js";
import { calm, mountPaths } from "./run-path.js";
import { mountSignals } from "./run-signals.js";
import { createState } from "./run-state.js";
import { motionOf, mountStrip } from "./run-strip.js";

const data = pageData();
const { run } = data;
const clock = createTimeCursor({ t0: run.t0, t1: run.t1 });
const state = createState(methodsOf(data), clock);
const context = {
  data,
  run,
  clock,
  state,
  fileName: run.name.replace(/[^\w.+-]+/g, "_").slice(0, 60),
  estimates: () => data.estimates,
  lead: () => data.lead,
  decided: () => decided(),
};

const TABS = { path: mountPath, signals: mountSignals, imu: mountImu, consistency: mountConsistency, gap: mountGap, files: mountFiles, notes: mountNotes };
const WITH_TIME = new Set(["path", "signals", "imu", "consistency"]);
let mounted = null; // the tab that is up
let paths = null;
let strip = null;

function mountPath(host) {
  if (!data.estimates.length) {
    const box = nothing();
    host.append(box);
    return { setEvents() {}, destroy: () => box.remove() };
  }
  const multiples = mountMultiples(host, context);
  const parts = [metricsTable({ estimates: data.estimates, methods: data.methods, fileName: context.fileName, runName: run.name }), methodNotes(data.estimates) ?? ""];
  host.append(parts[0]);
  const list = mountEvents(host, context);
  host.append(parts[1]);
  return {
    setEvents(events) {
      multiples.setEvents(events);
      list.update();
    },
    destroy() {
      multiples.destroy();
      list.destroy();
      for (const part of parts) part.remove?.();
    },
  };
}

// No estimate: being made, not possible (and why, method by method), or not asked for yet.
function nothing() {
  if (run.is_live) return calm("Still going on", h("p", {}, "The paths so far are on the monitor; here they appear, smoothed too, once the run has ended. The signals can be looked at meanwhile."), h("p", {}, h("a", { class: "button", href: `/live/${encodeURIComponent(run.robot)}` }, "Watch it live")));
  const job = data.jobs.find((j) => j.kind === "estimate");
  if (job?.state === "queued" || job?.state === "running") return calm("Being estimated", h("p", {}, "Paths, errors and metrics appear here when they are done. The signals can be looked at meanwhile."));
  const reasons = data.methods.filter((m) => m.reason);
  if (reasons.length && reasons.length === data.methods.length) {
    return calm("No path can be estimated from this run", h("p", {}, "Each method says what it misses; the signals are all here."), h("ul", {}, reasons.map((m) => h("li", {}, h("b", {}, m.label), " ", m.reason))), h("p", {}, h("a", { href: "?tab=signals" }, "Look at the signals")));
  }
  return calm("Not estimated yet", h("p", {}, "“Estimate again” above starts every method that can run."));
}

function showTab() {
  for (const tab of $$("[role=tab]")) {
    const on = tab.dataset.tab === state.tab;
    tab.setAttribute("aria-selected", String(on));
    tab.tabIndex = on ? 0 : -1;
    $(`#panel-${tab.dataset.tab}`).hidden = !on;
  }
  mounted?.destroy();
  const paintable = state.methods.some((m) => m.has);
  $("#split").hidden = !(state.tab === "path" && paintable);
  $("#strip").hidden = !WITH_TIME.has(state.tab) || (state.tab === "path" && !paintable);
  $("#methods").hidden = !paintable || state.tab !== "path";
  if (paintable && state.tab === "path") paths ??= mountPaths(context);
  mounted = TABS[state.tab]($(`#panel-${state.tab}`), context);
  tellEvents();
}

function tellEvents() {
  const events = eventsOf(context);
  mounted?.setEvents(events);
  paths?.setEvents(eventMethod(context), events);
  strip.setMarks({ events });
}

// A user confirmed or dismissed an event: drawn so at once, and the sentence told anew.
async function decided() {
  tellEvents();
  const fresh = await (await request(`/runs/${run.id}.json`)).json();
  $("#verdict").textContent = data.sentence = fresh.sentence;
}

// Where the wheels turn, out of a thinned curve: enough to see when it drove.
async function showMotion() {
  const stream = run.streams.find((s) => s.name === "wheels") ?? run.streams.find((s) => s.name === "truth" && s.columns.some((c) => c.name === "x"));
  const gaps = run.streams.filter((s) => s.name === "beacon" || s.name === "ranges").flatMap((s) => s.gaps);
  strip.setMarks({ gaps });
  if (!stream) return;
  const columns = stream.name === "wheels" ? "left,right" : "x,y";
  const got = await api(`runs/${run.id}/streams/${stream.name}?${query({ columns, points: 3000 })}`);
  strip.setMarks({ motion: motionOf(got.series, stream.name === "wheels" ? 0.05 : 0.01) });
}

// After an estimate: the page's data once more, and what hangs on it drawn again. The address stays.
async function refresh() {
  const fresh = await (await request(`/runs/${run.id}.json`)).json();
  Object.assign(data, { estimates: fresh.estimates, methods: fresh.methods, jobs: fresh.jobs, lead: fresh.lead, event_method: fresh.event_method, sentence: fresh.sentence });
  $("#verdict").textContent = data.sentence;
  for (const m of methodsOf(data)) {
    Object.assign(state.methods.find((old) => old.name === m.name) ?? {}, { estimate: m.estimate, reason: m.reason });
    if (m.has) state.appear(m.name);
  }
  paths?.reload();
  showTab();
}

function onTabKey(event) {
  const tabs = $$("[role=tab]");
  const at = tabs.findIndex((t) => t.dataset.tab === state.tab);
  const to = { ArrowLeft: at - 1, ArrowRight: at + 1 }[event.key];
  if (to === undefined) return;
  const next = tabs[(to + tabs.length) % tabs.length];
  state.set("tab", next.dataset.tab);
  next.focus();
}

// `e`: the export menu of the plot or map below the pointer, else of the first one.
function openExport() {
  const under = $(".chart:hover, .map:hover") ?? document.activeElement?.closest?.(".chart, .map") ?? $(".chart, .map");
  const menu = under?.querySelector(".chart-menu");
  if (!menu) return;
  menu.open = true;
  menu.querySelector("button").focus();
}

for (const tab of $$("[role=tab]")) {
  tab.addEventListener("click", () => state.set("tab", tab.dataset.tab));
  tab.addEventListener("keydown", onTabKey);
}
mountHeader(context);
mountMethods($("#methods"), state);
strip = mountStrip($("#strip"), clock);
keys("Run", { e: ["export the view below the pointer", openExport], d: ["diagnose the gap", () => state.set("tab", "gap")] });
state.subscribe((what) => {
  if (what === "tab") showTab();
  if (what === "events") tellEvents();
});
showTab();
showMotion().catch(() => {}); // the strip without its shading still says the time
mountJobs({ ...context, refresh });
document.documentElement.dataset.ready = "run";
