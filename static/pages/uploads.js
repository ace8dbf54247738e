// Files being added: one panel per file, from drop to stored run; mistakes stand where they are.

import { $, h, icon } from "../lib/dom.js";
import { api, problemNote } from "../lib/api.js";
import { incoming } from "../lib/drop.js";
import { bytes, duration } from "../lib/format.js";
import { followJob } from "../lib/jobs.js";
import { abandon, columns, finish, upload } from "../lib/upload.js";
import { mappingStep } from "./mapping.js";
import { sparkline, streamChips } from "./runs-table.js";

const TABLE = /\.(csv|parquet)$/i;
let context;
let queue = Promise.resolve();

class Panel {
  constructor(item) {
    this.item = item;
    this.stop = new AbortController();
    this.state = h("span", { class: "state clip", role: "status" }, "waiting");
    this.fill = h("i");
    this.meter = h("span", { class: "meter" }, this.fill);
    this.more = h("div", { class: "more" });
    this.close = h("button", { class: "icon-button", type: "button", "aria-label": `Stop adding ${item.name}`, onclick: () => this.dismiss() }, icon("close"));
    this.element = h("article", { class: "upload", "data-file": item.name, "data-state": "waiting" }, h("div", { class: "upload-head" }, h("span", { class: "file clip" }, item.name), this.state, this.close), this.meter, this.more);
    $("#uploads").append(this.element);
    $("#uploads").hidden = false;
  }

  say(state, text, fraction) {
    this.element.dataset.state = state;
    this.state.textContent = text;
    if (fraction !== undefined) this.fill.style.width = `${Math.round(fraction * 100)}%`;
    this.meter.hidden = state === "stored" || state === "failed" || state === "mapping";
  }

  dismiss() {
    this.stop.abort();
    if (this.upload && (!this.job || this.mendable)) abandon(this.file, this.upload.id);
    if (this.job && this.element.dataset.state === "reading") api(`jobs/${this.job.id}/cancel`, { method: "POST" }).catch(() => {});
    this.element.remove();
    $("#uploads").hidden = $("#uploads").children.length === 0;
  }

  fail(error) {
    if (error.name === "AbortError" || this.stop.signal.aborted) return;
    this.say("failed", error.code === "too_large" ? "too large" : "refused; nothing of it was stored");
    this.mendable = error.code === "stamp_order";
    this.more.replaceChildren(problemNote(error, this.mendable ? this.mend() : ""));
  }

  /** Stamps that go back: the file as it is stays refused, but its other rows can be had. */
  mend() {
    const yes = h("button", { type: "button", class: "button", "data-mend": "in_order" }, "Leave those rows out and add the rest");
    yes.addEventListener("click", () => {
      this.more.replaceChildren();
      this.read({ ...this.how, in_order: true }).catch((error) => this.fail(error));
    });
    return h("p", { class: "row" }, yes, h("span", { class: "dim" }, "How many they were will stand among the run's warnings."));
  }

  async run() {
    try {
      this.file = await this.item.file();
      await this.send();
      const mapping = TABLE.test(this.file.name) ? await this.map() : undefined;
      await this.read(mapping ? { mapping } : {});
    } catch (error) {
      this.fail(error);
    }
  }

  async send() {
    if (this.file.size > context.limit) throw { code: "too_large", detail: `${this.file.name} has ${bytes(this.file.size).text}; this server takes up to ${bytes(context.limit).text}.` };
    const size = bytes(this.file.size).text;
    this.upload = await upload(this.file, {}, {
      signal: this.stop.signal,
      onProgress: (received, total) => this.say("sending", `sending, ${bytes(received).text} of ${size}`, received / Math.max(1, total)),
      onWait: (ms) => this.say("sending", `the connection is lost; trying again in ${Math.ceil(ms / 1000)} s`),
    });
  }

  /** What the columns of a single table are: asked only where its names do not say it. */
  async map() {
    const table = await columns(this.upload.id);
    if (!table.needs_mapping) return undefined;
    this.say("mapping", "which column is what?");
    const answer = mappingStep(this.more, table, context.mapping, this.stop.signal);
    setTimeout(() => this.element.scrollIntoView({ block: "end" }), 100); // its button is what goes on
    const mapping = await answer;
    this.more.replaceChildren();
    return mapping;
  }

  async read(how) {
    this.how = how;
    this.say("reading", "reading", 0);
    this.job = await finish(this.file, this.upload.id, how);
    const job = await followJob(this.job.id, (now) => this.say("reading", now.message || "reading", now.progress));
    if (job.state === "cancelled") return this.dismiss();
    if (job.state === "failed") return this.fail(job.error ?? { detail: job.message });
    const run = await api(`runs/${job.result.run_id}`);
    this.stored(run);
    return context.onStored();
  }

  stored(run) {
    this.say("stored", `stored: ${duration(run.duration_s).text}, ${bytes(run.size_bytes).text}`);
    const open = h("a", { class: "button primary", href: `/runs/${run.id}` }, "Open");
    const warnings = run.warnings?.length ? h("div", { class: "note amber" }, run.warnings.map((w) => h("p", {}, w))) : null;
    this.more.replaceChildren(h("div", { class: "found" }, sparkline(run.sparkline), h("b", {}, run.name), run.robot && h("span", {}, run.robot), streamChips(run.streams), h("span", { class: "spread" }), open), warnings ?? "");
  }
}

function add(items) {
  for (const panel of items.map((item) => new Panel(item))) queue = queue.then(() => !panel.stop.signal.aborted && panel.run());
}

function startDrop() {
  let depth = 0;
  const isFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  const show = (yes) => ($("#drop").hidden = !yes);
  document.addEventListener("dragenter", (event) => isFiles(event) && (event.preventDefault(), (depth += 1), show(true)));
  document.addEventListener("dragleave", (event) => isFiles(event) && ((depth = Math.max(0, depth - 1)), show(depth > 0)));
  document.addEventListener("dragover", (event) => isFiles(event) && event.preventDefault());
  document.addEventListener("drop", (event) => {
    if (!isFiles(event)) return;
    event.preventDefault();
    depth = 0;
    show(false);
    incoming(event.dataTransfer).then(add);
  });
}

/** {limit: bytes, mapping: {streams, units}, onStored()} */
export function startUploads(given) {
  context = given;
  startDrop();
  const input = $("#files");
  $("#add").addEventListener("click", () => input.click());
  input.addEventListener("change", () => incoming({ files: input.files }).then(add).finally(() => (input.value = "")));
}
