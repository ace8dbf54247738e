// The analysis at work: its progress, why it failed, and how to ask for it again with other segments.

import { api, problemNote } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { isActive, watchJobs } from "../lib/jobs.js";

export function imuJob({ run, imu, lengthOf }, done) {
  const note = h("div", { "aria-live": "polite", id: "imu-job" });
  const length = h("input", { type: "number", min: "0.1", max: "3600", step: "0.1", value: String(lengthOf()), "aria-label": "Length of a segment in seconds" });
  const n = h("input", { type: "number", min: "1", max: "10000", value: String(imu.methods.find((m) => m.method === "C")?.provenance.config.n ?? 10), "aria-label": "Segments that method C averages" });
  const go = h("button", { type: "submit", class: "button" }, imu.analysed ? "Analyse again" : "Analyse");
  const form = h("form", { class: "imu-again" }, h("label", { "data-term": "imu_segment" }, "segments of ", length, " s"), h("label", { "data-term": "imu_by_average" }, "C averages ", n), go);
  const root = h("div", {}, note, h("details", { class: "imu-again-box", open: !imu.analysed }, h("summary", { class: "dim" }, imu.analysed ? "Other segments" : "Analyse this IMU"), form));

  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    go.disabled = true;
    try {
      paint(await api(`runs/${run.id}/imu`, { json: { length: Number(length.value), n: Number(n.value) } }));
    } catch (error) {
      note.replaceChildren(problemNote(error));
    }
    go.disabled = false;
  });

  function paint(job) {
    if (job.state === "failed") note.replaceChildren(problemNote(job.error ?? { detail: job.message }));
    else if (job.state === "cancelled") note.replaceChildren(h("div", { class: "job-note" }, "The analysis was cancelled; what stood before stands."));
    if (!isActive(job)) return;
    const share = Math.round(job.progress * 100);
    const cancel = h("button", { type: "button", class: "button quiet" }, "Cancel");
    cancel.addEventListener("click", () => {
      cancel.disabled = true;
      api(`jobs/${job.id}/cancel`, { method: "POST" }).catch((error) => note.append(problemNote(error)));
    });
    note.replaceChildren(h("div", { class: "job-note", "data-job": job.id, "data-state": job.state }, h("b", {}, job.state === "queued" ? "Waiting to analyse" : "Analysing the IMU"), h("span", { class: "meter" }, h("i", { style: { width: `${share}%` } })), h("span", { class: "num" }, `${share} %`), h("span", { class: "dim spread" }, job.message), cancel));
  }

  const off = watchJobs((job) => {
    if (job.run_id !== run.id || job.kind !== "imu") return;
    paint(job);
    if (job.state === "done") done();
  });
  if (imu.job && imu.job.state !== "done") paint(imu.job);
  return { root, destroy: off };
}
