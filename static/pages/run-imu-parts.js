// Small pieces that the sections of the IMU tab share.

import { copyText } from "../lib/chart-export.js";
import { problemNote } from "../lib/api.js";
import { h } from "../lib/dom.js";

/** What could not be computed: the reason as it was given, and what would mend it. */
export function refusal(title, error, mend) {
  return problemNote({ detail: `${title}: ${error.detail.replace(/\.$/, "")}.`, code: error.code, where: error.where }, mend && h("p", { class: "dim" }, mend));
}

/** Sentences that the analysis says of itself; nothing where there are none. */
export function notesList(notes) {
  return notes.length ? h("ul", { class: "imu-notes" }, notes.map((n) => h("li", {}, n))) : "";
}

/** A button that puts the `driftscope` line for the same result on the clipboard; the line, made when it is wanted, stands on its hover. */
export function copyCommand(line) {
  const button = h("button", { type: "button", class: "button quiet" }, "Copy as command");
  button.addEventListener("pointerenter", () => (button.dataset.hint = line()));
  button.addEventListener("focus", () => (button.dataset.hint = line()));
  button.addEventListener("click", async () => {
    button.textContent = (await copyText(line())) ? "Copied" : "Copy was refused";
    setTimeout(() => (button.textContent = "Copy as command"), 2500);
  });
  return button;
}

/** A section with its heading, a sentence on it, and what stands at its right. */
export function section(id, title, about, ...tools) {
  const body = h("div", { class: "imu-body" });
  const root = h("section", { class: "block imu-section", id: `imu-${id}-section`, "aria-label": title }, h("div", { class: "block-head" }, h("h2", {}, title), about && h("span", { class: "dim imu-about" }, about), h("span", { class: "spread" }), ...tools), body);
  return { root, body };
}
