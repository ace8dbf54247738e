// Files and provenance: where every number is from, how to make it again, and everything out in every format.

import { API } from "../lib/api.js";
import { copyText } from "../lib/chart-export.js";
import { h } from "../lib/dom.js";
import { bytes, count, hertz, seconds, show, when } from "../lib/format.js";
import { methodStyle } from "../lib/methods.js";
import { methodSwatch } from "./run-methods.js";
import { odometryCard } from "./run-odometry.js";

const PATH_FORMATS = [
  ["csv", "CSV", "t, x, y, theta and deviations: m, rad"],
  ["tum", "TUM", "t x y z qx qy qz qw per line"],
  ["kitti", "KITTI", "3 x 4 pose matrix per line"],
];

export function mountFiles(host, context) {
  const { run, data, estimates } = context;
  const box = h("div", { class: "cards" }, source(run), downloads(run, data), streams(run), h("section", { class: "card wide" }, h("h2", {}, "Estimates"), estimates().length ? estimates().map((e) => estimateCard(run, e)) : h("p", { class: "dim" }, "None yet.")), odometryCard(context), description(run));
  host.append(box);
  return { setEvents() {}, destroy: () => box.remove() };
}

const fact = (name, ...value) => [h("dt", {}, name), h("dd", {}, ...value)];

function source(run) {
  const { file_name: file, format, size_bytes: size, mapping } = run.source;
  return h(
    "section",
    { class: "card" },
    h("h2", {}, "Where it is from"),
    h(
      "dl",
      { class: "facts" },
      fact("File", file ?? "unknown"),
      format && fact("Read as", format),
      size && fact("Size", show(bytes(size)), " as sent, ", show(bytes(run.size_bytes)), " stored"),
      fact("Stored", `${when(run.created_at).si}`),
      fact("Run id", h("code", {}, run.id), h("span", { class: "dim" }, " the first 16 digits of its hash")),
      fact("SHA-256", h("span", { class: "hash", "data-hint": "Hash of the run's description and of every column: the same readings are the same run, wherever they were stored." }, run.sha256)),
      Object.entries(run.source).filter(([k, v]) => !["file_name", "format", "size_bytes", "mapping", "sha256"].includes(k) && v).map(([k, v]) => fact(k.replaceAll("_", " "), typeof v === "object" ? JSON.stringify(v) : String(v))),
      mapping && fact("Column mapping", h("code", {}, JSON.stringify(mapping))),
    ),
  );
}

function downloads(run, data) {
  const link = (path, label, what) => h("a", { href: path, download: "", "data-hint": what }, label);
  return h(
    "section",
    { class: "card" },
    h("h2", {}, "Download"),
    h(
      "dl",
      { class: "facts" },
      fact("Run", h("span", { class: "links-row" }, data.exports.map((e) => link(e.path, e.label, e.what)))),
      fact("3D scene", link(`${API}/runs/${run.id}/files/scene.html`, "One HTML file", "Opens anywhere, without this server")),
      fact("This page", h("a", { href: `/runs/${run.id}.json` }, "JSON")),
      fact("Series", h("span", { class: "links-row" }, run.streams.map((s) => h("a", { href: `${API}/runs/${run.id}/streams/${s.name}?points=20000&format=arrow`, download: `${s.name}.arrow`, "data-hint": "Arrow, thinned to 20,000 points; all readings are in the run folder above" }, `${s.name}.arrow`)))),
    ),
    commandLine(`curl -O -J ${location.origin}${data.exports[0].path}`),
  );
}

function streams(run) {
  const rows = run.streams.map((s) =>
    h("tr", {}, h("th", { scope: "row" }, s.name), h("td", { class: "num" }, count(s.rows)), h("td", { class: "num" }, show(hertz(s.rate_hz))), h("td", { class: "num" }, show(seconds(s.t1 - s.t0))), h("td", { class: "num" }, String(s.gaps.length)), h("td", {}, s.columns.map((c) => h("span", { class: "chip", "data-hint": `${c.label}${c.unit ? ` [${c.unit}]` : ""}; array ${c.array.slice(0, 16)}…` }, c.name)))),
  );
  const head = ["Stream", "Rows", "Rate", "Span", "Gaps", "Columns"].map((text, i) => h("th", { class: i > 0 && i < 5 ? "num" : "" }, text));
  return h("section", { class: "card wide" }, h("h2", {}, "Streams"), h("table", { class: "table" }, h("thead", {}, h("tr", {}, head)), h("tbody", {}, rows)));
}

function estimateCard(run, e) {
  const links = PATH_FORMATS.map(([format, label, what]) => h("a", { href: `${API}/estimates/${e.id}/files/${format}`, download: "", "data-hint": what }, label));
  const config = Object.entries(e.config);
  return h(
    "details",
    { class: "estimate", "data-estimate": e.method, open: true },
    h("summary", {}, methodSwatch(e.method), ` ${methodStyle(e.method).label}`),
    h(
      "dl",
      { class: "facts" },
      fact("Path", h("span", { class: "links-row" }, links)),
      fact("Made", `${when(e.created_at).si}, in `, show(seconds(e.runtime_s), "runtime_s")),
      fact("By", h("code", {}, e.code_version)),
      fact("From run", h("span", { class: "hash" }, e.run_sha256)),
      fact("Configuration", config.length ? h("code", {}, JSON.stringify(e.config)) : "defaults", `, seed ${e.seed}`),
      Object.keys(e.parameters).length > 0 && fact("Parameters", h("code", {}, Object.entries(e.parameters).map(([k, p]) => `${k} = ${Number(p.value?.toPrecision(5))}${p.unit && p.unit !== "1" ? ` ${p.unit.replace("^2", "²")}` : ""}`).join(", "))),
      fact("Estimate id", h("code", {}, e.id)),
    ),
    commandLine(`driftscope estimate ${run.id} --method ${e.method} --out ${e.method.replace("+", "-")}.csv --json -`),
  );
}

function description(run) {
  return h("section", { class: "card wide" }, h("h2", {}, "run.json"), h("pre", { class: "command-text" }, JSON.stringify(run.meta, null, 2)));
}

export function commandLine(command) {
  const button = h("button", { type: "button", class: "button quiet" }, "Copy");
  button.addEventListener("click", async () => (button.textContent = (await copyText(command)) ? "Copied" : "Select it"));
  return h("div", { class: "command" }, h("pre", {}, command), button);
}
