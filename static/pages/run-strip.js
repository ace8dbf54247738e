// The event strip: the whole run in one line. What happened, where the stamps pause, what is visible, where we are;
// drag to move the time, drag the window's edges to zoom, play at any speed.

import { timeIncrements, timeText, timeUnit } from "../lib/chart-axes.js";
import { h, s } from "../lib/dom.js";
import { drawEventMark, eventLegend, eventTip } from "../lib/events.js";
import { keys } from "../lib/keys.js";
import { colour, onThemeChange, withAlpha } from "../lib/palette.js";

const EDGE = 7; // px within which a window edge is caught

// Losses are common and long: a thin lane at the foot. What happened to the robot itself takes the full height.
const lane = (kind) => (kind.endsWith("_loss") ? [23, 5] : [4, 24]);
const MARK = 5; // px from a mark's middle to its edge
const markY = (e) => (e.kind.endsWith("_loss") ? 22 : 14);

export function mountStrip(host, clock) {
  const play = h("button", { type: "button", class: "icon-button strip-play", "aria-label": "Play", "data-hint": "Play or pause (space)" });
  const speed = h("button", { type: "button", class: "strip-speed", "data-hint": "Speed: click for faster, shift-click for slower ( ] and [ )" });
  const follow = h("button", { type: "button", class: "icon-button strip-follow", "aria-label": "Follow the robot", "data-hint": "Map and 3D follow the robot (f)" }, s("svg", { viewBox: "0 0 20 20", "aria-hidden": "true" }, s("circle", { cx: 10, cy: 10, r: 5 }), s("path", { d: "M10 2v4M10 14v4M2 10h4M14 10h4" })));
  const canvas = h("canvas", {});
  const track = h("div", { class: "strip-track", role: "slider", tabindex: "0", "aria-label": "Time", "aria-valuemin": clock.full[0], "aria-valuemax": clock.full[1] }, canvas);
  const tip = h("div", { class: "map-tip event-tip strip-tip", hidden: true });
  const legend = h("ul", { class: "strip-legend", "aria-label": "Events" });
  track.append(tip);
  const now = h("span", {});
  const rest = h("small", {});
  const all = h("button", { type: "button", class: "strip-all", "data-hint": "Show the whole run (double-click a plot)", hidden: true }, "whole run");
  host.append(h("div", { class: "strip-controls" }, play, speed, follow), track, h("div", { class: "strip-time" }, now, rest, all), legend);

  const span = clock.full[1] - clock.full[0];
  let marks = { motion: [], events: [], gaps: [] };
  let dirty = false;
  let grabbed = null; // "time" | "from" | "to" | "window"

  const x = (t) => 8 + ((t - clock.full[0]) / span) * (track.clientWidth - 16);
  const timeAt = (px) => clock.full[0] + ((px - 8) / (track.clientWidth - 16)) * span;

  function redraw() {
    if (dirty) return;
    dirty = true;
    requestAnimationFrame(() => {
      dirty = false;
      paint();
    });
  }

  function paint() {
    const ratio = devicePixelRatio;
    const [width, height] = [track.clientWidth, track.clientHeight];
    if (!width) return;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const ctx = canvas.getContext("2d");
    ctx.scale(ratio, ratio);
    ctx.font = `10px ${getComputedStyle(host).fontFamily}`;
    ctx.fillStyle = colour("--sunken");
    ctx.fillRect(x(clock.full[0]), 4, x(clock.full[1]) - x(clock.full[0]), 24);
    for (const [a, b] of marks.motion) bar(ctx, a, b, 4, 24, colour("--line-strong"), 0.55);
    for (const [a, b] of marks.gaps) bar(ctx, a, b, 23, 5, colour("--amber"), 0.9);
    for (const e of marks.events) bar(ctx, e.t0, e.t1, ...lane(e.kind), colour(e.color), e.faint ? 0.12 : 0.4);
    paintMarks(ctx);
    ticks(ctx, width, height);
    paintWindow(ctx);
    paintTime(ctx);
    say();
  }

  function bar(ctx, a, b, y, height, ink, alpha) {
    ctx.fillStyle = withAlpha(ink, alpha);
    ctx.fillRect(x(a), y, Math.max(x(b) - x(a), 2), height);
  }

  // Where events crowd, one mark stands for those within its reach; what was dismissed gives way.
  function paintMarks(ctx) {
    const taken = [];
    for (const e of [...marks.events].sort((a, b) => a.faint - b.faint || a.t0 - b.t0)) {
      const [at, y] = [x(e.t0), markY(e)];
      if (taken.some(([px, py]) => py === y && Math.abs(px - at) < 1.6 * MARK)) continue;
      taken.push([at, y]);
      drawEventMark(ctx, e, at, y, MARK);
    }
  }

  function ticks(ctx, width, height) {
    const step = timeIncrements.find((i) => (i / span) * width > 76) ?? span;
    ctx.fillStyle = colour("--ink-3");
    ctx.textAlign = "center";
    ctx.textBaseline = "bottom";
    for (let k = Math.ceil(clock.full[0] / step); k * step <= clock.full[1]; k++) {
      const at = x(k * step);
      ctx.fillRect(Math.round(at), 28, 1, 4);
      if (at > 12 && at < width - 12) ctx.fillText(timeText(k * step, step, clock.full[1]), at, height);
    }
  }

  function paintWindow(ctx) {
    if (clock.isFullRange) return;
    const [a, b] = clock.range.map(x);
    ctx.fillStyle = withAlpha(colour("--surface"), 0.62);
    ctx.fillRect(8, 4, Math.max(a - 8, 0), 24);
    ctx.fillRect(b, 4, Math.max(x(clock.full[1]) - b, 0), 24);
    ctx.strokeStyle = colour("--focus");
    ctx.lineWidth = 1.5;
    ctx.strokeRect(a, 3.5, Math.max(b - a, 2), 25);
    ctx.fillStyle = colour("--focus");
    for (const edge of [a, b]) ctx.fillRect(edge - 2, 10, 4, 12);
  }

  function paintTime(ctx) {
    if (clock.hover !== null) {
      ctx.fillStyle = colour("--ink-3");
      ctx.fillRect(x(clock.hover) - 0.5, 2, 1, 28);
    }
    const at = x(clock.time);
    ctx.fillStyle = colour("--ink");
    ctx.fillRect(at - 1, 2, 2, 28);
    ctx.beginPath();
    ctx.arc(at, 4, 4, 0, 7);
    ctx.fill();
  }

  function say() {
    const text = `${timeText(clock.time, 0.01, clock.full[1])}`;
    now.textContent = `${text} ${clock.full[1] < 180 ? "s" : ""}`;
    const happening = marks.events.find((e) => !e.faint && clock.time >= e.t0 && clock.time <= e.t1);
    rest.textContent = happening ? happening.label : `of ${timeText(clock.full[1], 0.1, clock.full[1])} ${timeUnit(clock.full[1])}`;
    all.hidden = clock.isFullRange;
    track.setAttribute("aria-valuenow", clock.time.toFixed(3));
    track.setAttribute("aria-valuetext", text);
    track.dataset.time = String(clock.time);
  }

  function controls() {
    const path = clock.playing ? "M6 4h3v12H6zM11 4h3v12h-3z" : "M6 3.500v13l11-6.500z";
    play.replaceChildren(s("svg", { viewBox: "0 0 20 20", "aria-hidden": "true" }, s("path", { d: path })));
    play.setAttribute("aria-label", clock.playing ? "Pause" : "Play");
    speed.textContent = `${clock.speed} ×`;
    follow.setAttribute("aria-pressed", String(clock.follow));
  }

  // ---- hands

  const local = (event) => event.clientX - track.getBoundingClientRect().left;

  track.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    const px = local(event);
    track.setPointerCapture(event.pointerId);
    grabbed = grip(px);
    if (grabbed === "time") clock.setTime(timeAt(px));
  });
  track.addEventListener("pointermove", (event) => {
    const px = local(event);
    if (!grabbed) {
      track.style.cursor = grip(px) === "time" ? "pointer" : "ew-resize";
      clock.setHover(timeAt(px));
      showTip(px);
      return;
    }
    const t = timeAt(px);
    if (grabbed === "time") clock.setTime(t);
    else if (grabbed === "from") clock.setRange(Math.min(t, clock.range[1] - 1e-3), clock.range[1]);
    else clock.setRange(clock.range[0], Math.max(t, clock.range[0] + 1e-3));
  });
  const drop = () => (grabbed = null);
  track.addEventListener("pointerup", drop);
  track.addEventListener("pointercancel", drop);
  track.addEventListener("pointerleave", () => {
    tip.hidden = true;
    if (!grabbed) clock.setHover(null);
  });

  // The events under the pointer: the mark within its reach first, else what lasts there.
  function showTip(px) {
    const apart = (e) => Math.abs(px - x(e.t0));
    const near = marks.events.filter((e) => apart(e) <= MARK + 2).sort((a, b) => apart(a) - apart(b));
    const under = near.length ? near : marks.events.filter((e) => px >= x(e.t0) && px <= x(e.t1));
    tip.hidden = !under.length;
    if (!under.length) return;
    tip.replaceChildren(...eventTip(under[0]), under.length > 1 ? h("span", { class: "dim" }, `and ${under.length - 1} more here`) : "");
    tip.style.transform = `translateX(${Math.max(Math.min(px - 20, track.clientWidth - 340), 0)}px)`;
  }
  track.addEventListener("dblclick", () => clock.resetRange());

  function grip(px) {
    if (clock.isFullRange || Math.abs(px - x(clock.time)) < 5) return "time";
    if (Math.abs(px - x(clock.range[0])) < EDGE) return "from";
    if (Math.abs(px - x(clock.range[1])) < EDGE) return "to";
    return "time";
  }

  track.addEventListener("keydown", (event) => {
    const act = { ArrowLeft: () => clock.step(event.shiftKey ? -25 : -1), ArrowRight: () => clock.step(event.shiftKey ? 25 : 1), Home: () => clock.setTime(clock.full[0]), End: () => clock.setTime(clock.full[1]) }[event.key];
    if (!act) return;
    event.preventDefault();
    event.stopPropagation();
    act();
  });
  play.addEventListener("click", () => clock.toggle());
  speed.addEventListener("click", (event) => (event.shiftKey ? clock.slower() : clock.faster()));
  follow.addEventListener("click", () => clock.setFollow(!clock.follow));
  all.addEventListener("click", () => clock.resetRange());
  keys("Run", {
    " ": ["play, pause", () => clock.toggle(), "space"],
    ",": ["step back, forward", () => clock.step(-1), ", ."],
    ".": [null, () => clock.step(1)],
    "[": ["slower, faster", () => clock.slower(), "[ ]"],
    "]": [null, () => clock.faster()],
    f: ["follow the robot", () => clock.setFollow(!clock.follow)],
  });

  clock.subscribe((what) => {
    if (what === "play" || what === "speed" || what === "follow") controls();
    redraw();
  });
  onThemeChange(redraw);
  new ResizeObserver(redraw).observe(track);
  controls();
  redraw();
  return {
    setMarks(more) {
      marks = { ...marks, ...more };
      host.dataset.events = String(marks.events.length);
      if (more.events) legend.replaceChildren(...eventLegend(marks.events.filter((e) => !e.faint)));
      redraw();
    },
  };
}

// Stretches in which the wheels turn (or truth moves), out of thinned readings: [[t0, t1], ...].
export function motionOf(series, least) {
  const stretches = [];
  for (const { t, y } of series) {
    for (let i = 1; i < t.length; i++) {
      if (y[i] === null || y[i - 1] === null || !(t[i] > t[i - 1])) continue;
      if (Math.abs(y[i] - y[i - 1]) / (t[i] - t[i - 1]) > least) stretches.push([t[i - 1], t[i]]);
    }
  }
  stretches.sort((a, b) => a[0] - b[0]);
  const joined = [];
  for (const [a, b] of stretches) {
    const last = joined[joined.length - 1];
    if (last && a <= last[1] + 0.4) last[1] = Math.max(last[1], b);
    else joined.push([a, b]);
  }
  return joined;
}
