// The bias methods by figures: what each accepted, how far its bias moved, how wrong its heading ends, what it claims.

import { biasStyle } from "../lib/bias-methods.js";
import { copyText } from "../lib/chart-export.js";
import { seriesSwatch } from "../lib/chart-frame.js";
import { h } from "../lib/dom.js";
import { angle, bias, count, seconds, show } from "../lib/format.js";

const size = (v) => (v === null || v === undefined ? null : Math.abs(v));

// [key, label, value out of a method's summary, how it is told, whether the least is the best]
const COLUMNS = [
  ["imu_accepted", "Accepted", (s) => s.accepted, null, false],
  ["imu_by_range", "By range", (s) => s.rejected_by_range, null, false],
  ["imu_by_average", "By average", (s) => s.rejected_by_band, null, false],
  ["imu_bias_end", "Bias at the end", (s) => s.bias_end, bias, false],
  ["imu_drift", "Moved", (s) => s.bias_drift, bias, false],
  ["imu_final", "Heading error, end", (s) => s.final_rad, angle, true],
  ["imu_max", "Largest", (s) => s.max_rad, angle, true],
  ["imu_claimed", "Claimed ± 1σ", (s) => s.theta_sd_end, angle, false],
  ["imu_net", "Net", (s) => size(s.net_rate), bias, true],
  ["imu_hourly", "Worst hour", (s) => s.hourly_rate, bias, true],
];

export function methodsTable({ imu, fileName, run }) {
  const rows = imu.methods;
  const columns = COLUMNS.filter(([, , of]) => rows.some((m) => (of(m.summary) ?? null) !== null));
  const best = Object.fromEntries(
    columns.filter(([, , , , ranked]) => ranked).map(([key, , of, tell]) => {
      const known = rows.map((m) => of(m.summary)).filter((v) => v !== null && v !== undefined).map(Math.abs);
      return [key, known.length > 1 ? tell(Math.min(...known)).text : null];
    }),
  );
  const cell = (m) => ([key, , of, tell]) => {
    const v = of(m.summary) ?? null;
    const sd = key === "imu_bias_end" && v !== null && m.summary.bias_sd_end !== null ? h("span", { class: "dim" }, ` ± ${bias(m.summary.bias_sd_end).value}`) : "";
    const text = tell ? show(tell(v), key) : v === null ? "–" : `${count(v)}${key === "imu_accepted" ? ` of ${count(m.summary.segments)}` : ""}`;
    return h("td", { class: tell && best[key] && v !== null && tell(Math.abs(v)).text === best[key] ? "num best" : "num" }, text, sd);
  };
  const row = (m) => {
    const name = h("th", { scope: "row", "data-hint": `${m.label}. ${m.source}` }, seriesSwatch(biasStyle(m.method)), biasStyle(m.method).label, h("span", { class: "dim" }, m.causal ? "" : " hindsight"));
    const rest = m.error ? h("td", { class: "why", colspan: columns.length + 1 }, m.error.detail) : [columns.map(cell(m)), h("td", { class: "num" }, show(seconds(m.provenance.runtime_s), "imu_runtime"))];
    return h("tr", { "data-bias-method": m.method }, name, rest);
  };
  const heads = columns.map(([key, label]) => h("th", { class: "num", scope: "col", "data-term": key }, label));
  const table = h("table", { class: "table metrics", id: "imu-methods" }, h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Method"), heads, h("th", { class: "num", scope: "col", "data-term": "imu_runtime" }, "Run time"))), h("tbody", {}, rows.map(row)));
  const csv = () => [["method", ...columns.map(([key]) => key.slice(4))], ...rows.map((m) => [m.method, ...columns.map(([, , of]) => of(m.summary) ?? "")])].map((r) => r.join(",")).join("\r\n") + "\r\n";
  const copy = h("button", { type: "button", class: "button quiet", "data-hint": "The table in SI units (rad, rad/s)" }, "Copy CSV");
  copy.addEventListener("click", async () => (copy.textContent = (await copyText(csv())) ? "Copied" : "Copy was refused"));
  return { table: h("div", { class: "metrics-scroll" }, table), copy, name: `${fileName}-${run.id}` };
}

/** What the methods say of the record: gaps, no rest, saturation, readings that look like degrees. */
export function methodNotes({ imu }) {
  const said = new Map();
  for (const m of imu.methods) for (const note of m.notes) said.set(note, [...(said.get(note) ?? []), biasStyle(m.method).label]);
  if (!said.size) return "";
  return h("ul", { class: "imu-notes" }, [...said].map(([note, by]) => h("li", {}, note, h("span", { class: "dim" }, ` ${by.join(", ")}`))));
}
