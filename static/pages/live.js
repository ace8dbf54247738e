// The list of live robots, asked for once a second while the page is in sight.

import { api, problemNote } from "../lib/api.js";
import { $, h, pageData } from "../lib/dom.js";
import { duration, number, seconds, show, when } from "../lib/format.js";
import { keys } from "../lib/keys.js";

const EVERY = 1000; // ms
const HEADS = [["Robot"], ["State", "live_state"], ["Driver", "live_driver"], ["Since"], ["Length", "length", "num"], ["Rate", "live_rate", "num"], ["Latency", "live_latency", "num"], ["Loss", "live_loss", "num"], ["Viewers", null, "num"], ["Run"]];
const MAIN = ["imu", "wheels", "beacon", "ranges"];

let robots = pageData().robots;
let began = false; // a virtual robot was asked for: its monitor opens when it is there

function rateOf({ rate_hz: rates }) {
  const main = MAIN.find((name) => rates[name] > 0);
  const all = Object.entries(rates).map(([name, hz]) => `${name} ${number(hz, 3)} Hz`).join(", ");
  return main ? h("span", { "data-hint": all }, `${main} ${number(rates[main], 3)}`, h("span", { class: "unit" }, "Hz")) : "–";
}

function row(robot) {
  const { quality } = robot;
  const link = `/live/${encodeURIComponent(robot.robot)}`;
  const state = h("span", { class: "live-state", "data-state": robot.state }, h("i"), robot.state === "silent" ? `silent for ${duration(quality.silent_s).text}` : robot.state);
  const since = when(robot.started_at);
  const cells = [
    h("a", { href: link }, h("b", {}, robot.robot), robot.virtual && h("span", { class: "chip" }, "virtual")),
    state,
    robot.driver ?? h("span", { class: "dim" }, "nobody"),
    h("span", { "data-hint": since.si }, since.text),
    duration(robot.duration_s).text,
    rateOf(quality),
    quality.latency_ms === null ? "–" : show(seconds(quality.latency_ms / 1000)),
    `${number(100 * quality.loss, 2)} %`,
    String(robot.viewers),
    h("a", { href: `/runs/${robot.run_id}` }, robot.name),
  ];
  return h("tr", { "data-robot": robot.robot, "data-state": robot.state }, cells.map((cell, i) => h("td", { class: HEADS[i][2] }, cell)));
}

function paint() {
  $("#list").hidden = robots.length === 0;
  $("#table").tBodies[0].replaceChildren(...robots.map(row));
  if ($("#start")) $("#start").hidden = robots.some((r) => r.robot === "virtual" && r.state === "live");
  document.documentElement.dataset.robots = String(robots.length);
}

function tell() {
  const silent = robots.filter((r) => r.state !== "live").length;
  const [one] = robots;
  if (!one) return "No robot is connected.";
  if (robots.length === 1) return `${one.robot} is ${one.state}; ${one.driver ? `driven by ${one.driver}` : "nobody drives it"}.`;
  return `${robots.length} robots are connected${silent ? `, ${silent} of them silent` : ", all of them live"}.`;
}

async function ask() {
  if (!document.hidden) {
    try {
      const answer = await api("live");
      robots = answer.items;
      $("#problem").replaceChildren();
      $("#verdict").textContent = tell();
      if (!$("#table").matches(":hover")) paint(); // nothing moves under a pointer that is about to click
      const mine = began && robots.find((r) => r.virtual && r.state === "live");
      if (mine) location.href = `/live/${encodeURIComponent(mine.robot)}`;
    } catch (error) {
      $("#problem").replaceChildren(problemNote(error));
    }
  }
  setTimeout(ask, EVERY);
}

async function start(button) {
  button.disabled = true;
  button.textContent = "Starting …";
  try {
    await api("live/virtual", { method: "POST" });
    began = true;
  } catch (error) {
    button.disabled = false;
    button.textContent = "Start a virtual robot";
    $("#problem").replaceChildren(problemNote(error));
  }
}

$("#table").tHead.replaceChildren(h("tr", {}, HEADS.map(([label, term, kind]) => h("th", { scope: "col", class: kind, "data-term": term, tabindex: term ? "0" : undefined }, label))));
$("#start")?.addEventListener("click", (event) => start(event.currentTarget));
keys("Live", { Enter: ["open the first robot", () => (robots[0] ? (location.href = `/live/${encodeURIComponent(robots[0].robot)}`) : false)] });
paint();
ask();
document.documentElement.dataset.ready = "live";
