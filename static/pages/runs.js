// The list of runs: search, facets, table, selection, tags, deletion with undo.

import { $, debounce, h, icon, pageData, save } from "../lib/dom.js";
import { api, problemNote, query } from "../lib/api.js";
import { count, when } from "../lib/format.js";
import { watchJobs } from "../lib/jobs.js";
import { keys } from "../lib/keys.js";
import { paintFacets, toggle } from "./runs-facets.js";
import { COLUMNS, RunTable } from "./runs-table.js";
import { startUploads } from "./uploads.js";

const PAGE = 500;
const page = pageData();
const search = $("#search");
const state = { ...page, loading: null };
const asked = { q: page.q, sort: page.sort }; // what the user wants, also while its answer is on the way: a refresh asks no less

const table = new RunTable($("#list"), $("#table"), {
  more: (index) => loadTo(index),
  open: (id) => (location.href = `/runs/${id}`),
  selection: paintSelection,
  filter: (key, value) => go({ q: toggle(state.q, key, value) }),
  saveTags,
  sort: (key) => go({ sort: state.sort === `-${key}` ? key : state.sort === key ? `-${key}` : key === "name" ? key : `-${key}` }),
});

const listQuery = (more) => query({ q: state.q, sort: state.sort, ...more });

/** Rows up to `index`, page after page, one request at a time; who asks meanwhile is served by the same loop. */
async function loadTo(index) {
  state.wanted = Math.max(state.wanted ?? 0, index);
  if (state.loading) return state.loading.done;
  const token = (state.loading = {});
  token.done = loadPages(token).finally(() => {
    if (state.loading === token) Object.assign(state, { loading: null, wanted: 0 });
  });
  return token.done;
}

async function loadPages(token) {
  try {
    while (state.next && table.items.length < state.wanted) {
      const answer = await api(`runs?${listQuery({ cursor: state.next, limit: PAGE })}`);
      if (state.loading !== token) return;
      state.next = answer.next;
      table.append(answer.items);
      paintCount();
    }
  } catch (error) {
    showProblem(error);
  }
}

/** The page for another search or order: its JSON twin says all of it, the sentence too. */
async function go(change, { keep = false } = {}) {
  const wanted = { ...Object.assign(asked, change) };
  const params = query({ q: wanted.q, sort: wanted.sort === "-created_at" ? "" : wanted.sort });
  try {
    const token = (state.loading = {});
    const limit = keep ? Math.min(PAGE, Math.max(100, table.items.length)) : 100;
    const answer = await api(`/runs.json?${query({ ...wanted, limit })}`);
    if (state.loading !== token) return;
    Object.assign(state, answer.data, { loading: null, wanted: 0 });
    $("#verdict").textContent = answer.sentence;
    history.replaceState(null, "", params ? `/runs?${params}` : "/runs");
    $("#undo").querySelector("[role=alert]")?.remove();
    paint({ keep });
  } catch (error) {
    state.loading = null;
    showProblem(error);
  }
}

// not while tags are being written: the row must stay
const refresh = debounce(400, () => (table.editing ? refresh() : go({}, { keep: true })));

function showProblem(error) {
  $("#undo").replaceChildren(problemNote(error));
}

function paint({ keep = false } = {}) {
  if (document.activeElement !== search) search.value = state.q;
  const verdicts = state.items.some((r) => r.verdict);
  table.set({ ...state, keep, columns: COLUMNS.filter((c) => c.key !== "verdict" || verdicts) });
  paintFacets($("#facets"), state.facets, state.q, (q) => go({ q }));
  paintCount();
  paintSelection(table.selected);
  const empty = state.stored === 0;
  $(".runs").classList.toggle("teaching", empty || !$("#format").hidden);
  if (empty) $("#format").hidden = false;
  $("#list").hidden = state.total === 0;
  $("#nothing").hidden = state.total > 0;
  if (state.total === 0 && !empty) {
    const clear = h("button", { class: "button", type: "button", onclick: () => go({ q: "" }) }, "Clear search");
    $("#nothing").replaceChildren(h("p", {}, "No run matches ", h("b", {}, state.q), "."), h("p", {}, clear));
  }
  for (const id of ["export", "show-deleted"]) $(`#${id}`).hidden = empty && id === "export";
}

function paintCount() {
  const of = state.total === state.stored ? "" : ` of ${count(state.stored)}`;
  $("#count").textContent = state.stored ? `${count(state.total)}${of} ${state.stored === 1 ? "run" : "runs"}` : "";
}

/* selection */

function paintSelection(selected) {
  const bar = $("#selection");
  const n = selected.size;
  bar.hidden = n === 0;
  if (n === 0) return bar.replaceChildren();
  const can = n >= 2 && n <= 8;
  const compare = h("button", { class: "button primary", id: "compare", type: "button", disabled: !can, "data-hint": can ? "" : "Select two to eight runs to compare them.", onclick: compareSelected }, icon("compare"), "Compare");
  const tag = h("input", { id: "bulk-tag", placeholder: "Add tag", "aria-label": "Add a tag to the selected runs" });
  tag.addEventListener("keydown", (event) => event.key === "Enter" && addTag(tag.value.trim()));
  const remove = h("button", { class: "button quiet danger", type: "button", onclick: () => deleteRuns([...selected]) }, icon("trash"), "Delete");
  const none = h("button", { class: "icon-button", type: "button", "aria-label": "Select none", onclick: () => table.selectNone() }, icon("close"));
  const diagnose = h("button", { class: "button", id: "diagnose", type: "button", "data-hint": "The gap between these runs and their simulator (d)", onclick: diagnoseSelected }, icon("diagnoses"), "Diagnose");
  return bar.replaceChildren(h("b", {}, `${count(n)} selected`), compare, diagnose, tag, remove, none);
}

function compareSelected() {
  const n = table.selected.size;
  if (n >= 2 && n <= 8) location.href = `/compare?runs=${[...table.selected].join(",")}`;
}

function diagnoseSelected() {
  const chosen = table.selected.size ? [...table.selected] : active() ? [active().id] : [];
  if (chosen.length) location.href = `/diagnoses?runs=${chosen.join(",")}`;
}

async function saveTags(id, tags) {
  try {
    table.replace(await api(`runs/${id}`, { method: "PATCH", json: { tags } }));
    refresh();
  } catch (error) {
    table.redraw(id);
    showProblem(error);
  }
}

async function addTag(tag) {
  if (!tag) return;
  const runs = table.items.filter((r) => table.selected.has(r.id) && !r.tags.includes(tag));
  for (const run of runs) await saveTags(run.id, [...run.tags, tag]);
}

/* deletion */

async function deleteRuns(ids) {
  if (ids.length === 0) return undefined;
  const names = ids.map((id) => table.items.find((r) => r.id === id)?.name ?? id);
  try {
    for (const id of ids) await api(`runs/${id}`, { method: "DELETE" });
  } catch (error) {
    return showProblem(error);
  }
  for (const id of ids) table.selected.delete(id);
  const what = ids.length === 1 ? `“${names[0]}”` : `${count(ids.length)} runs`;
  const undo = h("button", { class: "button", id: "undo-button", type: "button", onclick: () => restore(ids) }, "Undo");
  const close = h("button", { class: "icon-button", type: "button", "aria-label": "Close", onclick: () => $("#undo").replaceChildren() }, icon("close"));
  $("#undo").replaceChildren(h("div", { class: "bar" }, h("span", { class: "spread" }, `Deleted ${what}. It can be brought back for ${count(state.undo_hours)} hours.`), undo, close));
  return go({}, { keep: true });
}

async function restore(ids) {
  try {
    for (const id of ids) await api(`runs/${id}/restore`, { method: "POST" });
    $("#undo").replaceChildren();
  } catch (error) {
    showProblem(error);
  }
  if (!$("#deleted").hidden) await paintDeleted();
  await go({}, { keep: true });
}

async function paintDeleted() {
  const answer = await api("runs/deleted");
  const runs = answer.items ?? answer;
  const rows = runs.map((run) => h("tr", {}, h("td", {}, run.name), h("td", { class: "dim" }, run.robot ?? ""), h("td", { class: "dim" }, `stored ${when(run.created_at).text}`), h("td", { class: "num" }, h("button", { class: "button", type: "button", onclick: () => restore([run.id]) }, "Bring back"))));
  $("#deleted").replaceChildren(h("h2", {}, "Deleted in the last day"), rows.length ? h("table", { class: "table" }, h("tbody", {}, rows)) : h("p", { class: "dim" }, "Nothing."));
}

async function toggleDeleted() {
  const open = $("#deleted").hidden;
  if (open) await paintDeleted().catch(showProblem);
  $("#deleted").hidden = !open;
  $("#show-deleted").setAttribute("aria-expanded", String(open));
}

function toggleFormat() {
  const open = $("#format").hidden || state.stored === 0;
  $("#format").hidden = !open;
  $("#show-format").setAttribute("aria-expanded", String(open));
  $("#show-format").textContent = open && state.stored ? "Back to the runs" : "Format";
  $(".runs").classList.toggle("teaching", open);
  table.later();
}

/* out */

const cell = (value) => {
  const text = value === null || value === undefined ? "" : String(value);
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
};

async function exportCsv() {
  await loadTo(state.total);
  const head = ["id", "name", "robot", "created_at", "duration_s", "streams", "best_method", "best_ate_m", "bias_drift_rad_s", "verdict", "tags"];
  const lines = table.items.map((r) => [r.id, r.name, r.robot, r.created_at, r.duration_s, r.streams.map((x) => x.name).join(" "), r.best?.method, r.best?.ate_rmse_m, r.bias_drift_rad_s, r.verdict, r.tags.join(" ")].map(cell).join(","));
  save(new Blob([[head.join(","), ...lines, ""].join("\n")], { type: "text/csv" }), "runs.csv");
}

/* wiring */

search.addEventListener("input", debounce(180, () => go({ q: search.value.trim() })));
search.form.addEventListener("submit", (event) => {
  event.preventDefault();
  go({ q: search.value.trim() });
  search.blur();
});
$("#export").addEventListener("click", exportCsv);
$("#show-deleted").addEventListener("click", toggleDeleted);
$("#show-format").addEventListener("click", toggleFormat);
$("#show-facets").addEventListener("click", () => {
  const open = $("#facets").classList.toggle("open");
  $("#show-facets").setAttribute("aria-expanded", String(open));
});
watchJobs((job) => job.state === "done" && refresh());
startUploads({ limit: page.max_upload_bytes, mapping: page.mapping, onStored: refresh });

const active = () => table.activeRun;
keys("Runs", {
  j: ["next run", () => table.move(1)],
  k: ["previous run", () => table.move(-1)],
  Enter: ["open the run", () => (active() ? (location.href = `/runs/${active().id}`) : false)],
  x: ["select it", () => active() && table.select(active().id, !table.selected.has(active().id))],
  c: ["compare the selected", compareSelected],
  d: ["diagnose the selected", diagnoseSelected],
  t: ["edit its tags", () => active() && table.editTags(active().id)],
  Delete: ["delete it, or the selected", () => deleteRuns(table.selected.size ? [...table.selected] : active() ? [active().id] : [])],
  u: ["undo the deletion", () => $("#undo-button")?.click()],
  a: ["add runs", () => $("#files").click()],
  e: ["export the list as CSV", exportCsv],
  ArrowDown: [null, () => table.move(1)],
  ArrowUp: [null, () => table.move(-1)],
});
paint();
document.documentElement.dataset.ready = "runs";
