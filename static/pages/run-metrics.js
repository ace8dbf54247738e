// Methods against metrics: sortable, the best of each column marked, every number explained; out as CSV or LaTeX.

import { copyText } from "../lib/chart-export.js";
import { h, save } from "../lib/dom.js";
import { bias, percent, quantity, seconds, show } from "../lib/format.js";
import { methodStyle, sortMethods } from "../lib/methods.js";
import { methodSwatch } from "./run-methods.js";

// Columns in order, where any method has them. `best`: which end of the column is the better one.
const COLUMNS = [
  ["ate_rmse_m", "ATE", "low"],
  ["rpe_per_m_m", "RPE per m", "low"],
  ["rpe_per_s_m", "RPE per s", "low"],
  ["final_m", "Final", "low"],
  ["max_m", "Max", "low"],
  ["heading_rmse_rad", "Heading", "low"],
  ["final_rad", "Final heading", "abs"],
  ["nees", "NEES", null],
  ["nees_inside", "Inside", null],
  ["bias_drift_rad_s", "Bias drift", null],
  ["distance_m", "Length", null],
  ["unmatched", "Unmatched", null],
  ["runtime_s", "Run time", null],
];

export function metricsTable({ estimates, methods, fileName, runName }) {
  const rows = sortMethods(estimates.map((e) => e.method)).map((m) => estimates.find((e) => e.method === m));
  const value = (e, name) => (name === "runtime_s" ? e.runtime_s : (e.metrics[name]?.value ?? null));
  const columns = COLUMNS.filter(([name]) => rows.some((e) => value(e, name) !== null));
  const units = Object.fromEntries(columns.map(([name]) => [name, name === "runtime_s" ? "s" : rows.find((e) => e.metrics[name])?.metrics[name].unit]));
  const body = h("tbody", {});
  const heads = columns.map(([name, label]) => {
    const button = h("button", { type: "button" }, label);
    const th = h("th", { class: "num sortable", scope: "col", "data-term": name, "data-metric": name }, button);
    button.addEventListener("click", () => sortBy(name, th));
    return th;
  });
  const missing = methods.filter((m) => m.reason && !rows.some((e) => e.method === m.name));
  const table = h("table", { class: "table metrics", id: "metrics" }, h("thead", {}, h("tr", {}, h("th", { scope: "col" }, "Method"), heads)), body);

  function sortBy(name, th) {
    const down = th.getAttribute("aria-sort") === "ascending";
    for (const other of heads) other.removeAttribute("aria-sort");
    th.setAttribute("aria-sort", down ? "descending" : "ascending");
    const rank = (e) => value(e, name) ?? Infinity;
    rows.sort((a, b) => (value(a, name) === null) - (value(b, name) === null) || (down ? rank(b) - rank(a) : rank(a) - rank(b)));
    paint();
  }

  function paint() {
    const best = Object.fromEntries(columns.map(([name, , end]) => [name, bestText(rows.map((e) => value(e, name)), end, units[name])]));
    body.replaceChildren(...rows.map(row), ...missing.map(absent));
    function row(e) {
      const cells = columns.map(([name]) => {
        const v = value(e, name);
        const marked = v !== null && best[name] === quantity(v, units[name]).text;
        return h("td", { class: marked ? "num best" : "num" }, shown(name, v, units[name]));
      });
      return h("tr", { "data-method": e.method }, h("th", { scope: "row" }, methodSwatch(e.method), methodStyle(e.method).label), cells);
    }
    function absent(m) {
      return h("tr", { class: "dim" }, h("th", { scope: "row" }, methodSwatch(m.name), methodStyle(m.name).label), h("td", { class: "why", colspan: columns.length }, m.reason));
    }
  }

  const note = h("span", { class: "dim", role: "status" });
  const copy = async (text, what) => (note.textContent = (await copyText(text)) ? `${what} copied` : "The clipboard is not allowed here: use the file.");
  const button = (text, hint, act) => h("button", { type: "button", class: "button quiet", "data-hint": hint, onclick: act }, text);
  const csv = () => toCsv(rows, columns, value, units);
  paint();
  return h(
    "section",
    { class: "block", "aria-label": "Metrics" },
    h(
      "div",
      { class: "block-head" },
      h("h2", {}, "Methods and metrics"),
      note,
      button("Copy CSV", "The table, SI units in the header", () => copy(csv(), "CSV")),
      button("Copy LaTeX", "A tabular for a paper (booktabs)", () => copy(toLatex(rows, columns, value, units, runName), "LaTeX")),
      button("CSV file", "The table as a file", () => save(new Blob([csv()], { type: "text/csv" }), `${fileName}-metrics.csv`)),
    ),
    h("div", { class: "metrics-scroll" }, table),
  );
}

function shown(name, v, unit) {
  if (name === "bias_drift_rad_s") return show(bias(v), name);
  if (name === "runtime_s") return show(seconds(v), name);
  if (name === "nees_inside" && v !== null) return show(percent(v), name);
  return show(quantity(v, unit), name);
}

// The best value as it reads; none where all read the same: what the eye cannot tell apart is not ranked.
function bestText(values, end, unit) {
  const known = values.filter((v) => v !== null);
  if (!end || known.length < 2) return undefined;
  const best = end === "low" ? Math.min(...known) : known.reduce((a, b) => (Math.abs(b) < Math.abs(a) ? b : a));
  const texts = new Set(known.map((v) => quantity(v, unit).text));
  return texts.size > 1 ? quantity(best, unit).text : undefined;
}

function toCsv(rows, columns, value, units) {
  const head = ["method", ...columns.map(([name]) => `${name} [${units[name] || "1"}]`)];
  return [head, ...rows.map((e) => [e.method, ...columns.map(([name]) => value(e, name) ?? "")])].map((r) => r.join(",")).join("\r\n") + "\r\n";
}

function toLatex(rows, columns, value, units, runName) {
  const clean = (text) => text.replace(/[&%$#_{}]/g, "\\$&");
  const cell = (v) => (v === null ? "--" : Math.abs(v) >= 1e-3 || v === 0 ? Number(v.toPrecision(3)).toString() : `$${v.toExponential(2).replace(/e(.*)/, "\\cdot 10^{$1}").replace("+", "")}$`);
  const lines = [
    `% ${runName}`,
    `\\begin{tabular}{l${"r".repeat(columns.length)}}`,
    "\\toprule",
    ["Method", ...columns.map(([name, label]) => `${clean(label)}${units[name] ? ` / ${units[name].replace("/", "\\,/\\,")}` : ""}`)].join(" & ") + " \\\\",
    "\\midrule",
    ...rows.map((e) => [clean(methodStyle(e.method).label), ...columns.map(([name]) => cell(value(e, name)))].join(" & ") + " \\\\"),
    "\\bottomrule",
    "\\end{tabular}",
  ];
  return lines.join("\n") + "\n";
}

// What each method assumed, froze or could not see: its own sentences.
export function methodNotes(estimates) {
  const noted = estimates.filter((e) => e.notes.length);
  if (!noted.length) return null;
  return h(
    "details",
    { class: "method-notes" },
    h("summary", {}, `What the methods assumed (${noted.reduce((n, e) => n + e.notes.length, 0)})`),
    noted.map((e) => h("div", {}, h("b", {}, methodSwatch(e.method), ` ${methodStyle(e.method).label}`), h("ul", {}, e.notes.map((n) => h("li", {}, n))))),
  );
}
