// Jobs in progress: one stream of events per browser, however many tabs are open (a tab holds a lock and tells the rest).

import { $, h, icon } from "./dom.js";
import { api, API } from "./api.js";

const ACTIVE = new Set(["queued", "running"]);
const listeners = new Set();
const channel = "BroadcastChannel" in window ? new BroadcastChannel("driftscope-jobs") : null;
let started = false;

export const isActive = (job) => ACTIVE.has(job.state);

function tell(job) {
  for (const listener of listeners) listener(job);
}

function listen() {
  const source = new EventSource(`${API}/jobs/events`);
  source.addEventListener("job", (event) => {
    const job = JSON.parse(event.data);
    tell(job);
    channel?.postMessage(job);
  });
}

/** Calls back with every Job that changes. Returns a function that stops it. */
export function watchJobs(callback) {
  listeners.add(callback);
  if (!started) {
    started = true;
    channel?.addEventListener("message", (event) => tell(event.data));
    if (navigator.locks && channel) navigator.locks.request("driftscope-jobs", () => new Promise(listen)).catch(() => {});
    else listen();
  }
  return () => listeners.delete(callback);
}

/** Resolves with the job once it is done, failed or cancelled; calls back with its progress meanwhile. */
export function followJob(id, callback) {
  return new Promise((resolve, reject) => {
    let timer = 0;
    const stop = watchJobs((job) => job.id === id && step(job));
    const step = (job) => {
      callback?.(job);
      if (isActive(job)) return;
      stop();
      clearInterval(timer);
      resolve(job);
    };
    const ask = () => api(`jobs/${id}`).then(step, (error) => error.status === 404 && (stop(), clearInterval(timer), reject(error)));
    timer = setInterval(ask, 2000); // an event may have passed before we listened, or its stream may be broken
    ask();
  });
}

const KINDS = { ingest: "Read file", estimate: "Estimate", imu: "Analyse IMU", calibrate: "Calibrate", correct: "Correct", judge: "Judge", diagnose: "Diagnose", odometry: "Calibrate odometry", live: "Live run" };
export const jobLabel = (job) => KINDS[job.kind] ?? job.kind;

function jobRow(job) {
  const meter = h("span", { class: "meter" }, h("i", { style: { width: `${Math.round(job.progress * 100)}%` } }));
  const cancel = h("button", { class: "button quiet", type: "button" }, "Cancel");
  cancel.addEventListener("click", () => {
    cancel.disabled = true;
    api(`jobs/${job.id}/cancel`, { method: "POST" }).catch((error) => (cancel.textContent = error.message));
  });
  const where = job.run_id ? h("a", { href: `/runs/${job.run_id}` }, jobLabel(job)) : jobLabel(job);
  return h("li", { class: "job-row", "data-job": job.id }, h("div", { class: "row" }, where, h("span", { class: "spread dim clip" }, job.message || job.state), h("span", { class: "num" }, `${Math.round(job.progress * 100)}%`)), meter, cancel);
}

/** The pill in the top bar, hidden while there is nothing to do; a click opens the list. */
export function startJobsPill() {
  const pill = $("#jobs-pill");
  const panel = $("#jobs-panel");
  if (!pill) return;
  const active = new Map();
  const close = h("button", { class: "icon-button", type: "button", "aria-label": "Close", onclick: () => open(false) }, icon("close"));
  const open = (yes) => {
    panel.hidden = !yes;
    pill.setAttribute("aria-expanded", String(yes));
    paint();
  };
  const paint = () => {
    const jobs = [...active.values()];
    pill.hidden = jobs.length === 0;
    const mean = jobs.reduce((sum, j) => sum + j.progress, 0) / Math.max(1, jobs.length);
    pill.replaceChildren(
      `${jobs.length} ${jobs.length === 1 ? "job" : "jobs"}`,
      h("span", { class: "meter" }, h("i", { style: { width: `${Math.round(mean * 100)}%` } })),
      `${Math.round(mean * 100)}%`,
    );
    if (panel.hidden) return;
    const rows = jobs.length ? h("ul", { class: "job-rows" }, jobs.map(jobRow)) : h("p", { class: "dim" }, "Nothing is being worked on.");
    panel.replaceChildren(h("header", {}, h("h2", {}, "In progress"), close), rows, h("p", {}, h("a", { href: "/jobs" }, "All jobs")));
  };
  const take = (job) => {
    if (isActive(job)) active.set(job.id, job);
    else active.delete(job.id);
    paint();
  };
  pill.addEventListener("click", () => open(panel.hidden));
  watchJobs(take);
  api("jobs?state=active").then((page) => (page.items ?? page).forEach(take)).catch(() => {});
}
