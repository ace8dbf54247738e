// Temperature against bias, where the IMU tells its temperature: each segment at rest, and a line through them.

import { api } from "../lib/api.js";
import { createChart } from "../lib/chart.js";
import { h } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { refusal } from "./run-imu-parts.js";

const HOURLY = (180 / Math.PI) * 3600;

export async function mountTemperature(host, { run, imu, fileName }) {
  if (imu.refusals.temperature) {
    host.replaceChildren(refusal("No bias against temperature", imu.refusals.temperature));
    return { destroy() {} };
  }
  const got = await api(`runs/${run.id}/imu/temperature`);
  const cell = h("div", { class: "imu-plot" });
  const s = got.summary;
  const slope = s.slope === undefined || s.slope === null ? "One temperature only: no slope." : `${number(s.slope * HOURLY, 3)} °/h per °C by a plain line, correlation ${number(s.correlation, 3)}.`;
  host.replaceChildren(cell, h("p", { class: "dim imu-facts" }, `Segments that method ${got.method} took for rest. ${slope}`));
  const room = Math.max((s.to - s.from) * 0.04, 0.05);
  const ends = [s.from, s.to];
  // one reading per place on the axis: equal temperatures stand a hair apart
  const x = got.temperature.map((v, i) => v + i * 1e-9);
  const chart = createChart(cell, {
    id: "imu-temperature",
    title: "Bias against temperature",
    term: "imu_temperature",
    unit: "°/h",
    siUnit: "rad/s",
    siFactor: 1 / HOURLY,
    subject: run.name,
    fileName,
    domain: [s.from - room, s.to + room],
    xLabel: "temperature",
    xUnit: "°C",
    series: [
      ...(s.slope ? [{ key: "line", label: "line", color: "--method-encoders-gyro", width: 1.5, dash: [7, 3] }] : []),
      { key: "bias", label: "segments at rest", color: "--c2", style: "dots" },
    ],
    load: async () => ({
      series: {
        line: { t: ends, y: ends.map((v) => (s.at_mean + s.slope * (v - s.mean)) * HOURLY), total: 0, shown: 0 },
        bias: { t: x, y: got.bias.map((v) => v * HOURLY), total: got.total, shown: got.shown },
      },
    }),
  });
  return { destroy: () => chart.destroy() };
}
