// The report: what the server drew, and with it the time cursor, maps, 3D, timeline and overlay of a run.

import { api, problemNote } from "../lib/api.js";
import { closeOutside } from "../lib/chart-frame.js";
import { copyText } from "../lib/chart-export.js";
import { $, $$, debounce, h, pageData, save } from "../lib/dom.js";
import { keys } from "../lib/keys.js";
import { startFigures } from "./diagnosis-figures.js";
import { mountRun } from "./diagnosis-run.js";

const { diagnosis, evidence, targets } = pageData();
const params = new URLSearchParams(location.search);
const runs = (evidence?.runs ?? []).map((one, i) => ({ ...one, name: diagnosis.runs[i]?.name ?? one.name, id: diagnosis.runs[i]?.id, stored: diagnosis.runs[i]?.stored })).filter((one) => one.path || one.free_run || one.timeline?.t.length);
const say = (error) => $("#said").replaceChildren(problemNote(error));
const some = Object.keys(diagnosis.effects).length > 0; // effects to add
let run = null; // the one that is shown
let at = 0;

/* one run at a time */

function choose(index) {
  at = Math.min(Math.max(index, 0), runs.length - 1);
  run?.destroy();
  run = mountRun(runs[at], { params, some, changed: remember, fileName: diagnosis.name.replace(/[^\w.+-]+/g, "_").slice(0, 60) });
  for (const [i, button] of $$("#run-choice button").entries()) button.setAttribute("aria-pressed", String(i === at));
  remember();
}

// Map alone, 3D alone; again: both.
function view(one) {
  if (!run) return;
  if (params.get("view") === one) params.delete("view");
  else params.set("view", one);
  choose(at);
}

function startRuns() {
  if (!runs.length) return;
  $("#run-choice").hidden = runs.length < 2;
  $("#run-choice").append(h("div", { class: "segmented", role: "group", "aria-label": "Run shown" }, runs.map((r, i) => h("button", { type: "button", onclick: () => choose(i) }, `${r.name}${r.held_out ? ", held out" : ""}`))));
  const held = runs.findIndex((r) => r.held_out);
  choose(params.has("run") ? Number(params.get("run")) || 0 : Math.max(held, 0));
  for (const button of $$(".jump")) button.addEventListener("click", () => run.look(Number(button.dataset.t0), Number(button.dataset.t1)));
}

const remember = debounce(150, () => {
  const now = new URLSearchParams(run?.address() ?? {});
  if (runs.length > 1) now.set("run", String(at));
  history.replaceState(null, "", `${location.pathname}?${now}${location.hash}`);
});

/* what leaves the page */

async function patch(target) {
  const note = $("#export-note");
  note.hidden = false;
  try {
    const made = await api(`diagnoses/${diagnosis.id}/patches/${target.name}?form=json`);
    save(new Blob([made.text], { type: made.media_type }), made.file_name);
    const lists = [["roughly", made.nearest], ["not", made.missing]].flatMap(([how, list]) => Object.entries(list).map(([e, why]) => [h("dt", {}, `${how}: ${e}`), h("dd", {}, why)]));
    note.replaceChildren(h("p", {}, `${made.file_name}: ${target.what}. Modelled: ${made.expressed.join(", ") || "nothing beyond the nominal robot"}.`), lists.length ? h("dl", {}, lists) : "");
  } catch (error) {
    note.replaceChildren(problemNote(error));
  }
}

function command() {
  const of = (held) => diagnosis.runs.filter((r) => r.held_out === held).map((r) => r.id).join(" ");
  const sizes = Object.entries(diagnosis.config.tolerances ?? {}).map(([key, size]) => `${key}=${size}`);
  return `driftscope diagnose ${of(false)}${of(true) ? ` --held-out ${of(true)}` : ""}${sizes.length ? ` --tolerance ${sizes.join(" ")}` : ""}${diagnosis.seed ? ` --seed ${diagnosis.seed}` : ""}${diagnosis.simulator ? ` --simulator ${diagnosis.simulator}` : ""} --json diagnosis.json`;
}

function startTools() {
  const menu = $("#patch .menu-list");
  menu.append(...targets.map((t) => h("button", { type: "button", "data-target": t.name, title: t.what, onclick: () => (($("#patch").open = false), patch(t)) }, t.label)));
  $("#patch").hidden = !some;
  $(".share-row").hidden = !some;
  if ($("#open-sandbox")) $("#open-sandbox").href = `/sandbox?${new URLSearchParams({ run: diagnosis.runs[0].id, ...(some ? { effects: JSON.stringify(diagnosis.effects) } : {}) })}`;
  for (const id of ["#patch", "#download"]) closeOutside($(id));
  const copy = $("#copy-command");
  copy.dataset.hint = command();
  copy.addEventListener("click", async () => {
    copy.textContent = (await copyText(command())) ? "Copied" : "Copy was refused";
    setTimeout(() => (copy.textContent = "Copy as command"), 1500);
  });
  $("#delete").addEventListener("click", remove);
  const write = (change) => api(`diagnoses/${diagnosis.id}`, { method: "PATCH", json: change }).catch(say);
  $("#notes").addEventListener("change", () => write({ notes: $("#notes").value }));
  $("#diagnosis-name").addEventListener("dblclick", rename);
  $("#diagnosis-name").dataset.hint = "Double-click to rename";
}

function rename() {
  const title = $("#diagnosis-name");
  const input = h("input", { maxlength: "200", "aria-label": "Name of the diagnosis", value: diagnosis.name });
  title.replaceWith(input);
  input.select();
  const end = async () => {
    const name = input.value.trim();
    try {
      if (name && name !== diagnosis.name) diagnosis.name = (await api(`diagnoses/${diagnosis.id}`, { method: "PATCH", json: { name } })).name;
    } catch (error) {
      say(error);
    }
    title.textContent = diagnosis.name;
    if (input.isConnected) input.replaceWith(title);
  };
  input.addEventListener("blur", end, { once: true });
  input.addEventListener("keydown", (event) => ["Enter", "Escape"].includes(event.key) && input.blur());
}

async function remove() {
  try {
    await api(`diagnoses/${diagnosis.id}`, { method: "DELETE" });
    const undo = h("button", { type: "button", class: "button primary" }, "Undo");
    undo.addEventListener("click", () => api(`diagnoses/${diagnosis.id}/restore`, { method: "POST" }).then(() => $("#said").replaceChildren(), say));
    $("#said").replaceChildren(h("div", { class: "bar" }, h("span", { class: "spread" }, `“${diagnosis.name}” is deleted; for a day it can be brought back.`), undo, h("a", { class: "button", href: "/diagnoses" }, "To the diagnoses")));
    undo.focus();
  } catch (error) {
    say(error);
  }
}

keys("Diagnosis", {
  d: ["diagnose these runs again", () => location.assign(`/diagnoses?${new URLSearchParams({ runs: diagnosis.runs.filter((r) => !r.held_out).map((r) => r.id).join(","), held_out: diagnosis.runs.filter((r) => r.held_out).map((r) => r.id).join(",") })}`)],
  " ": ["play and pause", () => run?.clock.toggle(), "space"],
  ",": ["a step back", () => run?.clock.step(-1)],
  ".": ["a step on", () => run?.clock.step(1)],
  "[": ["slower, faster", () => run?.clock.slower(), "[ ]"],
  "]": [null, () => run?.clock.faster()],
  m: ["map alone, 3D alone", () => view("map"), "m v"],
  v: [null, () => view("scene")],
  f: ["3D camera follows", () => run?.clock.setFollow(!run.clock.follow)],
  j: ["next, previous run", () => runs.length > 1 && choose((at + 1) % runs.length), "j k"],
  k: [null, () => runs.length > 1 && choose((at + runs.length - 1) % runs.length)],
  e: ["export", () => (($("#download").open = true), $("#download a").focus())],
  Home: ["whole time", () => run?.clock.resetRange()],
});
startTools();
startFigures(evidence, diagnosis);
startRuns();
document.documentElement.dataset.ready = "diagnosis";
