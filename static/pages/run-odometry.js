// Odometry calibration: radii, track width, gyro scale, mounts and clocks by this run, and what it cannot show.

import { api, problemNote } from "../lib/api.js";
import { copyText } from "../lib/chart-export.js";
import { h } from "../lib/dom.js";
import { seconds, show, uncertain, when } from "../lib/format.js";
import { followJob, isActive } from "../lib/jobs.js";

const LABELS = {
  left_radius: "Left wheel's radius", right_radius: "Right wheel's radius", track_width: "Track width", gyro_scale: "Gyro scale",
  tag_x: "Tag, x", tag_y: "Tag, y", tag_yaw: "Turn of the reference's heading", imu_clock: "IMU clock", reference_delay: "Delay of the reference",
  imu_yaw: "IMU, yaw", imu_x: "IMU, x", imu_y: "IMU, y",
};
const REFERENCES = { auto: "the best reference there is", truth: "truth", beacon: "fixes", ranges: "ranges" };

export function odometryCard({ run, data }) {
  const streams = new Set(run.streams.map((s) => s.name));
  const have = ["truth", "beacon", "ranges"].filter((name) => streams.has(name));
  const note = h("div", { "aria-live": "polite" });
  const found = h("div", { id: "odometry-found" });
  const by = h("select", { "aria-label": "Calibrate by" }, ["auto", ...have].map((name) => h("option", { value: name }, REFERENCES[name])));
  const go = h("button", { type: "button", class: "button", id: "calibrate-odometry", disabled: !have.length || !streams.has("wheels"), "data-hint": "Everything at once by maximum likelihood; a few seconds per minute of run" }, "Calibrate odometry");
  const card = h("section", { class: "card wide", id: "odometry" }, h("h2", {}, "Odometry calibration"), found, note, h("div", { class: "row" }, go, h("label", {}, "by ", by), h("a", { class: "dim", href: "/guide/odometry" }, "how")));

  async function load() {
    try {
      const { calibration } = await api(`runs/${run.id}/odometry`);
      const nothing = have.length ? "Not calibrated yet: which radii, track width, gyro scale and mounts does this run show, and how well?" : "This run has no truth, fixes or ranges to calibrate by.";
      found.replaceChildren(...(calibration ? shown(calibration) : [h("p", { class: "dim" }, nothing)]));
    } catch (error) {
      note.replaceChildren(problemNote(error));
    }
    card.dataset.state = "ready";
  }

  async function follow(job) {
    go.disabled = true;
    note.replaceChildren(h("p", { class: "dim" }, "Calibrating …"));
    const ended = await followJob(job.id, () => {});
    go.disabled = false;
    if (ended.state === "done") note.replaceChildren();
    else note.replaceChildren(problemNote(ended.error ?? { detail: ended.message || "The calibration was cancelled." }));
    await load();
  }

  go.addEventListener("click", async () => {
    try {
      await follow(await api(`runs/${run.id}/odometry`, { json: { reference: by.value } }));
    } catch (error) {
      go.disabled = false;
      note.replaceChildren(problemNote(error));
    }
  });

  const active = data.jobs.find((job) => job.kind === "odometry" && isActive(job));
  if (active) follow(active);
  load();
  return card;
}

function shown(made) {
  const rows = Object.entries(made.parameters).map(([name, p]) =>
    h("tr", { "data-parameter": name }, h("th", { scope: "row" }, LABELS[name] ?? name), p ? [h("td", { class: "num" }, uncertain(p.value, p.sd)), h("td", {}, p.unit === "1" ? "" : p.unit), h("td", {})] : [h("td", { class: "num dim" }, "–"), h("td", {}), h("td", { class: "dim" }, made.reasons[name] ?? "not shown")]),
  );
  return [
    h("p", { class: "dim" }, `By ${made.reference}, ${when(made.created_at).text}, in `, show(seconds(made.runtime_s))),
    h("table", { class: "table" }, h("thead", {}, h("tr", {}, ["Parameter", "Value ± one sd", "Unit", "What this run cannot show"].map((text, i) => h("th", { class: i === 1 ? "num" : "" }, text)))), h("tbody", {}, rows)),
    made.notes.length ? h("ul", { class: "dim" }, made.notes.map((text) => h("li", {}, text))) : "",
    h("div", { class: "row" }, copy("Copy as JSON", made), copy("Copy robot section of run.json", { robot: made.robot })),
  ];
}

function copy(label, value) {
  const button = h("button", { type: "button", class: "button quiet" }, label);
  button.addEventListener("click", async () => (button.textContent = (await copyText(JSON.stringify(value, null, 2))) ? "Copied" : "Could not copy"));
  return button;
}
