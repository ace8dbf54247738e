// The bar of methods: one colour and one dash each, on and off for map, 3D and every plot at once; keys 1 to 6, 0 the truth, 7 the fixes.

import { h } from "../lib/dom.js";
import { keys } from "../lib/keys.js";
import { METHOD_KEYS, methodStyle, sortMethods, swatch } from "../lib/methods.js";

// What could be shown for this run, in the order of the keys: { name, label, has, reason, estimate }.
export function methodsOf({ run, estimates, methods }) {
  const streams = new Map(run.streams.map((s) => [s.name, s]));
  const columns = (stream) => (streams.get(stream)?.columns ?? []).map((c) => c.name);
  const found = new Map(methods.map((m) => [m.name, { name: m.name, has: false, reason: m.reason, summary: m.summary }]));
  for (const e of estimates) found.set(e.method, { ...found.get(e.method), name: e.method, has: true, estimate: e });
  if (columns("truth").includes("x")) found.set("truth", { name: "truth", has: true, summary: "The reference path." });
  if (streams.has("beacon")) found.set("fixes", { name: "fixes", has: true, summary: "Raw fixes of the beacon system." });
  return sortMethods([...found.keys()]).map((name) => ({ label: methodStyle(name).label, ...found.get(name) }));
}

export function mountMethods(host, state) {
  const chips = new Map();

  function paint() {
    for (const [name, chip] of chips) {
      const method = state.methods.find((m) => m.name === name);
      chip.disabled = !method.has;
      chip.setAttribute("aria-pressed", String(method.has && state.isVisible(name)));
      chip.dataset.hint = method.has ? `${method.summary ?? ""} Click or press the key: on and off. Alt-click: this one alone.` : (method.reason ?? "Not estimated yet.");
    }
  }

  function solo(name) {
    const others = state.methods.filter((m) => m.has && m.name !== name && m.name !== "truth");
    const alone = state.isVisible(name) && others.every((m) => !state.isVisible(m.name));
    for (const m of others) state.toggle(m.name, alone);
    state.toggle(name, true);
  }

  const table = {};
  state.methods.forEach((method, i) => {
    const key = METHOD_KEYS[method.name];
    const chip = h("button", { type: "button", class: "method", "data-method": method.name }, methodSwatch(method.name), method.label, key && h("kbd", {}, key));
    chip.addEventListener("click", (event) => (event.altKey ? solo(method.name) : state.toggle(method.name)));
    chips.set(method.name, chip);
    host.append(chip);
    if (key) table[key] = [i === 0 ? "methods on and off, 0 the truth, 7 the fixes" : null, () => state.toggle(method.name), "0 … 7"];
  });
  keys("Run", table);
  state.subscribe((what) => what === "methods" && paint());
  paint();
}

// Raw fixes are dots, not a line.
export function methodSwatch(name) {
  const picture = swatch(name);
  if (name === "fixes") picture.firstChild.setAttribute("stroke-dasharray", "0.1 5");
  if (name === "fixes") picture.firstChild.style.strokeWidth = "3.4";
  return picture;
}
