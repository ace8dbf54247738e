// A diagnosis at work: its progress in words and a bar, cancel, and why it failed. Used wherever one can be asked for.

import { api, problemNote } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { followJob, isActive } from "../lib/jobs.js";

/** Ask for a diagnosis; what goes wrong is told in `host`, with what is wrong with the runs themselves, [[name, [fault]]].
 *  {runs, held_out, options} -> the diagnosis's id, or null. */
export async function diagnose(host, wanted, faults = []) {
  try {
    return await follow(host, await api("diagnoses", { json: wanted }), faults);
  } catch (error) {
    host.replaceChildren(problemNote(error, mend(error, faults)));
    return null;
  }
}

/** Show a job until it ends: the id of what it found, or null. */
export async function follow(host, job, faults = []) {
  let last = job;
  paint(host, job);
  const ticks = setInterval(() => paint(host, last), 1000); // the seconds go on where a step takes long
  const ended = await followJob(job.id, (now) => isActive(now) && paint(host, (last = now))).finally(() => clearInterval(ticks));
  if (ended.state === "done") {
    host.replaceChildren();
    return ended.result.diagnosis_id;
  }
  if (ended.state === "cancelled") host.replaceChildren(h("div", { class: "at-work", "data-state": "cancelled" }, "The diagnosis was cancelled; nothing was stored."));
  else host.replaceChildren(problemNote(ended.error ?? { detail: ended.message }, mend(ended.error, faults)));
  return null;
}

function paint(host, job) {
  const bar = host.querySelector(`.at-work[data-job="${job.id}"]`);
  const share = Math.round(job.progress * 100);
  const seconds = job.started_at ? Math.max(0, Math.round((Date.now() - new Date(job.started_at)) / 1000)) : null;
  const said = [job.message, seconds === null ? "" : `${seconds} s`].filter(Boolean).join(" · ");
  if (bar && bar.dataset.state === job.state) {
    bar.querySelector(".meter > i").style.width = `${share}%`;
    bar.querySelector(".num").textContent = `${share} %`;
    bar.querySelector(".doing").textContent = said;
    return;
  }
  const cancel = h("button", { type: "button", class: "button quiet" }, "Cancel");
  cancel.addEventListener("click", () => {
    cancel.disabled = true;
    api(`jobs/${job.id}/cancel`, { method: "POST" }).catch((error) => host.append(problemNote(error)));
  });
  host.replaceChildren(h("div", { class: "at-work", "data-job": job.id, "data-state": job.state }, h("b", {}, job.state === "queued" ? "Waiting to diagnose" : "Diagnosing"), h("span", { class: "meter" }, h("i", { style: { width: `${share}%` } })), h("span", { class: "num" }, `${share} %`), h("span", { class: "dim doing" }, said), cancel));
}

/** What would do instead, where the error does not say. */
function mend(error, faults) {
  if (faults.length) return faultsNote(faults);
  if (error?.code !== "not_enough_data") return "";
  return h("p", { class: "dim" }, "Not enough data is an answer too. A minute with turns both ways, stops and two speeds usually suffices; several runs can be given together.");
}

/** What the estimators found wrong with the runs: the likeliest reason of a strange answer or none. [[name, [fault]]] */
export function faultsNote(faults) {
  const one = ([name, told]) => h("p", { "data-faults": name }, h("b", {}, name), `: ${told.join(" ")}`);
  return h("div", { class: "note amber" }, faults.map(one), h("p", {}, "So the estimators read it for the paths. A diagnosis takes the readings as they were recorded: if it is so, put it right in run.json or where the run was written, import the run again, and diagnose that."));
}
