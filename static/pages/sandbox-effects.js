// The effects by link: a slider and a field per parameter, a tick at neutral, changed ones on top.
//
//   const panel = createEffects(host, { effects, source, reach, values, onMove });
//   panel.values -> {effect: {parameter: value}} of what is not neutral; panel.reset(); panel.showProblem(where);
//   panel.refuse({effect: reason})   // of the simulator that is chosen: marked, and not to be moved

import { h } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { humanOf, scaleOf, tidy } from "./sandbox-scale.js";

const FAMILIES = {
  drive: "Commands → wheels",
  kinematics: "Wheels → body",
  ground: "Body on the ground",
  gyroscope: "Body → gyro",
  accelerometer: "Body → accelerometer",
  encoders: "Wheels → encoders",
  beacons: "Body → beacons",
  timing: "Clocks",
};
const OPEN = new Set(["drive", "kinematics", "gyroscope"]);

export function createEffects(host, { effects, source, reach, values, onMove }) {
  const given = new Map(effects.map((e) => [e.id, new Map(Object.entries(values[e.id] ?? {}))]));
  const rows = new Map();
  const changed = h("div", { id: "changed" });
  const homes = new Map();
  const resetAll = h("button", { type: "button", class: "button quiet", id: "reset-all", onclick: () => panel.reset() }, "Reset all");
  host.append(h("header", { class: "row" }, h("h2", {}, "Effects"), h("span", { class: "spread" }), resetAll), changed);
  host.addEventListener("submit", (event) => event.preventDefault());

  const panel = {
    get values() {
      const out = {};
      for (const effect of effects) if (isOn(effect)) out[effect.id] = Object.fromEntries(given.get(effect.id));
      return out;
    },
    reset() {
      for (const effect of effects) clear(effect);
      arrange();
      onMove();
    },
    refuse(reasons) {
      for (const [id, { root, refused, parameters }] of rows) {
        const why = reasons[id];
        root.classList.toggle("refused", Boolean(why));
        refused.hidden = !why;
        refused.dataset.hint = why ? `This simulator cannot take it: ${why}.` : "";
        for (const p of parameters) for (const control of [p.range, p.field, p.toggle]) if (control) control.disabled = Boolean(why);
        if (!why) paint(effects.find((e) => e.id === id));
      }
    },
    showProblem(where) {
      const [effect, parameter] = String(where ?? "").split(".");
      for (const [id, row] of rows) for (const p of row.parameters) p.field?.setAttribute("aria-invalid", String(id === effect && p.name === parameter));
    },
  };

  const isOn = (effect) => effect.switch.some((name) => given.get(effect.id).has(name));

  for (const [family, label] of Object.entries(FAMILIES)) {
    const box = h("details", { open: OPEN.has(family) || null, "data-family": family }, h("summary", {}, label));
    for (const effect of effects.filter((e) => e.family === family)) {
      rows.set(effect.id, effectRow(effect));
      homes.set(effect.id, box);
    }
    host.append(box);
  }
  for (const effect of effects) paint(effect);
  arrange();
  return panel;

  function effectRow(effect) {
    const idle = source.idle[effect.id];
    const hint = `${effect.equation}. Moves ${effect.streams.join(", ") || "which readings there are"}.${idle ? ` Here it shows nothing: ${idle}.` : ""}`;
    const reset = h("button", { type: "button", class: "button quiet reset", hidden: true, onclick: () => (clear(effect), arrange(), onMove()) }, "Reset");
    reset.setAttribute("aria-label", `Reset ${effect.label}`);
    const refused = h("span", { class: "chip", tabindex: "0", hidden: true }, "refused");
    const parameters = effect.parameters.map((p) => (p.text ? choice(effect, p) : slider(effect, p)));
    const root = h("div", { class: idle ? "effect idle" : "effect", "data-effect": effect.id }, h("header", {}, h("span", { "data-hint": hint, tabindex: "0" }, effect.label), refused, reset), parameters.map((p) => p.root));
    return { root, reset, refused, parameters };
  }

  function slider(effect, p) {
    const human = humanOf(p.unit);
    const scale = scaleOf(p, reach);
    const label = `${effect.label}, ${p.name}`;
    const bounds = `${p.name}: ${number(p.low === null ? -Infinity : p.low * human.factor)} to ${p.high === null ? "∞" : number(p.high * human.factor)} ${human.unit}; neutral ${p.neutral === null ? "none (off)" : number(p.neutral * human.factor)}${human.factor === 1 ? "" : `. In files: ${p.unit}`}`;
    const range = h("input", { type: "range", min: scale.min, max: scale.max, step: "any", "aria-label": label });
    const field = h("input", { type: "number", step: "any", "aria-label": `${label}, value` });
    const toggle = scale.optional ? h("input", { type: "checkbox", "aria-label": `${label}, on` }) : null;
    const tick = scale.optional ? null : h("i", { class: "tick" });
    const root = h("div", { class: "parameter", "data-parameter": p.name }, h("span", { "data-hint": bounds }, p.name), h("span", { class: "slider" }, toggle, range, tick), field, h("span", { class: "unit" }, human.unit), h("span", { class: "ends", "data-hint": bounds }, ends(scale, human)));
    if (tick) tick.style.left = `calc(8px + ${(Math.min(Math.max(scale.toPosition(p.neutral), scale.min), scale.max) - scale.min) / (scale.max - scale.min)} * (100% - 16px))`;
    const move = (value) => {
      set(effect, p, value);
      onMove();
    };
    range.addEventListener("input", () => move(tidy(scale.toValue(snapped(Number(range.value), scale)), p.neutral)));
    range.addEventListener("change", () => arrange(range));
    range.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageUp: 5, PageDown: -5 }[event.key];
      if (!step) return;
      event.preventDefault();
      range.value = String(Number(range.value) + step * (event.shiftKey ? 2 : 12));
      range.dispatchEvent(new Event("input"));
    });
    range.addEventListener("keyup", (event) => /^(Arrow|Page)/.test(event.key) && arrange(range));
    field.addEventListener("input", () => field.value !== "" && Number.isFinite(field.valueAsNumber) && move(field.valueAsNumber / human.factor));
    field.addEventListener("change", () => (field.value === "" && move(p.neutral), arrange(field)));
    toggle?.addEventListener("change", () => (move(toggle.checked ? 1 : null), arrange(toggle)));
    return { name: p.name, p, root, range, field, toggle, scale, human };
  }

  function choice(effect, p) {
    const field = h("select", { "aria-label": `${effect.label}, ${p.name}` }, source.beacons.map((b) => h("option", {}, b.name)));
    field.addEventListener("change", () => (given.get(effect.id).set(p.name, field.value), onMove()));
    return { name: p.name, p, field, root: h("div", { class: "parameter" }, h("span", {}, p.name), field) };
  }

  function set(effect, p, value) {
    const own = given.get(effect.id);
    if (value === p.neutral && effect.switch.includes(p.name)) own.delete(p.name);
    else own.set(p.name, value);
    if (isOn(effect)) for (const other of effect.parameters) if (!own.has(other.name) && !effect.switch.includes(other.name)) own.set(other.name, companion(other));
    paint(effect);
  }

  // What an effect needs beside the parameter that switches it on: where, when, how long.
  function companion(p) {
    if (p.text) return source.beacons[0]?.name ?? "";
    if (p.name === "x" || p.name === "y") return tidy(reach[p.name]);
    if (p.name === "time") return tidy((reach.t0 + reach.t1) / 2);
    if (p.name === "tau") return 600;
    return p.name === "radius" || p.name === "size" ? 1 : Math.max(p.neutral, p.low);
  }

  function clear(effect) {
    given.get(effect.id).clear();
    paint(effect);
  }

  function paint(effect) {
    const own = given.get(effect.id);
    const row = rows.get(effect.id);
    row.reset.hidden = own.size === 0;
    for (const one of row.parameters) {
      const value = own.get(one.name) ?? one.p.neutral;
      one.root.toggleAttribute("data-changed", own.has(one.name));
      if (one.p.text) {
        if (value) one.field.value = value;
        continue;
      }
      if (one.toggle) [one.toggle.checked, one.range.disabled] = [value !== null, value === null || row.root.classList.contains("refused")];
      if (document.activeElement !== one.range) one.range.value = value === null ? String(one.scale.max) : String(one.scale.toPosition(value));
      if (document.activeElement !== one.field) one.field.value = value === null ? "" : String(Number((value * one.human.factor).toPrecision(7)));
      one.range.setAttribute("aria-valuetext", value === null ? "off" : `${one.field.value} ${one.human.unit}`);
    }
  }

  // After a move has ended: what is on goes to the top, the rest home in the table's order.
  function arrange(focus = null) {
    resetAll.hidden = !effects.some((e) => given.get(e.id).size > 0);
    for (const effect of effects) {
      const { root } = rows.get(effect.id);
      const home = given.get(effect.id).size > 0 ? changed : homes.get(effect.id);
      if (root.parentElement === home) continue;
      if (home === changed) changed.append(root);
      else home.insertBefore(root, after(effect, home));
    }
    focus?.focus(); // where it now is comes into sight
  }

  function after(effect, home) {
    const order = effects.map((e) => e.id);
    return [...home.children].find((c) => c.dataset.effect && order.indexOf(c.dataset.effect) > order.indexOf(effect.id)) ?? null;
  }
}

// The range of the slider at its ends; the field takes what lies beyond, as far as it is physical.
function ends(scale, human) {
  return [scale.min, scale.max].map((p) => h("span", {}, number(Number(scale.toValue(p).toFixed(9)) * human.factor, 2)));
}

// Neutral is easy to hit again.
function snapped(position, scale) {
  return scale.min < 0 && Math.abs(position) < 6 ? 0 : position;
}
