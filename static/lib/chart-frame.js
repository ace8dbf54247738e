// The elements around a plot: title, unit, tools, legend, message, table. No style attributes: classes and CSSOM only.

import { number } from "./chart-axes.js";
import { extent, valueAt } from "./chart-data.js";
import { MARK_PATHS } from "./chart-draw.js";
import { h, s } from "./dom.js";

const TOOLS = [
  ["png", "PNG", "Picture of this view, with title and legend"],
  ["svg", "SVG", "Drawing of this view, for papers"],
  ["csv", "CSV", "Readings of the visible range, SI units in the header"],
  ["link", "Copy link", "Link to exactly this view"],
  ["table", "Table", "Smallest, largest, first and last value of each line in view"],
];

// A short stretch of a series as it is drawn: colour and dashes.
export function seriesSwatch({ color, dash = [], style, mark: shape }) {
  const mark = style === "marks" ? s("path", { d: MARK_PATHS[shape], transform: "translate(9 4)" }) : style === "dots" ? s("circle", { cx: 9, cy: 4, r: 2.6 }) : s("path", { d: "M0 4H18", "stroke-dasharray": dash.join(" ") || undefined });
  const css = color.startsWith("--") ? `var(${color})` : color;
  mark.style.stroke = css;
  if (style === "dots" || shape === "dot") mark.style.fill = css;
  return s("svg", { class: "swatch", viewBox: "0 0 18 8", "aria-hidden": "true" }, mark);
}

function glyph(path) {
  return s("svg", { viewBox: "0 0 20 20", "aria-hidden": "true" }, s("path", { d: path }));
}

export function buildFrame(host, spec, { tool }) {
  const title = h("span", { class: "chart-title" }, spec.title);
  const unit = h("span", { class: "chart-unit" }, spec.unit || "");
  const sampling = h("span", { class: "chart-sampling" });
  if (spec.help) title.dataset.hint = spec.help;
  if (spec.term) title.dataset.term = spec.term;
  sampling.dataset.term = "sampling";
  const when = spec.clock ? null : h("output", { class: "legend-when" }); // where on the other axis the pointer is
  const menu = exportMenu(spec.title, TOOLS, tool);
  const legendRow = h("div", { class: "chart-legend" }, when);
  const head = h("figcaption", { class: "chart-head" }, title, unit, spec.compact && legendRow, sampling, menu);
  if (spec.onEnlarge) {
    const enlarge = h("button", { type: "button", class: "chart-enlarge", "aria-label": `Enlarge ${spec.title}`, "data-hint": "Enlarge; again: back" }, glyph("M11 3h6v6M17 3l-6 6M9 17H3v-6M3 17l6-6"));
    enlarge.addEventListener("click", () => tool("enlarge"));
    head.append(enlarge);
  }
  const plot = h("div", { class: "chart-plot", tabindex: "0", role: "img", "aria-label": spec.title });
  const message = h("div", { class: "chart-message", role: "status", hidden: true });
  const table = h("div", { class: "chart-table", hidden: true });
  const root = h("figure", { class: spec.compact ? "chart compact" : "chart", "data-chart": spec.id }, head, spec.compact ? "" : legendRow, plot, message, table);
  host.append(root);
  return {
    root,
    plot,
    sampling,
    table,
    when,
    legend: new Map(),
    legendRow,
    timeLine: h("div", { class: "chart-time", hidden: true }),
    hoverLine: h("div", { class: "chart-hover", hidden: true }),
    selection: h("div", { class: "chart-selection", hidden: true }),
    say(text, again) {
      message.hidden = !text;
      message.textContent = text;
      if (!text || !again) return;
      const button = h("button", { type: "button", class: "button" }, "Try again");
      button.addEventListener("click", again);
      message.append(" ", button);
    },
  };
}

// details/summary: opens with Enter, closes with Escape or a click elsewhere.
export function exportMenu(title, tools, tool) {
  const summary = h("summary", { "aria-label": `Export ${title}`, "data-hint": "Export this view (e)" }, glyph("M10 3v9M6 8.5l4 4 4-4M3 16.5h14"));
  const list = h("div", { class: "menu-list" });
  const menu = h("details", { class: "menu chart-menu" }, summary, list);
  for (const [kind, label, hint] of tools) {
    const button = h("button", { type: "button", title: hint, "data-export": kind }, label);
    button.addEventListener("click", async () => {
      const said = await tool(kind);
      if (kind === "link") button.textContent = said ? "Copied" : "Copy the address bar";
      else menu.open = false;
    });
    list.append(button);
  }
  closeOutside(menu);
  return menu;
}

export function closeOutside(menu) {
  document.addEventListener("pointerdown", (event) => {
    if (menu.open && !menu.contains(event.target)) menu.open = false;
  });
  menu.addEventListener("keydown", (event) => {
    if (event.key !== "Escape" || !menu.open) return;
    event.stopPropagation();
    menu.open = false;
    menu.querySelector("summary").focus();
  });
}

export function legendItem(frame, series, toggle) {
  const value = h("output", { class: "legend-value" }, "–");
  const root = h("button", { type: "button", class: "legend-item", "data-series": series.key, "aria-pressed": "true" });
  root.append(seriesSwatch(series), h("span", {}, series.label), value);
  if (series.help) root.dataset.hint = series.help;
  root.addEventListener("click", () => toggle(series.key));
  frame.legend.set(series.key, { root, value });
  frame.legendRow.append(root);
}

export function summaryTable(host, chart) {
  const range = chart.clock.range;
  const head = h("tr", {}, ...["series", "points", "min", "max", "first", "last"].map((text) => h("th", { scope: "col" }, text)));
  const body = chart.visibleSeries.map((series) => {
    const reading = chart.reading(series.key);
    const span = extent(reading, range) ?? [null, null];
    const ends = range.map((t) => valueAt(reading, Math.min(Math.max(t, reading.t[0]), reading.t[reading.t.length - 1])));
    const cells = [reading.total, ...[...span, ...ends].map(number)];
    return h("tr", {}, h("th", { scope: "row" }, series.label), ...cells.map((c) => h("td", { class: "num" }, String(c))));
  });
  const caption = h("caption", {}, `${chart.spec.title}, ${chart.spec.unit || "no unit"}, visible range`);
  host.replaceChildren(h("table", { class: "table" }, caption, h("thead", {}, head), h("tbody", {}, ...body)));
}
