// The list of events: sortable, a click moves the time; confirm or dismiss each, again takes it back; CSV and JSON.

import { API, api, problemNote, query } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { dressedEvent, eventSwatch } from "../lib/events.js";
import { seconds, show } from "../lib/format.js";
import { methodStyle, sortMethods } from "../lib/methods.js";
import { methodSwatch } from "./run-methods.js";

const COLUMNS = [
  ["kind", "Event", (e) => e.label],
  ["t0", "Begins", (e) => e.t0],
  ["lasts", "Lasts", (e) => e.t1 - e.t0],
  ["evidence", "Evidence", (e) => e.evidence],
  ["replaced", "Used instead", (e) => e.replaced],
  ["decision", "Decision", (e) => e.decision ?? ""],
];
const DECIDE = { confirmed: ["Confirm", "It did happen"], dismissed: ["Dismiss", "It did not happen: drawn faint, not counted"] };

/** The events shown, by the chosen method: the page's own choice where the address has none. */
export function eventMethod({ data, state }) {
  const having = data.estimates.filter((e) => e.events.length).map((e) => e.method);
  return having.includes(state.events) ? state.events : data.event_method;
}

export function eventsOf({ data, state }) {
  const method = eventMethod({ data, state });
  return (data.estimates.find((e) => e.method === method)?.events ?? []).map(dressedEvent);
}

export function mountEvents(host, context) {
  const { data, run, state, clock, estimates } = context;
  const having = sortMethods(estimates().filter((e) => e.events.length).map((e) => e.method));
  const looked = estimates().some((e) => ["fused", "encoders+gyro", "published"].includes(e.method));
  if (!having.length) {
    const none = h("p", { class: "dim block", id: "events" }, looked ? "No events: nothing on this run contradicts another sensor for longer than noise explains." : "");
    host.append(none);
    return { update() {}, destroy: () => none.remove() };
  }
  const body = h("tbody", {});
  const said = h("span", { role: "status" });
  let order = ["t0", 1];
  const heads = COLUMNS.map(([key, label]) => {
    const button = h("button", { type: "button" }, label);
    const th = h("th", { scope: "col", class: key === "t0" || key === "lasts" ? "num" : "", "data-sort": key }, button);
    button.addEventListener("click", () => {
      order = [key, order[0] === key ? -order[1] : 1];
      paint();
    });
    return th;
  });
  const chips = having.map((m) => h("button", { type: "button", class: "method", "data-method": m, onclick: () => state.set("events", m) }, methodSwatch(m), `${methodStyle(m).label} ${count(m)}`));
  const links = h("span", { class: "events-tools" });
  const box = h(
    "section",
    { class: "block", id: "events", "aria-label": "Events" },
    h("div", { class: "block-head" }, h("h2", { "data-term": "events" }, "Events"), said, h("span", { class: "events-tools choice", role: "group", "aria-label": "Found by" }, having.length > 1 ? chips : ""), links),
    h("div", { class: "events-scroll" }, h("table", { class: "table events" }, h("thead", {}, h("tr", {}, heads)), body)),
  );
  host.append(box);

  function count(method) {
    return estimates().find((e) => e.method === method).events.length;
  }

  function paint() {
    const method = eventMethod(context);
    const value = COLUMNS.find(([key]) => key === order[0])[2];
    const rows = eventsOf(context).sort((a, b) => order[1] * compare(value(a), value(b)) || a.t0 - b.t0);
    heads.forEach((th) => (th.dataset.sort === order[0] ? th.setAttribute("aria-sort", order[1] > 0 ? "ascending" : "descending") : th.removeAttribute("aria-sort")));
    chips.forEach((chip) => chip.setAttribute("aria-pressed", String(chip.dataset.method === method)));
    const file = `${API}/runs/${run.id}/events?${query({ method })}`;
    links.replaceChildren(h("a", { class: "button quiet", href: `${file}&format=csv`, download: "", "data-hint": "Events with their decisions, seconds" }, "CSV"), h("a", { class: "button quiet", href: file, download: `${context.fileName}-events.json`, "data-hint": "The same as JSON" }, "JSON"));
    body.replaceChildren(...rows.map((e) => row(e, method)));
    mark();
  }

  function row(event, method) {
    const jump = h("button", { type: "button", "data-hint": event.about }, eventSwatch(event.kind, event.faint), ` ${event.label}`);
    const cells = [
      h("th", { scope: "row" }, jump),
      h("td", { class: "num" }, `${event.t0.toFixed(2)} s`),
      h("td", { class: "num" }, show(seconds(event.t1 - event.t0))),
      h("td", { class: "why" }, event.evidence),
      h("td", { class: "why dim" }, event.replaced),
      h("td", { class: "decide" }, Object.entries(DECIDE).map(([decision, [label, hint]]) => decideButton(event, method, decision, label, hint))),
    ];
    const tr = h("tr", { class: event.decision ?? "", "data-event": event.id }, cells);
    tr.addEventListener("click", (e) => e.target.closest(".decide") || goTo(event));
    return tr;
  }

  function goTo(event) {
    if (event.t0 < clock.range[0] || event.t0 > clock.range[1]) clock.resetRange();
    clock.setTime(event.t0);
  }

  function decideButton(event, method, decision, label, hint) {
    const on = event.decision === decision;
    const button = h("button", { type: "button", class: "button quiet", "aria-pressed": String(on), "data-decision": decision, "data-hint": on ? "Click again to take it back" : hint }, label);
    button.addEventListener("click", async () => {
      const path = `runs/${run.id}/events/${encodeURIComponent(method)}/${encodeURIComponent(event.id)}`;
      try {
        const now = await api(path, on ? { method: "DELETE" } : { method: "PUT", json: { decision } });
        data.estimates.find((e) => e.method === method).events.find((e) => e.id === event.id).decision = now.decision;
        said.replaceChildren();
        context.decided();
        box.querySelector(`[data-event="${CSS.escape(event.id)}"] [data-decision="${decision}"]`)?.focus();
      } catch (error) {
        said.replaceChildren(problemNote(error));
      }
    });
    return button;
  }

  // The row of what happens at the cursor.
  function mark() {
    const now = new Set(eventsOf(context).filter((e) => clock.time >= e.t0 && clock.time <= e.t1).map((e) => e.id));
    for (const tr of body.children) tr.classList.toggle("now", now.has(tr.dataset.event));
  }

  const off = clock.subscribe((what) => what === "time" && mark());
  paint();
  return {
    update: paint,
    destroy() {
      off();
      box.remove();
    },
  };
}

const compare = (a, b) => (typeof a === "number" ? a - b : String(a).localeCompare(String(b)));
