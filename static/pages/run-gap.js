// The Gap tab of a run: what the latest diagnosis said, the earlier ones, and a new one.

import { api, problemNote } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { number, when } from "../lib/format.js";
import { isActive } from "../lib/jobs.js";
import { diagnose, faultsNote, follow } from "./diagnose-job.js";
import { said, streamName } from "./gap-words.js";

const VERDICTS = { none: ["no gap", "green"], explained: ["explained", ""], partly_explained: ["partly explained", "amber"], unknown: ["unknown cause", "red"] };

export function mountGap(host, { run, data }) {
  const note = h("div", { "aria-live": "polite", id: "gap-job" });
  const found = h("div", { class: "gap-latest", id: "gap-found" });
  const go = h("button", { type: "button", class: "button primary", id: "diagnose-run", "data-hint": "Against the nominal simulator; stretches of the run judge" }, "Diagnose this run");
  const more = h("a", { class: "button", href: `/diagnoses?runs=${run.id}`, "data-hint": "With other runs, some held out, and what matters (d)" }, "With other runs …");
  const asking = h("div", { class: "row" }, go, more);
  const faults = data.faults.length ? [[run.name, data.faults]] : [];
  const root = h("section", { class: "card gap-tab" }, faults.length ? faultsNote(faults) : "", found);
  found.replaceChildren(asking, note);
  let gone = false;
  host.append(root);

  go.addEventListener("click", async () => {
    go.disabled = true;
    await diagnose(note, { runs: [run.id], held_out: [], options: {} }, faults);
    go.disabled = false;
    if (!gone) load();
  });

  async function load() {
    try {
      const { items } = await api(`diagnoses?run=${run.id}&limit=20`);
      if (!gone) found.replaceChildren(...shown(items, asking, note));
    } catch (error) {
      found.replaceChildren(problemNote(error), asking, note);
    }
    root.dataset.state = "ready";
  }

  function shown([latest, ...rest], ...ask) {
    if (!latest) return [h("p", {}, "Not diagnosed yet: where does this run differ from its simulator, which effect causes it, and how far does the gap shrink?"), ...ask];
    const streams = Object.entries(latest.gap.by_stream).sort((a, b) => b[1].before / b[1].floor - a[1].before / a[1].floor);
    const rows = [["all streams", latest.gap], ...streams].map(([name, g]) => h("tr", {}, h("th", { scope: "row" }, streamName(name)), h("td", { class: "num" }, number(g.before)), h("td", { class: "num" }, number(g.after)), h("td", { class: "num dim" }, number(g.floor))));
    return [
      h("p", { class: "said" }, said(latest.sentence)),
      h("div", { class: "row" }, chip(latest), h("a", { class: "button", id: "open-diagnosis", href: `/diagnoses/${latest.id}` }, "Open the report"), h("span", { class: "dim" }, when(latest.created_at).text), h("span", { class: "spread" }), ask[0]),
      ask[1],
      h("table", { class: "table g-lines" }, h("thead", {}, h("tr", {}, h("th", { "data-term": "gap_far" }, "Gap, × noise"), h("th", { class: "num" }, "before"), h("th", { class: "num" }, "after"), h("th", { class: "num", "data-term": "gap_floor" }, "floor"))), h("tbody", {}, rows)),
      rest.length ? h("details", {}, h("summary", { class: "dim" }, `${rest.length} earlier`), h("ul", { class: "imu-notes" }, rest.map((d) => h("li", {}, h("a", { href: `/diagnoses/${d.id}` }, d.name), " ", chip(d), h("span", { class: "dim" }, ` ${d.headline}, ${when(d.created_at).text}`))))) : "",
    ];
  }

  const active = data.jobs.find((job) => job.kind === "diagnose" && isActive(job));
  if (active) follow(note, active).then(() => gone || load());
  load();
  return {
    setEvents() {},
    destroy() {
      gone = true;
      root.remove();
    },
  };
}

const chip = (d) => h("span", { class: `chip ${VERDICTS[d.verdict][1]}` }, VERDICTS[d.verdict][0]);
