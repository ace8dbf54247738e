// One time cursor per page: where we are (time), what we look at (range), and whether it plays.
// Plots, map, event strip and 3D scene subscribe; whoever moves it says so through the setters.
//
//   const clock = createTimeCursor({ t0: 0, t1: 63 });
//   clock.subscribe((what, clock) => ...)   what: "time" | "hover" | "range" | "play" | "speed" | "follow"
//
// `time` is the chosen instant (click, slider, play); `hover` the one under the pointer, null elsewhere.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 20, 60, 300];
const MIN_SPAN = 1e-3; // s: nothing here is sampled faster than a few kHz

export function createTimeCursor({ t0, t1 }) {
  const listeners = new Set();
  const full = [t0, Math.max(t1, t0 + MIN_SPAN)];
  let frame = 0;
  let last = 0;

  const clock = {
    full,
    time: t0,
    hover: null,
    range: [...full],
    playing: false,
    speed: 1,
    follow: false,

    subscribe(listener) {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },

    get isFullRange() {
      return clock.range[0] <= full[0] && clock.range[1] >= full[1];
    },

    setTime(t) {
      const next = clamp(t, full[0], full[1]);
      if (next === clock.time) return;
      clock.time = next;
      if (clock.playing && !clock.isFullRange) keepInView();
      tell("time");
    },

    setHover(t) {
      const next = t === null ? null : clamp(t, full[0], full[1]);
      if (next === clock.hover) return;
      clock.hover = next;
      tell("hover");
    },

    // The range stays within the run and never gets narrower than MIN_SPAN.
    setRange(a, b) {
      let lo = Math.min(a, b);
      let hi = Math.max(a, b);
      const span = clamp(hi - lo, MIN_SPAN, full[1] - full[0]);
      if (hi - lo < MIN_SPAN) lo = (lo + hi - MIN_SPAN) / 2;
      lo = clamp(lo, full[0], full[1] - span);
      hi = lo + span;
      if (lo === clock.range[0] && hi === clock.range[1]) return;
      clock.range = [lo, hi];
      tell("range");
    },

    resetRange() {
      clock.setRange(full[0], full[1]);
    },

    // factor < 1 zooms in; `at` stays where it is on the screen.
    zoom(factor, at = (clock.range[0] + clock.range[1]) / 2) {
      const [lo, hi] = clock.range;
      const span = clamp((hi - lo) * factor, MIN_SPAN, full[1] - full[0]);
      const share = (at - lo) / (hi - lo);
      clock.setRange(at - share * span, at + (1 - share) * span);
    },

    pan(seconds) {
      clock.setRange(clock.range[0] + seconds, clock.range[1] + seconds);
    },

    // One step is a five-hundredth of what is visible: a pixel or two on every plot.
    step(count) {
      clock.setTime(clock.time + (count * (clock.range[1] - clock.range[0])) / 500);
    },

    toggle() {
      clock.playing ? clock.pause() : clock.play();
    },

    play() {
      if (clock.playing) return;
      const end = clock.isFullRange ? full[1] : clock.range[1];
      if (clock.time >= end - MIN_SPAN) clock.time = clock.range[0];
      clock.playing = true;
      last = performance.now();
      frame = requestAnimationFrame(tick);
      tell("play");
    },

    pause() {
      if (!clock.playing) return;
      clock.playing = false;
      cancelAnimationFrame(frame);
      tell("play");
    },

    setSpeed(speed) {
      clock.speed = clamp(speed, SPEEDS[0], SPEEDS[SPEEDS.length - 1]);
      tell("speed");
    },

    faster() {
      clock.setSpeed(SPEEDS.find((s) => s > clock.speed) ?? clock.speed);
    },

    slower() {
      clock.setSpeed(SPEEDS.findLast((s) => s < clock.speed) ?? clock.speed);
    },

    setFollow(on) {
      clock.follow = on;
      tell("follow");
    },
  };

  function tell(what) {
    for (const listener of listeners) listener(what, clock);
  }

  // While playing inside a zoomed range the range travels along.
  function keepInView() {
    const [lo, hi] = clock.range;
    if (clock.time > hi || clock.time < lo) {
      const span = hi - lo;
      clock.setRange(clock.time - 0.05 * span, clock.time + 0.95 * span);
    }
  }

  function tick(now) {
    if (!clock.playing) return;
    clock.setTime(clock.time + (clock.speed * Math.min(now - last, 1000)) / 1000);
    last = now;
    if (clock.time >= full[1]) {
      clock.pause();
      return;
    }
    frame = requestAnimationFrame(tick);
  }

  return clock;
}

export { SPEEDS };

function clamp(value, lo, hi) {
  return Math.min(Math.max(value, lo), hi);
}
