// The figures below the map: positions by method with their spread, the links against their noise floors, events, the
// connection. Written at most five times a second: they are for reading.

import { h, icon } from "../lib/dom.js";
import { eventKind, eventSwatch, legible } from "../lib/events.js";
import { angle, duration, length, number, seconds, show } from "../lib/format.js";
import { METHOD_KEYS, methodStyle, swatch } from "../lib/methods.js";

const NONE = "–";

// ---- positions

export function mountPositions(table, { toggle }) {
  const rows = new Map();
  const heads = [["Method"], ["x", "live_position"], ["y", "live_position"], ["heading", "live_heading"], ["", "live_apart"]];
  table.tHead.replaceChildren(h("tr", {}, heads.map(([label, term], i) => h("th", { scope: "col", class: i ? "num" : undefined, "data-term": term, tabindex: term ? "0" : undefined }, label))));

  const apart = table.tHead.querySelector("th:last-child");

  function setMethods(methods, visible) {
    rows.clear();
    table.tBodies[0].replaceChildren(...methods.map(({ method, label, reason }) => {
      const key = METHOD_KEYS[method];
      const name = h("button", { class: "method-name", type: "button", "aria-pressed": String(visible(method)), "data-hint": `Show or hide${key ? ` (${key})` : ""}`, onclick: () => toggle(method) }, swatch(method), h("span", {}, methodStyle(method).label ?? label));
      const cells = Array.from({ length: 4 }, () => h("td", { class: "num" }, NONE));
      const row = h("tr", { "data-method": method }, h("th", { scope: "row" }, name), cells);
      rows.set(method, { row, name, cells, reason: null });
      tellReason(method, reason);
      return row;
    }));
  }

  function tellReason(method, reason) {
    const row = rows.get(method);
    if (!row || (row.reason ?? null) === (reason ?? null)) return;
    row.reason = reason;
    const told = h("td", { class: "dim why", colspan: "4", "data-hint": reason }, reason);
    row.row.replaceChildren(row.row.firstChild, ...(reason ? [told] : row.cells));
  }

  // referenceAt(t): pose of the method `against` at that moment, so that who is late is not wrong for it.
  function tell(poses, against, referenceAt) {
    apart.textContent = `from ${against}`;
    for (const [method, row] of rows) {
      const pose = poses.get(method);
      if (!pose || row.reason) continue;
      const spread = (value, sd, format) => (sd === null || sd === undefined || value === null ? null : h("span", { class: "sd" }, `± ${format(sd).text}`));
      const put = (i, value, sd, format) => row.cells[i].replaceChildren(...[show(format(value)), spread(value, sd, format)].filter(Boolean));
      put(0, pose.x, pose.sd_x, length);
      put(1, pose.y, pose.sd_y, length);
      put(2, pose.theta === null ? null : wrapped(pose.theta), pose.sd_theta, angle);
      const reference = method === against ? null : referenceAt(pose.t);
      const away = reference ? Math.hypot(pose.x - reference.x, pose.y - reference.y) : null;
      row.cells[3].replaceChildren(away === null ? NONE : show(length(away)));
    }
  }

  return { setMethods, tellReason, tell, show: (method, on) => rows.get(method)?.name.setAttribute("aria-pressed", String(on)) };
}

function wrapped(theta) {
  return theta - 2 * Math.PI * Math.round(theta / (2 * Math.PI));
}

// ---- links

const LEAST = 0.5; // bars are logarithmic: from half the floor to eight times it
const OCTAVES = 4;
const place = (excess) => Math.max(0, Math.min(1, Math.log2(excess / LEAST) / OCTAVES));
const LINK_TERMS = { "commands to wheels": "live_link_wheels", "wheels to gyro": "live_link_gyro", "wheels to accelerometer": "live_link_accelerometer", "body to beacon": "live_link_beacon", "body to ranges": "live_link_ranges" };

export function mountLinks(host) {
  const rows = new Map();
  const waiting = h("p", { class: "dim" }, "Told once the robot has driven for a few seconds.");
  host.replaceChildren(waiting);

  function rowOf(link) {
    if (rows.has(link)) return rows.get(link);
    const fill = h("i", { class: "link-fill" });
    const level = h("i", { class: "link-level" });
    const floor = h("i", { class: "link-floor", style: { left: `${100 * place(1)}%` } });
    const value = h("output", { class: "link-value" }, NONE);
    const said = h("span", { class: "link-said" });
    const bar = h("div", { class: "link-bar", role: "meter", "aria-label": link, "aria-valuemin": "0" }, fill, floor, level);
    waiting.remove();
    const root = h("div", { class: "link", "data-link": link }, h("span", { class: "link-name", "data-term": LINK_TERMS[link] ?? "live_link", tabindex: "0" }, link.replace(" to ", " → ")), said, value, bar);
    host.append(root);
    rows.set(link, { root, fill, level, bar, value, said });
    return rows.get(link);
  }

  return (links) => {
    for (const { link, excess, level, warn } of links) {
      const row = rowOf(link);
      const state = excess === null ? "none" : warn ? "out" : excess > level ? "high" : "in";
      row.root.dataset.state = state;
      row.fill.style.width = `${excess === null ? 0 : 100 * place(excess)}%`;
      row.level.style.left = `${100 * place(level)}%`;
      row.value.textContent = excess === null ? NONE : `${number(excess, excess < 10 ? 3 : 2)} ×`;
      row.said.replaceChildren(...(state === "out" ? [icon("warn"), "left the floor"] : [{ none: "no data", high: "above", in: "inside" }[state]]));
      row.bar.setAttribute("aria-valuenow", String(excess ?? 0));
      row.bar.setAttribute("aria-valuetext", `${row.value.textContent}, ${row.said.textContent}`);
    }
  };
}

// ---- events

const SHOWN = 40;

export function tellEvents(host, events) {
  if (!events.length) return host.replaceChildren(h("li", { class: "dim" }, "None so far."));
  const newest = [...events].sort((a, b) => b.t0 - a.t0).slice(0, SHOWN);
  return host.replaceChildren(...newest.map((e) => {
    const { label, about } = eventKind(e.kind);
    const lasted = e.t1 === null ? "going on" : `for ${seconds(e.t1 - e.t0).text}`;
    return h("li", { "data-kind": e.kind, tabindex: "0", "data-hint": `${about} ${legible(e.evidence) ?? ""}` }, eventSwatch(e.kind), h("span", {}, label), h("span", { class: "dim" }, `${number(e.t0, 4)} s, ${lasted}`));
  }));
}

// ---- the connection

const STREAMS = { imu: "IMU", wheels: "wheels", beacon: "beacon", ranges: "ranges", commands: "commands", truth: "truth" }; // most telling first

export function tellQuality(host, quality) {
  const told = (name) => `${STREAMS[name]} ${number(quality.rate_hz[name], quality.rate_hz[name] < 100 ? 2 : 3)}`;
  const rates = Object.keys(STREAMS).filter((name) => quality.rate_hz[name] > 0).map(told);
  const ms = (value) => (value === null || value === undefined ? NONE : `${number(value, value < 10 ? 2 : 3)} ms`);
  const offset = quality.clock_offset_s;
  const facts = [
    ["rate", "live_rate", rates.length ? `${rates.slice(0, 3).join(" · ")} Hz` : NONE, rates.length > 3 ? `${rates.join(", ")} Hz.` : undefined],
    ["latency", "live_latency", `${ms(quality.latency_ms)}${quality.latency_p99_ms === null ? "" : ` (99 %: ${number(quality.latency_p99_ms, 2)})`}`],
    ["loss", "live_loss", `${number(100 * quality.loss, 2)} %${quality.late_rows ? `, ${number(quality.late_rows, 3)} late rows` : ""}`],
    ["clock", "live_clock", offset === null ? NONE : `${offset < 0 ? "−" : "+"}${Math.abs(offset) < 1 ? `${number(1000 * Math.abs(offset), 2)} ms` : seconds(Math.abs(offset)).text}`],
  ];
  host.replaceChildren(...facts.flatMap(([name, term, text, all]) => [h("dt", { "data-term": term, "data-hint": all, tabindex: "0" }, name), h("dd", { "data-quality": name }, text)]));
}

/** One sentence of where the robot is and how sure that is. */
export function sentence({ robot, state, silent, t, speed, turn, pose, links, leading }) {
  if (state === "waiting") return `No robot called ${robot} is connected. This page begins by itself when it is.`;
  if (state === "ended") return `${robot} has ended its run after ${duration(t).text}.`;
  if (state === "silent") return `${robot} has been silent for ${duration(silent).text}. The run goes on where it stopped when it speaks again.`;
  const motion = Math.abs(speed) < 0.01 && Math.abs(turn) < 0.02 ? "stands" : `drives at ${number(speed, 2)} m/s${Math.abs(turn) < 0.02 ? "" : ` and turns at ${number(turn * (180 / Math.PI), 2)} °/s`}`;
  const known = pose && pose.sd_x !== null ? `its place by ${methodStyle(leading).label} is known to ± ${length(Math.hypot(pose.sd_x, pose.sd_y)).text}` : pose ? `${methodStyle(leading).label} says where, not how surely` : "no method has a position yet";
  const out = links.filter((l) => l.warn).map((l) => l.link);
  const told = links.filter((l) => l.excess !== null).length;
  const chain = out.length ? `${out.join(", ")}: outside the noise floor.` : told ? "Every link is inside its noise floor." : "";
  return `${robot} ${motion}; ${known}. ${chain}`.trim();
}
