// The monitor of one robot: the feed comes in, is put where it belongs, and is drawn once per animation frame.

import { api, problemNote } from "../lib/api.js";
import { $, h, pageData } from "../lib/dom.js";
import { duration } from "../lib/format.js";
import { keys } from "../lib/keys.js";
import { poseAt } from "../lib/map-view.js";
import { METHOD_KEYS, sortMethods } from "../lib/methods.js";
import { mountScene } from "../lib/scene.js";
import { createTimeCursor } from "../lib/timecursor.js";
import { mountDrive, remembered } from "./monitor-drive.js";
import { openFeed } from "./monitor-feed.js";
import { mountLinks, mountPositions, sentence, tellEvents, tellQuality } from "./monitor-figures.js";
import { mountMap, TRAILS } from "./monitor-map.js";
import { mountSignals } from "./monitor-signals.js";
import { createTrack } from "./monitor-tracks.js";

const FIGURES_EVERY = 200; // ms
const SENTENCE_EVERY = 1000; // ms
const PRECEDENCE = ["fused", "published", "encoders+gyro", "encoders", "beacon"];

const page = pageData();
const { robot } = page;
const address = new URLSearchParams(location.search);
const root = document.documentElement;
const clock = createTimeCursor({ t0: 0, t1: 1 });
const run = { id: null, state: "waiting", t: 0, links: [], events: new Map(), quality: null, rows: {}, methods: [], beacons: [], heard: 0 };
const hidden = new Set(address.get("hide")?.split(",").filter(Boolean));
const tracks = new Map();
let scene = null;
let frame = 0;
let figuresAt = 0;
let sentenceAt = 0;
let updates = 0;

const leadOf = () => PRECEDENCE.find((m) => tracks.get(m)?.rows.t.length && !hidden.has(m)) ?? null;
const view = mountMap($("#map"), { clock, subject: robot, lead: leadOf });
const positions = mountPositions($("#positions"), { toggle });
const tellLinks = mountLinks($("#links"));
const signals = mountSignals($("#signals"));
const feed = openFeed(robot, { message: heard, state: connection });
const drive = mountDrive($("#drive"), { send: feed.send, remember: remembered() });

// ---- what comes in

const HEARD = { snapshot, update, driver: (m) => drivers(m), refused, gone };

function heard(message) {
  HEARD[message.type]?.(message);
  root.dataset.updates = String(++updates);
  if (!frame) frame = requestAnimationFrame(paint);
}

function snapshot(m) {
  const again = m.run_id === run.id;
  Object.assign(run, { id: m.run_id, state: m.state, t: m.t, links: m.links, quality: m.quality, rows: m.rows, methods: m.methods, heard: performance.now() });
  run.events = new Map(m.events.map((e) => [`${e.kind} ${e.t0}`, e]));
  tracks.clear();
  for (const method of sortMethods(Object.keys(m.paths))) trackOf(method).extend(m.paths[method], null);
  reference(m.signals);
  run.beacons = beaconsOf(m.run);
  showMethods();
  view.setRun(tracks, run.beacons);
  view.setRanges(m.ranges);
  view.setEvents([...run.events.values()]);
  signals.restart(m);
  drivers(m.driver);
  if (m.state !== "waiting" && m.state !== "ended" && !(again && scene)) openScene();
  if (m.state === "waiting" || m.state === "ended") offer();
  else $("#ended").hidden = true;
  root.dataset.run = m.run_id ?? "";
  [figuresAt, sentenceAt] = [0, 0];
}

function update(m) {
  Object.assign(run, { state: m.state, t: m.t, quality: m.quality, rows: m.rows, heard: performance.now() });
  if (m.links.length) run.links = m.links;
  const gap = worst(run.links);
  let fresh = false;
  for (const [method, path] of Object.entries(m.trail)) {
    fresh ||= !tracks.has(method);
    trackOf(method).extend(path, gap);
  }
  fresh = reference(m.signals) || fresh;
  for (const [method, pose] of Object.entries(m.poses)) {
    fresh ||= !tracks.has(method);
    trackOf(method).now = pose;
  }
  if (m.methods) {
    run.methods = m.methods;
    fresh = true;
  }
  if (fresh) {
    showMethods();
    view.setRun(tracks, run.beacons);
  }
  view.setRanges(m.ranges);
  for (const event of m.events) run.events.set(`${event.kind} ${event.t0}`, event);
  if (m.events.length) view.setEvents([...run.events.values()]);
  signals.push(m);
}

function gone(m) {
  run.state = "ended";
  drive.setOff("This run has ended.");
  const id = m.stored_as ?? m.run_id;
  offer(m.stored_as ? h("span", {}, "The run has ended and is stored. ", h("a", { href: `/runs/${id}` }, "Open the stored run"), " ") : "The run has ended and is being stored. ");
  root.dataset.stored = m.stored_as ?? "";
  if (m.stored_as) $("#run-link").href = `/runs/${id}`;
  sentenceAt = 0;
}

// This server's own robot can be started from here; any other comes by itself.
function offer(...told) {
  const note = $("#ended");
  const button = h("button", { class: "button primary", id: "start", type: "button", onclick: start }, "Start the virtual robot");
  note.replaceChildren(...told, page.can_start ? button : h("span", { class: "dim" }, "When the robot starts a run, it appears here."));
  note.hidden = false;
}

async function start(event) {
  event.currentTarget.disabled = true;
  event.currentTarget.textContent = "Starting …";
  try {
    await api("live/virtual", { method: "POST" });
  } catch (error) {
    $("#ended").replaceChildren(problemNote(error));
  }
}

function drivers(m) {
  drive.setLimits(m.limits);
  drive.setOff(run.state === "waiting" ? "No robot is connected." : run.state === "ended" ? "This run has ended." : m.allowed ? null : (m.reason ?? "This robot takes no commands."));
  drive.setDriver(m);
}

let refusals = 0;
function refused(m) {
  const note = $("#refused");
  note.textContent = m.detail;
  note.hidden = false;
  clearTimeout(refusals);
  refusals = setTimeout(() => (note.hidden = true), 6000);
}

function connection(state, wait) {
  root.dataset.connection = state;
  if (state === "open") return;
  // called once while the page is still being put together
  queueMicrotask(() => {
    if (state === "lost") drive.setOff("The connection to the server is lost; the robot has stopped by itself.");
    $("#link-state").textContent = state === "lost" ? `connection lost, again in ${wait} s` : "connecting …";
    paintState();
  });
}

// Where the robot streams its own reference, as virtual ones do: a path like the methods'. Whether it is the first of it.
function reference({ "truth.x": x, "truth.y": y, "truth.theta": theta }) {
  if (!x || !y || !x.t.length) return false;
  const first = !tracks.has("truth");
  const at = (signal) => (signal?.t.length ? x.t.map((t) => between(signal, t)) : null);
  trackOf("truth").extend({ t: x.t, x: x.y, y: at(y), theta: at(theta) }, null);
  return first;
}

// Linear between readings: columns are thinned each by itself.
function between({ t, y }, time) {
  let i = 1;
  while (i < t.length - 1 && t[i] < time) i++;
  if (t.length < 2 || time <= t[0]) return y[0];
  const share = Math.min(1, (time - t[i - 1]) / (t[i] - t[i - 1]));
  return y[i - 1] + share * (y[i] - y[i - 1]);
}

function trackOf(method) {
  if (!tracks.has(method)) tracks.set(method, createTrack());
  return tracks.get(method);
}

function beaconsOf(meta) {
  const map = meta.beacons ?? {};
  return Object.entries(map).map(([name, place]) => (Array.isArray(place) ? { name, x: place[0], y: place[1], z: place[2] ?? 0 } : { name, ...place }));
}

const worst = (links) => links.reduce((most, l) => (l.excess === null ? most : Math.max(most ?? 0, l.excess)), null);

// Twice, so that no run ends by a slip of the hand.
async function end() {
  const button = $("#end");
  if (!button.classList.contains("danger")) {
    button.classList.add("danger");
    button.textContent = "Really end it?";
    setTimeout(() => (button.classList.remove("danger"), (button.textContent = "End run")), 4000);
    return;
  }
  try {
    await api(`live/${encodeURIComponent(robot)}/end`, { method: "POST" });
  } catch (error) {
    $("#ended").hidden = false;
    $("#ended").replaceChildren(problemNote(error));
  }
}

// ---- drawing

function paint(now) {
  frame = 0;
  const lead = leadOf();
  clock.full[1] = Math.max(run.t, 1);
  clock.range = [...clock.full];
  view.map.setLead(lead);
  clock.setTime(run.t);
  view.map.grown();
  signals.draw(run.t);
  const pose = lead && poseOf(lead);
  root.dataset.t = run.t.toFixed(3);
  root.dataset.poseT = pose ? pose.t.toFixed(3) : "";
  root.dataset.pose = pose ? [pose.x, pose.y, pose.theta].map((v) => (v ?? NaN).toFixed(3)).join(",") : "";
  if (now - figuresAt > FIGURES_EVERY) {
    figuresAt = now;
    figures(lead);
  }
  if (now - sentenceAt > SENTENCE_EVERY) {
    sentenceAt = now;
    $("#verdict").textContent = tellSentence(lead);
  }
}

const poseOf = (method) => {
  const track = tracks.get(method);
  return track ? (track.now ?? lastOf(track.rows)) : null;
};

function lastOf(rows) {
  const i = rows.t.length - 1;
  return i < 0 ? null : Object.fromEntries(Object.entries(rows).map(([name, column]) => [name, column[i]]));
}

function figures(lead) {
  const poses = new Map([...tracks.keys()].map((m) => [m, poseOf(m)]));
  const against = tracks.has("truth") ? "truth" : "fused";
  positions.tell(poses, against, (t) => (tracks.has(against) ? poseAt({ hold: true, ...tracks.get(against).rows }, t) : null));
  tellLinks(run.links);
  tellEvents($("#event-list"), [...run.events.values()]);
  if (run.quality) tellQuality($("#quality"), run.quality);
  signals.tell();
  paintState();
}

function paintState() {
  const lost = root.dataset.connection !== "open";
  const state = lost ? root.dataset.connection : run.state;
  $("#state").dataset.state = state;
  $("#state-word").textContent = { live: "live", silent: "silent", ended: "ended", waiting: "waiting", lost: "offline", connecting: "connecting", open: "" }[state] ?? state;
  if (!lost) $("#link-state").textContent = run.state === "waiting" ? "" : duration(run.t).text;
  $("#run-link").hidden = !run.id;
  $("#end").hidden = run.state !== "live" && run.state !== "silent";
  if (run.id && run.state !== "ended") $("#run-link").href = `/runs/${run.id}`;
}

function tellSentence(lead) {
  const speed = signals.latest("commands.v") ?? 0;
  const rows = lead && tracks.get(lead)?.rows;
  const moving = rows?.speed.at(-1) ?? 0;
  return sentence({ robot, state: run.state, silent: run.quality?.silent_s ?? 0, t: run.t, speed: speed < 0 ? -moving : moving, turn: turnOf(rows), pose: lead && poseOf(lead), links: run.links, leading: lead });
}

function turnOf(rows) {
  if (!rows || rows.t.length < 5) return 0;
  const [a, b] = [rows.t.length - 5, rows.t.length - 1];
  const turn = rows.theta[b] - rows.theta[a];
  return (turn - 2 * Math.PI * Math.round(turn / (2 * Math.PI))) / Math.max(rows.t[b] - rows.t[a], 1e-3);
}

// ---- methods, views, trail: what the address holds

function showMethods() {
  const known = new Map(run.methods.map((m) => [m.method, m]));
  for (const method of tracks.keys()) if (!known.has(method)) known.set(method, { method, label: method, reason: null });
  positions.setMethods(sortMethods([...known.keys()]).map((m) => known.get(m)), (m) => !hidden.has(m));
  for (const method of hidden) view.map.setVisible(method, false);
  root.dataset.methods = [...tracks.keys()].join(" ");
}

function toggle(method) {
  if (!tracks.has(method)) return;
  if (!hidden.delete(method)) hidden.add(method);
  const on = !hidden.has(method);
  view.map.setVisible(method, on);
  positions.show(method, on);
  scene?.setMethods(shownMethods());
  remember("hide", [...hidden].join(","));
}

const shownMethods = () => (hidden.size ? [...tracks.keys()].filter((m) => !hidden.has(m)) : null);

function remember(name, value) {
  if (value) address.set(name, value);
  else address.delete(name);
  const text = address.toString().replaceAll("%2C", ",").replaceAll("%2B", "+");
  history.replaceState(null, "", text ? `?${text}` : location.pathname);
}

function openScene() {
  scene?.dispose();
  scene = mountScene($("#scene"), run.id, clock, { methods: shownMethods(), live: true, trail: address.get("trail") ?? "method" });
}

function setView(name) {
  $("#views").dataset.view = name;
  remember("view", name === "both" ? "" : name);
  for (const button of document.querySelectorAll("#view button")) button.setAttribute("aria-pressed", String(button.dataset.view === name));
}

function setTrail(name) {
  view.setTrail(name);
  scene?.setTrail(name);
  remember("trail", name === "method" ? "" : name);
  for (const button of document.querySelectorAll("#trail button")) button.setAttribute("aria-pressed", String(button.dataset.trail === name));
}

function follow(on = !clock.follow) {
  clock.setFollow(on);
  remember("follow", on ? "1" : "");
  $("#follow").setAttribute("aria-pressed", String(on));
}

const nextTrail = () => setTrail(Object.keys(TRAILS)[(Object.keys(TRAILS).indexOf(address.get("trail") ?? "method") + 1) % 3]);
const alone = (name) => setView($("#views").dataset.view === name ? "both" : name);

$("#trail").append(...Object.entries(TRAILS).map(([name, { label, about }]) => h("button", { type: "button", "data-trail": name, "data-hint": `${about} Key: t`, onclick: () => setTrail(name) }, label)));
for (const button of document.querySelectorAll("#view button")) button.addEventListener("click", () => setView(button.dataset.view));
$("#follow").addEventListener("click", () => follow());
$("#end").addEventListener("click", end);
keys("Monitor", {
  f: ["map and 3D follow the robot", () => follow()],
  m: ["map alone", () => alone("map")],
  v: ["3D alone", () => alone("scene")],
  t: ["trail by method, speed, gap", nextTrail],
  ...Object.fromEntries(Object.entries(METHOD_KEYS).filter(([m]) => PRECEDENCE.includes(m)).map(([method, key]) => [key, [key === "1" ? "methods on and off" : null, () => toggle(method), "1 … 5"]])),
});
setView(["map", "scene"].includes(address.get("view")) ? address.get("view") : "both");
setTrail(address.get("trail") in TRAILS ? address.get("trail") : "method");
if (address.get("follow")) follow(true);
root.dataset.ready = "monitor";
