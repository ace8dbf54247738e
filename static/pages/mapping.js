// The mapping step: which column of a foreign table is what, in which unit, with which sign.

import { h } from "../lib/dom.js";
import { api, problemNote } from "../lib/api.js";
import { number } from "../lib/format.js";

const DIMENSIONS = [
  ["wheel_radius", "Wheel radius, m", "0.075"],
  ["track_width", "Track width, m", "0.32"],
  ["ticks_per_rev", "Encoder ticks per turn", "2048"],
];
const TIME = "t";

/** Choices per column of the table ({what: "imu.gz" | "t" | "", unit, sign}) out of a mapping's JSON. */
function choicesOf(mapping, names) {
  const choices = new Map(names.map((n) => [n, { what: "", unit: "", sign: 1 }]));
  for (const [stream, targets] of Object.entries(mapping?.streams ?? {}))
    for (const [target, source] of Object.entries(targets))
      if (choices.has(source.column)) choices.set(source.column, { what: target === TIME ? TIME : `${stream}.${target}`, unit: source.unit ?? "", sign: source.sign ?? 1 });
  return choices;
}

class Step {
  constructor(root, table, catalogue) {
    Object.assign(this, { root, catalogue, names: table.columns.map((c) => c.name), rows: table.rows });
    this.targets = new Map(catalogue.streams.flatMap((stream) => stream.columns.filter((c) => c.name !== TIME).map((c) => [`${stream.name}.${c.name}`, c])));
    this.use(table.suggested);
  }

  use(mapping) {
    this.choices = choicesOf(mapping, this.names);
    this.robot = { ...mapping?.robot };
    this.t0 = mapping?.t0 ?? "first";
  }

  si(what) {
    return what === TIME ? "s" : (this.targets.get(what)?.unit ?? "");
  }

  /** The mapping as JSON, or {missing: [sentences]}. */
  result() {
    const missing = [];
    const streams = {};
    const time = [...this.choices].find(([, c]) => c.what === TIME);
    if (!time) missing.push("No column is the time.");
    const taken = new Set();
    for (const [column, { what, unit, sign }] of this.choices) {
      if (!what || what === TIME) continue;
      if (taken.has(what)) missing.push(`Two columns are ${what}.`);
      taken.add(what);
      const [stream, target] = what.split(".");
      streams[stream] ??= time ? { t: { column: time[0], unit: time[1].unit || "s", sign: 1 } } : {};
      streams[stream][target] = { column, unit: unit || this.si(what), sign };
      const needs = this.catalogue.units[this.si(what)]?.[unit]?.needs;
      if (needs && !this.robot[needs]) missing.push(`${column} is in ${unit}: that needs the ${needs.replaceAll("_", " ")}.`);
    }
    if (taken.size === 0) missing.push("No column is a reading.");
    for (const stream of this.catalogue.streams) if (streams[stream.name]) missing.push(...this.incomplete(stream, streams[stream.name]));
    const robot = Object.keys(this.robot).length ? { robot: this.robot } : {};
    return { missing: [...new Set(missing)], streams, mapping: { streams, t0: this.t0, ...robot } };
  }

  incomplete(stream, found) {
    const lacking = stream.columns.filter((c) => c.required && c.name !== TIME && !found[c.name]).map((c) => c.name);
    const oneOf = stream.at_least_one_of;
    if (oneOf.length && !oneOf.some((name) => found[name])) lacking.push(`one of ${oneOf.join(", ")}`);
    return lacking.length ? [`${stream.name} needs ${lacking.join(" and ")} too.`] : [];
  }
}

function option(value, label, chosen) {
  return h("option", { value, selected: value === chosen }, label);
}

function whatSelect(step, name, repaint) {
  const choice = step.choices.get(name);
  const select = h(
    "select",
    { "aria-label": `What ${name} is` },
    option("", "not used", choice.what),
    option(TIME, "time", choice.what),
    step.catalogue.streams.map((stream) => h("optgroup", { label: stream.name }, stream.columns.filter((c) => c.name !== TIME).map((c) => option(`${stream.name}.${c.name}`, `${stream.name}.${c.name}: ${c.label}`, choice.what)))),
  );
  select.addEventListener("change", () => {
    step.choices.set(name, { what: select.value, unit: "", sign: 1 });
    repaint();
  });
  return select;
}

function unitSelect(step, name, repaint) {
  const choice = step.choices.get(name);
  const si = step.si(choice.what);
  const units = Object.keys(step.catalogue.units[si] ?? {}).filter((u) => u && (choice.what.startsWith("wheels.") || !step.catalogue.units[si][u].needs));
  if (!choice.what || units.length === 0) return "";
  const select = h("select", { "aria-label": `Unit of ${name}` }, units.map((u) => option(u, u, choice.unit || si)));
  select.addEventListener("change", () => ((choice.unit = select.value), repaint()));
  return select;
}

function signSelect(step, name, repaint) {
  const choice = step.choices.get(name);
  if (!choice.what || choice.what === TIME || step.si(choice.what) === "") return "";
  const select = h("select", { "aria-label": `Sign of ${name}` }, option("1", "+", String(choice.sign)), option("-1", "− (turn round)", String(choice.sign)));
  select.addEventListener("change", () => ((choice.sign = Number(select.value)), repaint()));
  return select;
}

/** The first reading in SI, so that a wrong unit is seen before it is stored. */
function converted(step, name) {
  const { what, unit, sign } = step.choices.get(name);
  const si = step.si(what);
  const rule = step.catalogue.units[si]?.[unit || si];
  const raw = Number(step.rows.find((row) => row[name] !== null && row[name] !== "")?.[name]);
  if (!what || !si || !rule || !Number.isFinite(raw)) return "";
  const divisor = rule.needs ? Number(step.robot[rule.needs]) : rule.divisor;
  return divisor ? `${number(sign * (raw * (rule.factor / divisor) + rule.offset), 4)} ${si}` : "";
}

function tableOf(step, repaint) {
  const samples = step.rows.slice(0, 3);
  const head = h("tr", {}, ["Column", "Is", "Unit", "Sign", "First, in SI", ...samples.map((_, i) => `Row ${i + 1}`)].map((t) => h("th", { scope: "col" }, t)));
  const rows = step.names.map((name) =>
    h(
      "tr",
      { class: step.choices.get(name).what ? "" : "unused", "data-column": name },
      h("th", { scope: "row" }, name),
      h("td", {}, whatSelect(step, name, repaint)),
      h("td", {}, unitSelect(step, name, repaint)),
      h("td", {}, signSelect(step, name, repaint)),
      h("td", { class: "num" }, converted(step, name)),
      samples.map((row) => h("td", { class: "sample" }, row[name] ?? "")),
    ),
  );
  return h("div", { class: "mapping-scroll" }, h("table", { class: "mapping-table" }, h("thead", {}, head), h("tbody", {}, rows)));
}

function robotFields(step, repaint) {
  return DIMENSIONS.map(([key, label, example]) => {
    const input = h("input", { inputmode: "decimal", placeholder: `e.g. ${example}`, value: step.robot[key] ?? "" });
    input.addEventListener("change", () => {
      const value = Number(input.value.replace(",", "."));
      if (input.value.trim() && value > 0) step.robot[key] = value;
      else delete step.robot[key];
      repaint();
    });
    return h("label", { class: "field" }, label, input);
  });
}

function savedSelect(step, saved, repaint) {
  if (saved.length === 0) return null;
  const select = h("select", {}, option("", "guessed", ""), saved.map((m) => option(m.name, m.name, step.savedName ?? "")));
  select.addEventListener("change", () => {
    step.savedName = select.value;
    const found = saved.find((m) => m.name === select.value);
    if (found) step.use(found.mapping);
    repaint();
  });
  return h("label", { class: "field" }, "Saved mapping", select);
}

function summary(step) {
  const { missing, streams } = step.result();
  if (missing.length) return h("p", { class: "note amber", role: "status" }, missing.join(" "));
  const parts = Object.entries(streams).map(([stream, targets]) => `${stream} (${Object.keys(targets).join(", ")})`);
  return h("p", { class: "dim", role: "status" }, `Will store ${parts.join(" and ")}.`);
}

function startSelect(step) {
  const select = h("select", {}, option("first", "0 at the first row", step.t0), option("zero", "as it is", step.t0));
  select.addEventListener("change", () => (step.t0 = select.value));
  return h("label", { class: "field" }, "Time", select);
}

/** Asks in `root`; resolves with the mapping's JSON (saved under its name where one was given). */
export async function mappingStep(root, table, catalogue, signal) {
  const answer = await api("mappings").catch(() => []);
  const saved = (answer.items ?? answer).filter((m) => Object.values(m.mapping.streams).some((targets) => Object.values(targets).every((x) => table.columns.some((c) => c.name === x.column))));
  const step = new Step(root, table, catalogue);
  return new Promise((resolve, reject) => {
    signal.addEventListener("abort", () => reject(new DOMException("dismissed", "AbortError")), { once: true });
    const name = h("input", { placeholder: "e.g. hall logger", "aria-label": "Remember this mapping as" });
    const go = h("button", { class: "button primary", type: "button" }, "Read with these columns");
    go.addEventListener("click", async () => {
      const { missing, mapping } = step.result();
      if (missing.length) return;
      try {
        if (name.value.trim()) await api(`mappings/${encodeURIComponent(name.value.trim())}`, { method: "PUT", json: mapping });
        resolve(mapping);
      } catch (error) {
        root.append(problemNote(error));
      }
    });
    const paint = () => {
      go.disabled = step.result().missing.length > 0;
      const bar = h("div", { class: "mapping-bar" }, savedSelect(step, saved, paint), startSelect(step), robotFields(step, paint), h("label", { class: "field" }, "Remember as", name), go);
      root.replaceChildren(h("div", { class: "mapping" }, tableOf(step, paint), summary(step), bar));
    };
    paint();
  });
}
