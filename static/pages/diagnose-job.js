// A diagnosis at work: its progress in words and a bar, cancel, and why it failed. Used wherever one can be asked for.

import { api, problemNote } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { followJob, isActive } from "../lib/jobs.js";

/** Ask for a diagnosis; what goes wrong is told in `host`. {runs, held_out, options} -> the diagnosis's id, or null. */
export async function diagnose(host, wanted) {
  try {
    return await follow(host, await api("diagnoses", { json: wanted }));
  } catch (error) {
    host.replaceChildren(problemNote(error, mend(error)));
    return null;
  }
}

/** Show a job until it ends: the id of what it found, or null. */
export async function follow(host, job) {
  paint(host, job);
  const ended = await followJob(job.id, (now) => isActive(now) && paint(host, now));
  if (ended.state === "done") {
    host.replaceChildren();
    return ended.result.diagnosis_id;
  }
  if (ended.state === "cancelled") host.replaceChildren(h("div", { class: "at-work", "data-state": "cancelled" }, "The diagnosis was cancelled; nothing was stored."));
  else host.replaceChildren(problemNote(ended.error ?? { detail: ended.message }, mend(ended.error)));
  return null;
}

function paint(host, job) {
  const share = Math.round(job.progress * 100);
  const cancel = h("button", { type: "button", class: "button quiet" }, "Cancel");
  cancel.addEventListener("click", () => {
    cancel.disabled = true;
    api(`jobs/${job.id}/cancel`, { method: "POST" }).catch((error) => host.append(problemNote(error)));
  });
  host.replaceChildren(h("div", { class: "at-work", "data-job": job.id, "data-state": job.state }, h("b", {}, job.state === "queued" ? "Waiting to diagnose" : "Diagnosing"), h("span", { class: "meter" }, h("i", { style: { width: `${share}%` } })), h("span", { class: "num" }, `${share} %`), h("span", { class: "dim" }, job.message), cancel));
}

/** What would do instead, where the error does not say. */
function mend(error) {
  if (error?.code !== "not_enough_data") return "";
  return h("p", { class: "dim" }, "Not enough data is an answer too. A minute with turns both ways, stops and two speeds usually suffices; several runs can be given together.");
}
