// A new diagnosis: which runs to fit and which to hold out, what matters, and the job that follows.

import { h } from "../lib/dom.js";
import { duration, number, when } from "../lib/format.js";
import { diagnose, faultsNote } from "./diagnose-job.js";

const SHOWN = 100;

export function diagnosePanel({ runs, effects, simulators, chosen, held }, onFound) {
  const fit = new Set(chosen);
  const keep = new Set(held);
  const matters = [];
  const note = h("div", { "aria-live": "polite", id: "new-note" });
  const search = h("input", { type: "search", placeholder: "Find runs by name or robot", "aria-label": "Find runs" });
  const body = h("tbody", {});
  const go = h("button", { type: "submit", class: "button primary", disabled: true }, "Diagnose");
  const told = h("span", { class: "dim", id: "told-choice" });
  const name = h("input", { maxlength: "200", placeholder: "robot and runs", "aria-label": "Name" });
  const seed = h("input", { type: "number", min: "0", step: "1", value: "0", "aria-label": "Seed" });
  const simulator = h("select", { "aria-label": "Simulator", "data-term": "sandbox_simulator" }, simulators.map((s) => h("option", { value: s }, s)));
  const list = h("div", { class: "matters", id: "matters" });
  const more = h("button", { type: "button", class: "button quiet", onclick: () => addSize() }, "Set another size that matters");
  const byId = new Map(runs.map((r) => [r.id, r]));

  const wrong = h("div", { "aria-live": "polite" });
  const faults = () => [...fit, ...keep].map((id) => byId.get(id)).filter((r) => r?.faults.length).map((r) => [r.name, r.faults]);
  const robotOf = () => [...fit, ...keep].map((id) => byId.get(id)?.robot ?? null)[0];

  function rows() {
    const words = search.value.trim().toLowerCase().split(/\s+/).filter(Boolean);
    const match = (r) => words.every((w) => `${r.name} ${r.robot ?? ""}`.toLowerCase().includes(w));
    const picked = runs.filter((r) => fit.has(r.id) || keep.has(r.id));
    const rest = runs.filter((r) => !fit.has(r.id) && !keep.has(r.id) && match(r));
    return [...picked, ...rest].slice(0, Math.max(SHOWN, picked.length));
  }

  function paint() {
    const any = fit.size + keep.size > 0;
    const robot = robotOf();
    body.replaceChildren(...rows().map((r) => row(r, any && (r.robot ?? null) !== robot)));
    const known = faults();
    wrong.replaceChildren(...(known.length ? [faultsNote(known)] : []));
    go.disabled = fit.size === 0;
    go.textContent = fit.size ? `Diagnose ${fit.size} ${fit.size === 1 ? "run" : "runs"}` : "Diagnose";
    told.textContent = !fit.size ? "Tick at least one run to fit." : keep.size ? `${keep.size} held out: they only judge.` : "None held out: stretches of the same runs judge, which flatters a little.";
  }

  function row(r, off) {
    const tick = (set, other, label) => {
      const box = h("input", { type: "checkbox", "aria-label": `${label} ${r.name}`, checked: set.has(r.id) });
      box.addEventListener("change", () => {
        set[box.checked ? "add" : "delete"](r.id);
        if (box.checked) other.delete(r.id);
        paint();
        body.querySelector(`tr[data-run="${r.id}"] input[aria-label^="${label}"]`)?.focus();
      });
      return h("td", { class: "pick" }, box);
    };
    return h("tr", { "data-run": r.id, class: off ? "off" : "", "data-hint": off ? "Of another robot than the chosen runs." : undefined }, tick(fit, keep, "Fit"), tick(keep, fit, "Hold out"), h("td", { class: "wide" }, r.name, r.faults.length ? [" ", h("span", { class: "chip amber", "data-hint": r.faults.join(" "), tabindex: "0" }, "faulty readings")] : ""), h("td", {}, r.robot ?? h("span", { class: "dim" }, "no robot")), h("td", { class: "num" }, duration(r.duration_s).text), h("td", { class: "dim" }, r.streams.join(" ")), h("td", { class: "dim" }, when(r.created_at).text));
  }

  function addSize() {
    const unit = h("span", { class: "dim" });
    const select = h("select", { "aria-label": "Effect and parameter" }, effects.map((e) => h("option", { value: e.key }, e.label)));
    const value = h("input", { type: "number", step: "any", min: "0", "aria-label": "Smallest size that matters" });
    const entry = { select, value };
    const show = () => {
      const e = effects.find((one) => one.key === select.value);
      value.placeholder = String(e.small);
      unit.textContent = `${e.unit || "no unit"}${e.of_reach ? "" : `; the table says ${number(e.small)}`}`;
    };
    select.addEventListener("change", show);
    const off = h("button", { type: "button", class: "icon-button", "aria-label": "Remove" }, "×");
    const line = h("div", { class: "row" }, select, "matters from", value, unit, off);
    off.addEventListener("click", () => (line.remove(), matters.splice(matters.indexOf(entry), 1)));
    matters.push(entry);
    list.append(line);
    show();
    select.focus();
  }

  const tolerances = () => Object.fromEntries(matters.filter((m) => m.value.value !== "").map((m) => [m.select.value, Number(m.value.value)]));

  const form = h(
    "form",
    { id: "diagnose-form" },
    h("div", { class: "row" }, search, told),
    h("div", { class: "choose" }, h("table", { class: "table" }, h("thead", {}, h("tr", {}, h("th", { class: "pick", "data-term": "gap_fitted" }, "Fit"), h("th", { class: "pick", "data-term": "gap_held_out" }, "Hold out"), h("th", {}, "Run"), h("th", {}, "Robot"), h("th", { class: "num" }, "Length"), h("th", {}, "Streams"), h("th", {}, "When"))), body)),
    h("details", {}, h("summary", { class: "dim", "data-term": "gap_tolerance" }, "What matters, seed, name"), list, more, h("div", { class: "options" }, h("label", { class: "field" }, "Seed", seed), h("label", { class: "field" }, "Name", name))),
    h("p", { class: "row dim" }, "Against the simulator", simulators.length > 1 ? simulator : h("b", {}, simulators[0]), "with what the runs' own simulator.effects say it models already."),
    wrong,
    h("div", { class: "row" }, go),
    note,
  );
  search.addEventListener("input", paint);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    go.disabled = true;
    const options = { simulator: simulator.value, tolerances: tolerances(), seed: Math.max(0, Math.floor(Number(seed.value) || 0)), ...(name.value.trim() ? { name: name.value.trim() } : {}) };
    const id = await diagnose(note, { runs: [...fit], held_out: [...keep], options }, faults());
    if (id) onFound(id);
    paint();
  });
  paint();
  return form;
}
