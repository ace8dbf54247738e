// The stored calibrations; a new one from runs that were made for it, or from a file.

import { api, problemNote } from "../lib/api.js";
import { $, h, pageData } from "../lib/dom.js";
import { hertz, show, when } from "../lib/format.js";
import { followJob, isActive } from "../lib/jobs.js";

const KINDS = { rest: "at rest", six_position: "six positions", rate_table: "rate table" };
const data = pageData();
const asked = new URLSearchParams(location.search).get("runs")?.split(",") ?? []; // a run's page sends its own

function row(c) {
  const from = c.source === "upload" ? h("span", { class: "dim" }, "uploaded") : c.runs.map((r, i) => [i ? ", " : "", h("a", { href: `/runs/${r.id}?tab=imu` }, r.name)]);
  const robot = c.robot ? h("a", { href: `/runs?q=robot:${encodeURIComponent(`"${c.robot}"`)}` }, c.robot) : h("span", { class: "dim" }, "–");
  return h("tr", { "data-calibration": c.id }, h("td", {}, h("a", { href: `/calibrations/${c.id}`, "data-hint": c.sentence }, c.name)), h("td", {}, robot), h("td", {}, from), h("td", {}, h("span", { class: "knows" }, c.knows.map((k) => h("span", { class: "chip" }, k)))), h("td", { class: "num" }, show(when(c.created_at))));
}

function paintList() {
  $("#calibrations").tBodies[0].replaceChildren(...data.calibrations.map(row));
  $("#calibrations").hidden = !data.calibrations.length;
  $("#none").hidden = data.calibrations.length > 0;
}

// Runs by robot: a calibration is of one IMU.
function choices() {
  const robots = [...new Set(data.runs.map((r) => data.robots[r.id]))];
  return robots.flatMap((robot) => [
    h("li", { class: "robot" }, robot ?? "no robot named"),
    ...data.runs
      .filter((r) => data.robots[r.id] === robot)
      .map((r) => h("li", {}, h("label", {}, h("input", { type: "checkbox", value: r.id, checked: asked.includes(r.id) }), h("span", {}, r.name), h("span", { class: "chip" }, KINDS[r.kind] ?? r.kind), h("span", { class: "dim" }, hertz(r.rate_hz).text)))),
  ]);
}

function paintNew() {
  const host = $("#new");
  if (!data.runs.length) {
    host.replaceChildren(
      h("h2", {}, "New, from runs"),
      h("p", {}, "No stored run says that it was made for calibration. Record one of these, from switching on, and say so in its run.json, under ", h("code", {}, "procedure"), ":"),
      h("ul", { class: "imu-notes" }, h("li", {}, "at rest for an hour or more (bias, drift, noise);"), h("li", {}, "six positions, each axis up and down (the accelerometer's scale and misalignment);"), h("li", {}, "a rate table, each axis both ways (the gyro's).")),
      h("p", {}, h("a", { href: "/guide/run-format" }, "The run format"), " has an example."),
    );
    return;
  }
  const name = h("input", { maxlength: "200", placeholder: "robot and date" });
  const robot = h("input", { maxlength: "200", placeholder: "the runs' own" });
  const go = h("button", { type: "submit", class: "button primary", disabled: true }, "Calibrate");
  const list = h("ul", { class: "run-choice" }, choices());
  const note = h("div", { "aria-live": "polite" });
  const chosen = () => [...list.querySelectorAll("input:checked")].map((i) => i.value);
  const count = () => {
    const n = chosen().length;
    go.disabled = n === 0;
    go.textContent = n ? `Calibrate from ${n} ${n === 1 ? "run" : "runs"}` : "Calibrate";
  };
  list.addEventListener("change", count);
  const form = h("form", { id: "calibrate" }, list, h("div", { class: "form-row" }, h("label", { class: "field" }, "Name", name), h("label", { class: "field" }, "Robot", robot), go), note);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    go.disabled = true;
    try {
      const job = await api("calibrations", { json: { runs: chosen(), name: name.value.trim() || null, robot: robot.value.trim() || null } });
      const ended = await followJob(job.id, (j) => isActive(j) && note.replaceChildren(progress(j)));
      if (ended.state === "done") location.assign(`/calibrations/${ended.result.calibration_id}`);
      else note.replaceChildren(problemNote(ended.error ?? { detail: ended.message }));
    } catch (error) {
      note.replaceChildren(problemNote(error));
    }
    count();
  });
  host.replaceChildren(h("h2", {}, "New, from runs"), h("p", { class: "dim" }, "Runs of one IMU, each from switching on: the more kinds, the more it knows."), form);
  count();
}

function progress(job) {
  const share = Math.round(job.progress * 100);
  const cancel = h("button", { type: "button", class: "button quiet", onclick: () => api(`jobs/${job.id}/cancel`, { method: "POST" }) }, "Cancel");
  return h("div", { class: "row form-row" }, h("span", { class: "meter spread" }, h("i", { style: { width: `${share}%` } })), h("span", { class: "num" }, `${share} %`), h("span", { class: "dim" }, job.message), cancel);
}

function paintUpload() {
  const file = h("input", { type: "file", accept: ".json,application/json", "aria-label": "calibration/1 JSON" });
  const name = h("input", { maxlength: "200", required: true });
  const robot = h("input", { maxlength: "200" });
  const note = h("div", { "aria-live": "polite" });
  file.addEventListener("change", () => (name.value ||= file.files[0]?.name.replace(/\.json$/i, "") ?? ""));
  const form = h("form", { id: "upload-form" }, h("div", { class: "form-row" }, file), h("div", { class: "form-row" }, h("label", { class: "field" }, "Name", name), h("label", { class: "field" }, "Robot", robot), h("button", { type: "submit", class: "button" }, "Upload")), note);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    try {
      if (!file.files[0]) throw { detail: "Choose a file first: what `driftscope calibrate --json` writes.", code: "parameter" };
      const made = await api(`calibrations/upload?${new URLSearchParams({ name: name.value.trim() || "calibration", ...(robot.value.trim() ? { robot: robot.value.trim() } : {}) })}`, { json: parsed(await file.files[0].text()) });
      location.assign(`/calibrations/${made.id}`);
    } catch (error) {
      note.replaceChildren(problemNote(error));
    }
  });
  $("#upload").replaceChildren(h("h2", {}, "Upload"), h("p", { class: "dim" }, "A file in schema calibration/1; what it leaves null stays unknown."), form);
}

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch (error) {
    throw { detail: `This is no JSON: ${error.message}`, code: "format" };
  }
}

paintList();
paintNew();
paintUpload();
document.documentElement.dataset.ready = "calibrations";
