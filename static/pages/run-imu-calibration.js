// A stored calibration against this run: error at the start and at the asymptote, noise, and how well the online values
// agree with those of hindsight (Fig. 13, 14). One click makes the corrected run.

import { api, problemNote } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { followJob, isActive } from "../lib/jobs.js";
import { sensorOf } from "../lib/triads.js";
import { copyCommand, notesList } from "./run-imu-parts.js";

const STATES = ["raw", "online", "offline"];

export async function mountCalibration(host, context) {
  const { run, state, imu } = context;
  const all = (await api("calibrations")).items;
  const own = all.filter((c) => c.robot && c.robot === run.robot);
  const rest = all.filter((c) => !own.includes(c));
  const made = imu.procedure && imu.procedure !== "drive" ? h("a", { class: "button", href: `/calibrations?runs=${run.id}` }, "Calibrate from this run") : "";
  const corrected = run.source.corrected;
  const origin = corrected ? h("p", { class: "dim imu-facts" }, "This run is already corrected, by ", h("a", { href: `/calibrations/${corrected.calibration}` }, corrected.calibration_name), ", out of ", h("a", { href: `/runs/${corrected.from_run}?tab=imu` }, "its original"), ".") : "";
  if (!all.length) {
    host.replaceChildren(h("p", { class: "dim" }, "No calibration is stored yet. ", h("a", { href: "/calibrations" }, "Make one from runs, or upload one."), " "), made);
    return { destroy() {} };
  }
  const likely = state.calibration ?? (corrected ? null : own[0]?.id); // the robot's newest: one click applies it
  const option = (c) => h("option", { value: c.id, selected: c.id === likely }, c.robot && c.robot !== run.robot ? `${c.name} (${c.robot})` : c.name);
  const group = (label, list) => (list.length ? h("optgroup", { label }, list.map(option)) : "");
  const select = h("select", { id: "imu-calibration", "aria-label": "Calibration" }, h("option", { value: "" }, "choose …"), group(`of ${run.robot ?? "this robot"}`, own), group("others", rest));
  const apply = h("button", { type: "button", class: "button", disabled: !likely, "data-hint": "Stores this run again with its IMU corrected by Algorithm 1; this one stays." }, "Make the corrected run");
  const note = h("div", { "aria-live": "polite" });
  const body = h("div", {});
  const command = copyCommand(() => `driftscope correct ${run.id} --calibration calibration.json --out corrected`);
  host.replaceChildren(origin, h("div", { class: "judgement-bar" }, h("label", { class: "row" }, "Calibration", select), apply, command, h("span", { class: "spread" }), made, h("a", { class: "button quiet", href: "/calibrations" }, "All calibrations")), note, body);
  let gone = false;

  async function show() {
    const id = select.value;
    state.set("calibration", id || null);
    apply.disabled = !id;
    body.replaceChildren();
    note.replaceChildren();
    if (!id) return;
    const path = `runs/${run.id}/imu/calibrations/${id}`;
    try {
      let got = await api(path).catch((error) => (error.status === 404 ? null : Promise.reject(error)));
      if (!got) {
        await work(await api(path, { method: "POST" }), "Judging");
        got = await api(path);
      }
      if (!gone && select.value === id) body.replaceChildren(...report(got, all.find((c) => c.id === id)));
    } catch (error) {
      if (!gone) note.replaceChildren(problemNote(error));
    }
  }

  async function work(job, doing) {
    const ended = await followJob(job.id, (j) => isActive(j) && note.replaceChildren(h("div", { class: "job-note" }, h("b", {}, doing), h("span", { class: "meter" }, h("i", { style: { width: `${Math.round(j.progress * 100)}%` } })), h("span", { class: "num" }, `${Math.round(j.progress * 100)} %`), h("span", { class: "dim spread" }, j.message))));
    note.replaceChildren();
    if (ended.state !== "done") throw ended.error ?? { detail: ended.message, code: ended.state };
    return ended;
  }

  apply.addEventListener("click", async () => {
    apply.disabled = true;
    try {
      const ended = await work(await api(`runs/${run.id}/corrections`, { json: { calibration: select.value } }), "Correcting");
      note.replaceChildren(h("div", { class: "job-note" }, "Stored as a run of its own. ", h("a", { href: `/runs/${ended.result.run_id}?tab=imu`, id: "corrected-run" }, "Open the corrected run")));
    } catch (error) {
      note.replaceChildren(problemNote(error));
    }
    apply.disabled = false;
  });
  select.addEventListener("change", show);
  if (state.calibration) show();
  else if (likely) body.replaceChildren(h("p", {}, h("button", { type: "button", class: "button quiet", id: "judge-calibration", onclick: show }, "How good it is on this run")));
  return {
    destroy() {
      gone = true;
    },
  };
}

function report({ figures, notes, error }, calibration) {
  const about = h("p", { class: "imu-facts" }, h("a", { href: `/calibrations/${calibration.id}` }, calibration.name), ": ", calibration.sentence);
  if (error) return [about, problemNote({ ...error, detail: `It cannot be judged on this run: ${error.detail}` }, h("p", { class: "dim" }, "It can still be applied: the corrected run needs no rest.")), notesList(notes)];
  const rows = figures.axes.map((axis, j) => ({ axis, j })).filter(({ j }) => STATES.some((s) => figures[s].sd[j] !== null));
  const heads = (text, term) => h("th", { class: "num", colspan: 3, "data-term": term }, text);
  const values = (axis, j, what) => {
    const { fineFactor } = sensorOf(axis);
    return STATES.map((s) => h("td", { class: s === "online" ? "num better" : "num" }, number(figures[s][what][j] === null ? NaN : figures[s][what][j] * fineFactor, 3)));
  };
  const body = rows.map(({ axis, j }) =>
    h("tr", { "data-axis": axis }, h("th", { scope: "row" }, axis, h("span", { class: "unit" }, sensorOf(axis).fine)), values(axis, j, "start"), values(axis, j, "asymptote"), values(axis, j, "sd"), h("td", { class: "num" }, number(figures.noise_factor[j], 3)), h("td", { class: "num" }, figures.correlation[j] === null ? "–" : figures.correlation[j].toFixed(4))),
  );
  const sub = STATES.map((s) => h("th", { class: "num" }, s));
  return [
    about,
    h(
      "div",
      { class: "metrics-scroll" },
      h(
        "table",
        { class: "table metrics judged", id: "judged" },
        h("thead", {}, h("tr", {}, h("th", {}, ""), heads("Error at the start", "cal_start"), heads("Error at the asymptote", "cal_asymptote"), heads("Noise, sd", "cal_sd"), h("th", { class: "num", "data-term": "cal_factor" }, "less by"), h("th", { class: "num", "data-term": "cal_correlation" }, "online to offline")), h("tr", {}, h("th", {}, ""), sub, sub.map((t) => t.cloneNode(true)), sub.map((t) => t.cloneNode(true)), h("th", {}), h("th", {}))),
        h("tbody", {}, body),
      ),
    ),
    h("p", { class: "dim imu-facts" }, `On the rest from ${number(figures.t0, 5)} to ${number(figures.t1, 5)} s, against what the run declares; online values come ${figures.delay} readings later.`),
    notesList(notes),
  ];
}
