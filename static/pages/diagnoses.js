// The stored diagnoses, those at work, and a new one.

import { api, problemNote } from "../lib/api.js";
import { $, h, icon, pageData } from "../lib/dom.js";
import { number, when } from "../lib/format.js";
import { isActive, watchJobs } from "../lib/jobs.js";
import { keys } from "../lib/keys.js";
import { follow } from "./diagnose-job.js";
import { diagnosePanel } from "./diagnose-panel.js";
import { said } from "./gap-words.js";

const page = pageData();
const params = new URLSearchParams(location.search);
const ids = (name) => (params.get(name) ?? "").split(",").filter(Boolean);
const MARKS = { none: "green", explained: "", partly_explained: "amber", unknown: "red" };
let shown = params.get("verdict") ?? "";
let panel = null;

function openPanel(open = $("#panel").hidden) {
  $("#panel").hidden = !open;
  $("#new").setAttribute("aria-expanded", String(open));
  if (open && !panel) {
    panel = diagnosePanel({ runs: page.runs, effects: page.effects, simulators: page.simulators, chosen: ids("runs"), held: ids("held_out") }, (id) => location.assign(`/diagnoses/${id}`));
    $("#panel").append(h("h2", {}, "Which runs of a robot"), page.runs.length ? panel : h("p", { class: "dim" }, "No stored run has commands or wheels: add one under Runs."));
  }
  if (open) $("#panel input")?.focus();
}

/* the list */

function paintFilter() {
  const counts = (v) => page.diagnoses.filter((d) => d.verdict === v).length;
  const choices = [["", "all", page.diagnoses.length], ...Object.entries(page.verdicts).map(([v, label]) => [v, label, counts(v)])].filter(([v, , n]) => !v || n);
  $("#filter").hidden = choices.length < 3;
  $("#filter").replaceChildren(...choices.map(([v, label, n]) => h("button", { type: "button", "aria-pressed": String(v === shown), onclick: () => ((shown = v), paint()) }, `${label} ${n}`)));
}

const withRobots = () => page.diagnoses.some((d) => d.robot);

function row(d) {
  const remove = h("button", { type: "button", class: "icon-button", "aria-label": `Delete ${d.name}`, "data-hint": "Delete; it can be brought back for a day", onclick: () => drop(d) }, icon("trash"));
  const runs = d.runs.map((r) => h("div", {}, r.stored ? h("a", { href: `/runs/${r.id}?tab=gap` }, r.name) : r.name, r.held_out && h("span", { class: "dim" }, " held out")));
  return h("tr", { "data-diagnosis": d.id }, h("td", { class: "said" }, h("a", { href: `/diagnoses/${d.id}` }, d.name), h("div", {}, said(d.sentence))), withRobots() && h("td", {}, d.robot ?? ""), h("td", {}, runs), h("td", {}, h("span", { class: `chip ${MARKS[d.verdict]}` }, page.verdicts[d.verdict])), h("td", { class: "num" }, `${number(d.gap.before, 2)} → ${number(d.gap.after, 2)}`), h("td", { class: "num" }, h("time", { datetime: d.created_at, "data-hint": when(d.created_at).si }, when(d.created_at).text)), h("td", {}, remove));
}

function paint() {
  paintFilter();
  const rows = page.diagnoses.filter((d) => !shown || d.verdict === shown);
  const head = [["Diagnosis"], ...(withRobots() ? [["Robot"]] : []), ["Runs"], ["Verdict", "verdict"], ["× noise", "gap_far"], ["When", "when"], [""]];
  const empty = h("div", {}, h("p", {}, "A diagnosis compares runs of a robot with its simulator and says where they differ, which effect causes it, and how far the gap shrinks once that effect is added."), h("p", { class: "dim" }, "It needs commands or wheels, and anything that was measured beside them: IMU, fixes, ranges or a reference. ", h("a", { href: "/guide/diagnoses" }, "How to read one")));
  $("#list").replaceChildren(page.diagnoses.length ? h("div", { class: "scroll-x" }, h("table", { class: "table diagnoses" }, h("thead", {}, h("tr", {}, head.map(([text, term]) => h("th", { class: ["× noise", "When"].includes(text) ? "num" : "", "data-term": term }, text)))), h("tbody", {}, rows.map(row)))) : empty);
}

async function drop(d) {
  try {
    await api(`diagnoses/${d.id}`, { method: "DELETE" });
    const at = page.diagnoses.indexOf(d);
    page.diagnoses.splice(at, 1);
    paint();
    const undo = h("button", { type: "button", class: "button primary", id: "undo-button" }, "Undo");
    undo.addEventListener("click", async () => {
      await api(`diagnoses/${d.id}/restore`, { method: "POST" });
      page.diagnoses.splice(at, 0, d);
      $("#said").replaceChildren();
      paint();
    });
    $("#said").replaceChildren(h("div", { class: "bar" }, h("span", { class: "spread" }, `“${d.name}” is deleted; for a day it can be brought back.`), undo));
    undo.focus();
  } catch (error) {
    $("#said").replaceChildren(problemNote(error));
  }
}

/* at work */

async function watch(job) {
  const host = h("div", {});
  $("#at-work").append(host);
  const id = await follow(host, job);
  if (!id) return;
  const made = await api(`diagnoses/${id}`);
  if (!page.diagnoses.some((d) => d.id === id)) page.diagnoses.unshift(made);
  paint();
}

const seen = new Set(page.jobs.map((job) => job.id));
watchJobs((job) => {
  if (job.kind !== "diagnose" || !isActive(job) || seen.has(job.id) || !$("#panel").hidden) return;
  seen.add(job.id);
  watch(job);
});
page.jobs.forEach(watch);
$("#new").addEventListener("click", () => openPanel());
keys("Diagnoses", { d: ["new diagnosis", () => openPanel(true)], u: ["undo the deletion", () => $("#undo-button")?.click()] });
paint();
if (ids("runs").length || !page.diagnoses.length) openPanel(true);
document.documentElement.dataset.ready = "diagnoses";
