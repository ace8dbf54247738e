// What the page shows, kept in its address: tab, view, range, time, methods, the enlarged plot. A link restores it all.

const TABS = ["path", "signals", "imu", "consistency", "gap", "files", "notes"];
const FORMER = { bias: "imu" }; // old links
const FOCUS = ["best", "C", "smoothed", "B", "A"]; // whose segments are shown first
const VIEWS = ["both", "map", "scene"];
const WRITE_DELAY = 250;

// `methods`: [{ name, has }] in the order of the keys. State tells its subscribers what changed: "tab", "view",
// "split", "big", "methods", "map", "events" (whose), "by" (the method judged); of the IMU tab "axis", "bias" (methods shown), "segments" (whose), "calibration".
export function createState(methods, clock) {
  const params = new URLSearchParams(location.search);
  const listeners = new Set();
  const has = methods.filter((m) => m.has).map((m) => m.name);
  const given = params.get("m");
  const wanted = given === null ? has : given.split(",");
  let timer = 0;

  const state = {
    tab: oneOf(FORMER[params.get("tab")] ?? params.get("tab"), TABS),
    axis: params.get("axis") ?? "gz",
    segments: params.get("seg"),
    calibration: params.get("cal"),
    events: params.get("ev"),
    by: params.get("by"),
    biasMethods: [],
    biasOff: new Set((params.get("off") ?? "").split(",").filter(Boolean)),
    view: oneOf(params.get("view"), VIEWS),
    split: within(params.get("split"), 10, 90) ?? 50,
    big: params.get("big"),
    map: numbers(params.get("map"), 3),
    methods,
    visible: new Map(methods.map((m) => [m.name, m.has && wanted.includes(m.name)])),

    set(name, value) {
      if (state[name] === value) return;
      state[name] = value;
      tell(name);
    },

    isVisible: (method) => state.visible.get(method) === true,

    toggle(method, on = !state.isVisible(method)) {
      if (!has.includes(method)) return;
      state.visible.set(method, on);
      tell("methods", method);
    },

    // A method that has just been estimated is shown.
    appear(method) {
      if (has.includes(method)) return;
      has.push(method);
      methods.find((m) => m.name === method).has = true;
      state.toggle(method, true);
    },

    // What the IMU tab can show of this run; an axis that it lacks gives way.
    adopt(imu) {
      state.biasMethods = imu.methods.filter((m) => !m.error).map((m) => m.method);
      if (!imu.axes.includes(state.axis)) state.axis = imu.axes.includes("gz") ? "gz" : imu.axes[0];
    },

    biasVisible: (method) => !state.biasOff.has(method),

    toggleBias(method) {
      if (!state.biasOff.delete(method)) state.biasOff.add(method);
      tell("bias", method);
    },

    focus: () => (state.biasMethods.includes(state.segments) ? state.segments : FOCUS.find((m) => state.biasMethods.includes(m))),

    subscribe(listener) {
      listeners.add(listener);
      return () => listeners.delete(listener);
    },

    writeNow: write,
  };

  const range = numbers(`${params.get("t0")},${params.get("t1")}`, 2);
  if (range) clock.setRange(...range);
  const time = numbers(params.get("t"), 1);
  if (time) clock.setTime(time[0]);

  clock.subscribe((what) => {
    if (what === "range" || (what === "time" && !clock.playing) || what === "play") writeLater();
  });

  function tell(what, detail) {
    for (const listener of listeners) listener(what, detail);
    writeLater();
  }

  function writeLater() {
    clearTimeout(timer);
    timer = setTimeout(write, WRITE_DELAY);
  }

  function write() {
    clearTimeout(timer);
    const shown = has.filter((name) => state.isVisible(name));
    const fields = {
      tab: state.tab === "path" ? null : state.tab,
      view: state.view === "both" ? null : state.view,
      split: state.split === 50 ? null : round(state.split),
      big: state.big,
      map: state.map?.map(round).join(","),
      t0: clock.isFullRange ? null : round(clock.range[0]),
      t1: clock.isFullRange ? null : round(clock.range[1]),
      t: clock.time === clock.full[0] ? null : round(clock.time),
      m: shown.length === has.length ? null : shown.join(","),
      axis: state.axis === "gz" ? null : state.axis,
      seg: state.segments,
      off: [...state.biasOff].join(",") || null,
      cal: state.calibration,
      ev: state.events,
      by: state.by,
    };
    const query = Object.entries(fields)
      .filter(([, value]) => value !== null && value !== undefined)
      .map(([name, value]) => `${name}=${encodeURIComponent(value).replaceAll("%2C", ",")}`)
      .join("&");
    history.replaceState(null, "", query ? `${location.pathname}?${query}` : location.pathname);
  }

  return state;
}

const oneOf = (value, known) => (known.includes(value) ? value : known[0]);
const round = (value) => Number(value.toPrecision(9));

function numbers(text, count) {
  const parts = (text ?? "").split(",").map((part) => (part === "" ? NaN : Number(part)));
  return parts.length === count && parts.every(Number.isFinite) ? parts : null;
}

function within(text, lo, hi) {
  const value = numbers(text, 1)?.[0];
  return value !== undefined && value >= lo && value <= hi ? value : null;
}
