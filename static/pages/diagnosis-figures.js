// Every drawing of the server out: SVG and PNG as it is seen, CSV of what it shows.

import { exportMenu } from "../lib/chart-frame.js";
import { $$, save } from "../lib/dom.js";

const TOOLS = [
  ["svg", "SVG", "Drawing, for papers"],
  ["png", "PNG", "Picture"],
  ["csv", "CSV", "What is drawn, in SI units"],
];
const SHOWN = ["fill", "stroke", "stroke-width", "stroke-dasharray", "opacity", "font-size", "font-family", "font-weight"];

export function startFigures(evidence, diagnosis) {
  for (const figure of $$("figure[data-figure]")) {
    const name = figure.dataset.figure;
    const drawn = figure.querySelector("svg.g-plot, svg.g-far");
    const tools = TOOLS.filter(([kind]) => kind === "csv" || drawn);
    const menu = exportMenu(name, tools, (kind) => out(kind, name, drawn, evidence, diagnosis));
    menu.classList.add("figure-tools");
    figure.append(menu);
  }
}

async function out(kind, name, drawn, evidence, diagnosis) {
  if (kind === "csv") return save(new Blob([`${table(name, evidence, diagnosis).map((row) => row.map(cell).join(",")).join("\r\n")}\r\n`], { type: "text/csv" }), `${name}.csv`);
  const svg = standalone(drawn);
  if (kind === "svg") return save(new Blob([svg], { type: "image/svg+xml" }), `${name}.svg`);
  const image = new Image();
  image.src = `data:image/svg+xml,${encodeURIComponent(svg)}`;
  await image.decode();
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [2 * drawn.width.baseVal.value, 2 * drawn.height.baseVal.value];
  const ctx = canvas.getContext("2d");
  ctx.drawImage(image, 0, 0, canvas.width, canvas.height);
  return save(await new Promise((done) => canvas.toBlob(done, "image/png")), `${name}.png`);
}

// With the colours as they are seen written into each element: no stylesheet travels along.
function standalone(drawn) {
  const copy = drawn.cloneNode(true);
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  const [from, to] = [drawn.querySelectorAll("*"), copy.querySelectorAll("*")];
  from.forEach((element, i) => {
    const style = getComputedStyle(element);
    for (const key of SHOWN) to[i].setAttribute(key, style.getPropertyValue(key));
    to[i].removeAttribute("class");
  });
  const ground = document.createElementNS("http://www.w3.org/2000/svg", "rect");
  for (const [k, v] of Object.entries({ width: "100%", height: "100%", fill: getComputedStyle(document.body).backgroundColor })) ground.setAttribute(k, v);
  copy.prepend(ground);
  return new XMLSerializer().serializeToString(copy);
}

function table(name, evidence, { result, gap }) {
  const columns = (object, keys) => [keys, ...object[keys[0]].map((_, i) => keys.map((k) => object[k][i]))];
  const records = (list, keys) => [keys, ...list.map((one) => keys.map((k) => one[k]))];
  if (name === "heat") return records(evidence.cells, ["stream", "regime", "rows", "before", "after", "floor", "p_value", "significant"]);
  if (name === "probabilities") return [["effect", "probability"], ...Object.entries({ ...Object.fromEntries(result.causes.map((c) => [c.effect, c.probability])), ...result.probabilities })];
  if (name === "far") return [["stream", "before", "after", "floor"], ["", gap.before, gap.after, gap.floor], ...Object.entries(gap.by_stream).map(([s, g]) => [s, g.before, g.after, g.floor])];
  if (name === "drive") return columns(evidence.next.path, ["x", "y"]);
  const [kind, ...rest] = name.split("-");
  if (kind === "shape") return columns(evidence.unexplained.shapes[Number(rest[0])], ["x", "y", "lo", "hi"]);
  return columns(evidence.signatures[rest.join("-")], ["x", "residual", "sd", "fitted", "after"]);
}

const cell = (value) => {
  const text = value === null || value === undefined ? "" : String(value);
  return /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
};
