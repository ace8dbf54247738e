// The 3D view of a run with the gap on its path, and the patched path beside it.

import { api } from "../lib/api.js";
import { mountScene } from "../lib/scene.js";
import { level } from "./gap-levels.js";

const POINTS = 1500;

export function mountGapScene(host, run, clock) {
  host.hidden = false;
  const scene = mountScene(host, run, clock, { methods: ["truth"] });
  const viewer = scene.address.split("/").at(-2);
  const waiting = new Map();
  let busy = false;

  async function send() {
    if (busy || !waiting.size || host.dataset.scene !== "ready") return;
    busy = true;
    const [name, path] = waiting.entries().next().value;
    waiting.delete(name);
    try {
      await api(`scenes/${run}/overlay?viewer=${viewer}&name=${name}`, { method: "PUT", json: path });
      host.dataset.overlay = [...new Set([...(host.dataset.overlay ?? "").split(" ").filter(Boolean), name])].join(" ");
    } catch (error) {
      host.title = error.message;
    }
    busy = false;
    send();
  }

  function rowsOf(path) {
    const step = Math.max(1, Math.ceil(path.x.length / POINTS));
    return path.x.map((_, i) => i).filter((i) => (i % step === 0 || i === path.x.length - 1) && path.x[i] !== null && path.y[i] !== null);
  }

  const laid = (path, more = {}) => {
    const rows = rowsOf(path);
    return rows.length > 1 ? { ...Object.fromEntries(["t", "x", "y"].map((c) => [c, rows.map((i) => path[c][i])])), ...(more.levels ? { levels: rows.map((i) => more.levels[i]) } : {}) } : null;
  };
  const put = (name, path) => path && waiting.set(name, path);

  host.addEventListener("scene-ready", send);
  return {
    show(gap, simulated, patched) {
      if (gap) put("gap", laid(gap, { levels: gap.gap.map(level) }));
      if (simulated) put("simulated", laid(simulated));
      if (patched) put("patched", laid(patched));
      send();
    },
    dispose() {
      host.removeEventListener("scene-ready", send);
      scene.dispose();
      delete host.dataset.overlay;
    },
  };
}
