// The IMU of the run: a sentence, then what the gyro did over time, its noise, what a stretch of it looks like, its
// bias against temperature, and the calibrations that fit it. Sections are made when they come into sight.

import { api } from "../lib/api.js";
import { biasStyle } from "../lib/bias-methods.js";
import { seriesSwatch } from "../lib/chart-frame.js";
import { h } from "../lib/dom.js";
import { mountBias } from "./run-bias.js";
import { mountAllan } from "./run-imu-allan.js";
import { mountCalibration } from "./run-imu-calibration.js";
import { biasChart, errorChart, headingChart, signalChart } from "./run-imu-curves.js";
import { imuJob } from "./run-imu-job.js";
import { copyCommand, refusal, section } from "./run-imu-parts.js";
import { mountStatistics } from "./run-imu-statistics.js";
import { methodNotes, methodsTable } from "./run-imu-table.js";
import { mountTemperature } from "./run-imu-temperature.js";
import { calm } from "./run-path.js";

const LENGTH = 3; // s, of a segment where nothing else was asked for

export function mountImu(host, page) {
  const box = h("div", { class: "imu", "data-state": "loading" });
  host.append(box);
  let body = null;
  let job = null;
  let events = [];
  let gone = false;

  async function load() {
    let imu = null;
    try {
      imu = await api(`runs/${page.run.id}/imu`);
    } catch (error) {
      if (!gone) box.replaceChildren(refusal("The IMU could not be shown", { detail: error.message, code: error.code }));
      return;
    }
    if (gone) return;
    body?.destroy();
    job?.destroy();
    const context = { ...page, imu, gaps: page.run.streams.find((s) => s.name === "imu")?.gaps ?? [], lengthOf: () => imu.methods.find((m) => m.provenance.config.length)?.provenance.config.length ?? LENGTH };
    const head = h("p", { class: "verdict imu-verdict", id: "imu-verdict" }, imu.sentence);
    if (!imu.axes.length) {
      box.replaceChildren(calm("No IMU", h("p", {}, "This run has no IMU stream: no turn rate, no bias to speak of. The format is in the guide, ", h("a", { href: "/guide/run-format" }, "the run format"), ".")));
      box.dataset.state = "ready";
      return;
    }
    page.state.adopt(imu);
    job = imuJob(context, load);
    body = sections(context);
    box.replaceChildren(head, job.root, body.root);
    body.watch(host.closest("main"));
    body.setEvents(events);
    box.dataset.state = "ready";
  }

  load();
  return {
    setEvents(list) {
      events = list;
      body?.setEvents(list);
    },
    destroy() {
      gone = true;
      body?.destroy();
      job?.destroy();
      box.remove();
    },
  };
}

function sections(context) {
  const { imu, state, run } = context;
  const live = new Map(); // section -> what stands in it
  const makers = new Map(); // element -> makes it
  const root = h("div", {}, toolbar(context));
  let events = [];

  const add = (id, title, about, make, ...tools) => {
    const made = section(id, title, about, ...tools);
    root.append(made.root);
    makers.set(made.root, () => Promise.resolve(make(made.body)));
    return made;
  };
  const bias = (method) => `driftscope bias ${run.id} --method ${method} --out ${method}.csv --json -`;
  add("signal", "Signal", "every sample counts; what is drawn is thinned", (host) => charts(host, context, [["imu-signal", (cell) => signalChart(cell, context, state.axis)]], "one"));
  if (imu.analysed) {
    const picker = h("span", { class: "imu-focus" });
    add("bias", "Bias", "of gz, by five methods", (host) => charts(host, context, [["imu-bias", (cell) => biasChart(cell, context)]], "one tall", focusPicker(picker, context)), picker, copyCommand(() => bias(state.focus())));
    add("heading", "Heading", imu.has_heading ? "against truth, from the same start" : "no reference heading in this run: nothing judges it", (host) => {
      const list = [["imu-heading", (cell) => headingChart(cell, context)]];
      if (imu.methods.some((m) => m.columns.includes("error"))) list.push(["imu-error", (cell) => errorChart(cell, context)]);
      return charts(host, context, list, "pair");
    });
    const { table, copy } = methodsTable(context);
    add("methods", "Methods by figures", "", (host) => (host.replaceChildren(table, methodNotes(context)), null), copy);
    add("allan", "Noise", "", (host) => mountAllan(host, context, state.axis), copyCommand(() => `driftscope allan ${run.id} --axis ${state.axis} --json -`));
  }
  add("statistics", "A stretch", "", (host) => mountStatistics(host, context, state.axis));
  if (imu.has_temperature && imu.analysed) add("temperature", "Temperature", "", (host) => mountTemperature(host, context));
  add("calibration", "Calibration", "a stored error model against this run: Algorithm 1, sample by sample and with hindsight", (host) => mountCalibration(host, context));
  if (context.estimates().some((e) => e.columns.includes("bias"))) add("paths", "Bias by the methods of the path", "", (host) => mountBias(host, context));

  const sight = { observer: null };
  const open = async (element) => {
    const made = await makers.get(element)();
    if (!element.isConnected) return made?.destroy?.();
    live.set(element, made);
    return made?.setEvents?.(events);
  };
  const reopen = (ids) => {
    for (const element of [...live.keys()].filter((e) => ids.some((id) => e.id === `imu-${id}-section`))) {
      live.get(element)?.destroy?.();
      live.delete(element);
      open(element);
    }
  };
  const off = state.subscribe((what, detail) => {
    if (what === "axis") reopen(["signal", "allan", "statistics"]);
    if (what === "segments") reopen(["bias", "heading"]);
    if (what === "bias") for (const made of live.values()) made?.setVisible?.(detail, state.biasVisible(detail));
    if (what === "axis" || what === "bias") root.firstChild.replaceWith(toolbar(context));
  });
  return {
    root,
    watch(scroller) {
      sight.observer = new IntersectionObserver(
        (entries) => entries.filter((e) => e.isIntersecting).forEach(({ target }) => (sight.observer.unobserve(target), open(target))),
        { root: scroller, rootMargin: "400px" },
      );
      for (const element of makers.keys()) sight.observer.observe(element);
    },
    setEvents(list) {
      events = list;
      for (const made of live.values()) made?.setEvents?.(list);
    },
    destroy() {
      off();
      sight.observer?.disconnect();
      for (const made of live.values()) made?.destroy?.();
      root.remove();
    },
  };
}

// Charts in cells that can be enlarged, as one thing.
function charts(host, { state }, list, layout, before = null) {
  const cells = list.map(([id]) => h("div", { class: "multiple", "data-multiple": id }));
  const grid = h("div", { class: `imu-charts ${layout}` }, cells);
  host.replaceChildren(...(before ? [before] : []), grid);
  const made = list.map(([, make], i) => make(cells[i]));
  const size = () => cells.forEach((cell) => cell.classList.toggle("enlarged", state.big === cell.dataset.multiple));
  size();
  const off = state.subscribe((what) => what === "big" && size());
  return {
    setEvents: (events) => made.forEach((c) => c.setEvents(events)),
    setVisible: (key, on) => made.forEach((c) => c.setVisible(key, on)),
    destroy() {
      off();
      made.forEach((c) => c.destroy());
      host.replaceChildren();
    },
  };
}

function toolbar({ imu, state }) {
  const axes = h("div", { class: "segmented", role: "group", "aria-label": "Axis", id: "imu-axes" }, imu.axes.map((axis) => h("button", { type: "button", "aria-pressed": String(axis === state.axis), "data-axis": axis, onclick: () => state.set("axis", axis) }, axis)));
  const chips = imu.methods.map((m) => {
    const why = m.error ? m.error.detail : `${m.label}; ${m.causal ? "looks back only" : "with hindsight"}. Click: on and off.`;
    return h("button", { type: "button", class: "method", "data-bias": m.method, "aria-pressed": String(state.biasVisible(m.method)), disabled: Boolean(m.error), "data-hint": why, onclick: () => state.toggleBias(m.method) }, seriesSwatch(biasStyle(m.method)), biasStyle(m.method).label);
  });
  return h("div", { class: "imu-tools" }, h("span", { class: "dim", "data-hint": "Signal, noise and statistics are of this axis; bias and heading are of gz." }, "Axis"), axes, h("span", { class: "spread" }), h("div", { class: "methods", role: "group", "aria-label": "Bias methods shown" }, chips));
}

// Whose band and whose segments the plot of the bias shows.
function focusPicker(host, { imu, state }) {
  const options = imu.methods.filter((m) => !m.error).map((m) => h("option", { value: m.method, selected: m.method === state.focus() }, biasStyle(m.method).label));
  const select = h("select", { "aria-label": "Segments and band of", id: "imu-focus" }, options);
  select.addEventListener("change", () => state.set("segments", select.value));
  host.replaceChildren(h("label", { class: "row dim" }, "segments and band of", select));
  return null;
}
