// The control part: a stick, keys, limits, STOP; who drives; why driving is off where it is off.
//
// What a hand wants is said 20 times a second as long as it wants something, and thrice when it lets go: the server and
// the robot stop by themselves when nothing is said for a moment (dead-man). A robot that was stopped like that does not
// set off again by itself, whatever is still held: the hand must let go and press anew.

import { h } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { keys } from "../lib/keys.js";

const EVERY = 50; // ms
const GOODBYES = 3;
const RAMP = 4; // full stick per second, for keys: a wheel that is jerked slips
const DEG = 180 / Math.PI;
const KEYS = { ArrowUp: [1, 0], w: [1, 0], ArrowDown: [-1, 0], s: [-1, 0], ArrowLeft: [0, 1], a: [0, 1], ArrowRight: [0, -1], d: [0, -1] };

export function mountDrive(host, { send, remember }) {
  const held = new Set();
  const stick = { v: 0, w: 0, pointer: null };
  const wanted = { v: 0, w: 0 }; // shares of the limits, -1 to 1
  let driver = { who: null, you: false };
  let off = "Connecting …"; // why driving is off, null where it is on
  let limits = { v: 0.5, w: 1.5 };
  let goodbyes = 0;
  let timer = 0;
  let last = 0;
  let asked = 0; // when the seat was last asked for
  let broken = false; // the robot was stopped under a hand that held something

  const parts = build();
  host.append(...parts.all);

  const api = {
    get wanted() {
      return { v: wanted.v * chosen("v"), w: wanted.w * chosen("w") };
    },
    setOff(reason) {
      off = reason;
      if (reason) letGo();
      paint();
    },
    setDriver(told) {
      if (driver.you && !told.you) told.who ? release() : letGo();
      driver = { ...told };
      paint();
    },
    setLimits(told) {
      limits = { ...limits, ...told };
      for (const axis of ["v", "w"]) scaleSlider(axis);
      paint();
    },
    stop,
  };

  // ---- elements

  function build() {
    const knob = h("div", { class: "stick-knob" });
    const pad = h("div", { class: "stick", id: "stick", role: "application", tabindex: "0", "aria-label": "Stick: up is forward, left turns left. Arrow keys or WASD do the same.", "data-term": "live_stick" }, h("span", { class: "stick-cross" }), knob);
    const who = h("p", { class: "drive-who", id: "driver", role: "status" });
    const seat = h("button", { class: "button", id: "seat", type: "button", onclick: askOrLeave }, "Drive");
    const reason = h("p", { class: "note drive-off", id: "drive-off", hidden: true });
    const said = h("output", { class: "drive-said", id: "commanded", "data-term": "live_command", tabindex: "0" });
    const halt = h("button", { class: "button stop", id: "stop", type: "button", onclick: stop }, "STOP", h("kbd", {}, "space"));
    const limit = (axis, label) => {
      const slider = h("input", { type: "range", id: `limit-${axis}`, min: "0", max: "100", step: "1", value: "50", "aria-label": `Limit of ${label}` });
      const value = h("output", { class: "num" });
      slider.addEventListener("input", () => (remember(axis, chosen(axis)), paint()));
      return { slider, value, row: h("label", { class: "drive-limit", "data-term": `live_limit_${axis}` }, h("span", {}, label), value, slider) };
    };
    const v = limit("v", "limit");
    const w = limit("w", "turn limit");
    const all = [h("div", { class: "drive-head" }, who, seat), reason, h("div", { class: "drive-hand" }, pad, h("div", { class: "drive-side" }, said, v.row, w.row)), halt];
    return { all, pad, knob, who, seat, reason, said, halt, v, w };
  }

  // Sliders are shares of what the robot allows.
  const chosen = (axis) => (limits[axis] * Number(parts[axis].slider.value)) / 100;

  function scaleSlider(axis) {
    const kept = remember(axis);
    if (kept && limits[axis]) parts[axis].slider.value = String(Math.round((100 * Math.min(kept, limits[axis])) / limits[axis]));
  }

  function paint() {
    const can = off === null;
    host.dataset.driver = driver.you ? "you" : driver.who ? "other" : "nobody";
    host.dataset.off = String(!can);
    parts.reason.hidden = can && !broken;
    parts.reason.textContent = off ?? (broken ? "The robot was stopped while you drove. Let go and press again to drive on." : "");
    parts.who.textContent = driver.you ? "You drive" : driver.who ? `${driver.who} drives` : can ? "Nobody drives" : "Control";
    parts.seat.hidden = !can;
    parts.seat.textContent = driver.you ? "Let go" : driver.who ? "Take over" : "Drive";
    parts.pad.setAttribute("aria-disabled", String(!can));
    for (const axis of ["v", "w"]) parts[axis].slider.disabled = !can;
    parts.v.value.textContent = `${number(chosen("v"), 2)} m/s`;
    parts.w.value.textContent = `${number(chosen("w") * DEG, 2)} °/s`;
    paintStick();
  }

  function paintStick() {
    const reach = parts.pad.clientWidth / 2 - parts.knob.offsetWidth / 2 - 2;
    parts.knob.style.transform = `translate(${-wanted.w * reach}px, ${-wanted.v * reach}px)`;
    const { v, w } = driver.you ? api.wanted : { v: 0, w: 0 };
    parts.said.replaceChildren(h("b", {}, `${v.toFixed(2).replace("-", "−")} m/s`), h("b", {}, `${(w * DEG).toFixed(0).replace("-", "−")} °/s`));
  }

  // ---- the hand

  function target() {
    if (stick.pointer !== null) return stick;
    const sum = { v: 0, w: 0 };
    for (const key of held) {
      sum.v += KEYS[key][0];
      sum.w += KEYS[key][1];
    }
    return { v: Math.sign(sum.v), w: Math.sign(sum.w) };
  }

  const busy = () => stick.pointer !== null || held.size > 0;

  function go() {
    if (off !== null) return;
    if (broken) {
      broken = false;
      paint();
    }
    if (!driver.you) takeSeat();
    if (timer) return;
    last = performance.now();
    timer = setInterval(tick, EVERY);
    tick();
  }

  function takeSeat() {
    if (driver.who || performance.now() - asked < 500) return; // another's seat is asked for with the button only
    asked = performance.now();
    send({ type: "drive_request" });
  }

  function tick() {
    const now = performance.now();
    const step = stick.pointer === null ? (RAMP * (now - last)) / 1000 : 2;
    const aim = target();
    last = now;
    for (const axis of ["v", "w"]) {
      const back = Math.abs(aim[axis]) < Math.abs(wanted[axis]) || aim[axis] * wanted[axis] < 0;
      wanted[axis] = back ? aim[axis] : wanted[axis] + Math.max(-step, Math.min(step, aim[axis] - wanted[axis]));
    }
    paintStick();
    if (busy()) goodbyes = GOODBYES;
    if (driver.you) send({ type: "drive", ...api.wanted });
    else if (busy()) takeSeat();
    if (!busy() && --goodbyes <= 0) rest();
  }

  function rest() {
    clearInterval(timer);
    timer = 0;
  }

  function release() {
    held.clear();
    stick.pointer = null;
    Object.assign(stick, { v: 0, w: 0 });
    Object.assign(wanted, { v: 0, w: 0 });
    paintStick();
  }

  function letGo() {
    broken ||= busy();
    release();
  }

  function stop() {
    release();
    broken = false;
    paint();
    send({ type: "stop" });
    rest();
    parts.halt.classList.add("pressed");
    setTimeout(() => parts.halt.classList.remove("pressed"), 250);
  }

  function askOrLeave() {
    broken = false;
    if (driver.you) {
      release();
      send({ type: "drive_release" });
      return;
    }
    send({ type: "drive_request", take_over: Boolean(driver.who) });
  }

  // ---- pointer and keys

  function point(event) {
    const box = parts.pad.getBoundingClientRect();
    let [x, y] = [(2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height];
    const length = Math.hypot(x, y);
    if (length > 1) [x, y] = [x / length, y / length];
    const dead = (a) => (Math.abs(a) < 0.08 ? 0 : a);
    Object.assign(stick, { v: dead(y), w: dead(-x) });
  }

  parts.pad.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || off !== null) return;
    event.preventDefault();
    parts.pad.focus();
    parts.pad.setPointerCapture(event.pointerId);
    stick.pointer = event.pointerId;
    point(event);
    go();
  });
  parts.pad.addEventListener("pointermove", (event) => event.pointerId === stick.pointer && point(event));
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    parts.pad.addEventListener(name, (event) => {
      if (event.pointerId !== stick.pointer) return;
      Object.assign(stick, { v: 0, w: 0, pointer: null });
      tick();
    });
  }

  const press = (event) => {
    if (event.target.matches?.("input[type=range], summary, .map-top")) return false; // arrows are theirs
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (!event.repeat && off === null) held.add(key);
    if (held.has(key)) go();
    return true;
  };
  const both = (first, second, label) => ({ [first]: [label, press, `${first} ${second}`], [second]: [null, press], [second.toUpperCase()]: [null, press] });
  keys("Drive", {
    " ": ["STOP, whoever drives", stop],
    ...both("ArrowUp", "w", "forward"),
    ...both("ArrowDown", "s", "back"),
    ...both("ArrowLeft", "a", "turn left"),
    ...both("ArrowRight", "d", "turn right"),
  });
  document.addEventListener("keyup", (event) => {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (held.delete(key) && timer) tick();
  });
  // The space bar stops, also where it would press a button or turn a page.
  document.addEventListener("keydown", (event) => {
    if (event.key !== " " || event.target.closest?.("input:not([type=range]), textarea, select")) return;
    event.preventDefault();
    event.stopPropagation();
    if (!event.repeat) stop();
  }, { capture: true });
  const away = () => {
    if (!busy()) return;
    release();
    tick();
  };
  addEventListener("blur", () => setTimeout(() => document.hasFocus() || away(), 0)); // not for a click into the 3D view
  addEventListener("pagehide", away);
  document.addEventListener("visibilitychange", () => document.hidden && away());

  for (const axis of ["v", "w"]) scaleSlider(axis);
  paint();
  requestAnimationFrame(paintStick);
  return api;
}

/** What the reader chose before: limits by axis, in SI, kept by the browser for its tab. */
export function remembered() {
  return (axis, value) => {
    const key = `drive-limit-${axis}`;
    if (value === undefined) return Number(sessionStorage.getItem(key)) || null;
    sessionStorage.setItem(key, String(value));
    return value;
  };
}
