// The 3D view of the run or scenario, with the nominal and the patched path laid into it as the effects move.

import { api } from "../lib/api.js";
import { mountScene } from "../lib/scene.js";

const POINTS = 600;

const OVERLAYS = { nominal: "simulated", patched: "patched" };

export function mountSandboxScene(host, run, reference, clock) {
  const scene = mountScene(host, run, clock, { methods: reference ? [reference] : [] });
  const viewer = scene.address.split("/").at(-2);
  const next = new Map();
  const laid = new Map();
  let busy = false;

  async function send() {
    if (busy || !next.size || host.dataset.scene !== "ready") return;
    busy = true;
    const [[name, path]] = next;
    next.delete(name);
    try {
      await api(`scenes/${run}/overlay?viewer=${viewer}&name=${name}`, { method: "PUT", json: path });
      laid.set(name, JSON.stringify(path));
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
        if (!name) continue;
        const thin = thinned(path);
        if (laid.get(name) !== JSON.stringify(thin)) next.set(name, thin); // the nominal one seldom moves
      }
      send();
    },
  };
}

function thinned(path) {
  const step = Math.max(1, Math.ceil(path.x.length / POINTS));
  const rows = path.x.map((_, i) => i).filter((i) => (i % step === 0 || i === path.x.length - 1) && path.x[i] !== null && path.y[i] !== null);
  return Object.fromEntries(["t", "x", "y"].map((c) => [c, rows.map((i) => path[c][i])]));
}
