// The 3D view of the run or scenario, with the nominal and the patched path laid into it as the effects move. It comes
// after the 2D: the newest paths a few times a second, as drawing in 3D takes the page's time too.

import { api } from "../lib/api.js";
import { mountScene } from "../lib/scene.js";

const POINTS = 600;
const EVERY = 200; // ms between two paths of a drag

const OVERLAYS = { nominal: "simulated", patched: "patched" };

export function mountSandboxScene(host, run, reference, clock) {
  const scene = mountScene(host, run, clock, { methods: reference ? [reference] : [] });
  const viewer = scene.address.split("/").at(-2);
  const next = new Map();
  const laid = new Map();
  let busy = false;
  let timer = 0;

  async function send() {
    if (busy || !next.size || host.dataset.scene !== "ready") return;
    busy = true;
    const [[name, path]] = next;
    next.delete(name);
    try {
      await api(`scenes/${run}/overlay?viewer=${viewer}&name=${name}`, { method: "PUT", json: thinned(path) });
      laid.set(name, sketch(path));
      host.dataset.overlay = [...laid.keys()].sort().join(" ");
    } catch (error) {
      host.title = error.message;
    }
    busy = false;
    send();
  }

  host.addEventListener("scene-ready", send);
  return {
    show(paths) {
      for (const path of paths) {
        const name = OVERLAYS[path.method];
        if (name && laid.get(name) !== sketch(path)) next.set(name, path); // the nominal one seldom moves
      }
      timer ||= setTimeout(() => ((timer = 0), send()), EVERY);
    },
  };
}

/** Tells two paths apart without looking at every number. */
const sketch = ({ x, y }) => [0, 1, 2, 3, 4, 5, 6, 7, 8].map((k) => Math.round((k / 8) * (x.length - 1))).map((i) => `${x[i]},${y[i]}`).join(" ");

function thinned(path) {
  const step = Math.max(1, Math.ceil(path.x.length / POINTS));
  const rows = Array.from(path.x, (_, i) => i).filter((i) => (i % step === 0 || i === path.x.length - 1) && path.x[i] !== null && path.y[i] !== null);
  return Object.fromEntries(["t", "x", "y"].map((c) => [c, rows.map((i) => path[c][i])]));
}
