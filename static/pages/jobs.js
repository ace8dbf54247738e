// The jobs, live: progress, cancel, retry, and the whole error of what failed.

import { $, debounce, h, pageData } from "../lib/dom.js";
import { api, problemNote } from "../lib/api.js";
import { count, duration, show, when } from "../lib/format.js";
import { isActive, jobLabel, watchJobs } from "../lib/jobs.js";
import { keys } from "../lib/keys.js";

const VIEWS = [
  ["all", "All", () => true],
  ["active", "In progress", isActive],
  ["failed", "Failed", (job) => job.state === "failed"],
  ["done", "Done", (job) => job.state === "done"],
];
const CHIP = { running: "chip green", queued: "chip", done: "chip", failed: "chip red", cancelled: "chip" };
const WORDS = { running: "running", queued: "waiting", done: "done", failed: "failed", cancelled: "cancelled" };

const page = pageData();
const jobs = new Map(page.jobs.map((job) => [job.id, job]));
const problems = new Map(); // of buttons, by job
let counts = page.counts;
let view = new URLSearchParams(location.search).get("state") ?? "all";

const took = (job) => (job.started_at ? ((job.finished_at ? new Date(job.finished_at) : new Date()) - new Date(job.started_at)) / 1000 : null);

function act(job, verb) {
  problems.delete(job.id);
  return api(`jobs/${job.id}/${verb}`, { method: "POST" })
    .then(take)
    .catch((error) => (problems.set(job.id, error), paint()));
}

function action(job) {
  if (isActive(job)) return h("button", { class: "button", type: "button", onclick: () => act(job, "cancel") }, "Cancel");
  if (job.state === "failed" || job.state === "cancelled") return h("button", { class: "button", type: "button", onclick: () => act(job, "retry") }, "Retry");
  return "";
}

function subject(job) {
  const run = job.run_id ?? job.result?.run_id;
  const label = job.run_name ?? job.file ?? run ?? "";
  return run ? h("a", { href: `/runs/${run}` }, label) : label;
}

function progress(job) {
  const meter = isActive(job) && h("span", { class: "meter" }, h("i", { style: { width: `${Math.round(job.progress * 100)}%` } }));
  const percent = isActive(job) && h("span", { class: "num" }, `${Math.round(job.progress * 100)}%`);
  return h("div", { class: "message" }, meter, percent, h("span", { class: "clip dim", title: job.message }, job.message), job.attempt > 1 && h("span", { class: "chip", "data-hint": "How often it was started." }, `attempt ${job.attempt}`));
}

function rowsOf(job) {
  const problem = problems.get(job.id) ?? (job.state === "failed" ? (job.error ?? { detail: job.message }) : null);
  const row = h(
    "tr",
    { class: problem ? "has-detail" : "", "data-job": job.id, "data-state": job.state },
    h("td", {}, h("span", { class: CHIP[job.state] ?? "chip" }, WORDS[job.state] ?? job.state)),
    h("td", {}, jobLabel(job)),
    h("td", { class: "clip" }, subject(job)),
    h("td", {}, progress(job)),
    h("td", { class: "num" }, job.started_at ? show(when(job.started_at)) : ""),
    h("td", { class: "num" }, job.started_at ? show(duration(took(job))) : ""),
    h("td", { class: "num" }, action(job)),
  );
  return problem ? [row, h("tr", { class: "detail" }, h("td", { colspan: 7 }, problemNote(problem)))] : [row];
}

function paint() {
  const filter = VIEWS.find(([key]) => key === view)?.[2] ?? VIEWS[0][2];
  const order = [...jobs.values()].sort((a, b) => (a.created_at < b.created_at ? 1 : a.created_at > b.created_at ? -1 : 0)).filter(filter);
  $("#jobs").tBodies[0].replaceChildren(...order.flatMap((job) => rowsOf(job)));
  $("#none").hidden = order.length > 0;
  $("#jobs").hidden = order.length === 0;
  const number = { all: Object.values(counts).reduce((a, b) => a + b, 0), active: (counts.running ?? 0) + (counts.queued ?? 0), failed: counts.failed ?? 0, done: counts.done ?? 0 };
  $("#states").replaceChildren(
    ...VIEWS.map(([key, label]) =>
      h("button", { type: "button", "aria-pressed": String(key === view), onclick: () => choose(key) }, `${label} ${count(number[key])}`),
    ),
  );
}

function choose(key) {
  view = key;
  history.replaceState(null, "", key === "all" ? "/jobs" : `/jobs?state=${key}`);
  paint();
}

/** The counts and the sentence are the server's: asked again once things have settled. */
const recount = debounce(300, async () => {
  const answer = await api("/jobs.json").catch(() => null);
  if (!answer) return;
  counts = answer.counts;
  $("#verdict").textContent = answer.sentence;
  for (const job of answer.jobs) jobs.set(job.id, { ...jobs.get(job.id), ...job });
  paint();
});

function take(job) {
  const before = jobs.get(job.id);
  jobs.set(job.id, { ...before, ...job });
  if (before?.state !== job.state) recount();
  paint();
}

watchJobs(take);
setInterval(() => [...jobs.values()].some(isActive) && paint(), 1000);
keys("Jobs", Object.fromEntries(VIEWS.map(([key, label], i) => [String(i + 1), [label.toLowerCase(), () => choose(key)]])));
paint();
document.documentElement.dataset.ready = "jobs";
