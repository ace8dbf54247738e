// Runs over each other by one method: paths, errors over time since each start, figures, descriptions.

import { $, h, pageData, save, s } from "../lib/dom.js";
import { api, problemNote, query } from "../lib/api.js";
import { createChart } from "../lib/chart.js";
import { duration, percent, quantity, show } from "../lib/format.js";
import { keys } from "../lib/keys.js";
import { createMap } from "../lib/map.js";
import { methodStyle, swatch } from "../lib/methods.js";
import { term } from "../lib/terms.js";
import { createTimeCursor } from "../lib/timecursor.js";

const DASHES = [[], [7, 3], [2, 3], [9, 3, 2, 3], [12, 4], [4, 2], [1, 3], [6, 2, 1, 2, 1, 2]];
const DEG = 180 / Math.PI;
// what is smaller is better; the rest is only listed
const ERRORS = new Set(["ate_rmse_m", "final_m", "final_rad", "max_m", "max_rad", "heading_rmse_rad", "runtime_s"]);

const page = pageData();
const params = new URLSearchParams(location.search);
const runs = page.runs.map((run, i) => ({ ...run, color: `--run-${run.letter}`, dash: DASHES[i] }));
const withPath = runs.filter((run) => run.estimates[page.method]);
const span = Math.max(...runs.map((run) => run.t1 - run.t0), 1e-3);
const clock = createTimeCursor({ t0: 0, t1: span });
const hidden = new Set((params.get("hide") ?? "").split("").filter(Boolean));
const charts = [];
let map = null;
let onlyDifferences = params.get("diff") === "1";

const address = (change) => {
  const now = { runs: runs.map((r) => r.id).join(","), method: page.method, diff: onlyDifferences ? "1" : "", hide: [...hidden].join(""), ...change };
  if (!clock.isFullRange) Object.assign(now, { t0: clock.range[0].toFixed(3), t1: clock.range[1].toFixed(3) });
  if (clock.time > 0) now.t = clock.time.toFixed(3);
  return query(now).replaceAll("%2C", ",");
};

function remember() {
  history.replaceState(null, "", `/compare?${address()}`);
  $("#json").href = `/compare.json?${query({ runs: runs.map((r) => r.id).join(","), method: page.method })}`;
}

/* head */

function letter(run) {
  const box = h("span", { class: "letter" }, run.letter);
  box.style.background = `var(${run.color})`;
  return box;
}

function line(run) {
  const path = s("path", { d: "M0 4H18", "stroke-dasharray": run.dash.join(" ") || undefined });
  path.style.stroke = `var(${run.color})`;
  return s("svg", { class: "swatch", viewBox: "0 0 18 8", "aria-hidden": "true" }, path);
}

function paintHead() {
  $("#methods").replaceChildren(
    ...page.methods.map((m) =>
      h("button", { type: "button", "aria-pressed": String(m === page.method), onclick: () => (location.href = `/compare?${address({ method: m })}`) }, methodStyle(m).label),
    ),
  );
  $("#methods").hidden = page.methods.length === 0;
  $("#legend").replaceChildren(
    ...runs.map((run) => {
      const toggle = h("button", { type: "button", "aria-pressed": String(!hidden.has(run.letter)), onclick: () => setVisible(run, hidden.has(run.letter)) }, letter(run), line(run), h("span", { class: "clip" }, run.name));
      const without = !run.estimates[page.method] && h("span", { class: "chip absent" }, "no path");
      return h("li", {}, toggle, without, h("a", { class: "dim", href: `/runs/${run.id}` }, "open"));
    }),
  );
  $("#figures-of").replaceChildren("by ", page.method ? h("span", { class: "row" }, swatch(page.method), methodStyle(page.method).label) : "no method");
}

function setVisible(run, on) {
  if (on) hidden.delete(run.letter);
  else hidden.add(run.letter);
  map?.setVisible(run.letter, on);
  for (const chart of charts) chart.setVisible(run.letter, on);
  paintHead();
  remember();
}

/* paths */

const shift = (run, t) => t.map((x) => x - run.t0);

async function loadPath(run) {
  const answer = await api(`runs/${run.id}/path?${query({ methods: page.method, points: 4000 })}`);
  const path = answer.paths.find((p) => p.method === page.method);
  return { beacons: answer.beacons, path: path && { ...path, t: shift(run, path.t), method: run.letter, label: `${run.letter} ${run.name}`, color: run.color, dash: run.dash, width: 1.75 } };
}

async function paintMap() {
  if (withPath.length === 0) return $("#map").append(h("p", { class: "empty" }, "No path by this method."));
  try {
    const found = await Promise.all(withPath.map(loadPath));
    map = createMap($("#map"), { clock, subject: runs.map((r) => r.name).join(", "), fileName: "compare" });
    const beacons = new Map(found.flatMap((f) => f.beacons).map((b) => [b.name, b]));
    map.setPaths(found.map((f) => f.path).filter(Boolean), [...beacons.values()]);
    for (const run of runs) map.setVisible(run.letter, !hidden.has(run.letter));
  } catch (error) {
    $("#map").append(problemNote(error));
  }
  return undefined;
}

/* errors over time */

async function loadErrors(column, scale, judged, { t0, t1, points, signal }) {
  const all = await Promise.all(
    judged.map(async (run) => {
      const range = { columns: column, t0: t0 + run.t0, t1: t1 + run.t0, points };
      const answer = await api(`estimates/${run.estimates[page.method].id}/series?${query(range)}`, { signal });
      const found = answer.series.find((x) => x.column === column);
      return [run.letter, found && { ...found, t: shift(run, found.t), y: found.y.map((y) => (y === null ? null : y * scale)) }];
    }),
  );
  return { series: Object.fromEntries(all.filter(([, found]) => found)), bands: {}, gaps: [] };
}

function paintCharts() {
  const judged = withPath.filter((run) => run.estimates[page.method].metrics.ate_rmse_m?.value != null);
  const hosts = [
    ["error-xy", "Position error", "m", "error_xy", 1, "Distance between the path and the truth, over the time since each run's start."],
    ["error-theta", "Heading error", "°", "error_theta", DEG, "Heading difference to the truth, wrapped, over the time since each run's start."],
  ];
  for (const [id, title, unit, column, scale, help] of hosts) {
    const host = $(`#${id}`);
    if (judged.length === 0) {
      host.append(h("p", { class: "empty dim" }, `${title}: none of these runs has a truth to be measured against.`));
      continue;
    }
    const series = judged.map((run) => ({ key: run.letter, label: run.letter, color: run.color, dash: run.dash, on: !hidden.has(run.letter), style: "line" }));
    const onToggle = (key, on) => setVisible(runs.find((r) => r.letter === key), on);
    const chart = createChart(host, { id, title, unit, help, series, clock, zero: true, onToggle, fileName: `compare-${id}`, load: (asked) => loadErrors(column, scale, judged, asked) });
    charts.push(chart);
    chart.refresh();
  }
}

/* tables */

const same = (values) => values.every((v) => JSON.stringify(v) === JSON.stringify(values[0]));

function headRow(label) {
  return h("thead", {}, h("tr", {}, h("th", {}, label), runs.map((run) => h("th", { class: "num" }, h("span", { class: "row" }, letter(run), run.name)))));
}

const label = (name) => term(name)?.label ?? name.replace(/_(m|rad|s|rad_s)$/, "").replaceAll("_", " ");

function metricRows() {
  const names = [...new Set(withPath.flatMap((run) => Object.keys(run.estimates[page.method].metrics)))];
  const rows = names.map((name) => {
    const cells = runs.map((run) => run.estimates[page.method]?.metrics[name] ?? null);
    const found = cells.map((c) => c?.value ?? null);
    const numbers = found.filter((v) => v !== null);
    const best = ERRORS.has(name) && numbers.length > 1 ? Math.min(...numbers.map(Math.abs)) : null;
    return { name, found, row: h("tr", { class: same(found) ? "same" : "", "data-metric": name }, h("td", {}, h("span", { "data-term": name }, label(name))), cells.map((c) => h("td", { class: c && best !== null && Math.abs(c.value) === best ? "num best" : "num" }, c && c.value !== null ? show(name === "nees_inside" ? percent(c.value) : quantity(c.value, c.unit, name)) : h("span", { class: "dim" }, "–")))) };
  });
  const runtime = runs.map((run) => run.estimates[page.method]?.runtime_s ?? null);
  if (!names.includes("runtime_s")) rows.push({ name: "runtime_s", found: runtime, row: h("tr", { "data-metric": "runtime_s" }, h("td", {}, h("span", { "data-term": "runtime_s" }, label("runtime_s"))), runtime.map((v) => h("td", { class: "num" }, show(quantity(v, "s"))))) });
  const lengths = runs.map((run) => run.duration_s);
  rows.push({ name: "duration_s", found: lengths, row: h("tr", { class: same(lengths) ? "same" : "" }, h("td", {}, h("span", { "data-term": "length" }, label("length"))), lengths.map((v) => h("td", { class: "num" }, show(duration(v))))) });
  return rows;
}

const rounded = (key, value) => (typeof value === "number" ? Number(value.toPrecision(9)) : value); // 2.3, not 2.3000000000000003
const leafText = (value) => (value === null || value === undefined ? "–" : typeof value === "object" ? JSON.stringify(value, rounded).replaceAll(",", ", ") : String(rounded("", value)));

function descriptionRows() {
  const names = [...new Set(runs.flatMap((run) => Object.keys(run.description)))].filter((n) => n !== "format" && n !== "name");
  const rows = names.map((name) => ({ name, found: runs.map((run) => run.description[name] ?? null) }));
  const config = [...new Set(withPath.flatMap((run) => Object.keys(run.estimates[page.method].config)))];
  rows.push(...config.map((name) => ({ name: `config.${name}`, found: runs.map((run) => run.estimates[page.method]?.config[name] ?? null) })));
  rows.push({ name: "code version", found: runs.map((run) => run.estimates[page.method]?.code_version ?? null) });
  return rows.map(({ name, found }) => ({ name, found, row: h("tr", { class: same(found) ? "same" : "", "data-key": name }, h("td", {}, h("code", {}, name)), found.map((v) => h("td", { class: "leaf" }, leafText(v)))) }));
}

function paintTable(table, head, rows) {
  const shown = rows.filter((r) => !onlyDifferences || !same(r.found));
  const none = h("tr", {}, h("td", { class: "dim", colspan: runs.length + 1 }, "No differences."));
  table.replaceChildren(headRow(head), h("tbody", {}, shown.length ? shown.map((r) => r.row) : none));
}

function paintTables() {
  $("#only-differences").checked = onlyDifferences;
  paintTable($("#metrics"), "Figure", metricRows());
  paintTable($("#descriptions"), "Key", descriptionRows());
}

function exportCsv() {
  const cell = (v) => (/[",\n]/.test(leafText(v)) ? `"${leafText(v).replaceAll('"', '""')}"` : v === null ? "" : leafText(v));
  const rows = [...metricRows(), ...descriptionRows()].filter((r) => !onlyDifferences || !same(r.found));
  const lines = [["figure", ...runs.map((r) => r.name)], ...rows.map((r) => [r.name, ...r.found])].map((row) => row.map(cell).join(","));
  save(new Blob([`${lines.join("\n")}\n`], { type: "text/csv" }), "compare.csv");
}

function setDifferences(on) {
  onlyDifferences = on;
  paintTables();
  remember();
}

$("#only-differences").addEventListener("change", (event) => setDifferences(event.target.checked));
$("#csv").addEventListener("click", exportCsv);
$("#copy-link").addEventListener("click", async (event) => {
  await navigator.clipboard.writeText(new URL(`/compare?${address()}`, location.href).href);
  event.target.textContent = "Copied";
  setTimeout(() => (event.target.textContent = "Copy link"), 1500);
});
keys("Compare", {
  d: ["only differences, on and off", () => setDifferences(!onlyDifferences)],
  e: ["export the tables as CSV", exportCsv],
  ...Object.fromEntries(runs.map((run, i) => [String(i + 1), [i ? null : "runs on and off", () => setVisible(run, hidden.has(run.letter)), "1 … 8"]])),
  Home: ["whole time", () => clock.resetRange()],
});

if (params.has("t0")) clock.setRange(Number(params.get("t0")), Number(params.get("t1")));
if (params.has("t")) clock.setTime(Number(params.get("t")));
clock.subscribe((what) => (what === "range" || what === "time") && remember());
remember();
paintHead();
paintTables();
paintCharts();
paintMap().finally(() => (document.documentElement.dataset.ready = "compare"));
