// The signals of the monitor, scrolling: gyro, accelerometer, speed, and the gyro's bias with its band.

import { createScroll } from "../lib/scroll.js";

const DEG = 180 / Math.PI;
const PLOTS = [
  { id: "gyro", title: "Gyro", unit: "°/s", term: "live_gyro", scale: DEG, least: 0.01, series: [{ key: "imu.gz", label: "z", color: "--c1" }] },
  {
    id: "accelerometer", title: "Accelerometer", unit: "m/s²", term: "live_accelerometer", least: 0.2,
    series: [{ key: "imu.ax", label: "x, forward", color: "--c2" }, { key: "imu.ay", label: "y, left", color: "--c3", dash: [5, 3] }],
  },
  {
    id: "speed", title: "Speed", unit: "m/s", term: "live_speed", least: 0.1,
    series: [{ key: "commands.v", label: "commanded", color: "--c1", dash: [4, 3], style: "steps" }, { key: "driven", label: "driven", color: "--method-fused", width: 1.8 }],
  },
  { id: "bias", title: "Gyro bias", unit: "°/h", term: "live_bias", scale: DEG * 3600, seconds: 120, least: 1e-5, series: [{ key: "bias", label: "fused ± σ", color: "--method-fused", band: true, widest: 5e-4 }] },
]; // prettier-ignore

export function mountSignals(host) {
  const plots = PLOTS.map((spec) => createScroll(host, spec));
  const owner = new Map(PLOTS.flatMap((spec, i) => spec.series.map((s) => [s.key, plots[i]])));
  const last = new Map(); // newest value by signal
  let before = null; // pose from which the driven speed is told

  function push({ signals, bias, poses }) {
    for (const [name, { t, y }] of Object.entries(signals)) {
      owner.get(name)?.push(name, t, y.map((v) => v ?? NaN));
      if (y.length) last.set(name, y[y.length - 1]);
    }
    if (bias.t.length) owner.get("bias").push("bias", bias.t, bias.value, bias.sd);
    if (poses) driven(poses.fused ?? poses["encoders+gyro"] ?? poses.encoders);
  }

  // Along the heading, over a tenth of a second at least.
  function driven(pose) {
    if (!pose || (before && pose.t - before.t < 0.1)) return;
    if (before && pose.t - before.t < 2) {
      const [dx, dy] = [pose.x - before.x, pose.y - before.y];
      const forward = dx * Math.cos(pose.theta) + dy * Math.sin(pose.theta);
      owner.get("driven").push("driven", [pose.t], [(Math.sign(forward) * Math.hypot(dx, dy)) / (pose.t - before.t)]);
    }
    before = pose;
  }

  return {
    restart(snapshot) {
      for (const plot of plots) plot.clear();
      before = null;
      last.clear();
      push(snapshot);
    },
    push,
    draw: (now) => plots.forEach((plot) => plot.draw(now)),
    tell: () => plots.forEach((plot) => plot.tell()),
    latest: (name) => last.get(name) ?? null,
  };
}
