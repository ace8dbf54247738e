// The head of the run: facts, streams, rename, tags, delete with undo, neighbours.

import { api, problemNote } from "../lib/api.js";
import { closeOutside } from "../lib/chart-frame.js";
import { $, h } from "../lib/dom.js";
import { count, duration, hertz, when } from "../lib/format.js";
import { keys } from "../lib/keys.js";

const STREAMS = ["commands", "wheels", "imu", "beacon", "ranges", "truth"];

export function mountHeader({ run, data, state }) {
  const length = duration(run.duration_s);
  $("#run-length").textContent = length.text;
  $("#run-length").dataset.hint = length.si;
  $("#run-when").textContent = when(run.created_at).text;
  $("#run-when").dataset.hint = `Stored ${when(run.created_at).si}`;
  $("#run-streams").replaceChildren(...STREAMS.map((name) => h("li", {}, streamChip(run, name, state))));
  closeOutside($("#download"));
  tags(run);
  rename(run);
  $("#delete").addEventListener("click", () => remove(run));
  const go = (id) => () => (id ? location.assign(`/runs/${id}${location.search.replace(/[?&](t0|t1|t|map|m|big)=[^&]*/g, "").replace(/^&/, "?")}`) : false);
  keys("Run", {
    j: ["next, previous run", go(data.neighbours.older), "j k"],
    k: [null, go(data.neighbours.newer)],
  });
}

function streamChip(run, name, state) {
  const stream = run.streams.find((s) => s.name === name);
  if (!stream) return h("span", { class: "chip absent", "data-hint": `This run has no ${name}.` }, name);
  const gaps = stream.gaps.length;
  const hint = `${stream.label}: ${count(stream.rows)} rows at ${hertz(stream.rate_hz).text}; ${stream.columns.map((c) => c.name).join(", ")}${gaps ? `; ${gaps} pauses of over ten typical steps` : ""}. Click: its signals.`;
  const chip = h("button", { type: "button", class: gaps ? "chip amber" : "chip", "data-hint": hint }, name, h("span", { class: "dim" }, hertz(stream.rate_hz).text));
  chip.addEventListener("click", () => {
    state.set("tab", "signals");
    requestAnimationFrame(() => $(`[data-stream="${name}"]`)?.scrollIntoView({ block: "start" }));
  });
  return chip;
}

const say = (error) => $("#undo").replaceChildren(problemNote(error));

function tags(run) {
  const host = $("#run-tags");

  async function write(list) {
    try {
      run.tags = (await api(`runs/${run.id}`, { method: "PATCH", json: { tags: list } })).tags;
      paint();
    } catch (error) {
      say(error);
    }
  }

  function paint() {
    const input = h("input", { class: "tag-add", placeholder: "+ tag", "aria-label": "Add a tag", maxlength: "60" });
    input.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" || !input.value.trim()) return;
      write([...run.tags, input.value.trim()]).then(() => $(".tag-add").focus());
    });
    host.replaceChildren(
      ...run.tags.map((tag) => {
        const off = h("button", { type: "button", class: "tag-remove", "aria-label": `Remove tag ${tag}` }, "×");
        off.addEventListener("click", () => write(run.tags.filter((t) => t !== tag)));
        return h("span", { class: "chip tag" }, h("a", { href: `/runs?q=tag:${encodeURIComponent(`"${tag}"`)}` }, tag), off);
      }),
      input,
    );
  }
  paint();
}

function rename(run) {
  const title = $("#run-name");
  const button = $("#rename");

  button.addEventListener("click", () => {
    const input = h("input", { class: "rename-input", "aria-label": "Name of the run", maxlength: "200" });
    input.value = run.name;
    title.replaceWith(input);
    button.hidden = true;
    input.select();
    let over = false;
    const end = () => {
      if (over) return;
      over = true;
      title.textContent = title.title = run.name;
      document.title = `${run.name} · Driftscope`;
      input.replaceWith(title);
      button.hidden = false;
      button.focus();
    };
    const write = async () => {
      const name = input.value.trim();
      if (!name || name === run.name) return end();
      try {
        run.name = (await api(`runs/${run.id}`, { method: "PATCH", json: { name } })).name;
      } catch (error) {
        say(error);
      }
      return end();
    };
    input.addEventListener("keydown", (event) => {
      if (event.key === "Enter") write();
      if (event.key === "Escape") end();
    });
    input.addEventListener("blur", write);
  });
}

async function remove(run) {
  const button = $("#delete");
  button.disabled = true;
  try {
    await api(`runs/${run.id}`, { method: "DELETE" });
  } catch (error) {
    button.disabled = false;
    return say(error);
  }
  const undo = h("button", { type: "button", class: "button primary" }, "Undo");
  undo.addEventListener("click", async () => {
    try {
      await api(`runs/${run.id}/restore`, { method: "POST" });
      button.disabled = false;
      $("#undo").replaceChildren();
    } catch (error) {
      say(error);
    }
  });
  $("#undo").replaceChildren(h("div", { class: "bar" }, h("span", { class: "spread" }, `“${run.name}” is deleted; for a day it can be brought back.`), undo, h("a", { class: "button", href: "/runs" }, "To the runs")));
  undo.focus();
  return undefined;
}
