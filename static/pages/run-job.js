// Work under way on this run: progress by server-sent events; when it is done the page is told, when it fails it says why.

import { api, problemNote } from "../lib/api.js";
import { $, h } from "../lib/dom.js";
import { followJob, isActive } from "../lib/jobs.js";

export function mountJobs({ run, data, refresh }) {
  const host = $("#run-job");
  const button = $("#re-estimate");

  async function follow(id) {
    button.disabled = true;
    try {
      const job = await followJob(id, paint);
      if (job.state === "done") host.replaceChildren(...partFailed(job));
      await refresh();
    } catch (error) {
      host.replaceChildren(problemNote(error));
    }
    button.disabled = false;
  }

  function paint(job) {
    if (job.state === "done") return;
    if (job.state === "failed" || job.state === "cancelled") {
      host.replaceChildren(job.state === "failed" ? failure(job) : h("div", { class: "job-note" }, "The estimate was cancelled.", again(job)));
      return;
    }
    const share = Math.round(job.progress * 100);
    const cancel = h("button", { type: "button", class: "button quiet" }, "Cancel");
    cancel.addEventListener("click", () => {
      cancel.disabled = true;
      api(`jobs/${job.id}/cancel`, { method: "POST" }).catch((error) => host.append(problemNote(error)));
    });
    host.replaceChildren(h("div", { class: "job-note", "data-job": job.id, "data-state": job.state }, h("b", {}, job.state === "queued" ? "Waiting to estimate" : "Estimating"), h("span", { class: "meter" }, h("i", { style: { width: `${share}%` } })), h("span", { class: "num" }, `${share} %`), h("span", { class: "dim spread" }, job.message), cancel));
  }

  const failure = (job) => problemNote(job.error ?? { detail: job.message || "The estimate failed." }, h("p", {}, again(job)));

  // A job is done though one of its methods was not.
  function partFailed(job) {
    const failed = job.result?.failed ?? [];
    return failed.map((f) => problemNote({ detail: `${f.method}: ${f.detail}`, code: f.code }));
  }

  function again(job) {
    const retry = h("button", { type: "button", class: "button" }, "Try again");
    retry.addEventListener("click", async () => {
      try {
        await api(`jobs/${job.id}/retry`, { method: "POST" });
        follow(job.id);
      } catch (error) {
        host.append(problemNote(error));
      }
    });
    return retry;
  }

  button.addEventListener("click", async () => {
    try {
      const job = await api(`runs/${run.id}/estimates`, { json: { methods: null, config: {} } });
      follow(job.id);
    } catch (error) {
      host.replaceChildren(problemNote(error));
    }
  });

  const newest = data.jobs.find((j) => j.kind === "estimate");
  if (newest && isActive(newest)) follow(newest.id);
  else if (newest?.state === "failed") paint(newest);
  else if (newest?.state === "done") host.replaceChildren(...partFailed(newest));
}
