// Bias: the gyro's bias over the run by each method that estimates one, and what else the methods learnt.

import { bias as biasText, number, show } from "../lib/format.js";
import { h } from "../lib/dom.js";
import { methodStyle } from "../lib/methods.js";
import { estimateChart } from "./run-errors.js";
import { methodSwatch } from "./run-methods.js";
import { calm } from "./run-path.js";

export function mountBias(host, context) {
  const { state, run } = context;
  const having = context.estimates().filter((e) => e.columns.includes("bias"));
  if (!having.length) {
    const why = run.streams.some((s) => s.name === "imu") ? "No method has estimated this run's gyro bias yet." : "This run has no gyro: there is no bias to speak of.";
    const box = calm("No bias curve", h("p", {}, why));
    host.append(box);
    return { setEvents() {}, destroy: () => box.remove() };
  }
  const cell = h("div", { class: "multiple enlarged" });
  const box = h("div", {}, cell, facts(having), parameters(context.estimates()));
  host.append(box);
  const chart = estimateChart(cell, "bias", context);
  const off = state.subscribe((what, method) => what === "methods" && chart.setVisible(method, state.isVisible(method)));
  return {
    setEvents: (events) => chart.setEvents(events),
    destroy() {
      off();
      chart.destroy();
      box.remove();
    },
  };
}

function facts(estimates) {
  const rows = estimates.map((e) => {
    const drift = e.metrics.bias_drift_rad_s?.value ?? null;
    return h("tr", {}, h("th", { scope: "row" }, methodSwatch(e.method), methodStyle(e.method).label), h("td", { class: "num" }, show(biasText(drift), "bias_drift_rad_s")), h("td", { class: "dim" }, e.columns.includes("bias_sd") ? "one and two sigma: the bands in the plot" : "none stated by this method"));
  });
  return h("section", { class: "block" }, h("div", { class: "block-head" }, h("h2", {}, "How far it moved")), h("div", { class: "metrics-scroll" }, h("table", { class: "table metrics" }, h("thead", {}, h("tr", {}, h("th", {}, "Method"), h("th", { class: "num", "data-term": "bias_drift_rad_s" }, "Drift, end minus start"), h("th", {}, "Uncertainty"))), h("tbody", {}, rows))));
}

function parameters(estimates) {
  const rows = estimates.flatMap((e) =>
    Object.entries(e.parameters).map(([name, p]) =>
      h("tr", {}, h("th", { scope: "row" }, methodSwatch(e.method), methodStyle(e.method).label), h("td", {}, name.replaceAll("_", " ")), h("td", { class: "num" }, number(p.value, 4)), h("td", { class: "num" }, p.sd === null ? "–" : number(p.sd, 2)), h("td", { class: "dim" }, (p.unit || "1").replace("^2", "²"))),
    ),
  );
  if (!rows.length) return "";
  const head = ["Method", "Parameter", "Value", "± one sigma", "Unit"].map((text, i) => h("th", { class: i === 2 || i === 3 ? "num" : "" }, text));
  return h("section", { class: "block" }, h("div", { class: "block-head" }, h("h2", {}, "What the methods used and learnt")), h("div", { class: "metrics-scroll" }, h("table", { class: "table metrics" }, h("thead", {}, h("tr", {}, head)), h("tbody", {}, rows))));
}
