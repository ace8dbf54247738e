// The map of a live robot: paths that grow, ranges to beacons as they come, the trail by speed or by gap.

import { h } from "../lib/dom.js";
import { dressedEvent } from "../lib/events.js";
import { createMap } from "../lib/map.js";
import { halo } from "../lib/map-draw.js";
import { poseAt } from "../lib/map-view.js";
import { methodStyle } from "../lib/methods.js";
import { colour } from "../lib/palette.js";

const RANGE_HOLDS = 1; // s: an older range says little of where the robot is now
const STEPS = 8;
export const TRAILS = {
  method: { label: "methods", about: "Each path in its method's colour." },
  speed: { label: "speed", about: "The leading path, thicker and darker where it was faster.", unit: "m/s" },
  gap: { label: "gap", about: "The leading path, thicker and redder where the chain was further outside its noise floor.", unit: "× floor" },
};

export function mountMap(host, { clock, subject, lead }) {
  const map = createMap(host, { clock, subject, fileName: subject.replace(/[^\w.+-]+/g, "_"), layers: { base: trail, top: ranges } });
  const legend = h("div", { class: "trail-legend", hidden: true });
  host.append(legend);
  let tracks = new Map();
  let beacons = [];
  let latest = {}; // last range by beacon
  let mode = "method";

  const api = {
    map,
    setRun(newTracks, robotBeacons) {
      tracks = newTracks;
      beacons = robotBeacons;
      latest = {};
      const paths = [...tracks].map(([method, track]) => ({ method, hold: true, ...methodStyle(method), ...track.rows }));
      map.setPaths(paths, beacons);
      map.grown();
    },
    setEvents: (events) => map.setEvents(lead(), events.map((e) => dressedEvent({ ...e, t1: e.t1 ?? clock.time }))),
    setRanges(told) {
      Object.assign(latest, told);
    },
    setTrail(name) {
      mode = name;
      map.grown();
    },
  };

  const leading = () => map.shown.find((p) => p.method === lead()) ?? map.shown[0];

  // ---- the trail in classes, each with its width, so that it is read without colour too

  function trail(ctx, view) {
    const path = leading();
    legend.hidden = mode === "method" || !path;
    if (legend.hidden) return;
    const column = path[mode];
    const [lo, hi] = scaleOf(column);
    const ramp = colours();
    for (let k = 0; k < STEPS; k++) {
      ctx.strokeStyle = ramp[k];
      ctx.lineWidth = 2 + (4 * k) / (STEPS - 1);
      ctx.lineCap = "round";
      ctx.beginPath();
      for (let i = 1; i < path.t.length; i++) {
        if (path.x[i] === null || path.x[i - 1] === null || column[i] === null || stepOf(column[i], lo, hi) !== k) continue;
        ctx.moveTo(view.toX(path.x[i - 1]), view.toY(path.y[i - 1]));
        ctx.lineTo(view.toX(path.x[i]), view.toY(path.y[i]));
      }
      ctx.stroke();
    }
    ctx.lineCap = "butt";
    tellLegend(lo, hi, ramp);
  }

  // Gap: from the floor to four times it, wider where it is worse; speed: from rest to the fastest so far.
  function scaleOf(column) {
    let most = mode === "gap" ? 4 : 0.1;
    for (const v of column) if (v > most) most = v;
    return [mode === "gap" ? 1 : 0, most];
  }

  const stepOf = (value, lo, hi) => Math.max(0, Math.min(STEPS - 1, Math.floor((STEPS * (value - lo)) / (hi - lo))));

  function colours() {
    const [from, to] = [colour("--line-strong"), colour(mode === "gap" ? "--red" : "--method-fused")];
    const part = (hex, i) => parseInt(hex.slice(1 + 2 * i, 3 + 2 * i), 16);
    return Array.from({ length: STEPS }, (_, k) => `rgb(${[0, 1, 2].map((i) => Math.round(part(from, i) + ((part(to, i) - part(from, i)) * k) / (STEPS - 1))).join(",")})`);
  }

  let toldLegend = "";
  function tellLegend(lo, hi, ramp) {
    const text = `${mode} ${lo} ${hi.toPrecision(2)} ${ramp[0]}`;
    if (text === toldLegend) return;
    toldLegend = text;
    const bars = ramp.map((ink) => h("i", { style: { background: ink } }));
    legend.replaceChildren(h("span", {}, lo), h("span", { class: "ramp" }, bars), h("span", {}, `${Number(hi.toPrecision(2))} ${TRAILS[mode].unit}`));
  }

  // ---- ranges: from the beacon towards the robot, as long as was measured; a piece that is missing or too much is the error

  function ranges(ctx, view) {
    const path = leading();
    const pose = path && poseAt(path, clock.time);
    if (!pose) return;
    for (const { name, x, y, z } of beacons) {
      const last = latest[name];
      const age = last ? clock.time - last.t : Infinity;
      if (age > RANGE_HOLDS) continue;
      const away = Math.hypot(pose.x - x, pose.y - y);
      const flat = Math.sqrt(Math.max(last.range ** 2 - (z ?? 0) ** 2, 0));
      const share = away > 0 ? flat / away : 0;
      const end = [view.toX(x + share * (pose.x - x)), view.toY(y + share * (pose.y - y))];
      ctx.globalAlpha = 1 - 0.7 * (age / RANGE_HOLDS);
      ctx.strokeStyle = colour("--method-beacon");
      ctx.setLineDash([3, 3]);
      ctx.lineWidth = 1;
      ctx.beginPath();
      ctx.moveTo(view.toX(x), view.toY(y));
      ctx.lineTo(...end);
      ctx.stroke();
      ctx.setLineDash([]);
      ctx.textAlign = "left";
      ctx.textBaseline = "middle";
      halo(ctx, `${last.range.toFixed(2)} m`, view.toX(x) + 10, view.toY(y) + 13, colour("--ink-3"));
    }
    ctx.globalAlpha = 1;
  }

  return api;
}
