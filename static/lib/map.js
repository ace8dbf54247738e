// The map: paths of every method on the floor, seen from above; metres, equal axes, y up.
//
//   const map = createMap(host, { clock, subject: "corridor lap 3", fileName: "corridor" });
//   map.setPaths([{ method, label, color, dash, width, dots, t, x, y, theta, sd_x, sd_y, sd_theta, cov_xy }], beacons);
//   map.setVisible(method, on); map.setEvents(method, [dressedEvent]); map.setLead(method); map.fit();
//   map.setView([x, y, scale]); map.onView = (view) => {}; map.say(text);
//   layers: { base(ctx, view), top(ctx, view) } draw more: above the paths, and above the robots.
//   A path that grows has `hold: true` (its robot stays at its end); map.grown() draws what was added to it.
//
// Mouse: wheel zooms, drag pans, click sets the time, double-click fits. Touch: drag pans, two fingers zoom.
// Keyboard, when focused: arrows pan, + - zoom, Home fits.

import { number, tick, timeText, timeUnit } from "./chart-axes.js";
import { copyLink, quote } from "./chart-export.js";
import { exportMenu } from "./chart-frame.js";
import { h, s, save } from "./dom.js";
import { eventTip } from "./events.js";
import { length, angle } from "./format.js";
import { gestures } from "./gestures.js";
import * as draw from "./map-draw.js";
import { mapSvg } from "./map-svg.js";
import { bounds, createView, inDrawOrder, nearest, poseAt, roomier } from "./map-view.js";
import { colour, onThemeChange } from "./palette.js";

const BASE_EVERY = 1000; // ms, for paths that grow

const TOOLS = [
  ["png", "PNG", "Picture of this view, with legend"],
  ["svg", "SVG", "Drawing of this view, for papers"],
  ["csv", "CSV", "Poses of the visible range by the shown methods: m and rad"],
  ["link", "Copy link", "Link to exactly this view"],
];

export function createMap(host, { clock, subject = "", fileName = "path", layers = {} }) {
  const base = h("canvas", { class: "map-canvas" });
  const top = h("canvas", { class: "map-canvas map-top", tabindex: "0", role: "img", "aria-label": "Map of the paths" });
  const tip = h("div", { class: "map-tip", hidden: true });
  const ellipses = h("button", { type: "button", class: "map-tool", "aria-pressed": "false", "data-hint": "Ellipses along the leading path: 95 % where the claimed uncertainty is right" }, toolIcon("M10 5c5 0 8 2 8 5s-3 5-8 5-8-2-8-5 3-5 8-5zM10 10h.1"));
  const fitButton = h("button", { type: "button", class: "map-tool", "aria-label": "Fit", "data-hint": "Fit all paths (Home)" }, toolIcon("M3 7V3h4M13 3h4v4M17 13v4h-4M7 17H3v-4"));
  ellipses.setAttribute("aria-label", "Ellipses along the paths");
  const tools = h("div", { class: "map-tools" }, fitButton, ellipses, exportMenu("map", TOOLS, tool));
  const message = h("p", { class: "map-message", role: "status", hidden: true });
  const root = h("div", { class: "map", "data-map": "" }, base, top, message, tools, tip);
  host.append(root);

  const view = createView();
  const visible = new Map();
  const cleanups = [];
  let paths = [];
  let beacons = [];
  let events = { method: null, list: [] };
  let lead = null;
  let fitted = true; // the user has not moved the view: new paths and sizes fit again
  let dirty = 0; // 1: cursor layer, 2: everything
  let asked = 0; // the animation frame asked for
  let baseAt = 0; // when the base was painted
  const painted = new Map(); // how much of each path is on it
  let under = null; // {path, index} below the pointer
  let placed = []; // events as they stand on the screen

  const map = {
    view,
    onView: () => {}, // called with [x, y, scale] after the user moved the view, with null where it fits
    get shown() {
      return paths.filter((p) => visible.get(p.method) !== false);
    },
    setPaths(list, beaconList) {
      paths = list;
      beacons = beaconList;
      root.dataset.paths = paths.map((p) => p.method).join(" ");
      if (fitted) map.fit();
      redraw(2);
    },
    setVisible(method, on) {
      visible.set(method, on);
      redraw(2);
    },
    // The view widens in steps, not with every pose. Painted at once: who calls this is in an animation frame.
    grown() {
      const box = fitted && bounds(map.shown.length ? map.shown : paths, beacons);
      const outside = box && !view.holds(box);
      if (outside) view.fit(roomier(box));
      const stale = performance.now() - baseAt > BASE_EVERY || paths.some((p) => p.t.length < (painted.get(p.method) ?? 0));
      dirty = Math.max(dirty, outside || stale ? 2 : 1); // between two of the base, what is new is drawn on the top
      paint();
    },
    setEvents(method, list) {
      events = { method, list };
      redraw(2);
    },
    setLead(method) {
      lead = method;
    },
    // [x, y, px per m]: a view that a link restores.
    setView([x, y, scale]) {
      fitted = false;
      Object.assign(view, { x, y, scale });
      redraw(2);
    },
    say(text) {
      message.hidden = !text;
      message.textContent = text;
    },
    fit() {
      fitted = true;
      view.fit(bounds(map.shown.length ? map.shown : paths, beacons));
      tellView();
      redraw(2);
    },
    destroy() {
      for (const off of cleanups) off();
      root.remove();
    },
  };

  function redraw(layer) {
    if (!asked) asked = requestAnimationFrame(() => ((asked = 0), paint()));
    dirty = Math.max(dirty, layer);
  }

  function paint() {
    if (!dirty) return; // painted before its turn
    const all = [follow(), dirty === 2].some(Boolean);
    dirty = 0;
    if (all) paintOn(prepare(base), paintBase);
    paintOn(prepare(top), paintTop);
    root.dataset.view = [view.x, view.y, view.scale].map((v) => v.toPrecision(6)).join(",");
    root.dataset.shown = map.shown.map((p) => p.method).join(" ");
    root.dataset.time = String(clock.hover ?? clock.time);
  }

  function prepare(canvas) {
    const ratio = devicePixelRatio;
    const [w, hgt] = [Math.round(view.width * ratio), Math.round(view.height * ratio)];
    if (canvas.width !== w || canvas.height !== hgt) [canvas.width, canvas.height] = [w, hgt];
    const ctx = canvas.getContext("2d");
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, view.width, view.height);
    return ctx;
  }

  function paintOn(ctx, painter) {
    ctx.font = `11px ${getComputedStyle(root).fontFamily}`;
    painter(ctx);
  }

  function paintBase(ctx) {
    draw.drawGround(ctx, view);
    const shown = map.shown;
    baseAt = performance.now();
    for (const path of paths) painted.set(path.method, path.t.length);
    for (const path of shown) if (path.dots) draw.drawPath(ctx, view, path, clock.range);
    const claim = claiming();
    if (claim) for (const pose of draw.ellipsesAlong(view, claim, clock.range)) draw.drawEllipse(ctx, view, claim, pose, draw.SIGMAS_95, 0.08);
    for (const path of inDrawOrder(shown.filter((p) => !p.dots))) draw.drawPath(ctx, view, path, clock.range);
    layers.base?.(ctx, view);
    for (const path of shown) draw.drawEnds(ctx, view, path);
    draw.drawBeacons(ctx, view, beacons);
    const carrier = shown.find((p) => p.method === events.method) ?? shown.find((p) => !p.dots);
    placed = carrier ? draw.placeEvents(view, carrier, events.list) : [];
    draw.drawEvents(ctx, placed);
    draw.drawScaleBar(ctx, view);
    root.dataset.events = String(placed.length);
  }

  // Whose ellipses are drawn, where they are asked for: one method's, as those of several hide each other.
  function claiming() {
    if (ellipses.getAttribute("aria-pressed") !== "true") return null;
    const able = map.shown.filter((p) => p.sd_x && !p.dots);
    return able.find((p) => p.method === lead) ?? able[0] ?? null;
  }

  function paintTop(ctx) {
    for (const path of inDrawOrder(map.shown.filter((p) => p.hold))) draw.drawTail(ctx, view, path, painted.get(path.method) ?? 0);
    const moments = clock.hover === null ? [[clock.time, false]] : [[clock.time, true], [clock.hover, false]];
    for (const [time, ghost] of moments) {
      for (const path of map.shown) {
        const pose = path.dots || path.robot === false ? null : poseAt(path, time);
        if (!pose) continue;
        if (!ghost) draw.drawEllipse(ctx, view, path, pose, draw.SIGMAS_95, 0.14);
        draw.drawRobot(ctx, view, path, pose, ghost);
      }
    }
    layers.top?.(ctx, view);
    if (under) ring(ctx, under.path, under.index);
  }

  function ring(ctx, path, index) {
    ctx.strokeStyle = colour("--ink");
    ctx.lineWidth = 1.5;
    ctx.beginPath();
    ctx.arc(view.toX(path.x[index]), view.toY(path.y[index]), 5, 0, 7);
    ctx.stroke();
  }

  // The view moves on when the robot comes near its edge, not with every step: the paths need not be drawn each time.
  function follow() {
    const path = clock.follow && (paths.find((p) => p.method === lead) ?? map.shown.find((p) => !p.dots));
    const pose = path && poseAt(path, clock.time);
    if (!pose) return false;
    const [dx, dy] = [Math.abs(pose.x - view.x), Math.abs(pose.y - view.y)];
    if (dx * view.scale < 0.3 * view.width && dy * view.scale < 0.3 * view.height) return false;
    [view.x, view.y] = [pose.x, pose.y];
    return true;
  }

  // ---- what the user does

  let viewTimer = 0;
  function tellView() {
    clearTimeout(viewTimer);
    viewTimer = setTimeout(() => map.onView(fitted ? null : [view.x, view.y, view.scale]), 250);
  }

  function moved() {
    fitted = false;
    tellView();
    under = null;
    tip.hidden = true;
    redraw(2);
  }

  function hover(x, y) {
    const mark = placed.find((p) => Math.hypot(p.x - x, p.y - y) <= p.size + 3);
    if (mark) {
      under = null;
      clock.setHover(mark.event.t0);
      tip.hidden = false;
      tip.replaceChildren(...eventTip(mark.event));
      placeTip(x, y, 330);
      return redraw(1);
    }
    const found = nearest(view, map.shown, x, y);
    if (!found && !under) return void (tip.hidden = true);
    under = found;
    clock.setHover(found ? found.path.t[found.index] : null);
    showTip(x, y);
    return redraw(1);
  }

  function placeTip(x, y, width) {
    tip.style.transform = `translate(${Math.max(Math.min(x + 14, view.width - width), 4)}px, ${y > view.height - 110 ? y - 106 : y + 14}px)`;
  }

  function showTip(x, y) {
    tip.hidden = !under;
    if (!under) return;
    const { path, index } = under;
    const value = (column) => path[column]?.[index] ?? null;
    const spread = (column, form) => (value(column) === null ? "" : ` ± ${form(value(column)).text}`);
    const span = clock.full[1];
    tip.replaceChildren(
      h("b", {}, path.label),
      h("span", {}, `${timeText(path.t[index], 0.01, span)} ${timeUnit(span)}`),
      h("span", {}, `x ${number(value("x"))} m${spread("sd_x", length)}`),
      h("span", {}, `y ${number(value("y"))} m${spread("sd_y", length)}`),
      value("theta") !== null && h("span", {}, `θ ${angle(wrapped(value("theta"))).text}${spread("sd_theta", angle)}`) || "",
    );
    placeTip(x, y, 190);
  }

  cleanups.push(
    gestures(top, {
      hover,
      leave() {
        under = null;
        tip.hidden = true;
        clock.setHover(null);
        redraw(1);
      },
      click(x, y) {
        const mark = placed.find((p) => Math.hypot(p.x - x, p.y - y) <= p.size + 3);
        if (mark) return clock.setTime(mark.event.t0);
        const found = nearest(view, map.shown, x, y, 40);
        return found && clock.setTime(found.path.t[found.index]);
      },
      reset: () => map.fit(),
      pan(dx, dy) {
        if (clock.follow) clock.setFollow(false);
        view.pan(dx, dy);
        moved();
      },
      zoom(factor, x, y) {
        view.zoom(factor, ...(clock.follow ? [] : [x, y]));
        moved();
      },
    }),
  );

  top.addEventListener("keydown", (event) => {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const pan = (dx, dy) => (view.pan(dx, dy), moved());
    const act = {
      ArrowLeft: () => pan(40, 0),
      ArrowRight: () => pan(-40, 0),
      ArrowUp: () => pan(0, 40),
      ArrowDown: () => pan(0, -40),
      "+": () => (view.zoom(0.7), moved()),
      "=": () => (view.zoom(0.7), moved()),
      "-": () => (view.zoom(1 / 0.7), moved()),
      Home: () => map.fit(),
    }[event.key];
    if (!act) return;
    event.preventDefault();
    event.stopPropagation();
    act();
  });

  fitButton.addEventListener("click", () => map.fit());
  ellipses.addEventListener("click", () => {
    ellipses.setAttribute("aria-pressed", String(ellipses.getAttribute("aria-pressed") !== "true"));
    redraw(2);
  });

  // ---- out

  function tool(kind) {
    if (kind === "link") return copyLink();
    if (kind === "png") return exportPng();
    if (kind === "svg") return save(new Blob([mapSvg(drawing())], { type: "image/svg+xml" }), `${fileName}-map.svg`);
    return exportCsv();
  }

  // All that the SVG needs of what is seen.
  function drawing() {
    const claim = claiming();
    return { paths: map.shown, beacons, view, range: clock.range, subject, events: placed, claim, poses: claim ? draw.ellipsesAlong(view, claim, clock.range) : [] };
  }

  async function exportPng() {
    const canvas = h("canvas", {});
    const ctx = prepare(canvas);
    paintOn(ctx, paintBase);
    paintTop(ctx);
    let x = 12;
    for (const path of map.shown) {
      ctx.strokeStyle = colour(path.color);
      ctx.lineWidth = 2;
      ctx.setLineDash(path.dash);
      ctx.beginPath();
      ctx.moveTo(x, 16);
      ctx.lineTo(x + 22, 16);
      ctx.stroke();
      ctx.textAlign = "left";
      ctx.textBaseline = "middle";
      draw.halo(ctx, path.label, x + 28, 16, colour("--ink"));
      x += 44 + ctx.measureText(path.label).width;
    }
    save(await new Promise((done) => canvas.toBlob(done, "image/png")), `${fileName}-map.png`);
  }

  function exportCsv() {
    const columns = ["t", "x", "y", "theta", "sd_x", "sd_y", "sd_theta"];
    const units = ["s", "m", "m", "rad", "m", "m", "rad"];
    const lines = [["method", ...columns.map((c, i) => `${c} [${units[i]}]`)].join(",")];
    for (const path of map.shown) {
      for (let i = 0; i < path.t.length; i++) {
        if (path.t[i] < clock.range[0] || path.t[i] > clock.range[1]) continue;
        lines.push([quote(path.method), ...columns.map((c) => path[c]?.[i] ?? "")].join(","));
      }
    }
    const [a, b] = clock.range.map((t) => tick(t, 0.1));
    save(new Blob([lines.join("\r\n"), "\r\n"], { type: "text/csv" }), `${fileName}-path-${a}s-${b}s.csv`);
  }

  const sizes = new ResizeObserver(() => {
    if (!root.clientWidth) return;
    [view.width, view.height] = [root.clientWidth, root.clientHeight];
    if (fitted) map.fit();
    redraw(2);
  });
  sizes.observe(root);
  cleanups.push(
    () => sizes.disconnect(),
    onThemeChange(() => redraw(2)),
    clock.subscribe((what) => {
      if (what === "range" || what === "follow") redraw(2);
      else if (what === "time" || what === "hover") redraw(1);
    }),
  );
  return map;
}

function wrapped(theta) {
  return theta - 2 * Math.PI * Math.round(theta / (2 * Math.PI));
}

function toolIcon(path) {
  return s("svg", { viewBox: "0 0 20 20", "aria-hidden": "true" }, s("path", { d: path }));
}
