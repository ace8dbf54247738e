// The 3D view of the run, with the patched path laid into it as the effects move.

import { api } from "../lib/api.js";
import { mountScene } from "../lib/scene.js";

const POINTS = 600;

export function mountSandboxScene(host, run, clock) {
  host.hidden = false;
  const scene = mountScene(host, run, clock, { methods: ["truth"] });
  const viewer = scene.address.split("/").at(-2);
  let busy = false;
  let next = null;

  async function send() {
    if (busy || !next || host.dataset.scene !== "ready") return;
    busy = true;
    const path = next;
    next = null;
    try {
      await api(`scenes/${run}/overlay?viewer=${viewer}`, { method: "PUT", json: path });
      host.dataset.overlay = String(path.x.length);
    } catch (error) {
      host.title = error.message;
    }
    busy = false;
    send();
  }

  host.addEventListener("scene-ready", send);
  return {
    show(path) {
      const step = Math.max(1, Math.ceil(path.x.length / POINTS));
      const rows = path.x.map((_, i) => i).filter((i) => (i % step === 0 || i === path.x.length - 1) && path.x[i] !== null && path.y[i] !== null);
      next = Object.fromEntries(["t", "x", "y"].map((c) => [c, rows.map((i) => path[c][i])]));
      send();
    },
  };
}
